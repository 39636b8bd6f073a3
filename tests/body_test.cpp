#include "imaging/body.hpp"

#include <gtest/gtest.h>

#include <cmath>

#include "core/error.hpp"
#include "imaging/morphology.hpp"

namespace mtled {
namespace {

constexpr float air = -1000, lung = -800, soft = 40, bone = 600;

bool in_ellipse(double x, double y, double a, double b) { return x * x / (a * a) + y * y / (b * b) <= 1; }

Grid thorax_grid() { return {{80, 70, 30}, {-80, -70, -45}, {2, 2, 3}, Mat3d::identity()}; }

template <class Visit>
void for_each_voxel(const Grid& grid, Visit visit) {
  for (int k = 0; k < grid.size[2]; ++k)
    for (int j = 0; j < grid.size[1]; ++j)
      for (int i = 0; i < grid.size[0]; ++i) visit(i, j, k, grid.point(i, j, k));
}
/// A thorax without arms, cut by the first and last slice: two lungs that reach both, bowel gas, a couch that touches
/// the back, a thin sheet around it.
bool in_body(const Vec3d& x) { return in_ellipse(x.x, x.y, 62, 42); }
float intensity(const Vec3d& x) {
  if (in_body(x)) {
    if (in_ellipse(x.x - 30, x.y, 18, 24) || in_ellipse(x.x + 30, x.y, 18, 24)) return lung;
    if (norm(x - Vec3d{0, -15, 0}) < 8) return air;
    return in_ellipse(x.x, x.y - 25, 9, 9) ? bone : soft;
  }
  if (x.y > 42 && x.y < 50 && std::abs(x.x) < 75) return -200;    // couch
  if (std::abs(x.y + 50) < 2 && std::abs(x.x) < 40) return -300;  // sheet
  return air;
}
Image thorax(const Grid& grid) {
  Image ct(grid);
  for_each_voxel(grid, [&](int i, int j, int k, const Vec3d& x) { ct.at(i, j, k) = intensity(x); });
  return ct;
}
double dice(const Mask& a, const Mask& b) {
  double both = 0, sum = 0;
  for (std::size_t v = 0; v < a.data.size(); ++v)
    both += a.data[v] && b.data[v], sum += (a.data[v] != 0) + (b.data[v] != 0);
  return 2 * both / sum;
}
Mask true_body(const Grid& grid) {
  Mask body(grid);
  for_each_voxel(grid, [&](int i, int j, int k, const Vec3d& x) { body.at(i, j, k) = in_body(x); });
  return body;
}

TEST(BodyMask, FindsTheBodyWithoutCouchAndSheet) {
  const Image ct = thorax(thorax_grid());
  const Mask body = body_mask(ct, {});
  EXPECT_GT(dice(body, true_body(ct.grid)), 0.99);
  for_each_voxel(ct.grid, [&](int i, int j, int k, const Vec3d& x) {
    const bool outside = std::abs(x.y + 50) < 2 || x.y > 48, inside = in_ellipse(x.x, x.y, 55, 36);
    if (outside || inside) {
      EXPECT_EQ(body.at(i, j, k), inside) << x.x << " " << x.y << " " << x.z;
    }
  });
}

TEST(BodyMask, WithoutOpeningTheCouchStays) {
  const Image ct = thorax(thorax_grid());
  const Mask body = body_mask(ct, {.opening_radius_mm = 0});
  EXPECT_EQ(nearest_value<std::uint8_t>(body, {70, 46, 0}, 0), 1);
}

TEST(BodyMask, FillsALungThatTheSideOfTheImageCuts) {
  Grid grid = thorax_grid();
  grid.size[0] = 24;  // up to x = -34: through the right lung
  const Image ct = thorax(grid);
  EXPECT_GT(dice(body_mask(ct, {}), true_body(grid)), 0.985);
}

TEST(BodyMask, FollowsTheAxesOfTheImage) {
  // The same thorax with its voxel axes in the order z, x, y and z flipped.
  Grid grid = thorax_grid();
  grid.size = {30, 80, 70};
  grid.spacing = {3, 2, 2};
  grid.origin = {-80, -70, 42};
  grid.direction = Mat3d{};
  grid.direction[2][0] = -1, grid.direction[0][1] = 1, grid.direction[1][2] = 1;
  const Image ct = thorax(grid);
  EXPECT_GT(dice(body_mask(ct, {}), true_body(grid)), 0.99);
}

TEST(BodyMask, SaysWhyNothingWasFound) {
  const Image empty(thorax_grid(), air);
  try {
    body_mask(empty, {});
    FAIL();
  } catch (const Error& error) {
    EXPECT_EQ(error.failure(), Failure::input);
    EXPECT_NE(std::string(error.what()).find("from -1000 to -1000"), std::string::npos) << error.what();
    EXPECT_NE(std::string(error.what()).find("-500 HU"), std::string::npos) << error.what();
  }
}

TEST(Morphology, BallsAreExactInMillimetres) {
  Mask one(Grid{{21, 15, 11}, {}, {1, 1.5, 2.5}, Mat3d::identity()});
  one.at(10, 7, 5) = 1;
  const Vec3d center = one.grid.point(10, 7, 5);
  const double radius = 5;
  const Mask ball = dilate(one, radius);
  for_each_voxel(one.grid, [&](int i, int j, int k, const Vec3d& x) {
    EXPECT_EQ(ball.at(i, j, k), norm(x - center) <= radius) << i << " " << j << " " << k;
  });
  EXPECT_EQ(erode(ball, radius).data, one.data);
}

TEST(Morphology, KeepsTheLargestComponentAndFloodsByFaces) {
  Mask mask(Grid{{6, 3, 2}});
  for (const int i : {0, 1, 4}) mask.at(i, 0, 0) = 1;
  mask.at(2, 1, 0) = 1;  // touches (1,0,0) by an edge only
  mask.at(4, 0, 1) = 1, mask.at(4, 1, 1) = 1;
  EXPECT_EQ(largest_component(mask).at(4, 1, 1), 1);
  EXPECT_EQ(largest_component(mask).at(0, 0, 0), 0);
  const Mask in_slice = flood(mask, {mask.grid.offset(4, 0, 0)}, 2);
  EXPECT_EQ(in_slice.at(4, 0, 0), 1);
  EXPECT_EQ(in_slice.at(4, 0, 1), 0);
}

}  // namespace
}  // namespace mtled
