#include <gtest/gtest.h>

#include <numbers>
#include <random>

#include "core/motion.hpp"
#include "core/tensor.hpp"
#include "core/volume.hpp"

namespace mtled {
namespace {

constexpr double rounding = 1e-12;  ///< some tens of double roundings of numbers of size 1 to 100
constexpr double degree = std::numbers::pi / 180;

struct Random {
  std::mt19937 engine{5};
  std::uniform_real_distribution<double> unit{-1, 1};
  Vec3d vector() { return {unit(engine), unit(engine), unit(engine)}; }
  Mat3d matrix() {
    Mat3d a;
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) a[i][j] = unit(engine);
    return a;
  }
};

double difference(const Vec3d& a, const Vec3d& b) { return norm(a - b); }
double difference(const Mat3d& a, const Mat3d& b) {
  double top = 0;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) top = std::max(top, std::abs(a[i][j] - b[i][j]));
  return top;
}

TEST(Tensor, CrossProductFollowsTheRightHand) {
  EXPECT_EQ(cross(Vec3d{1, 0, 0}, Vec3d{0, 1, 0}), (Vec3d{0, 0, 1}));
  Random random;
  for (int n = 0; n < 10; ++n) {
    const Vec3d a = random.vector(), b = random.vector();
    EXPECT_NEAR(dot(cross(a, b), a), 0, rounding);
    EXPECT_NEAR(squared_norm(cross(a, b)) + dot(a, b) * dot(a, b), squared_norm(a) * squared_norm(b), rounding);
  }
}

TEST(Tensor, DeterminantAndInverse) {
  EXPECT_DOUBLE_EQ(determinant(Mat3d{{{2, 1, 0}, {0, 3, 5}, {1, 0, 4}}}), 2 * 12 - 1 * (0 - 5));
  Random random;
  for (int n = 0; n < 10; ++n) {
    Mat3d a = random.matrix(), b = random.matrix();
    for (int i = 0; i < 3; ++i) a[i][i] += 3;
    EXPECT_LT(difference(a * inverse(a), Mat3d::identity()), rounding);
    EXPECT_NEAR(determinant(a * b), determinant(a) * determinant(b), 100 * rounding);
    EXPECT_LT(difference(a * transpose(cofactors(a)), [&] {
      Mat3d d;
      for (int i = 0; i < 3; ++i) d[i][i] = determinant(a);
      return d;
    }()), 100 * rounding);
  }
}

TEST(Tensor, CofactorsAreTheDerivativeOfTheDeterminant) {
  Random random;
  constexpr double step = 1e-6, truncation = 1e-9;
  const Mat3d a = random.matrix(), c = cofactors(a);
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) {
      Mat3d up = a, down = a;
      up[i][j] += step, down[i][j] -= step;
      EXPECT_NEAR(c[i][j], (determinant(up) - determinant(down)) / (2 * step), truncation);
    }
}

TEST(RotationMatrix, TurnsByTheRightHand) {
  const Mat3d r = rotation_matrix({0, 0, 90 * degree});
  EXPECT_LT(difference(r * Vec3d{1, 0, 0}, Vec3d{0, 1, 0}), rounding);
  EXPECT_LT(difference(rotation_matrix({}), Mat3d::identity()), rounding);
}

TEST(RotationMatrix, IsTheInverseOfRotationVector) {
  Random random;
  for (double angle : {1e-9, 1e-4, 0.3, 2.0, 3.1, std::numbers::pi - 1e-6}) {
    const Vec3d direction = random.vector(), v = (angle / norm(direction)) * direction;
    const Mat3d r = rotation_matrix(v);
    EXPECT_LT(difference(r * transpose(r), Mat3d::identity()), rounding) << angle;
    EXPECT_NEAR(determinant(r), 1, rounding);
    // Near half a turn the axis follows from differences of nearly equal numbers.
    EXPECT_LT(difference(rotation_vector(r), v), angle > 3.13 ? 1e-8 : rounding) << angle;
  }
  EXPECT_LT(norm(rotation_vector(Mat3d::identity())), rounding);
}

TEST(RotationMatrix, DerivativeAtRestIsTheCrossProduct) {
  const Vec3d w{0.3, -0.2, 0.9}, x{1, 2, 3};
  constexpr double step = 1e-6, truncation = 1e-5;  // first-order difference
  EXPECT_LT(difference((1 / step) * (rotation_matrix(step * w) * x - x), cross(w, x)), truncation);
}

RigidMotion some_motion(double s) { return {{10, -5, 3 * s}, rotation_matrix({0.2 * s, -0.4, 0.1}), {1, 2 * s, -3}}; }

TEST(RigidMotion, TurnsAboutItsCentreThenMoves) {
  const RigidMotion m{{1, 0, 0}, rotation_matrix({0, 0, 90 * degree}), {0, 0, 5}};
  EXPECT_LT(difference(m.apply({2, 0, 0}), Vec3d{1, 1, 5}), rounding);
  EXPECT_LT(difference(m.displacement({1, 0, 7}), Vec3d{0, 0, 5}), rounding);
}

TEST(RigidMotion, InverseUndoesIt) {
  Random random;
  for (int n = 0; n < 10; ++n) {
    const Vec3d x = 50.0 * random.vector();
    const RigidMotion m = some_motion(n);
    EXPECT_LT(difference(inverse(m).apply(m.apply(x)), x), 100 * rounding);
    EXPECT_LT(difference(m.apply(inverse(m).apply(x)), x), 100 * rounding);
  }
}

