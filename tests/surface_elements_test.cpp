#include "imaging/surface_elements.hpp"

#include <gtest/gtest.h>

#include <cmath>

namespace mtled {
namespace {

constexpr double rounding = 1e-12;  ///< of areas of about 1
constexpr double rounding_mm = 1e-9;

int corner(int i, int j, int k) { return 1 << (i + 2 * j + 4 * k); }

TEST(SurfaceAreas, OfSimpleCellsAreThoseOfTheirPolygons) {
  const auto area = surface_areas_in_cells({1, 1, 1});
  EXPECT_EQ(area[0], 0);
  EXPECT_EQ(area[255], 0);
  const double triangle = std::sqrt(3) / 8;  // equilateral, of side sqrt(1/2)
  EXPECT_NEAR(area[std::size_t(corner(0, 0, 0))], triangle, rounding);
  EXPECT_NEAR(area[std::size_t(corner(0, 0, 0) | corner(1, 1, 0))], 2 * triangle, rounding) << "at opposite corners of a face: apart";
  EXPECT_NEAR(area[std::size_t(corner(0, 0, 0) | corner(1, 1, 1))], 2 * triangle, rounding);
  EXPECT_NEAR(area[std::size_t(corner(0, 0, 0) | corner(1, 0, 0))], std::sqrt(0.5), rounding) << "a rectangle";
  EXPECT_NEAR(area[std::size_t(corner(0, 0, 0) | corner(1, 0, 0) | corner(0, 1, 0) | corner(1, 1, 0))], 1, rounding) << "half of the cell";
  EXPECT_NEAR(area[std::size_t(corner(0, 0, 0) | corner(1, 0, 0) | corner(0, 1, 0) | corner(0, 0, 1))], 6 * triangle, rounding) << "a regular hexagon";
  // Three in an L: half of the square between the cut edges, and a trapezoid of three of the small triangles.
  EXPECT_NEAR(area[std::size_t(corner(0, 0, 0) | corner(1, 0, 0) | corner(0, 1, 0))], 0.5 + 3 * triangle, rounding);
}

TEST(SurfaceAreas, FollowTheSpacingAndAreThoseOfTheComplement) {
  const auto area = surface_areas_in_cells({2, 3, 5});
  EXPECT_NEAR(area[std::size_t(corner(0, 0, 0) | corner(1, 0, 0) | corner(0, 1, 0) | corner(1, 1, 0))], 6, 6 * rounding);
  EXPECT_NEAR(area[std::size_t(corner(0, 0, 0) | corner(1, 0, 0))], 2 * std::hypot(1.5, 2.5), 6 * rounding);
  for (std::size_t inside = 0; inside < 256; ++inside) EXPECT_EQ(area[inside], area[255 - inside]);
}

TEST(SurfaceAreas, DoNotDependOnTheNamesOfTheAxes) {
  const auto xyz = surface_areas_in_cells({2, 3, 5}), zxy = surface_areas_in_cells({5, 2, 3});
  for (int inside = 0; inside < 256; ++inside) {
    int turned = 0;
    for (int b = 0; b < 8; ++b)
      if (inside >> b & 1) turned |= corner(b >> 2 & 1, b & 1, b >> 1 & 1);
    EXPECT_NEAR(xyz[std::size_t(inside)], zxy[std::size_t(turned)], 30 * rounding) << inside;
  }
}

LabelImage box(const Grid& grid, int first, int edge) {
  LabelImage labels(grid);
  for (int k = first; k < first + edge; ++k)
    for (int j = first; j < first + edge; ++j)
      for (int i = first; i < first + edge; ++i) labels.at(i, j, k) = 4;
  return labels;
}

TEST(SurfaceElements, OfABoxHaveItsAreaWithCutEdgesAndCorners) {
  Grid grid;
  grid.size = {12, 12, 12};
  for (const int first : {2, 0}) {  // also where the box touches the end of the image
    const auto elements = surface_elements(box(grid, first, 6));
    ASSERT_EQ(elements.size(), 1u);
    double sum = 0;
    for (const SurfaceElement& e : elements.at(4)) sum += e.area;
    // Per face 5 x 5 cells, along each of 12 edges 5 cells whose corner is cut off, and 8 corners.
    EXPECT_NEAR(sum, 6 * 25 + 12 * 5 * std::sqrt(0.5) + 8 * std::sqrt(3) / 8, 1000 * rounding);
    EXPECT_EQ(elements.at(4).size(), 6u * 25 + 12 * 5 + 8);
  }
}

TEST(HausdorffByArea, CountsAreaAndTakesTheLargerDirection) {
  const std::vector<SurfaceElement> a{{{0, 0, 0}, 1}}, b{{{0, 0, 0}, 90}, {{0, 3, 0}, 6}, {{0, 0, 7}, 4}};
  EXPECT_NEAR(hausdorff_by_area(a, b, 90), 0, rounding_mm);
  EXPECT_NEAR(hausdorff_by_area(a, b, 95), 3, rounding_mm);
  EXPECT_NEAR(hausdorff_by_area(b, a, 96.5), 7, rounding_mm);
  EXPECT_NEAR(hausdorff_by_area(a, b, 100), 7, rounding_mm);
  EXPECT_TRUE(std::isnan(hausdorff_by_area(a, {}, 95)));
}

}  // namespace
}  // namespace mtled
