#include "imaging/field_difference.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numeric>
#include <random>

#include "core/error.hpp"
#include "imaging/percentile.hpp"

namespace mtled {
namespace {

constexpr double single_precision = 1e-6;  ///< relative, of differences kept as float

/// 101 points 1 mm apart along x; the reference moves the one at x by (0, x, 0).
struct Line {
  std::vector<Vec3d> points, reference;
  Line() {
    for (int n = 0; n <= 100; ++n) points.push_back({double(n), 5, -3}), reference.push_back({0, double(n), 0});
  }
};

TEST(FieldDifference, OfAConstantOffsetIsItsLengthAtEveryPercentile) {
  const Line line;
  const FieldDifference d = compare_displacements([](const Vec3d& x, Vec3d& u) { return u = {3, x.x, -4}, true; }, line.points, line.reference);
  ASSERT_EQ(d.curve_mm.size(), 100u);
  for (const double value : d.curve_mm) EXPECT_EQ(value, 5);
  for (const double value : {d.mean, d.root_mean_square, d.median, d.percentile_95, d.percentile_99_5, d.maximum}) EXPECT_EQ(value, 5);
  EXPECT_EQ(d.within_half_mm, 0);
  EXPECT_EQ(d.unknown, 0u);
  ASSERT_EQ(d.groups.size(), 10u);
  std::size_t points = 0;
  for (const DifferenceGroup& g : d.groups) {
    points += g.points;
    EXPECT_EQ(g.median_mm, 5);
    EXPECT_EQ(g.percentile_95_mm, 5);
  }
  EXPECT_EQ(points, 101u);
  EXPECT_EQ(d.groups.front().from_mm, 0);
  EXPECT_EQ(d.groups.back().to_mm, 100);
}

TEST(FieldDifference, ThatGrowsLinearlyHasItsPercentilesOnALine) {
  const Line line;
  const FieldDifference d = compare_displacements([](const Vec3d& x, Vec3d& u) { return u = {0, 0.99 * x.x, 0}, true; }, line.points, line.reference);
  for (int percent = 1; percent <= 100; ++percent) EXPECT_NEAR(d.curve_mm[std::size_t(percent - 1)], 0.01 * percent, single_precision);
  EXPECT_NEAR(d.mean, 0.5, single_precision);
  EXPECT_NEAR(d.root_mean_square, 0.01 * std::sqrt(100.0 * 201 / 6), single_precision);  // sum of squares of 0 to n: n (n + 1) (2 n + 1) / 6
  EXPECT_NEAR(d.percentile_99_5, 0.995, single_precision);
  EXPECT_NEAR(d.within_half_mm, 51 / 101.0, 1.0 / 101) << "the point at 0.5 mm may fall on either side";
  // Groups of 10 points, the last of 11: their medians lie in the middle of their displacements.
  for (const DifferenceGroup& g : d.groups) EXPECT_NEAR(g.median_mm, 0.005 * (g.from_mm + g.to_mm), single_precision);
}

/// Many points share a displacement, so that most borders of the groups lie among equals.
TEST(FieldDifference, IsThatOfTheSortedPoints) {
  std::mt19937 random(7);
  std::vector<Vec3d> points, reference, moved;
  for (int n = 0; n < 9973; ++n) {
    points.push_back({double(n), 0, 0});
    reference.push_back({std::floor(std::exponential_distribution(0.5)(random)), 0, 0});
    moved.push_back(reference.back() + Vec3d{0, std::normal_distribution(0.0, 2.0)(random), 0});
  }
  const FieldDifference d = compare_displacements([&](const Vec3d& x, Vec3d& u) { return u = moved[std::size_t(x.x)], true; }, points, reference);
  std::vector<std::size_t> order(points.size());
  std::iota(order.begin(), order.end(), std::size_t(0));
  std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) { return d.reference_mm[a] < d.reference_mm[b]; });
  ASSERT_EQ(d.groups.size(), 10u);
  for (std::size_t g = 0; g < 10; ++g) {
    const std::size_t first = g * order.size() / 10, end = (g + 1) * order.size() / 10;
    std::vector<float> values;
    for (std::size_t n = first; n < end; ++n) values.push_back(d.difference_mm[order[n]]);
    EXPECT_EQ(d.groups[g].points, end - first);
    EXPECT_EQ(d.groups[g].from_mm, d.reference_mm[order[first]]);
    EXPECT_EQ(d.groups[g].to_mm, d.reference_mm[order[end - 1]]);
    EXPECT_EQ(d.groups[g].median_mm, percentile(values, 50));
    EXPECT_EQ(d.groups[g].percentile_95_mm, percentile(values, 95));
  }
  std::vector<float> sorted = d.difference_mm;
  std::sort(sorted.begin(), sorted.end());
  for (int percent = 1; percent <= 100; ++percent) EXPECT_EQ(d.curve_mm[std::size_t(percent - 1)], percentile_of_sorted(sorted, percent));
  EXPECT_EQ(d.percentile_99_5, percentile_of_sorted(sorted, 99.5));
  EXPECT_EQ(d.maximum, sorted.back());
}

