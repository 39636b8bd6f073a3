#include "core/coupled_integration.hpp"

#include <gtest/gtest.h>

#include <map>

#include "scenes.hpp"

namespace mtled {
namespace {

using scenes::Box;

constexpr double rounding = 1e-9;  ///< of sums over some thousand points in double precision
const Box box{{8, 8, 8}, 5.0};
const double h = box.spacing;

/// A cube held at the bottom, with a rigid block of 2 x 2 x 2 cells inside; the modulus varies.
struct Held {
  Cloud cloud = scenes::lattice_box(box);
  std::vector<std::uint8_t> flags = std::vector<std::uint8_t>(cloud.size(), 0);
  Held() {
    for (std::size_t n = 0; n < cloud.size(); ++n) {
      const auto& c = cloud.lattice_ijk[n];
      bool block = true;
      for (int a : c) block = block && a >= 4 && a <= 6;
      flags[n] = c[2] == 0 || block;
    }
  }
  ShapeEvaluator evaluator() const { return {cloud, flags, {}}; }
};

IntegrationPoints cubes_of(double ratio) {
  return scenes::box_points(box, [](const Vec3d& x) { return 1 + 0.1 * x.x; }, 0.49, {ratio, ratio, ratio});
}

struct Totals {
  double volume = 0, shear = 0, bulk = 0, density = 0;
  Vec3d first_moment{};
  explicit Totals(const IntegrationPoints& points) {
    for (std::size_t p = 0; p < points.size(); ++p) {
      const double v = points.volume[p];
      volume += v, shear += v * points.shear_modulus[p], bulk += v * points.bulk_modulus[p], density += v * points.density[p];
      first_moment += v * points.position[p];
    }
  }
};

TEST(CoupledIntegration, AligningKeepsVolumeCentroidAndModuli) {
  const Held held;
  const IntegrationPoints given = cubes_of(0.8), aligned = align_with_coupled_cells(held.evaluator(), given);
  const Totals before(given), after(aligned);
  EXPECT_NE(given.size(), aligned.size());
  EXPECT_NEAR(after.volume, before.volume, rounding * before.volume);
  EXPECT_NEAR(after.shear, before.shear, rounding * before.shear);
  EXPECT_NEAR(after.bulk, before.bulk, rounding * before.bulk);
  EXPECT_NEAR(after.density, before.density, rounding * before.density);
  EXPECT_LT(norm(after.first_moment - before.first_moment), rounding * norm(before.first_moment));
}

TEST(CoupledIntegration, AlignedPointsAreTheCentresOfEighthsWhereCubesFillTheCells) {
  const Held held;
  const ShapeEvaluator evaluator = held.evaluator();
  const IntegrationPoints points = align_with_coupled_cells(evaluator, cubes_of(0.8));
  std::map<std::array<int, 3>, int> eighths;
  for (std::size_t p = 0; p < points.size(); ++p) {
    const auto cell = cell_of(*held.cloud.lattice, points.position[p]);
    if (!evaluator.coupled(cell) || std::abs(points.volume[p] - h * h * h / 8) > rounding) continue;
    ++eighths[cell];
    for (int a = 0; a < 3; ++a) EXPECT_NEAR(std::abs(points.position[p][a] / h - cell[std::size_t(a)] - 0.5), 0.25, rounding);
  }
  int coupled = 0;
  for (int k = 0; k < 8; ++k)
    for (int j = 0; j < 8; ++j)
      for (int i = 0; i < 8; ++i) {
        const bool rigid = i >= 4 && i < 6 && j >= 4 && j < 6 && k >= 4 && k < 6;
        if (!evaluator.coupled({i, j, k}) || rigid) continue;
        ++coupled;
        EXPECT_EQ((eighths[{i, j, k}]), 8) << i << ' ' << j << ' ' << k;
      }
  EXPECT_EQ(coupled, 64 + 64 - 8);
}

TEST(CoupledIntegration, PointsAwayFromCoupledCellsStayAsTheyAre) {
  const Held held;
  const ShapeEvaluator evaluator = held.evaluator();
  const IntegrationPoints given = cubes_of(0.8), aligned = align_with_coupled_cells(evaluator, given);
  std::size_t far = 0, at = 0;
  for (std::size_t p = 0; p < given.size(); ++p) {
    if (given.position[p].z < 1.5 * h || given.position[p].x > 2.5 * h) continue;
    ++far;
    while (at < aligned.size() && !(aligned.position[at] == given.position[p])) ++at;
    ASSERT_LT(at, aligned.size());
    EXPECT_EQ(aligned.volume[at], given.volume[p]);
  }
  EXPECT_GT(far, 100u);
}

TEST(CoupledIntegration, ReductionKeepsTheEnergyOfUniformDeformations) {
  const Held held;
  const ShapeEvaluator evaluator = held.evaluator();
  const IntegrationPoints given = align_with_coupled_cells(evaluator, cubes_of(0.8)), reduced = reduce_volumetric_integration(evaluator, given);
  const auto energy = [](const IntegrationPoints& points) {
    Mat3d F = Mat3d::identity();
    F[0][0] = 1.2, F[0][1] = 0.3, F[2][2] = 0.9;
    double sum = 0;
    for (std::size_t p = 0; p < points.size(); ++p) sum += points.volume[p] * NeoHookean<double>{points.shear_modulus[p], points.bulk_modulus[p]}.energy(F);
    return sum;
  };
  EXPECT_NEAR(energy(reduced), energy(given), rounding * energy(given));
  std::size_t volumetric = 0;
  for (double mu : reduced.shear_modulus) volumetric += mu == 0;
  EXPECT_EQ(volumetric, 64u + 64u - 8u);  // one per coupled cell
  EXPECT_EQ(reduced.size(), given.size() + volumetric);
}

TEST(CoupledIntegration, OtherCloudsKeepTheirPoints) {
  const Held held;
  const Cloud general = make_cloud(held.cloud.nodes, std::nullopt);
  const IntegrationPoints given = cubes_of(0.8);
  for (const ShapeEvaluator& evaluator : {ShapeEvaluator(general, held.flags, {}), ShapeEvaluator(held.cloud, {}, {})}) {
    EXPECT_EQ(align_with_coupled_cells(evaluator, given).size(), given.size());
    EXPECT_EQ(reduce_volumetric_integration(evaluator, given).bulk_modulus, given.bulk_modulus);
  }
}

}  // namespace
}  // namespace mtled