TEST(RigidMotion, ComposeAppliesInnerFirst) {
  Random random;
  for (int n = 0; n < 10; ++n) {
    const Vec3d x = 50.0 * random.vector();
    const RigidMotion inner = some_motion(n), outer = some_motion(2.5 - n);
    EXPECT_LT(difference(compose(outer, inner).apply(x), outer.apply(inner.apply(x))), 100 * rounding);
    EXPECT_GT(difference(compose(inner, outer).apply(x), outer.apply(inner.apply(x))), 0.1);  // the order matters
  }
}

/// Oblique, anisotropic and flipped, as scanners write them.
Grid oblique_grid() {
  Mat3d direction = rotation_matrix({0.3, -0.2, 0.5});
  for (int i = 0; i < 3; ++i) direction[i][2] *= -1;
  return {{4, 5, 6}, {-20, 30, 7}, {0.8, 1.1, 2.5}, direction};
}

TEST(Grid, PointsFollowOriginSpacingAndDirection) {
  const Grid grid{{4, 5, 6}, {10, 20, 30}, {1, 2, 3}};
  EXPECT_EQ(grid.point(1, 2, 3), (Vec3d{11, 24, 39}));
  EXPECT_EQ(grid.count(), 120u);
  EXPECT_EQ(grid.offset(1, 2, 3), 1u + 4 * (2 + 5 * 3));
  const Grid oblique = oblique_grid();
  EXPECT_NEAR(norm(oblique.point(0, 0, 3) - oblique.origin), 7.5, rounding);
  EXPECT_EQ(oblique.point(0, 0, 0), oblique.origin);
}

TEST(Grid, IndexIsTheInverseOfPoint) {
  const Grid grid = oblique_grid();
  Random random;
  for (int n = 0; n < 10; ++n) {
    const Vec3d c = 10.0 * random.vector();
    EXPECT_LT(difference(grid.index(grid.point(c)), c), 100 * rounding);
  }
}

/// An image that is linear in space.
double linear_function(const Vec3d& x) { return 3 + 0.5 * x.x - 2 * x.y + 0.25 * x.z; }
Image linear_image(const Grid& grid) {
  Image image(grid);
  for (int k = 0; k < grid.size[2]; ++k)
    for (int j = 0; j < grid.size[1]; ++j)
      for (int i = 0; i < grid.size[0]; ++i) image.at(i, j, k) = float(linear_function(grid.point(i, j, k)));
  return image;
}
constexpr double float_rounding = 1e-4;  ///< of voxel values up to 100 held in float

TEST(LinearValue, IsExactForLinearImages) {
  const Image image = linear_image(oblique_grid());
  VectorImage vectors(image.grid);
  for (std::size_t v = 0; v < image.data.size(); ++v) vectors.data[v] = {image.data[v], 2 * image.data[v], -image.data[v]};
  Random random;
  for (int n = 0; n < 100; ++n) {
    const Vec3d u = random.vector();
    const Vec3d x = image.grid.point({1.5 + 1.5 * u.x, 2 + 2 * u.y, 2.5 + 2.5 * u.z});
    double value = 0;
    ASSERT_TRUE(linear_value(image, x, value));
    EXPECT_NEAR(value, linear_function(x), float_rounding);
    Vec3d vector;
    ASSERT_TRUE(linear_value(vectors, x, vector));
    EXPECT_LT(difference(vector, value * Vec3d{1, 2, -1}), float_rounding);
  }
}

TEST(LinearValue, IsClampedWithinHalfAVoxelAndAbsentBeyond) {
  const Image image = linear_image(oblique_grid());
  double value = 0;
  EXPECT_TRUE(linear_value(image, image.grid.point({-0.49, 2, 2}), value));
  EXPECT_NEAR(value, image.at(0, 2, 2), float_rounding);
  EXPECT_TRUE(linear_value(image, image.grid.point({3.49, 4.49, 5.49}), value));
  EXPECT_NEAR(value, image.at(3, 4, 5), float_rounding);
  EXPECT_FALSE(linear_value(image, image.grid.point({-0.51, 2, 2}), value));
  EXPECT_FALSE(linear_value(image, image.grid.point({1, 2, 5.51}), value));
  EXPECT_FALSE(linear_value(image, {std::numeric_limits<double>::quiet_NaN(), 0, 0}, value));
}

TEST(LinearValue, WorksForASingleSlice) {
  const Image image = linear_image({{3, 3, 1}});
  double value = 0;
  ASSERT_TRUE(linear_value(image, {0.5, 1.5, 0.3}, value));
  EXPECT_NEAR(value, linear_function({0.5, 1.5, 0}), float_rounding);
}

TEST(NearestValue, IsTheVoxelThatHoldsThePoint) {
  const Image image = linear_image(oblique_grid());
  EXPECT_EQ(nearest_value(image, image.grid.point({1.4, 2.6, 3.1}), -1.0F), image.at(1, 3, 3));
  EXPECT_EQ(nearest_value(image, image.grid.point({-0.4, 4.4, 5.4}), -1.0F), image.at(0, 4, 5));
  EXPECT_EQ(nearest_value(image, image.grid.point({-0.6, 2, 2}), -1.0F), -1.0F);
  EXPECT_EQ(nearest_value(image, image.grid.point({1, 2, 5.6}), -1.0F), -1.0F);
}

}  // namespace
}  // namespace mtled
