#include "imaging/field_quality.hpp"

#include <gtest/gtest.h>

#include <cmath>

#include "core/error.hpp"

namespace mtled {
namespace {

Grid oblique_grid(std::array<int, 3> size) {
  Grid grid;
  grid.size = size, grid.origin = {-10, 20, 5}, grid.spacing = {1.5, 1, 2}, grid.direction = rotation_matrix({0.3, -0.2, 0.5});
  return grid;
}

template <class Function>
DenseField field_of(const Grid& grid, const Function& u) {
  return sample_displacement([&](const Vec3d& x, Vec3d& value) { return value = u(x), true; }, grid);
}

constexpr double single_precision_mm = 1e-5;  ///< of displacements of some 10 mm

TEST(SampleDisplacement, KnowsWhereItIsUnknown) {
  const Grid grid = oblique_grid({5, 4, 3});
  const DenseField field = sample_displacement([&](const Vec3d& x, Vec3d& u) { return u = {1, 2, 3}, grid.index(x).x < 2.5; }, grid);
  for (int i = 0; i < 5; ++i) {
    EXPECT_EQ(field.covered.at(i, 1, 1), i < 3);
    EXPECT_EQ(field.displacement.at(i, 1, 1), (i < 3 ? Vec3f{1, 2, 3} : Vec3f{}));
  }
}

TEST(Inverted, UndoesAStretch) {
  const Grid from = oblique_grid({30, 30, 30}), to = oblique_grid({20, 25, 22});
  const DenseField inverse = inverted([&](const Vec3d& x, Vec3d& u) { return u = {0.1 * x.x + 2, -1, 0.05 * x.z}, true; }, from, to);
  int covered = 0;
  for (int k = 0; k < 22; ++k)
    for (int j = 0; j < 25; ++j)
      for (int i = 0; i < 20; ++i) {
        if (!inverse.covered.at(i, j, k)) continue;
        ++covered;
        const Vec3d y = to.point(i, j, k), x{(y.x - 2) / 1.1, y.y + 1, y.z / 1.05};
        const Vec3f& v = inverse.displacement.at(i, j, k);
        ASSERT_LT(norm(y + Vec3d{v.x, v.y, v.z} - x), 0.1);
      }
  EXPECT_GT(covered, 9000);
  EXPECT_THROW(inverted([&](const Vec3d& x, Vec3d& u) { return u = {1e4, 0, 0}, norm(x - from.origin) < 1000; }, from, to), Error);
}

TEST(BestRigidMotion, FindsTheMotionOfPointsAndNoReflection) {
  const RigidMotion truth{{1, 2, 3}, rotation_matrix({0.5, -1, 0.8}), {4, -5, 6}};
  const std::vector<Vec3d> x{{0, 0, 0}, {10, 0, 0}, {0, 7, 0}, {0, 0, 5}, {3, 3, 3}};
  std::vector<Vec3d> y, mirrored;
  for (const Vec3d& p : x) y.push_back(truth.apply(p)), mirrored.push_back({-p.x, p.y, p.z});
  const RigidMotion motion = best_rigid_motion(x, y);
  for (const Vec3d& p : x) EXPECT_LT(norm(motion.apply(p) - truth.apply(p)), 1e-12);
  EXPECT_NEAR(determinant(best_rigid_motion(x, mirrored).rotation), 1, 1e-12);
  EXPECT_THROW(best_rigid_motion({}, {}), Error);
  EXPECT_THROW(best_rigid_motion(x, {{0, 0, 0}}), Error);
}

TEST(LabelRigidity, IsZeroForRigidMotionAndTheStretchForAStretch) {
  const Grid grid = oblique_grid({20, 16, 14});
  LabelImage labels(grid);
  for (int k = 2; k < 12; ++k)
    for (int j = 2; j < 12; ++j)
      for (int i = 2; i < 18; ++i) labels.at(i, j, k) = i < 10 ? 3 : 7;
  const RigidMotion motion{{5, 5, 5}, rotation_matrix({0.2, 0.1, -0.3}), {10, -3, 2}};
  const auto rigid = label_rigidity(labels, field_of(grid, [&](const Vec3d& x) { return motion.displacement(x); }));
  ASSERT_EQ(rigid.size(), 2u);
  EXPECT_EQ(rigid[1].label, 7);
  EXPECT_EQ(rigid[1].voxels, 800u);
  for (const LabelRigidity& r : rigid) EXPECT_LT(r.largest_mm, single_precision_mm);

  // 2 % along i: eight voxels of 1.5 mm, 5.25 mm to either side of the middle; mean square 1.5^2 (8^2 - 1) / 12.
  const Vec3d axis = (1 / grid.spacing.x) * (grid.point(1, 0, 0) - grid.point(0, 0, 0));
  for (const LabelRigidity& r : label_rigidity(labels, field_of(grid, [&](const Vec3d& x) { return 0.02 * dot(axis, x) * axis; }))) {
    EXPECT_NEAR(r.largest_mm, 0.02 * 5.25, single_precision_mm);
    EXPECT_NEAR(r.rms_mm, 0.02 * 1.5 * std::sqrt(63.0 / 12), single_precision_mm);
  }
  DenseField unknown = field_of(grid, [](const Vec3d& x) { return x; });
  unknown.covered = Mask(grid);
  EXPECT_TRUE(label_rigidity(labels, unknown).empty());
  EXPECT_THROW(label_rigidity(LabelImage(oblique_grid({20, 16, 13})), unknown), Error);
}

TEST(InverseConsistency, IsWhatTheWayBackMisses) {
  const Grid grid = oblique_grid({12, 10, 8});
  const DenseField there = field_of(grid, [](const Vec3d&) { return Vec3d{3, 0, 0}; });
  const Mask everywhere(grid, 1);
  const auto back = [](double miss) { return [miss](const Vec3d&, Vec3d& u) { return u = {-3, miss, 0}, true; }; };
  EXPECT_EQ(inverse_consistency(there, back(0), everywhere).maximum, 0);
  const InverseConsistency c = inverse_consistency(there, back(0.25), everywhere);
  EXPECT_EQ(c.voxels, grid.count());
  for (const double value : {c.mean, c.percentile_95, c.percentile_99, c.maximum}) EXPECT_DOUBLE_EQ(value, 0.25);
  EXPECT_EQ(inverse_consistency(there, [](const Vec3d&, Vec3d&) { return false; }, everywhere).voxels, 0u);
  EXPECT_EQ(inverse_consistency(there, back(0), Mask(grid)).voxels, 0u);
}

TEST(Correlation, OfLinearInvertedAndConstantImages) {
  const Grid grid = oblique_grid({40, 30, 20});
  Image a(grid), b(grid), c(grid);
  Mask where(grid, 1);
  for (std::size_t v = 0; v < a.data.size(); ++v) {
    a.data[v] = float(v % 7), b.data[v] = 3 * a.data[v] - 500, c.data[v] = -a.data[v];
    if (v % 5 == 0) where.data[v] = 0, b.data[v] = 1e6f;
  }
  EXPECT_NEAR(correlation(a, b, where), 1, 1e-12);
  EXPECT_NEAR(correlation(a, c, where), -1, 1e-12);
  EXPECT_EQ(correlation(a, Image(grid, 5), where), 0);
}

TEST(Jacobian, DeviationOfItsLogarithm) {
  // u_x = 0.002 x^2 along i: central differences give det = 1 + 0.004 x exactly, one-sided ones at the border differ.
  Grid grid;
  grid.size = {21, 6, 7}, grid.spacing = {2, 1, 1.5};
  const DenseField field = field_of(grid, [](const Vec3d& x) { return Vec3d{0.002 * x.x * x.x, 0, 0}; });
  Mask inner(grid);
  for (int k = 0; k < 7; ++k)
    for (int j = 0; j < 6; ++j)
      for (int i = 1; i < 20; ++i) inner.at(i, j, k) = 1;
  const auto deviation = [](int first, int last, const auto& f) {
    double sum = 0, squares = 0;
    for (int i = first; i <= last; ++i) sum += f(i);
    for (int i = first; i <= last; ++i) squares += std::pow(f(i) - sum / (last - first + 1), 2);
    return std::sqrt(squares / (last - first + 1));
  };
  constexpr double rounding = 1e-5;  // of differences of displacements in single precision
  const JacobianStatistics all = jacobian_statistics(field.displacement, Mask(grid, 1));
  EXPECT_NEAR(all.sd_log, deviation(0, 20, [](int i) { return std::log(i == 0 ? 1.004 : i == 20 ? 1.156 : 1 + 0.008 * i); }), rounding);
  const double learn2reg = deviation(2, 18, [](int i) { return std::log(4 + 0.008 * i); });
  EXPECT_NEAR(all.sd_log_learn2reg, learn2reg, rounding);
  EXPECT_GT(std::abs(all.sd_log - learn2reg), 100 * rounding) << "the two definitions must differ here";
  EXPECT_NEAR(jacobian_statistics(field.displacement, inner).sd_log_learn2reg, learn2reg, rounding);

  const JacobianStatistics mirrored = jacobian_statistics(field_of(grid, [](const Vec3d& x) { return Vec3d{-2 * x.x, 0, 0}; }).displacement, Mask(grid, 1));
  EXPECT_EQ(mirrored.folded, grid.count());
  EXPECT_TRUE(std::isnan(mirrored.sd_log));
  EXPECT_NEAR(mirrored.sd_log_learn2reg, 0, rounding);
  Grid thin = grid;
  thin.size[2] = 4;
  EXPECT_TRUE(std::isnan(jacobian_statistics(VectorImage(thin), Mask(thin, 1)).sd_log_learn2reg));
}

}  // namespace
}  // namespace mtled
