#include "core/body_sampling.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstring>
#include <map>
#include <numbers>
#include <set>

#include "core/shape_evaluator.hpp"
#include "core/solver.hpp"
#include "scenes.hpp"

namespace mtled {
namespace {

// Voxels of 1 mm and some 100 samples per cell: a ball of 30 mm is sampled to a few tenths of a per cent.
constexpr double sampling_error = 0.01;
constexpr double radius = 30;
constexpr double ball_volume = 4 * std::numbers::pi / 3 * radius * radius * radius;
constexpr double spacing = 6;

using Inside = std::function<bool(const Vec3d&)>;

Inside ball_at(const Vec3d& centre, double r = radius) {
  return [=](const Vec3d& x) { return norm(x - centre) < r; };
}

template <class T>
Volume<T> paint(const Grid& grid, const std::function<T(const Vec3d&)>& value) {
  Volume<T> volume(grid);
  for (int k = 0; k < grid.size[2]; ++k)
    for (int j = 0; j < grid.size[1]; ++j)
      for (int i = 0; i < grid.size[0]; ++i) volume.at(i, j, k) = value(grid.point(i, j, k));
  return volume;
}

/// All that sample_body() needs; the body is where `inside`, rigid bodies where `label` is not 0.
struct Images {
  Mask body;
  Image modulus;
  LabelImage labels;
  std::vector<LabelMotion> motions;
  SamplingOptions options;

