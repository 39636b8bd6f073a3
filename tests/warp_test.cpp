#include "imaging/warp.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "core/error.hpp"
#include "core/parallel.hpp"

namespace mtled {
namespace {

constexpr double tolerance_mm = 0.01;

Grid make_grid(std::array<int, 3> size, Vec3d spacing, const Mat3d& direction = Mat3d::identity()) {
  Grid grid;
  grid.size = size;
  grid.spacing = spacing;
  grid.direction = direction;
  const Vec3d middle = grid.point(Vec3d{0.5 * (size[0] - 1), 0.5 * (size[1] - 1), 0.5 * (size[2] - 1)});
  grid.origin = Vec3d{} - middle;
  return grid;
}

Mat3d oblique() { return rotation_matrix({0.3, -0.2, 0.5}); }

/// The same voxels in another order: axes i and j swapped, j reversed.
Grid reordered(const Grid& grid) {
  Grid other = grid;
  other.size = {grid.size[1], grid.size[0], grid.size[2]};
  other.spacing = {grid.spacing.y, grid.spacing.x, grid.spacing.z};
  for (int a = 0; a < 3; ++a) {
    other.direction[a][0] = -grid.direction[a][1];
    other.direction[a][1] = grid.direction[a][0];
  }
  other.origin = grid.point(0, grid.size[1] - 1, 0);
  return other;
}

template <class F>
Image image_of(const Grid& grid, const F& f) {
  Image image(grid);
  for (int k = 0; k < grid.size[2]; ++k)
    for (int j = 0; j < grid.size[1]; ++j)
      for (int i = 0; i < grid.size[0]; ++i) image.at(i, j, k) = float(f(grid.point(i, j, k)));
  return image;
}

double ramp(const Vec3d& p) { return 3 + 2 * p.x - p.y + 0.5 * p.z; }
bool in_ball(const Vec3d& X, double radius) { return squared_norm(X) <= radius * radius; }

/// u of a map, inside a ball around the origin.
template <class Map>
DisplacementFunction ball_displacement(double radius, const Map& map) {
  return [radius, map](const Vec3d& X, Vec3d& u) {
    if (!in_ball(X, radius)) return false;
    u = map(X) - X;
    return true;
  };
}

const RigidMotion motion{{4, -3, 2}, rotation_matrix({0.2, -0.3, 0.25}), {6, -8, 5}};

/// Folds nowhere, but |grad u| = 1.3: J between 0.4 and 1.6, sheared by 1.2.
Vec3d strong_map(const Vec3d& X) {
  return {X.x + 6 * std::sin(X.x / 10), X.y + 1.2 * X.x, X.z + 4 * std::sin(X.y / 12)};
}

TEST(ExtendSmoothly, IsExactForAConstant) {
  const Grid grid = make_grid({23, 17, 9}, {1, 1.5, 4});
  VectorImage field(grid);
  Mask covered(grid);
  for (const std::size_t voxel : {std::size_t(40), std::size_t(1000), std::size_t(1001)}) {
    covered.data[voxel] = 1;
    field.data[voxel] = {1.7f, -0.3f, 12.1f};
  }
  extend_smoothly(field, covered);
  for (const Vec3f& v : field.data) EXPECT_EQ(v, (Vec3f{1.7f, -0.3f, 12.1f}));
}

TEST(ExtendSmoothly, IsContinuousAtTheSurfaceAndBounded) {
  const Grid grid = make_grid({50, 50, 30}, {2, 2, 3.5});
  const auto u = ball_displacement(30, [](const Vec3d& X) {
    return X + Vec3d{8 * std::sin(X.x / 15), 0.2 * X.z, 0.1 * X.y};
  });
  const DenseField field = forward_field(grid, u);
  double inside = 0, elsewhere = 0;  // largest difference between neighbours [mm per mm]
  float smallest = 0, largest = 0;
  for (int k = 0; k < 30; ++k)
    for (int j = 0; j < 50; ++j)
      for (int i = 0; i + 1 < 50; ++i) {
        const Vec3f p = field.displacement.at(i, j, k), q = field.displacement.at(i + 1, j, k);
        const bool both = field.covered.at(i, j, k) && field.covered.at(i + 1, j, k);
        double& slope = both ? inside : elsewhere;
        slope = std::max(slope, norm(Vec3d{double(p.x) - q.x, double(p.y) - q.y, double(p.z) - q.z}) / 2);
        smallest = std::min(smallest, p.x);
        largest = std::max(largest, p.x);
      }
  EXPECT_GT(field.covered.at(25, 25, 15), 0);
  EXPECT_LT(elsewhere, 1.5 * inside);  // setting the surroundings to zero gives more than 4
  EXPECT_LE(largest, 8.001f);
  EXPECT_GE(smallest, -8.001f);
}

TEST(ExtendSmoothly, RefusesAnUncoveredField) {
  const Grid grid = make_grid({5, 5, 5}, {1, 1, 1});
  VectorImage field(grid);
  EXPECT_THROW(extend_smoothly(field, Mask(grid)), Error);
}

TEST(InverseField, OfARigidMotionIsTheInverseMotion) {
  const auto u = ball_displacement(40, [](const Vec3d& X) { return motion.apply(X); });
  const DenseField forward = forward_field(make_grid({60, 60, 40}, {2, 2, 3}), u);
  const Grid fixed_grid = make_grid({30, 41, 27}, {3, 2.5, 4}, oblique());
  InverseStatistics statistics;
  const DenseField result = inverse_field(fixed_grid, forward, u, tolerance_mm, statistics);
  const RigidMotion back = inverse(motion);
  std::size_t expected = 0;
  for (int k = 0; k < 27; ++k)
    for (int j = 0; j < 41; ++j)
      for (int i = 0; i < 30; ++i) {
        const Vec3d y = fixed_grid.point(i, j, k), X = back.apply(y);
        if (std::abs(norm(X) - 40) < 0.5) continue;  // at the surface the dense field decides
        expected += in_ball(X, 40);
        ASSERT_EQ(in_ball(X, 40), result.covered.at(i, j, k) != 0) << norm(X);
        if (!in_ball(X, 40)) continue;
        const Vec3f v = result.displacement.at(i, j, k);
        ASSERT_LE(norm(y + Vec3d{v.x, v.y, v.z} - X), 1.01 * tolerance_mm);
      }
  EXPECT_GE(statistics.covered, expected);
  EXPECT_EQ(statistics.unresolved, 0u);
  EXPECT_LE(statistics.largest_residual_mm, tolerance_mm);
}

TEST(InverseField, ConvergesWherePlainIterationDoesNot) {
  const auto u = ball_displacement(45, strong_map);
  const DenseField forward = forward_field(make_grid({50, 50, 50}, {2, 2, 2}), u);
  const Grid fixed_grid = make_grid({60, 90, 60}, {2, 2, 2});
  InverseStatistics statistics;
  const DenseField result = inverse_field(fixed_grid, forward, u, tolerance_mm, statistics);
  EXPECT_EQ(statistics.unresolved, 0u);
  double largest = 0;
  int plain_failures = 0;
  for (int k = 0; k < 60; ++k)
    for (int j = 0; j < 90; ++j)
      for (int i = 0; i < 60; ++i) {
        if (!result.covered.at(i, j, k)) continue;
        const Vec3d y = fixed_grid.point(i, j, k);
        const Vec3f v = result.displacement.at(i, j, k);
        largest = std::max(largest, norm(strong_map(y + Vec3d{v.x, v.y, v.z}) - y));
        Vec3d X = y;
        for (int iteration = 0; iteration < 5; ++iteration) X = y - (strong_map(X) - X);
        plain_failures += norm(strong_map(X) - y) > tolerance_mm;
      }
  EXPECT_LE(largest, 1.01 * tolerance_mm);
  EXPECT_GT(plain_failures, 10000);
  // Every rest position that is well inside is found: its image is a covered voxel's neighbourhood.
  for (int n = 0; n < 2000; ++n) {
    const Vec3d X{40 * std::sin(1.0 * n), 40 * std::sin(1.7 * n), 40 * std::sin(2.3 * n)};
    if (!in_ball(X, 38)) continue;
    EXPECT_EQ(nearest_value<std::uint8_t>(result.covered, strong_map(X), 2), 1) << X.x << " " << X.y << " " << X.z;
  }
}

TEST(InverseField, DoesNotDependOnTheNumberOfThreads) {
  const auto u = ball_displacement(30, strong_map);
  const DenseField forward = forward_field(make_grid({35, 35, 35}, {2, 2, 2}), u);
  const Grid fixed_grid = make_grid({40, 60, 40}, {2, 2, 2}, oblique());
  InverseStatistics statistics;
  const DenseField many = inverse_field(fixed_grid, forward, u, tolerance_mm, statistics);
  const ThreadLimit limit(1);
  const DenseField one = inverse_field(fixed_grid, forward, u, tolerance_mm, statistics);
  EXPECT_TRUE(many.displacement.data == one.displacement.data);
}

TEST(InverseField, KeepsItsPromiseWhereTheMapFolds) {
  const auto folded = [](const Vec3d& X) { return Vec3d{X.x + 15 * std::sin(X.x / 10), X.y, X.z}; };  // J down to -0.5
  const auto u = ball_displacement(45, folded);
  const DenseField forward = forward_field(make_grid({50, 50, 20}, {2, 2, 2}), u);
  const Grid fixed_grid = make_grid({50, 40, 12}, {2, 2, 2});
  InverseStatistics statistics;
  const DenseField result = inverse_field(fixed_grid, forward, u, tolerance_mm, statistics);
  EXPECT_LE(statistics.largest_residual_mm, tolerance_mm);
  for (int k = 0; k < 12; ++k)
    for (int j = 0; j < 40; ++j)
      for (int i = 0; i < 50; ++i) {
        const Vec3d y = fixed_grid.point(i, j, k);
        const Vec3f v = result.displacement.at(i, j, k);
        ASSERT_TRUE(std::isfinite(v.x) && std::isfinite(v.y) && std::isfinite(v.z));
        if (!result.covered.at(i, j, k)) continue;
        ASSERT_LE(norm(folded(y + Vec3d{v.x, v.y, v.z}) - y), 1.01 * tolerance_mm);
      }
}

TEST(Warp, OfARigidMotionIsExactForARampOnAnyGrid) {
  const auto u = ball_displacement(60, [](const Vec3d& X) { return motion.apply(X); });
  const Image moving = image_of(make_grid({50, 40, 60}, {2, 3, 2}, oblique()), ramp);
  const DenseField forward = forward_field(moving.grid, u);
  for (const Grid& fixed_grid :
       {make_grid({20, 21, 22}, {2, 2, 2}), make_grid({20, 21, 15}, {1.5, 2, 3}, rotation_matrix({0.9, 0.1, -0.4})),
        reordered(make_grid({20, 21, 22}, {2, 2, 2}, oblique()))}) {
    InverseStatistics statistics;
    const VectorImage field = inverse_field(fixed_grid, forward, u, 1e-4, statistics).displacement;
    for (const Interpolation interpolation : {Interpolation::linear, Interpolation::cubic}) {
      const Image warped = warp_image(moving, field, interpolation, -1);
      const Image rigid = warp_image_rigidly(moving, fixed_grid, motion, interpolation, -1);
      for (int k = 2; k < fixed_grid.size[2]; k += 5)
        for (int j = 1; j < fixed_grid.size[1]; j += 4)
          for (int i = 0; i < fixed_grid.size[0]; i += 3) {
            const double expected = ramp(inverse(motion).apply(fixed_grid.point(i, j, k)));
            EXPECT_NEAR(warped.at(i, j, k), expected, 1e-3);
            EXPECT_NEAR(rigid.at(i, j, k), expected, 1e-3);
          }
    }
  }
}

TEST(Warp, GivesTheSameVoxelsInAnotherOrder) {
  const auto u = ball_displacement(30, strong_map);
  const auto texture = [](const Vec3d& p) { return 100 * std::sin(p.x / 4) * std::cos(p.y / 5) + p.z; };
  const Grid moving_grid = make_grid({40, 40, 30}, {2, 2, 2.5}, oblique());
  const Grid fixed_grid = make_grid({40, 60, 30}, {2, 2, 2.5});
  const Grid fixed_other = reordered(fixed_grid);
  const Image moving = image_of(moving_grid, texture), moving_other = image_of(reordered(moving_grid), texture);
  InverseStatistics statistics;
  const DenseField field = inverse_field(fixed_grid, forward_field(moving_grid, u), u, 1e-5, statistics);
  const DenseField field_other = inverse_field(fixed_other, forward_field(moving_other.grid, u), u, 1e-5, statistics);
  const Image a = warp_image(moving, field.displacement, Interpolation::linear, 0);
  const Image b = warp_image(moving_other, field_other.displacement, Interpolation::linear, 0);
  for (int k = 0; k < 30; ++k)
    for (int j = 0; j < 60; ++j)
      for (int i = 0; i < 40; ++i) {
        if (!field.covered.at(i, j, k) || !field_other.covered.at(59 - j, i, k)) continue;
        ASSERT_NEAR(a.at(i, j, k), b.at(59 - j, i, k), 2e-3);
      }
}

TEST(Warp, CubicInterpolatesAndIsMoreAccurateThanLinear) {
  const auto wave = [](const Vec3d& p) { return std::sin(p.x / 3) * std::cos(p.y / 4) + std::sin(p.z / 5); };
  const Image image = image_of(make_grid({30, 28, 26}, {1, 1, 1.5}), wave);
  const Image same = warp_image(image, VectorImage(image.grid), Interpolation::cubic, 0);
  for (std::size_t v = 0; v < image.data.size(); ++v) ASSERT_NEAR(same.data[v], image.data[v], 1e-5);

  const VectorImage shifted(image.grid, Vec3f{0.4f, -0.3f, 0.6f});
  const Image linear = warp_image(image, shifted, Interpolation::linear, 0);
  const Image cubic = warp_image(image, shifted, Interpolation::cubic, 0);
  double linear_error = 0, cubic_error = 0;
  for (int k = 5; k < 20; ++k)
    for (int j = 5; j < 20; ++j)
      for (int i = 5; i < 20; ++i) {
        const double exact = wave(image.grid.point(i, j, k) + Vec3d{0.4, -0.3, 0.6});
        linear_error = std::max(linear_error, std::abs(linear.at(i, j, k) - exact));
        cubic_error = std::max(cubic_error, std::abs(cubic.at(i, j, k) - exact));
      }
  EXPECT_LT(cubic_error, 1e-3);
  EXPECT_GT(linear_error, 10 * cubic_error);
}

TEST(Warp, PositionsOutsideGetTheOutsideValue) {
  const Image image(make_grid({6, 1, 2}, {1, 1, 1}), 5);
  const VectorImage far(image.grid, Vec3f{3, 0, 0});
  for (const Interpolation interpolation : {Interpolation::nearest, Interpolation::linear, Interpolation::cubic}) {
    const Image warped = warp_image(image, far, interpolation, -1000);
    EXPECT_NEAR(warped.at(2, 0, 0), 5, 1e-5);
    EXPECT_EQ(warped.at(3, 0, 1), -1000);
  }
}

TEST(Warp, ContinuedBeyondTheBorder) {
  constexpr double rounding = 1e-4;  // of intensities of some hundred in single precision
  Grid grid = make_grid({6, 5, 4}, {1.5, 1, 2}, oblique()), finer = make_grid({13, 9, 7}, {1, 1.1, 1.7});
  const Image image = image_of(grid, ramp);
  VectorImage field(finer);
  for (std::size_t v = 0; v < field.data.size(); ++v) field.data[v] = {2.5f * float(v % 3), -1.5f, 0.3f * float(v % 5)};
  for (const VectorImage* by : {static_cast<const VectorImage*>(nullptr), static_cast<const VectorImage*>(&field)}) {
    Mask inside;
    const Image warped = warp_continued(image, finer, by, inside);
    std::size_t outside = 0;
    for (int k = 0; k < finer.size[2]; ++k)
      for (int j = 0; j < finer.size[1]; ++j)
        for (int i = 0; i < finer.size[0]; ++i) {
          const Vec3f v = by ? by->at(i, j, k) : Vec3f{};
          const Vec3d index = grid.index(finer.point(i, j, k) + Vec3d{v.x, v.y, v.z});
          Vec3d border;
          bool in = true;
          for (int a = 0; a < 3; ++a) {
            in = in && index[a] >= -0.5 && index[a] <= grid.size[std::size_t(a)] - 0.5;
            border[a] = std::clamp(index[a], 0.0, double(grid.size[std::size_t(a)] - 1));
          }
          ASSERT_EQ(inside.at(i, j, k), in);
          ASSERT_NEAR(warped.at(i, j, k), ramp(grid.point(border)), rounding);
          outside += !in;
        }
    EXPECT_GT(outside, 0u);
    EXPECT_LT(outside, finer.count());
  }
}

TEST(Warp, LabelsComeFromTheNearestVoxel) {
  LabelImage labels(make_grid({10, 3, 3}, {2, 2, 2}));
  labels.at(4, 1, 1) = 300;
  const LabelImage warped = warp_labels(labels, VectorImage(labels.grid, Vec3f{2.9f, 0, 0}));
  EXPECT_EQ(warped.at(3, 1, 1), 300);
  EXPECT_EQ(warped.at(4, 1, 1), 0);
  EXPECT_EQ(warped.at(9, 1, 1), 0);
  Grid shifted = labels.grid;
  shifted.origin.x += 2.9;
  EXPECT_EQ(labels_at(labels, shifted).data, warped.data);
}

TEST(WarpPoints, UsesTheMechanicsThenTheDenseFieldThenNaN) {
  const auto u = ball_displacement(10, [](const Vec3d& X) { return X + Vec3d{1, 2, 3}; });
  const VectorImage dense(make_grid({41, 41, 41}, {1, 1, 1}), Vec3f{-1, 0, 0});
  const auto warped = warp_points({{1, 1, 1}, {15, 0, 0}, {100, 0, 0}}, u, dense);
  EXPECT_EQ(warped[0], (Vec3d{2, 3, 4}));
  EXPECT_EQ(warped[1], (Vec3d{14, 0, 0}));
  EXPECT_TRUE(std::isnan(warped[2].x) && std::isnan(warped[2].y) && std::isnan(warped[2].z));
}

VectorImage affine_field(const Grid& grid, const Mat3d& F) {
  VectorImage field(grid);
  for (int k = 0; k < grid.size[2]; ++k)
    for (int j = 0; j < grid.size[1]; ++j)
      for (int i = 0; i < grid.size[0]; ++i) {
        const Vec3d X = grid.point(i, j, k), u = F * X - X;
        field.at(i, j, k) = {float(u.x), float(u.y), float(u.z)};
      }
  return field;
}

TEST(Jacobian, OfAnAffineMapIsItsDeterminant) {
  const Mat3d F{{{1.1, 0.2, -0.1}, {0.05, 0.8, 0.3}, {-0.2, 0.1, 1.05}}};
  for (const Grid& grid : {make_grid({9, 8, 7}, {1, 2, 3}), reordered(make_grid({9, 8, 7}, {1, 2, 3}, oblique()))}) {
    const auto statistics = jacobian_statistics(affine_field(grid, F), Mask(grid, 1));
    EXPECT_NEAR(statistics.minimum, determinant(F), 2e-5);
    EXPECT_NEAR(statistics.median, determinant(F), 2e-5);
    EXPECT_NEAR(statistics.maximum, determinant(F), 2e-5);
    EXPECT_EQ(statistics.voxels, grid.count());
    EXPECT_EQ(statistics.folded, 0u);
  }
}

TEST(Jacobian, FindsFoldsAndLooksOnlyInsideTheMask) {
  const Grid grid = make_grid({20, 6, 6}, {1, 1, 1});
  VectorImage field(grid);
  Mask left(grid);
  for (int k = 0; k < 6; ++k)
    for (int j = 0; j < 6; ++j)
      for (int i = 0; i < 20; ++i) {
        if (i >= 10) field.at(i, j, k).x = -1.5f * float(i - 10);  // det = -0.5 there
        left.at(i, j, k) = i <= 10;
      }
  const auto everywhere = jacobian_statistics(field, Mask(grid, 1));
  EXPECT_NEAR(everywhere.minimum, -0.5, 1e-6);
  EXPECT_EQ(everywhere.folded, 9u * 36);
  EXPECT_EQ(jacobian_statistics(field, left).folded, 0u);
  EXPECT_NEAR(jacobian_statistics(field, left).minimum, 1, 1e-6);
  EXPECT_THROW(jacobian_statistics(field, Mask(grid)), Error);
}

TEST(Resample, KeepsARampAndTheExtent) {
  const Image image = image_of(make_grid({30, 20, 11}, {1, 1.5, 3}, oblique()), ramp);
  const Image result = resample(image, {1.7, 1, 4});
  for (int a = 0; a < 3; ++a) {
    EXPECT_NEAR(result.grid.size[a] * result.grid.spacing[a], image.grid.size[a] * image.grid.spacing[a], 1e-9);
    EXPECT_NEAR(result.grid.spacing[a], (Vec3d{1.7, 1, 4})[a], 0.15);
  }
  const Vec3d corner = result.grid.point(Vec3d{-0.5, -0.5, -0.5}) - image.grid.point(Vec3d{-0.5, -0.5, -0.5});
  EXPECT_NEAR(norm(corner), 0, 1e-9);
  for (int k = 1; k + 1 < result.grid.size[2]; ++k)
    for (int j = 1; j + 1 < result.grid.size[1]; ++j)
      for (int i = 1; i + 1 < result.grid.size[0]; ++i)
        ASSERT_NEAR(result.at(i, j, k), ramp(result.grid.point(i, j, k)), 1e-4);
  EXPECT_THROW(resample(image, {0, 1, 1}), Error);
}

TEST(ResampleLabels, TakesTheNearestAndRefusesImagesApart) {
  LabelImage labels(make_grid({10, 10, 10}, {2, 2, 2}), 7);
  Grid grid = make_grid({30, 30, 30}, {1, 1, 1});
  const LabelImage result = resample_labels(labels, grid);
  EXPECT_EQ(result.at(15, 15, 15), 7);
  EXPECT_EQ(result.at(0, 0, 0), 0);
  grid.origin += Vec3d{500, 0, 0};
  EXPECT_THROW(resample_labels(labels, grid), Error);
}

}  // namespace
}  // namespace mtled
