#include "core/shape_evaluator.hpp"

#include <gtest/gtest.h>

#include <random>

#include "core/stencils.hpp"
#include "scenes.hpp"

namespace mtled {
namespace {

using scenes::Box;

constexpr double reproduction_tolerance = 1e-10;  ///< double precision, moment matrices of condition up to 1e4
const Box box{{6, 6, 6}, 5.0};
const double h = box.spacing;

std::vector<Vec3d> places_inside(int count) {
  std::mt19937 random(4);
  std::uniform_real_distribution<double> within(0.02 * h, box.length(0) - 0.02 * h);
  std::vector<Vec3d> result;
  for (int n = 0; n < count; ++n) result.push_back({within(random), within(random), within(random)});
  return result;
}

void expect_linear_reproduction(const ShapeEvaluator& evaluator, const Vec3d& x) {
  ShapeFunctions s;
  ASSERT_TRUE(evaluator.at(x, s));
  double one = 0;
  Vec3d position{}, gradient_of_one{};
  Mat3d gradient;
  for (std::size_t i = 0; i < s.node.size(); ++i) {
    const Vec3d p = evaluator.cloud().nodes[std::size_t(s.node[i])] - x;
    one += s.value[i], position += s.value[i] * p, gradient_of_one += s.gradient[i];
    for (int a = 0; a < 3; ++a)
      for (int b = 0; b < 3; ++b) gradient[a][b] += p[a] * s.gradient[i][b];
  }
  EXPECT_NEAR(one, 1, reproduction_tolerance);
  EXPECT_LT(norm(position), reproduction_tolerance * h);
  EXPECT_LT(norm(gradient_of_one), reproduction_tolerance / h);
  for (int a = 0; a < 3; ++a)
    for (int b = 0; b < 3; ++b) EXPECT_NEAR(gradient[a][b], a == b, reproduction_tolerance);
}

double value_of(const ShapeFunctions& s, int node) {
  for (std::size_t i = 0; i < s.node.size(); ++i)
    if (s.node[i] == node) return s.value[i];
  return 0;
}

/// A node inside, a face and an edge column: cells with one to eight prescribed corners.
std::vector<std::uint8_t> some_prescribed(const Cloud& cloud) {
  std::vector<std::uint8_t> flags(cloud.size(), 0);
  for (std::size_t n = 0; n < cloud.size(); ++n) {
    const auto& c = cloud.lattice_ijk[n];
    const bool column = c[0] >= 2 && c[0] <= 3 && c[1] >= 2 && c[1] <= 3 && c[2] >= 2 && c[2] <= 4;
    flags[n] = c[2] == 0 || column || (c[0] == 5 && c[1] == 5 && c[2] == 5);
  }
  return flags;
}

struct Bases : testing::TestWithParam<MlsOptions> {};
INSTANTIATE_TEST_SUITE_P(All, Bases, testing::Values(MlsOptions{Basis::linear, 1.75}, MlsOptions{Basis::quadratic, 2.5}, MlsOptions{Basis::modified_quadratic, 2.25}),
                         [](const auto& basis) { return basis.param.basis == Basis::linear ? "Linear" : basis.param.basis == Basis::quadratic ? "Quadratic" : "Modified"; });

TEST_P(Bases, ReproduceLinearFieldsOnALattice) {
  const Cloud cloud = scenes::lattice_box(box);
  const ShapeEvaluator evaluator(cloud, {}, GetParam());
  for (const Vec3d& x : places_inside(100)) expect_linear_reproduction(evaluator, x);
}

TEST_P(Bases, ReproduceLinearFieldsOnACoupledLattice) {
  const Cloud cloud = scenes::lattice_box(box);
  const ShapeEvaluator evaluator(cloud, some_prescribed(cloud), GetParam());
  int in_coupled_cells = 0;
  for (const Vec3d& x : places_inside(200)) {
    expect_linear_reproduction(evaluator, x);
    in_coupled_cells += evaluator.coupled(cell_of(*evaluator.cloud().lattice, x));
  }
  EXPECT_GT(in_coupled_cells, 50);
}

TEST_P(Bases, ReproduceLinearFieldsOnAJitteredCloud) {
  const Cloud cloud = scenes::jittered_box(box);
  const ShapeEvaluator evaluator(cloud, {}, GetParam());
  for (const Vec3d& x : places_inside(100)) expect_linear_reproduction(evaluator, x);
}

TEST_P(Bases, InterpolatePrescribedNodesOfALattice) {
  const Cloud cloud = scenes::lattice_box(box);
  const auto flags = some_prescribed(cloud);
  const ShapeEvaluator evaluator(cloud, flags, GetParam()), uncoupled(cloud, {}, GetParam());
  double largest_uncoupled = 0;
  for (std::size_t n = 0; n < cloud.size(); ++n) {
    if (!flags[n]) continue;
    ShapeFunctions s;
    ASSERT_TRUE(evaluator.at(cloud.nodes[n], s));
    for (std::size_t i = 0; i < s.node.size(); ++i) EXPECT_NEAR(s.value[i], s.node[i] == int(n), 1e-12);
    ASSERT_TRUE(uncoupled.at(cloud.nodes[n], s));
    largest_uncoupled = std::max(largest_uncoupled, std::abs(value_of(s, int(n)) - 1));
  }
  EXPECT_GT(largest_uncoupled, 0.05);  // moving least squares alone does not interpolate
}

TEST_P(Bases, GradientsAreDifferencesOfValuesInFreeAndCoupledCells) {
  const Cloud cloud = scenes::lattice_box(box);
  const ShapeEvaluator evaluator(cloud, some_prescribed(cloud), GetParam());
  constexpr double step = 1e-4;        // [spacings]
  constexpr double truncation = 1e-6;  // step^2 times third derivatives up to 100
  int coupled = 0;
  for (const Vec3d& x : places_inside(60)) {
    bool near_a_face = false;  // where coupled functions have a kink
    for (int a = 0; a < 3; ++a) near_a_face = near_a_face || std::abs(x[a] / h - std::round(x[a] / h)) < 2 * step;
    if (near_a_face) continue;
    coupled += evaluator.coupled(cell_of(*evaluator.cloud().lattice, x));
    ShapeFunctions s, up, down;
    int enlarged = 0, enlarged_up = 0, enlarged_down = 0;
    ASSERT_TRUE(evaluator.at(x, s, &enlarged));
    for (int a = 0; a < 3; ++a) {
      Vec3d d{};
      d[a] = step * h;
      ASSERT_TRUE(evaluator.at(x + d, up, &enlarged_up) && evaluator.at(x - d, down, &enlarged_down));
      if (enlarged_up != enlarged || enlarged_down != enlarged) continue;
      for (std::size_t i = 0; i < s.node.size(); ++i)
        EXPECT_NEAR(h * s.gradient[i][a], (value_of(up, s.node[i]) - value_of(down, s.node[i])) / (2 * step), truncation);
    }
  }
  EXPECT_GT(coupled, 10);
}

TEST(ShapeEvaluator, GradientsAreDifferencesOfValuesOnAJitteredCloud) {  // not with the modified basis: the mean radius that scales its penalty varies
  const Cloud cloud = scenes::jittered_box(box);
  constexpr double step = 1e-4, truncation = 1e-5;  // [spacings]; step^2 times third derivatives up to 1000, radii differ by a half
  for (const MlsOptions& options : {MlsOptions{Basis::linear, 1.75}, MlsOptions{Basis::quadratic, 2.5}, MlsOptions{Basis::linear, 1.75, 20}, MlsOptions{Basis::quadratic, 2.25, 45}}) {
    const ShapeEvaluator evaluator(cloud, {}, options);
    int compared = 0;
    for (const Vec3d& x : places_inside(60)) {
      ShapeFunctions s, up, down;
      int enlarged = 0, enlarged_up = 0, enlarged_down = 0;
      ASSERT_TRUE(evaluator.at(x, s, &enlarged));
      for (int a = 0; a < 3; ++a) {
        Vec3d d{};
        d[a] = step * h;
        ASSERT_TRUE(evaluator.at(x + d, up, &enlarged_up) && evaluator.at(x - d, down, &enlarged_down));
        if (enlarged_up != enlarged || enlarged_down != enlarged) continue;
        ++compared;
        for (std::size_t i = 0; i < s.node.size(); ++i) EXPECT_NEAR(h * s.gradient[i][a], (value_of(up, s.node[i]) - value_of(down, s.node[i])) / (2 * step), truncation);
      }
    }
    EXPECT_GT(compared, 150);
  }
}

TEST(ShapeEvaluator, SupportsByCountFollowAGradedCloud) {
  // Spacing from 1 to 4 mm along x; in the middle everywhere about the wanted number of nodes.
  std::vector<Vec3d> nodes;
  for (double x = 0, step = 1; x < 60; x += step, step = 1 + 3 * x / 60)
    for (double y = 0; y < 24; y += step)
      for (double z = 0; z < 24; z += step) nodes.push_back({x, y, z});
  const Cloud cloud = make_cloud(nodes, std::nullopt);
  for (const int count : {16, 25}) {
    MlsOptions options;
    options.count = count;
    const ShapeEvaluator evaluator(cloud, {}, options);
    double sum = 0;
    int places = 0;
    for (double x = 6; x < 50; x += 1.7)
      for (double y = 9.1; y < 15; y += 1.3, ++places) {
        ShapeFunctions s;
        ASSERT_TRUE(evaluator.at({x, y, 12.3}, s));
        sum += double(s.node.size());
        EXPECT_LT(s.node.size(), std::size_t(2 * count));
      }
    EXPECT_NEAR(sum / places, count, 0.2 * count);
  }
}

TEST(ShapeEvaluator, CellsWithAllCornersPrescribedAreTrilinear) {
  const Cloud cloud = scenes::lattice_box(box);
  const ShapeEvaluator evaluator(cloud, std::vector<std::uint8_t>(cloud.size(), 1), {});
  ShapeFunctions s;
  ASSERT_TRUE(evaluator.at({2.25 * h, 3.5 * h, 1.125 * h}, s));
  const Lattice& l = *cloud.lattice;
  EXPECT_NEAR(value_of(s, l.node(2, 3, 1)), 0.75 * 0.5 * 0.875, 1e-12);
  EXPECT_NEAR(value_of(s, l.node(3, 4, 2)), 0.25 * 0.5 * 0.125, 1e-12);
  for (std::size_t i = 0; i < s.node.size(); ++i)
    if (s.node[i] == l.node(3, 3, 1)) {
      EXPECT_LT(norm(s.gradient[i] - (1 / h) * Vec3d{0.5 * 0.875, -0.25 * 0.875, -0.25 * 0.5}), 1e-12);
    }
  double others = 0;
  for (std::size_t i = 0; i < s.node.size(); ++i) {
    const auto& c = cloud.lattice_ijk[std::size_t(s.node[i])];
    if (c[0] < 2 || c[0] > 3 || c[1] < 3 || c[1] > 4 || c[2] < 1 || c[2] > 2) others = std::max(others, std::abs(s.value[i]) + norm(s.gradient[i]));
  }
  EXPECT_LT(others, 1e-12);
}

TEST(ShapeEvaluator, ValuesAreContinuousAcrossCellFaces) {
  const Cloud cloud = scenes::lattice_box(box);
  const ShapeEvaluator evaluator(cloud, some_prescribed(cloud), {});
  constexpr double gap = 1e-5, largest_slope = 10;  // [spacings], [1 / spacing]
  std::mt19937 random(8);
  std::uniform_real_distribution<double> within(0.1, 5.9);
  for (int n = 0; n < 60; ++n)
    for (int a = 0; a < 3; ++a) {
      Vec3d x = h * Vec3d{within(random), within(random), within(random)}, d{};
      x[a] = h * (1 + n % 5), d[a] = gap * h;
      ShapeFunctions left, right;
      ASSERT_TRUE(evaluator.at(x - d, left) && evaluator.at(x + d, right));
      for (int node = 0; node < int(cloud.size()); ++node)
        EXPECT_NEAR(value_of(left, node), value_of(right, node), 2 * gap * largest_slope);
    }
}

TEST(ShapeEvaluator, PlacesOnTheUpperFaceBelongToTheLastCell) {
  const Cloud cloud = scenes::lattice_box(box);
  const ShapeEvaluator evaluator(cloud, {}, {});
  EXPECT_EQ(cell_of(*evaluator.cloud().lattice, {6 * h, 6 * h, 6 * h}), (std::array<int, 3>{5, 5, 5}));
  EXPECT_EQ(cell_of(*evaluator.cloud().lattice, {6 * h * (1 - 1e-12), 0.5 * h, 0}), (std::array<int, 3>{5, 0, 0}));
  EXPECT_TRUE(evaluator.covers({6 * h, 6 * h, 6 * h}));
  EXPECT_TRUE(evaluator.covers({0, 0, 0}));
  EXPECT_FALSE(evaluator.covers({6.1 * h, 3 * h, 3 * h}));
  EXPECT_FALSE(evaluator.covers({-0.1 * h, 3 * h, 3 * h}));
}

TEST(ShapeEvaluator, CoversAGeneralCloudUpToOneSpacing) {
  const Cloud cloud = scenes::jittered_box(box);
  const ShapeEvaluator evaluator(cloud, {}, {});
  EXPECT_TRUE(evaluator.covers({3 * h, 3 * h, 3 * h}));
  EXPECT_FALSE(evaluator.covers({3 * h, 3 * h, 9 * h}));
}

TEST(ShapeEvaluator, OutsideCornersNeedEnlargedSupports) {
  const Cloud cloud = scenes::lattice_box(box);
  const ShapeEvaluator evaluator(cloud, {}, {});
  ShapeFunctions s;
  int enlargements = -1;
  ASSERT_TRUE(evaluator.at({3.2 * h, 2.7 * h, 3 * h}, s, &enlargements));
  EXPECT_EQ(enlargements, 0);
  const Vec3d corner{6.4 * h, 6.4 * h, 6.4 * h};
  ASSERT_TRUE(evaluator.at(corner, s, &enlargements));
  EXPECT_GT(enlargements, 0);
  expect_linear_reproduction(evaluator, corner);
}

TEST(ShapeEvaluator, FarPlacesAndCoplanarNodesHaveNoShapes) {
  const Cloud cloud = scenes::lattice_box(box);
  ShapeFunctions s;
  s.add(0, 1, {});
  int enlargements = 0;
  EXPECT_FALSE(ShapeEvaluator(cloud, {}, {}).at({20 * h, 3 * h, 3 * h}, s, &enlargements));
  EXPECT_TRUE(s.node.empty());
  EXPECT_LT(enlargements, 0);

  std::vector<Vec3d> plane;
  for (int j = 0; j < 6; ++j)
    for (int i = 0; i < 6; ++i) plane.push_back({i * h, j * h, 2.0});
  const Cloud flat = make_cloud(plane, std::nullopt), flat_lattice = scenes::on_lattice({plane.begin(), plane.end()}, 1.0);
  EXPECT_FALSE(ShapeEvaluator(flat, {}, {}).at({2.3 * h, 2.4 * h, 2.0}, s));
  EXPECT_FALSE(ShapeEvaluator(flat_lattice, {}, {}).at({2.3 * h, 2.4 * h, 2.0}, s));
}

TEST(ShapeEvaluator, SupportsOfAGeneralCloudFollowTheLocalSpacing) {
  // The same nodes, once known as a lattice and once not: about as many nodes take part.
  const Cloud lattice = scenes::lattice_box({{10, 10, 10}, h}), general = make_cloud(lattice.nodes, std::nullopt);
  const ShapeEvaluator known(lattice, {}, {}), unknown(general, {}, {});
  double nodes_known = 0, nodes_unknown = 0;
  std::mt19937 random(2);
  std::uniform_real_distribution<double> within(4 * h, 6 * h);
  for (int n = 0; n < 200; ++n) {
    const Vec3d x{within(random), within(random), within(random)};
    ShapeFunctions s;
    ASSERT_TRUE(known.at(x, s));
    nodes_known += double(s.node.size());
    ASSERT_TRUE(unknown.at(x, s));
    nodes_unknown += double(s.node.size());
  }
  EXPECT_NEAR(nodes_unknown / nodes_known, 1, 0.25);  // (1.08)^3: the spacing comes from twenty nodes
}

TEST(MakeCloud, FindsTheLatticeOfItsNodes) {
  std::vector<Vec3d> nodes = scenes::cell_corners({{3, 2, 1}, 2.0}, scenes::every_cell);
  for (Vec3d& x : nodes) x += Vec3d{1, -5, 0.5};
  Lattice promise;
  promise.origin = {101, -105, 0.5}, promise.spacing = 2;  // fifty spacings off
  const Cloud cloud = make_cloud(nodes, promise);
  EXPECT_EQ(cloud.lattice->size, (std::array<int, 3>{4, 3, 2}));
  for (std::size_t n = 0; n < nodes.size(); ++n) {
    const auto& c = cloud.lattice_ijk[n];
    EXPECT_EQ(cloud.lattice->node(c[0], c[1], c[2]), int(n));
    EXPECT_LT(norm(cloud.lattice->origin + 2.0 * Vec3d{double(c[0]), double(c[1]), double(c[2])} - nodes[n]), 1e-12);
  }
  EXPECT_EQ(cloud.lattice->node(-1, 0, 0), -1);
  EXPECT_EQ(cloud.lattice->node(4, 0, 0), -1);
}

TEST(MakeCloud, RefusesABrokenPromise) {
  std::vector<Vec3d> nodes = scenes::cell_corners({{3, 3, 3}, 2.0}, scenes::every_cell);
  Lattice promise;
  promise.spacing = 2;
  nodes[17].y += 0.01;
  Failure failure{};
  const std::string message = scenes::error_of([&] { make_cloud(nodes, promise); }, &failure);
  EXPECT_EQ(failure, Failure::input);
  EXPECT_NE(message.find("node 17"), std::string::npos) << message;
  nodes[17] = nodes[5];
  EXPECT_NE(scenes::error_of([&] { make_cloud(nodes, promise); }).find("nodes 5 and 17 are at the same place"), std::string::npos);
  EXPECT_NE(scenes::error_of([&] { make_cloud(nodes, std::nullopt); }).find("nodes 5 and 17 are at the same place"), std::string::npos);
  EXPECT_NE(scenes::error_of([&] { make_cloud({}, std::nullopt); }), "");
  promise.spacing = 0;
  EXPECT_NE(scenes::error_of([&] { make_cloud(nodes, promise); }), "");
}

class Supports : public testing::TestWithParam<const char*> {};
INSTANTIATE_TEST_SUITE_P(Clouds, Supports, testing::Values("lattice", "coupled", "cut", "jittered", "slit"), [](const auto& cloud) { return std::string(cloud.param); });

TEST_P(Supports, AreTheShapeFunctionsOfTheirPoints) {
  const std::string kind = GetParam();
  const Box body{{8, 8, 9}, h};
  const auto in_ball = [&](const std::array<int, 3>& c) { return squared_norm(Vec3d{c[0] - 3.5, c[1] - 3.5, c[2] - 4.0}) < 15; };
  const auto beside_slit = [](const std::array<int, 3>& c) { return c[2] != 4 || c[0] < 3; };
  IntegrationPoints points = scenes::box_points(body, scenes::uniform(1), 0.49, scenes::usual_ratio, [&](const std::array<int, 3>& c) {
    return kind == "slit" && !beside_slit(c) ? scenes::CellKind::absent : scenes::CellKind::free;
  });
  Cloud cloud = kind == "cut" ? scenes::on_lattice(scenes::cell_corners(body, in_ball), h)
                      : kind == "jittered" ? scenes::jittered_box(body) : scenes::lattice_box(body);
  if (kind == "slit") mark_body_cells(cloud, points);
  const ShapeEvaluator evaluator(cloud, kind == "coupled" ? some_prescribed(cloud) : std::vector<std::uint8_t>{}, {});
  const SlotLayout layout = make_slot_layout(cloud, 1);
  const SupportTable table = build_supports(evaluator, layout, points);
  std::vector<int> node_of_slot(std::size_t(layout.num_slots), -1);
  for (std::size_t n = 0; n < cloud.size(); ++n) {
    ASSERT_EQ(node_of_slot.at(std::size_t(layout.slot_of_node[n])), -1);
    node_of_slot[std::size_t(layout.slot_of_node[n])] = int(n);
  }
  // Places that agree to 2^-20 of a spacing share a stencil.
  const double shared_place = 1e-5 / h;
  std::size_t dropped = 0;
  for (std::size_t p = 0; p < points.size(); ++p) {
    ShapeFunctions s;
    const bool usable = evaluator.at(points.position[p], s);
    ASSERT_EQ(usable, table.stencil[p] >= 0);
    if (!usable) {
      EXPECT_EQ(table.dropped.at(dropped++), p);
      continue;
    }
    const int begin = table.begin[std::size_t(table.stencil[p])], end = table.begin[std::size_t(table.stencil[p]) + 1];
    ASSERT_EQ(end - begin, int(s.node.size()));
    for (int e = begin; e < end; ++e) {
      const int node = node_of_slot.at(std::size_t(table.base[p] + table.offset[std::size_t(e)]));
      const auto at = std::find(s.node.begin(), s.node.end(), node);
      ASSERT_NE(at, s.node.end());
      EXPECT_LT(norm(table.gradient[std::size_t(e)] - s.gradient[std::size_t(at - s.node.begin())]), shared_place);
    }
  }
  EXPECT_EQ(dropped, table.dropped.size());
  if (kind == "cut") {
    EXPECT_GT(table.dropped.size(), 0u);   // the corners of the box are far from the ball
    EXPECT_GT(table.enlarged, 0u);
  } else {
    EXPECT_TRUE(table.dropped.empty());
  }
  if (kind == "jittered") {
    EXPECT_EQ(table.num_stencils(), int(points.size()));
  } else {
    EXPECT_LT(table.num_stencils(), int(points.size()));
  }
}

/// A box with an empty layer of cells, k = 3, except where i < 2.
const Box slit_box{{8, 4, 7}, h};
bool beside_slit(const std::array<int, 3>& c) { return c[2] != 3 || c[0] < 2; }
IntegrationPoints slit_points() {
  return scenes::box_points(slit_box, scenes::uniform(1), 0.49, scenes::usual_ratio,
                            [](const std::array<int, 3>& c) { return beside_slit(c) ? scenes::CellKind::free : scenes::CellKind::absent; });
}

TEST(Gaps, CellsWithBodyAreFound) {
  Cloud cloud = scenes::on_lattice(scenes::cell_corners(slit_box, beside_slit), h);
  mark_body_cells(cloud, slit_points());
  for (int k = 0; k < 7; ++k)
    for (int j = 0; j < 4; ++j)
      for (int i = 0; i < 8; ++i) EXPECT_EQ(cloud.lattice->holds_body(i, j, k), beside_slit({i, j, k})) << i << ' ' << j << ' ' << k;
  EXPECT_FALSE(cloud.lattice->holds_body(-1, 0, 0));
  EXPECT_FALSE(cloud.lattice->holds_body(8, 0, 0));
}

TEST(Gaps, NoSupportCrossesASlitButOneReachesAroundItsEnd) {
  Cloud cloud = scenes::on_lattice(scenes::cell_corners(slit_box, beside_slit), h);
  const Vec3d deep_below{6.3 * h, 2.4 * h, 2.9 * h}, at_the_end{1.6 * h, 2.4 * h, 2.9 * h};
  const auto highest = [&](const Vec3d& x) {
    ShapeFunctions s;
    EXPECT_TRUE(ShapeEvaluator(cloud, {}, {}).at(x, s));
    double z = 0;
    for (int n : s.node) z = std::max(z, cloud.nodes[std::size_t(n)].z);
    return z / h;
  };
  EXPECT_EQ(highest(deep_below), 4) << "without knowledge of the cells";
  mark_body_cells(cloud, slit_points());
  EXPECT_EQ(highest(deep_below), 3);
  EXPECT_EQ(highest(at_the_end), 4);
  EXPECT_EQ(highest({6.3 * h, 2.4 * h, 3 * h}), 3) << "a place on the slit's face belongs to the body";
  expect_linear_reproduction(ShapeEvaluator(cloud, {}, {}), deep_below);
}

TEST(Gaps, ABodyWithoutGapsKeepsItsShapeFunctions) {
  const Cloud plain = scenes::lattice_box(box);
  Cloud marked = plain;
  mark_body_cells(marked, scenes::box_points(box, scenes::uniform(1)));
  for (const MlsOptions& options : {MlsOptions{Basis::linear, 1.75}, MlsOptions{Basis::quadratic, 2.5}})
    for (const Vec3d& x : places_inside(50)) {
      ShapeFunctions a, b;
      ASSERT_TRUE(ShapeEvaluator(plain, {}, options).at(x, a) && ShapeEvaluator(marked, {}, options).at(x, b));
      EXPECT_EQ(a.node, b.node);
      EXPECT_EQ(a.gradient, b.gradient);
    }
}

TEST(Stencils, RepeatInsideALattice) {
  // 5 x 5 x 4 places per period of four lattice steps, and the phases (i mod 4, j mod 4) of the slots are part of these.
  const Box body{{24, 24, 24}, h};
  const Cloud cloud = scenes::lattice_box(body);
  const ShapeEvaluator evaluator(cloud, {}, {});
  IntegrationPoints all = scenes::box_points(body, scenes::uniform(1)), inside;
  for (std::size_t p = 0; p < all.size(); ++p) {
    const Vec3d& x = all.position[p];
    bool deep = true;
    for (int a = 0; a < 3; ++a) deep = deep && x[a] > 3 * h && x[a] < 21 * h;
    if (deep) scenes::add_point(inside, x, all.volume[p], 1, 0.49);
  }
  const SupportTable table = build_supports(evaluator, make_slot_layout(cloud, 1), inside);
  EXPECT_EQ(table.num_stencils(), 100);
  EXPECT_GT(inside.size(), 5000u);
}

}  // namespace
}  // namespace mtled