  Images(const Grid& grid, const Inside& inside, const std::function<double(const Vec3d&)>& shear_modulus = [](const Vec3d&) { return 1.0; },
         const std::function<int(const Vec3d&)>& label = [](const Vec3d&) { return 0; })
      : body(paint<std::uint8_t>(grid, [&](const Vec3d& x) { return std::uint8_t(inside(x)); })),
        modulus(paint<float>(grid, [&](const Vec3d& x) { return float(shear_modulus(x)); })),
        labels(paint<std::uint16_t>(grid, [&](const Vec3d& x) { return std::uint16_t(label(x)); })) {
    options.node_spacing_mm = spacing;
  }
  SampledBody sample() const { return sample_body(body, modulus, labels, motions, options); }
};

Grid plain_grid() { return {{73, 73, 73}, {-36, -36, -36}, {1, 1, 1}}; }

double total_volume(const IntegrationPoints& points) {
  double sum = 0;
  for (double v : points.volume) sum += v;
  return sum;
}
Vec3d centroid(const IntegrationPoints& points) {
  Vec3d sum{};
  for (std::size_t p = 0; p < points.size(); ++p) sum += points.volume[p] * points.position[p];
  return (1 / total_volume(points)) * sum;
}

TEST(SampleBody, KeepsVolumeAndCentroidOfABall) {
  const Vec3d centre{1.3, -0.7, 0.4};
  const SampledBody s = Images(plain_grid(), ball_at(centre)).sample();
  EXPECT_NEAR(total_volume(s.points), ball_volume, sampling_error * ball_volume);
  EXPECT_NEAR(s.body_volume_mm3, ball_volume, sampling_error * ball_volume);
  EXPECT_LT(norm(centroid(s.points) - centre), 0.1);  // a tenth of a voxel
  EXPECT_NEAR(double(s.points.size()) / double(s.cloud.size()), 1.8, 0.4);  // 2.08 inside, less with the outer nodes
  // Second moment: 1/5 V r^2 per axis. Whole cells at their centre instead of cut ones at their centroid are 3 % off.
  double moment = 0;
  for (std::size_t p = 0; p < s.points.size(); ++p) moment += s.points.volume[p] * squared_norm(s.points.position[p] - centre);
  EXPECT_NEAR(moment, 0.6 * ball_volume * radius * radius, 2 * sampling_error * ball_volume * radius * radius);
}

TEST(SampleBody, TakesTheMeanModulusOfTheBodyOnly) {
  // Linear in x inside, 1000 outside: no point may have a part of the outside.
  const auto modulus = [](const Vec3d& x) { return norm(x) < radius ? 2 + 0.02 * x.x : 1000.0; };
  const SampledBody s = Images(plain_grid(), ball_at({}), modulus).sample();
  double mean = 0, first_moment = 0;
  for (std::size_t p = 0; p < s.points.size(); ++p) {
    const double v = s.points.volume[p], mu = s.points.shear_modulus[p];
    mean += v * mu / total_volume(s.points), first_moment += v * mu * s.points.position[p].x / total_volume(s.points);
    EXPECT_NEAR(mu, 2 + 0.02 * s.points.position[p].x, 0.02 * 1.0);  // a voxel's step
    EXPECT_NEAR(s.points.bulk_modulus[p], bulk_modulus(mu, 0.49), 1e-9 * s.points.bulk_modulus[p]);
    EXPECT_EQ(s.points.density[p], 1e-6);
  }
  EXPECT_NEAR(mean, 2, 0.01);
  EXPECT_NEAR(first_moment, 0.02 * radius * radius / 5, 0.03 * 0.02 * radius * radius);
}

TEST(SampleBody, TakesTheArithmeticMeanAcrossAnInterface) {
  // 1 and 9 kPa meet at a plane through cells: the volume-weighted mean is kept, where sampling at points loses some.
  const double plane = 1.3;
  const SampledBody s = Images(plain_grid(), ball_at({}), [=](const Vec3d& x) { return x.x < plane ? 1.0 : 9.0; }).sample();
  double sum = 0;
  std::set<double> between;
  for (std::size_t p = 0; p < s.points.size(); ++p) {
    sum += s.points.volume[p] * s.points.shear_modulus[p];
    if (s.points.shear_modulus[p] > 1.01 && s.points.shear_modulus[p] < 8.99) between.insert(s.points.shear_modulus[p]);
  }
  // Voxel faces are at half millimetres: the painted plane is at 1.5.
  const double cap = std::numbers::pi * (radius - 1.5) * (radius - 1.5) * (2 * radius + 1.5) / 3;
  // The plane is known to half a sample (0.6 mm of the cells' 4.8 mm).
  EXPECT_NEAR(sum, ball_volume + 8 * cap, 8 * 0.6 * std::numbers::pi * radius * radius);
  EXPECT_FALSE(between.empty());
}

TEST(SampleBody, CompletesTheCornersOfAllCellsOfTheBody) {
  const SampledBody s = Images(plain_grid(), ball_at({})).sample();
  const Lattice& l = *s.cloud.lattice;
  EXPECT_DOUBLE_EQ(l.spacing, spacing);
  std::set<std::array<int, 3>> needed;  // corners of cells with a tenth or more of body, here by 12^3 samples
  int outside = 0;
  for (int k = 0; k + 1 < l.size[2]; ++k)
    for (int j = 0; j + 1 < l.size[1]; ++j)
      for (int i = 0; i + 1 < l.size[0]; ++i) {
        int count = 0;
        constexpr int n = 12;
        for (int c = 0; c < n * n * n; ++c) {
          const Vec3d t{(c % n + 0.5) / n, (c / n % n + 0.5) / n, (c / n / n + 0.5) / n};
          count += norm(l.origin + spacing * (Vec3d{double(i), double(j), double(k)} + t)) < radius;
        }
        bool complete = true;
        for (int c = 0; c < 8; ++c) complete = complete && l.node(i + (c & 1), j + (c >> 1 & 1), k + (c >> 2)) >= 0;
        if (count > 0.15 * n * n * n) {
          EXPECT_TRUE(complete) << i << " " << j << " " << k;
        }
        if (count < 0.05 * n * n * n && count > 0 && !complete) ++outside;
      }
  EXPECT_GT(outside, 0);  // and slivers need not have them
  bool beyond_the_surface = false;
  for (const Vec3d& x : s.cloud.nodes) beyond_the_surface = beyond_the_surface || norm(x) > radius + 1;
  EXPECT_TRUE(beyond_the_surface);
  for (std::size_t n = 0; n < s.cloud.size(); ++n) {
    const auto& c = s.cloud.lattice_ijk[n];
    EXPECT_EQ(l.node(c[0], c[1], c[2]), int(n));
    EXPECT_LT(norm(l.origin + spacing * Vec3d{double(c[0]), double(c[1]), double(c[2])} - s.cloud.nodes[n]), 1e-9);
  }
  // The lattice is anchored at the first voxel.
  for (int a = 0; a < 3; ++a) EXPECT_NEAR(std::remainder(l.origin[a] + 36, spacing), 0, 1e-9);
}

TEST(SampleBody, ASlightlyDifferentMaskKeepsTheNodes) {
  const SampledBody a = Images(plain_grid(), ball_at({})).sample(), b = Images(plain_grid(), ball_at({}, 0.97 * radius)).sample();
  std::size_t common = 0;
  for (const Vec3d& x : b.cloud.nodes) common += std::find(a.cloud.nodes.begin(), a.cloud.nodes.end(), x) != a.cloud.nodes.end();
  EXPECT_EQ(common, b.cloud.size());
}

/// A ball with two rigid boxes: label 3 is thick and moves by (1, 2, 3), label 5 turns, label 7 has no motion.
Images ball_with_bones() {
  const auto label = [](const Vec3d& x) {
    if (std::abs(x.x) < 8 && std::abs(x.y) < 8 && std::abs(x.z) < 14) return 3;
    if (std::abs(x.x - 18) < 4 && std::abs(x.y) < 4 && std::abs(x.z) < 7) return 5;
    if (std::abs(x.x + 18) < 4 && std::abs(x.y) < 4 && std::abs(x.z) < 4) return 7;
    return 0;
  };
  Images images(plain_grid(), ball_at({}), [](const Vec3d&) { return 1.0; }, label);
  images.motions = {{3, {{}, Mat3d::identity(), {1, 2, 3}}}, {5, {{18, 0, 0}, rotation_matrix({0, 0, 0.2}), {}}}};
  return images;
}

/// Volume of the pieces of each set, from their stiffness in tissue of one modulus [mm^3].
std::vector<double> piece_volumes(const SampledBody& s, const SamplingOptions& options, double modulus) {
  std::vector<double> volume(s.rigid.set_names.size(), 0);
  const double per_volume = options.rigid_stiffness * (bulk_modulus(modulus, 0.49) + 4 * modulus / 3) / (options.node_spacing_mm * options.node_spacing_mm);
  for (std::size_t p = 0; p < s.rigid.set.size(); ++p) volume[std::size_t(s.rigid.set[p])] += s.rigid.stiffness[p] / per_volume;
  return volume;
}

TEST(SampleBody, PiecesHaveTheVolumeAndTheMotionOfTheirLabel) {
  const Images images = ball_with_bones();
  const SampledBody s = images.sample();
  ASSERT_EQ(s.rigid.set_names, (std::vector<std::string>{"label 3", "label 5"}));
  EXPECT_TRUE(s.labels_outside.empty());
  const std::vector<double> volume = piece_volumes(s, images.options, 1);
  // Boxes of 15 x 15 x 27 and 7 x 7 x 13 voxels of 1 mm, samples of 1.2 to 1.5 mm; 8 and 2 % off as measured.
  EXPECT_NEAR(volume[0], 15 * 15 * 27, 0.1 * 15 * 15 * 27);
  EXPECT_NEAR(volume[1], 7 * 7 * 13, 0.1 * 7 * 7 * 13);
  std::vector<Vec3d> moment(2);
  for (std::size_t p = 0; p < s.rigid.position.size(); ++p) {
    const Vec3d& x = s.rigid.position[p];
    const std::size_t set = std::size_t(s.rigid.set[p]);
    EXPECT_LT(norm(s.rigid.displacement[p] - images.motions[set].motion.displacement(x)), 1e-12);
    moment[set] += (s.rigid.stiffness[p] / volume[set]) * x;
  }
  const double per_volume = (bulk_modulus(1, 0.49) + 4.0 / 3) / (spacing * spacing);
  EXPECT_LT(norm((1 / per_volume) * moment[0]), 0.75);                     // centroids, to half a sample
  EXPECT_LT(norm((1 / per_volume) * moment[1] - Vec3d{18, 0, 0}), 0.75);
  // Soft tissue and pieces share the body: nothing is counted twice or lost. Label 7 does not move: it is soft.
  EXPECT_NEAR(total_volume(s.points) + volume[0] + volume[1], ball_volume, sampling_error * ball_volume);
}

TEST(SampleBody, TheModulusOfRigidBodiesMattersNowhere) {
  Images images = ball_with_bones();
  const SampledBody soft = images.sample();
  for (std::size_t v = 0; v < images.modulus.data.size(); ++v)
    if (images.labels.data[v] == 3 || images.labels.data[v] == 5) images.modulus.data[v] = 40;
  const SampledBody stiff = images.sample();
  EXPECT_EQ(stiff.points.shear_modulus, soft.points.shear_modulus);
  EXPECT_EQ(stiff.points.position, soft.points.position);
  EXPECT_EQ(stiff.rigid.stiffness, soft.rigid.stiffness);
}

TEST(SampleBody, SpringsScaleWithTheTissueAround) {
  Images images = ball_with_bones();
  for (std::size_t v = 0; v < images.modulus.data.size(); ++v) images.modulus.data[v] = images.labels.data[v] == 3 ? 50.0f : 4.0f;
  const SampledBody s = images.sample();
  // 4 kPa everywhere, in pieces with soft tissue in their cell and without: the volumes come out as before.
  const std::vector<double> in_soft = piece_volumes(s, images.options, 4), expected = piece_volumes(ball_with_bones().sample(), images.options, 1);
  for (std::size_t set : {0u, 1u}) EXPECT_NEAR(in_soft[set], expected[set], 1e-6 * expected[set]);
}

/// A ball that a thin plate across the y axis pushes by 3 mm against a bone that stays; the lattice is `shift` mm off.
Images ball_with_plate(double shift) {
  Grid grid = plain_grid();
  grid.origin = grid.origin - Vec3d{0, shift, 0};  // the lattice is anchored at the first voxel
  grid.size[1] += 6;
  const auto label = [](const Vec3d& x) {
    if (std::abs(x.x) < 12 && std::abs(x.z) < 12 && std::abs(x.y - 7) < 1.6) return 1;  // 3 mm thick: half a node spacing
    if (std::abs(x.x) < 8 && std::abs(x.z) < 8 && std::abs(x.y + 18) < 5) return 2;
    return 0;
  };
  Images images(grid, ball_at({}), [](const Vec3d&) { return 1.0; }, label);
  images.motions = {{1, {{}, Mat3d::identity(), {0, 3, 0}}}, {2, {}}};
  return images;
}

TEST(SampleBody, AThinRigidPartMovesTheBodyWhereverTheLatticeLies) {
  const auto field = [](const Images& images, const std::vector<Vec3d>& places) {
    const SampledBody s = images.sample();
    const ShapeEvaluator evaluator(s.cloud, {}, {});
    const Solution solution = solve(evaluator, s.points, {}, {}, springs_on(s.rigid, evaluator));
    EXPECT_TRUE(solution.converged);
    std::vector<Vec3d> u(places.size());
    for (std::size_t p = 0; p < places.size(); ++p) EXPECT_TRUE(displacement_at(evaluator, solution.parameter, places[p], u[p]));
    return u;
  };
  const std::vector<Vec3d> plate{{0, 7, 0}, {8, 7, 8}, {-8, 7, 4}}, away{{0, 20, 0}, {15, 10, 0}, {0, -5, 0}, {-10, 2, 12}, {5, 0, -20}};
  std::vector<Vec3d> places = plate;
  places.insert(places.end(), away.begin(), away.end());
  Images fine = ball_with_plate(0);
  fine.options.node_spacing_mm = 2.5;
  const std::vector<Vec3d> expected = field(fine, places);
  // 0 to 5 mm: the plate lies on a plane of nodes, between two, and at all thirds of the way.
  constexpr double largest_error = 0.4;  // of 3 mm; 0.29 measured, in the narrow gap between plate and bone, else 0.2
  for (int shift = 0; shift < 6; ++shift) {
    const std::vector<Vec3d> u = field(ball_with_plate(shift), places);
    for (std::size_t p = 0; p < places.size(); ++p)
      EXPECT_LT(norm(u[p] - expected[p]), largest_error) << "shift " << shift << ", place " << p << ": " << u[p].y << " for " << expected[p].y;
  }
}

TEST(SampleBody, ReportsLabelsOutsideTheBody) {
  Images images = ball_with_bones();
  for (int k = 20; k < 40; ++k) images.labels.at(40, 40, k) = 9;  // one voxel wide, between the planes of nodes: still sampled
  images.labels.at(1, 1, 1) = 11;                                 // in a corner of the image
  images.motions.push_back({9, {}}), images.motions.push_back({11, {}}), images.motions.push_back({12, {}});  // 12: in no voxel at all
  EXPECT_EQ(images.sample().labels_outside, (std::vector<int>{11, 12}));
}

void expect_same_sampling(const SampledBody& a, const SampledBody& b) {
  ASSERT_EQ(a.cloud.size(), b.cloud.size());
  ASSERT_EQ(a.points.size(), b.points.size());
  for (std::size_t n = 0; n < a.cloud.size(); ++n) ASSERT_LT(norm(a.cloud.nodes[n] - b.cloud.nodes[n]), 1e-9);
  for (std::size_t p = 0; p < a.points.size(); ++p) {
    ASSERT_LT(norm(a.points.position[p] - b.points.position[p]), 1e-9);
    ASSERT_NEAR(a.points.volume[p], b.points.volume[p], 1e-9);
    ASSERT_NEAR(a.points.shear_modulus[p], b.points.shear_modulus[p], 1e-9);
  }
  ASSERT_EQ(a.rigid.position.size(), b.rigid.position.size());
  for (std::size_t p = 0; p < a.rigid.position.size(); ++p) {
    ASSERT_LT(norm(a.rigid.position[p] - b.rigid.position[p]), 1e-9);
    ASSERT_NEAR(a.rigid.stiffness[p], b.rigid.stiffness[p], 1e-9 * b.rigid.stiffness[p]);
  }
}

/// An egg with a bone in it, without any symmetry; samples never fall on a face between voxels.
Images egg(const Grid& grid) {
  const auto inside = [](const Vec3d& x) { return squared_norm(Vec3d{x.x / 25, x.y / 31, (x.z - 0.2 * x.x) / 22}) < 1; };
  const auto modulus = [](const Vec3d& x) { return 3 + 0.01 * x.x + 0.02 * x.y - 0.03 * x.z; };
  const auto label = [](const Vec3d& x) { return std::abs(x.x - 5) < 8 && std::abs(x.y + 2) < 7 && std::abs(x.z) < 9 ? 4 : 0; };
  Images images(grid, inside, modulus, label);
  images.motions = {{4, {{}, Mat3d::identity(), {0, 0, 4}}}};
  images.options.node_spacing_mm = 5.8;
  return images;
}

TEST(SampleBody, DoesNotDependOnTheOrderOfTheVoxels) {
  // 2 * 34.8 = 12 spacings between the first and the last voxel, so that both anchor the same lattice.
  const Grid straight{{59, 59, 59}, {-34.8, -34.8, -34.8}, {1.2, 1.2, 1.2}};
  const SampledBody expected = egg(straight).sample();
  EXPECT_GT(expected.rigid.position.size(), 10u);
  Grid flipped = straight;
  flipped.origin = {34.8, 34.8, -34.8};
  flipped.direction = {{{-1, 0, 0}, {0, -1, 0}, {0, 0, 1}}};
  expect_same_sampling(egg(flipped).sample(), expected);
  Grid sagittal = straight;  // axes i, j, k along y, z, x
  sagittal.direction = {{{0, 0, 1}, {1, 0, 0}, {0, 1, 0}}};
  expect_same_sampling(egg(sagittal).sample(), expected);
}

TEST(SampleBody, KeepsVolumeAndCentroidInAnObliqueAnisotropicImage) {
  const Vec3d centre{100, -250, 700};  // far from the image's origin
  Grid grid{{90, 60, 40}, {}, {0.8, 1.2, 1.9}, rotation_matrix({0.4, -0.3, 0.5})};
  grid.origin = centre - grid.direction * Vec3d{0.8 * 44.5, 1.2 * 29.5, 1.9 * 19.5};
  const SampledBody s = Images(grid, ball_at(centre)).sample();
  EXPECT_NEAR(total_volume(s.points), ball_volume, sampling_error * ball_volume);
  EXPECT_LT(norm(centroid(s.points) - centre), 0.1);
  for (std::size_t p = 0; p < s.points.size(); ++p) EXPECT_LT(norm(s.points.position[p] - centre), radius + 1.5);
}

TEST(SampleBody, ABodyThatFillsTheImageKeepsItsOuterHalfVoxels) {
  // Samples of 1, 1 and 1.25 mm are half a voxel: the faces of the body lie between them, and the volume is exact.
  Images images({{16, 20, 14}, {0, 0, 0}, {2, 2, 2.5}}, [](const Vec3d&) { return true; });
  images.options.node_spacing_mm = 5;
  const SampledBody s = images.sample();
  EXPECT_NEAR(total_volume(s.points), 32 * 40 * 35, 1e-6);
  EXPECT_LT(norm(centroid(s.points) - Vec3d{15, 19, 16.25}), 1e-9);
}

TEST(SampleBody, EveryPointHasAGoodSupport) {
  const SampledBody s = ball_with_bones().sample();
  const ShapeEvaluator evaluator(s.cloud, {}, {});
  int enlarged = 0;
  for (const Vec3d& x : s.points.position) {
    ShapeFunctions shapes;
    int enlargements = 0;
    EXPECT_TRUE(evaluator.at(x, shapes, &enlargements));
    enlarged += enlargements > 0;
  }
  EXPECT_LT(enlarged, 0.01 * double(s.points.size()));  // completed corners make enlargement the exception
}

TEST(SampleBody, BulkModulusIsTheMeanOfItsImageInsideTheBody) {
  // An image that is k of nu = 0.3 everywhere gives what the option gives; one that jumps gives the mean of mixed cells.
  const auto halves = [](const Vec3d& x) { return x.x < 0 ? 1.0 : 3.0; };
  Images images(plain_grid(), ball_at({}), halves);
  const auto with_bulk = [&](double left, double right) {
    Image bulk = images.modulus;
    for (float& m : bulk.data) m = m > 2 ? float(3 * right) : float(left);
    return sample_body(images.body, images.modulus, images.labels, images.motions, images.options, &bulk).points;
  };
  images.options.poisson_ratio = 0.3;
  const IntegrationPoints plain = images.sample().points, same = with_bulk(bulk_modulus(1, 0.3), bulk_modulus(1, 0.3)), mixed = with_bulk(2, 50);
  ASSERT_EQ(same.size(), plain.size());
  int between = 0;
  for (std::size_t p = 0; p < plain.size(); ++p) {
    EXPECT_NEAR(same.bulk_modulus[p], plain.bulk_modulus[p], 1e-6 * plain.bulk_modulus[p]);
    const double share = (mixed.shear_modulus[p] - 1) / 2;  // of the right half in the cell
    EXPECT_NEAR(mixed.bulk_modulus[p], 2 * (1 - share) + 150 * share, 1e-4);
    between += share > 0.1 && share < 0.9;
  }
  EXPECT_GT(between, 10);
}

TEST(SampleBody, ErrorsSayWhatIsWrong) {
  const auto error = [](const Images& images) {
    Failure failure{};
    const std::string message = scenes::error_of([&] { images.sample(); }, &failure);
    EXPECT_EQ(failure, Failure::input) << message;
    return message;
  };
  EXPECT_NE(error(Images(plain_grid(), [](const Vec3d&) { return false; })).find("mask is empty"), std::string::npos);
  EXPECT_NE(error(Images(plain_grid(), ball_at({}, 4))).find("nodes fit into the body"), std::string::npos);
  EXPECT_NE(error(Images(plain_grid(), ball_at({}), [](const Vec3d& x) { return x.x < 0 ? 1.0 : 0.0; })).find("shear modulus is not positive"), std::string::npos);
  Images rigid(plain_grid(), ball_at({}), [](const Vec3d&) { return 1.0; }, [](const Vec3d&) { return 1; });
  rigid.motions = {{1, {}}};
  EXPECT_NE(error(rigid).find("no soft tissue"), std::string::npos);
  Images images(plain_grid(), ball_at({}));
  images.options.node_spacing_mm = 0;
  EXPECT_NE(error(images).find("node spacing"), std::string::npos);
  images.options.node_spacing_mm = 0.01;
  EXPECT_NE(error(images).find("use a larger spacing"), std::string::npos);
  images.options.node_spacing_mm = 6;
  images.options.poisson_ratio = 0.5;
  EXPECT_NE(error(images).find("Poisson ratio"), std::string::npos);
}

}  // namespace
}  // namespace mtled