TEST(FieldDifference, LeavesOutAndCountsWhatIsUnknown) {
  const Line line;
  const auto half_known = [](const Vec3d& x, Vec3d& u) { return u = {1, x.x, 0}, x.x < 30; };
  const FieldDifference d = compare_displacements(half_known, line.points, line.reference);
  EXPECT_EQ(d.difference_mm, std::vector<float>(30, 1));
  EXPECT_EQ(d.reference_mm[29], 29);
  EXPECT_EQ(d.unknown, 71u);
  const auto nothing = [](const Vec3d&, Vec3d&) { return false; };
  EXPECT_THROW(compare_displacements(nothing, line.points, line.reference), Error);
  EXPECT_THROW(compare_displacements(half_known, line.points, {}), Error);
  EXPECT_THROW(compare_displacements(half_known, std::vector<Vec3d>{}, std::vector<Vec3d>{}), Error);
}

Grid oblique_grid() {
  Grid grid;
  grid.size = {20, 12, 8}, grid.origin = {-10, 20, 5}, grid.spacing = {1.5, 1, 2}, grid.direction = rotation_matrix({0.3, -0.2, 0.5});
  return grid;
}

TEST(FieldDifference, OfFieldsIsTakenWhereBothAreKnown) {
  const Grid grid = oblique_grid();
  const auto reference = [&](const Vec3d& x, Vec3d& u) { return u = {0.1 * x.x, 2, 0}, grid.index(x).x > 9.5; };
  const auto u = [&](const Vec3d& x, Vec3d& v) { return v = {0.1 * x.x, 2, 0.25}, grid.index(x).y > 2.5; };
  const FieldDifference d = compare_displacements(u, reference, grid);
  EXPECT_EQ(d.difference_mm.size(), 10u * 9 * 8);
  EXPECT_EQ(d.unknown, 10u * 3 * 8);
  EXPECT_EQ(d.mean, 0.25);
  EXPECT_EQ(d.maximum, 0.25);
  EXPECT_EQ(d.within_half_mm, 1);
  Grid slice = grid;
  slice.size[2] = 1;
  const Image values = difference_on_slice(u, reference, slice);
  for (int j = 0; j < 12; ++j)
    for (int i = 0; i < 20; ++i) {
      if (i > 9 && j > 2) EXPECT_EQ(values.at(i, j, 0), 0.25f);
      else EXPECT_TRUE(std::isnan(values.at(i, j, 0)));
    }
}

TEST(FieldDifference, OfPointsIsSeenAlongTheLineOfSight) {
  Grid slice;
  slice.size = {41, 41, 1}, slice.spacing = {0.5, 0.5, 0.5}, slice.origin = {-10, -10, 0};
  // A lattice of 3 x 3 points 4 mm apart, at two depths: the deeper ones differ more. They are 12 x 12 x 12 / 18 mm^3.
  std::vector<Vec3d> points, reference;
  for (const double z : {-6.0, 6.0})
    for (const double y : {-6.0, 0.0, 6.0})
      for (const double x : {-6.0, 0.0, 6.0}) points.push_back({x, y, z}), reference.push_back({0, 0, z < 0 ? 2.0 : 1.0});
  const Image values = differences_along_sight([](const Vec3d& x, Vec3d& u) { return u = {}, x.x < 5; }, points, reference, slice);
  const double radius = 0.5 * std::cbrt(12.0 * 12 * 12 / 18);
  for (int y = 0; y < 41; ++y)
    for (int x = 0; x < 41; ++x) {
      double nearest = 100;
      for (const Vec3d& p : points)
        if (p.x < 5) nearest = std::min(nearest, std::hypot(slice.point(x, y, 0).x - p.x, slice.point(x, y, 0).y - p.y));
      if (nearest <= radius) EXPECT_EQ(values.at(x, y, 0), 2) << x << " " << y;
      else EXPECT_TRUE(std::isnan(values.at(x, y, 0))) << x << " " << y;
    }
}

}  // namespace
}  // namespace mtled
