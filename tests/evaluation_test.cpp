#include "imaging/evaluation.hpp"

#include <gtest/gtest.h>

#include <cmath>

#include "core/error.hpp"
#include "core/motion.hpp"
#include "imaging/percentile.hpp"

namespace mtled {
namespace {

Grid make_grid(std::array<int, 3> size, Vec3d spacing, const Mat3d& direction = Mat3d::identity()) {
  Grid grid;
  grid.size = size;
  grid.spacing = spacing;
  grid.direction = direction;
  const Vec3d middle = grid.point(Vec3d{0.5 * (size[0] - 1), 0.5 * (size[1] - 1), 0.5 * (size[2] - 1)});
  grid.origin = Vec3d{0.3, -0.2, 0.4} - middle;
  return grid;
}

/// `contrast` inside a sphere around the origin, partial volume at its surface.
Image sphere_image(const Grid& grid, double radius, double contrast) {
  constexpr int parts = 4;
  Image image(grid);
  for (int k = 0; k < grid.size[2]; ++k)
    for (int j = 0; j < grid.size[1]; ++j)
      for (int i = 0; i < grid.size[0]; ++i) {
        int inside = 0;
        for (int part = 0; part < parts * parts * parts; ++part) {
          const auto at = [](int index, int step) { return index + (step % parts + 0.5) / parts - 0.5; };
          const Vec3d p = grid.point(Vec3d{at(i, part), at(j, part / parts), at(k, part / parts / parts)});
          inside += squared_norm(p) < radius * radius;
        }
        image.at(i, j, k) = float(contrast * inside / (parts * parts * parts));
      }
  return image;
}

std::size_t count(const Mask& mask) { return std::size_t(std::count(mask.data.begin(), mask.data.end(), 1)); }

TEST(Canny, EdgesOfASphereLieWithinHalfAVoxelAndCoverIt) {
  constexpr double radius = 25,
                   curvature_shift = 2 * 2 / radius;  // smoothing by sigma moves a sphere's edge by sigma^2/R
  for (const Grid& grid : {make_grid({70, 70, 70}, {1, 1, 1}), make_grid({80, 80, 25}, {0.9, 0.9, 3}),
                           make_grid({40, 70, 30}, {2, 1, 2.5}, rotation_matrix({0.3, -0.5, 0.4}))}) {
    SCOPED_TRACE(testing::Message() << "spacing " << grid.spacing.x << " " << grid.spacing.y << " " << grid.spacing.z);
    const Mask edges = canny_edges(sphere_image(grid, radius, 1000), {}, nullptr);
    ASSERT_GT(count(edges), 500u);
    for (int k = 0; k < grid.size[2]; ++k)
      for (int j = 0; j < grid.size[1]; ++j)
        for (int i = 0; i < grid.size[0]; ++i) {
          if (!edges.at(i, j, k)) continue;
          const Vec3d p = grid.point(i, j, k), across = transpose(grid.direction) * p;
          double half_voxel = 0;  // along the surface's normal
          for (int a = 0; a < 3; ++a) half_voxel += 0.5 * grid.spacing[a] * std::abs(across[a]) / norm(p);
          ASSERT_LE(std::abs(norm(p) - radius), 1.1 * half_voxel + curvature_shift) << i << " " << j << " " << k;
        }
    for (int n = 0; n < 3000; ++n) {
      Vec3d p{std::sin(1.1 * n), std::sin(1.7 * n + 1), std::sin(2.3 * n + 2)};
      p = (radius / norm(p)) * p;
      const Vec3d c = grid.index(p);
      bool found = false;
      for (int corner = 0; corner < 8; ++corner)
        found = found || edges.at(int(c.x) + (corner & 1), int(c.y) + (corner >> 1 & 1), int(c.z) + (corner >> 2));
      ASSERT_TRUE(found) << p.x << " " << p.y << " " << p.z;
    }
  }
}

TEST(Canny, ThresholdsArePerMillimetreOnEveryAxis) {
  // A step of 100 blurred by 2 mm has the slope 100 / (2 sqrt(2 pi)) = 19.9 per mm along x and along z.
  const Grid grid = make_grid({60, 40, 24}, {0.8, 1, 2});
  for (const int axis : {0, 2}) {
    Image step(grid);
    for (int k = 0; k < 24; ++k)
      for (int j = 0; j < 40; ++j)
        for (int i = 0; i < 60; ++i) step.at(i, j, k) = (axis == 0 ? i >= 30 : k >= 12) ? 100 : 0;
    EXPECT_GT(count(canny_edges(step, {2, 8, 16}, nullptr)), 0u) << axis;
    EXPECT_EQ(count(canny_edges(step, {2, 8, 22}, nullptr)), 0u) << axis;
  }
}

TEST(Canny, FindsNothingOnRampsPlateausAndImageBorders) {
  const Grid grid = make_grid({30, 30, 12}, {1, 1, 3});
  Image image(grid);
  EXPECT_EQ(count(canny_edges(image, {}, nullptr)), 0u);
  for (int k = 0; k < 12; ++k)
    for (int j = 0; j < 30; ++j)
      for (int i = 0; i < 30; ++i) image.at(i, j, k) = float(1024 * i);  // exact in float: no rounding makes a ridge
  const Mask edges = canny_edges(image, {}, nullptr);
  for (int k = 0; k < 12; ++k)
    for (int j = 0; j < 30; ++j)
      for (int i : {0, 29}) EXPECT_EQ(edges.at(i, j, k), 0);
}

TEST(Canny, StaysInsideTheMask) {
  const Grid grid = make_grid({60, 60, 60}, {1, 1, 1});
  const Image image = sphere_image(grid, 20, 1000);
  Mask half(grid);
  for (int k = 0; k < 60; ++k)
    for (int j = 0; j < 60; ++j)
      for (int i = 0; i < 30; ++i) half.at(i, j, k) = 1;
  const Mask everywhere = canny_edges(image, {}, nullptr), inside = canny_edges(image, {}, &half);
  for (std::size_t v = 0; v < half.data.size(); ++v) ASSERT_EQ(inside.data[v], half.data[v] && everywhere.data[v]);
  const Mask elsewhere(make_grid({60, 60, 59}, {1, 1, 1}));
  EXPECT_THROW(canny_edges(image, {}, &elsewhere), Error);
  EXPECT_THROW(canny_edges(image, {2, 40, 15}, nullptr), Error);
}

TEST(Percentile, InterpolatesBetweenOrderStatistics) {
  std::vector<double> values{4, 1, 3, 2};
  EXPECT_DOUBLE_EQ(percentile(values, 0), 1);
  EXPECT_DOUBLE_EQ(percentile(values, 50), 2.5);
  EXPECT_DOUBLE_EQ(percentile(values, 75), 3.25);
  EXPECT_DOUBLE_EQ(percentile(values, 100), 4);
  std::vector<double> nothing;
  EXPECT_TRUE(std::isnan(percentile(nothing, 50)));
}

/// Edge voxels at i = `index` for all j, k.
void add_plane(Mask& mask, int index) {
  for (int k = 0; k < mask.grid.size[2]; ++k)
    for (int j = 0; j < mask.grid.size[1]; ++j) mask.at(index, j, k) = 1;
}

TEST(CompareEdges, OfShiftedPlanesIsTheShift) {
  const Grid grid = make_grid({30, 12, 10}, {2, 1, 3}, rotation_matrix({0.1, 0.2, 0.3}));
  Mask a(grid), b(grid);
  add_plane(a, 10);
  add_plane(b, 13);
  const EdgeDistance result = compare_edges(a, b, 0);
  EXPECT_EQ(result.percents, (std::vector<double>{60, 75, 85, 95}));
  for (int p = 0; p < 4; ++p) {
    EXPECT_NEAR(result.hausdorff_mm[p], 6, 1e-9);
    EXPECT_NEAR(result.hausdorff_all_mm[p], 6, 1e-9);
  }
  EXPECT_EQ(result.edges_a, 120u);
  EXPECT_EQ(result.kept_a, 1);
  EXPECT_NEAR(result.mean_mm, 6, 1e-9);
  EXPECT_NEAR(result.modified_hausdorff_mm, 6, 1e-9);
  EXPECT_EQ(result.within_two_voxels, 0);  // 6 mm is not less than twice 3 mm
  EXPECT_EQ(compare_edges(a, b, 0, EdgeSpace::volume, 3.1).within_two_voxels, 1);  // but less than two of the source's voxels

  Mask far(grid);
  add_plane(far, 16);
  EXPECT_NEAR(compare_edges(a, far, 0).modified_hausdorff_mm, 10, 1e-9);
  EXPECT_NEAR(compare_edges(a, far, 0).mean_mm, 12, 1e-9);
}

TEST(CompareEdges, OfConcentricSpheresIsTheDifferenceOfRadii) {
  const auto shell = [](const Grid& grid, double radius) {
    Mask mask(grid);
    for (int k = 0; k < grid.size[2]; ++k)
      for (int j = 0; j < grid.size[1]; ++j)
        for (int i = 0; i < grid.size[0]; ++i) mask.at(i, j, k) = std::abs(norm(grid.point(i, j, k)) - radius) < 0.5;
    return mask;
  };
  const Mask a = shell(make_grid({70, 70, 70}, {1, 1, 1}), 20);
  const Mask b = shell(make_grid({100, 70, 60}, {0.8, 1, 1.2}, rotation_matrix({0, 0.4, 0.2})), 26);  // another grid
  const EdgeDistance result = compare_edges(a, b, 1);
  for (int p = 0; p < 4; ++p) EXPECT_NEAR(result.hausdorff_all_mm[p], 6, 1);
  EXPECT_NEAR(result.mean_mm, 6, 0.5);  // the shells are a voxel thick
}

TEST(CompareEdges, TakesPercentilesPerDirectionAndTheLargerOne) {
  // a: 10 points on b; b: those and 10 more at 1, 2, ... 10 mm: a -> b is 0, b -> a is 0 (ten times), 1, 2, ... 10.
  const Grid grid = make_grid({40, 30, 1}, {1, 1, 1});
  Mask a(grid), b(grid);
  for (int n = 0; n < 10; ++n) a.at(2, 3 * n, 0) = b.at(2, 3 * n, 0) = 1;
  for (int n = 1; n <= 10; ++n) b.at(2 + n, 0, 0) = 1;
  const EdgeDistance result = compare_edges(a, b, 0);
  const double expected[] = {0.60 * 19 - 9, 0.75 * 19 - 9, 0.85 * 19 - 9, 0.95 * 19 - 9};
  for (int p = 0; p < 4; ++p) EXPECT_NEAR(result.hausdorff_all_mm[p], expected[p], 1e-9);
  EXPECT_EQ(result.kept_a, 1);
  EXPECT_EQ(result.kept_b, 0.5);
  for (int p = 0; p < 4; ++p) EXPECT_EQ(result.hausdorff_mm[p], 0);
  EXPECT_NEAR(result.within_two_voxels_all, 21.0 / 30, 1e-12);
  EXPECT_EQ(result.within_two_voxels, 1);
  EXPECT_NEAR(result.modified_hausdorff_mm, 55.0 / 20, 1e-9);
  EXPECT_EQ(compare_edges(a, b, 3).kept_b, 13.0 / 20);
}

TEST(CompareEdges, RoundTripKeepsEverythingOnIdenticalSetsAndTies) {
  const Mask edges = canny_edges(sphere_image(make_grid({60, 60, 60}, {1, 1, 1}), 20, 1000), {}, nullptr);
  const EdgeDistance same = compare_edges(edges, edges, 0);
  EXPECT_EQ(same.kept_a, 1);
  EXPECT_EQ(same.kept_b, 1);
  EXPECT_EQ(same.hausdorff_mm[3], 0);
  EXPECT_EQ(same.within_two_voxels, 1);

  const Grid line = make_grid({9, 1, 1}, {1, 1, 1});
  Mask a(line), b(line);
  a.at(2, 0, 0) = a.at(6, 0, 0) = 1;
  b.at(4, 0, 0) = 1;
  EXPECT_EQ(compare_edges(a, b, 0).kept_a, 1);  // both ends of `a` are nearest to the middle
}

TEST(CompareEdges, EmptySetsHaveNoDistances) {
  const Grid grid = make_grid({5, 5, 5}, {1, 1, 1});
  Mask some(grid);
  some.at(1, 1, 1) = 1;
  for (const auto& [a, b] : {std::pair{some, Mask(grid)}, std::pair{Mask(grid), some}, std::pair{Mask(grid), Mask(grid)}}) {
    const EdgeDistance result = compare_edges(a, b, 0);
    EXPECT_FALSE(result.comparable());
    EXPECT_EQ(result.edges_a, count(a));
    EXPECT_EQ(result.unmatched_b, count(b));
    EXPECT_TRUE(result.hausdorff_mm.empty() && result.curve_all_mm.empty());
    for (const double value : {result.kept_a, result.mean_mm, result.modified_hausdorff_mm, result.within_two_voxels, result.within_two_voxels_all}) EXPECT_EQ(value, 0);
  }
  EXPECT_TRUE(compare_edges(some, some, 0).comparable());
}

TEST(CompareEdges, HasEveryPercentile) {
  // b has 101 voxels at 0, 1, ... 100 mm from the only one of a: percentile p of b -> a is p.
  const Grid line = make_grid({101, 1, 1}, {1, 1, 1});
  Mask a(line), b(line, 1);
  a.at(0, 0, 0) = 1;
  const EdgeDistance result = compare_edges(a, b, 0);
  ASSERT_EQ(result.curve_all_mm.size(), 100u);
  for (int percent = 1; percent <= 100; ++percent) EXPECT_NEAR(result.curve_all_mm[std::size_t(percent - 1)], percent, 1e-9);
  for (std::size_t p = 0; p < result.percents.size(); ++p) EXPECT_NEAR(result.hausdorff_all_mm[p], result.percents[p], 1e-9);
  EXPECT_EQ(result.curve_mm, std::vector<double>(100, 0));  // only the common voxel passes the round trip
}

TEST(CompareEdges, OfSlicesStaysInTheSlice) {
  // Per slice one voxel of a; that of b is 5 mm away in the slice and only 1 mm away in the next one.
  const Grid grid = make_grid({20, 4, 3}, {1, 1, 1});
  Mask a(grid), b(grid);
  for (int k = 0; k < 3; ++k) a.at(k % 2 == 0 ? 2 : 7, 0, k) = b.at(k % 2 == 0 ? 7 : 2, 0, k) = 1;
  EXPECT_NEAR(compare_edges(a, b, 0).curve_all_mm.back(), 1, 1e-9);
  EXPECT_NEAR(compare_edges(a, b, 0, EdgeSpace::slices).curve_all_mm.front(), 5, 1e-9);
  EXPECT_EQ(compare_edges(a, b, 0, EdgeSpace::slices).within_two_voxels_all, 0);

  b.at(2, 0, 1) = 0;  // the middle slice has an edge in a only
  const EdgeDistance result = compare_edges(a, a, 0, EdgeSpace::slices), unmatched = compare_edges(a, b, 0, EdgeSpace::slices);
  EXPECT_EQ(result.unmatched_a, 0u);
  EXPECT_EQ(result.within_two_voxels_all, 1);
  EXPECT_EQ(unmatched.unmatched_a, 1u);
  EXPECT_EQ(unmatched.unmatched_b, 0u);
  Mask last_only(grid);
  last_only.at(2, 0, 2) = 1;
  EXPECT_EQ(compare_edges(a, last_only, 0, EdgeSpace::slices).within_two_voxels_all, 2.0 / 4) << "two of the four voxels have no counterpart in their slice";
}

TEST(Canny, OfSlicesIsCannyOfEverySlice) {
  const Grid grid = make_grid({60, 60, 9}, {1, 1, 4}, rotation_matrix({0.2, 0.3, -0.1}));
  const Image image = sphere_image(grid, 15, 1000);
  Mask mask(grid, 1);
  for (int k = 0; k < 9; ++k)
    for (int i = 0; i < 60; ++i) mask.at(i, 20, k) = 0;
  const Mask edges = canny_edges_of_slices(image, {}, &mask);
  EXPECT_GT(count(edges), 100u);
  for (int k = 0; k < 9; ++k) {
    Grid one = grid;
    one.size[2] = 1;
    Image slice(one);
    Mask slice_mask(one);
    for (int j = 0; j < 60; ++j)
      for (int i = 0; i < 60; ++i) slice.at(i, j, 0) = image.at(i, j, k), slice_mask.at(i, j, 0) = mask.at(i, j, k);
    const Mask expected = canny_edges(slice, {}, &slice_mask);
    for (int j = 0; j < 60; ++j)
      for (int i = 0; i < 60; ++i) ASSERT_EQ(edges.at(i, j, k), expected.at(i, j, 0)) << i << " " << j << " " << k;
  }
}

TEST(PointErrors, AreDistancesOfPairs) {
  const PointErrors errors = point_errors({{0, 0, 0}, {1, 1, 1}, {0, 0, 5}}, {{3, 4, 0}, {1, 1, 1}, {0, 0, 4}});
  EXPECT_EQ(errors.distance_mm, (std::vector<double>{5, 0, 1}));
  EXPECT_DOUBLE_EQ(errors.mean, 2);
  EXPECT_DOUBLE_EQ(errors.median, 1);
  EXPECT_DOUBLE_EQ(errors.percentile_95, 4.6);
  EXPECT_DOUBLE_EQ(errors.maximum, 5);
  EXPECT_THROW(point_errors({{0, 0, 0}}, {}), Error);
  EXPECT_THROW(point_errors({}, {}), Error);
}

void add_box(LabelImage& labels, int first, std::uint16_t label) {
  for (int k = 5; k < 15; ++k)
    for (int j = 5; j < 15; ++j)
      for (int i = first; i < first + 10; ++i) labels.at(i, j, k) = label;
}

TEST(LabelOverlap, OfShiftedBoxes) {
  const Grid grid = make_grid({40, 20, 20}, {1.5, 1, 1});
  LabelImage a(grid), b(grid);
  add_box(a, 5, 3);
  add_box(b, 7, 3);
  add_box(a, 25, 9);
  const auto overlaps = label_overlap(a, b);
  ASSERT_EQ(overlaps.size(), 2u);
  EXPECT_EQ(overlaps[0].label, 3);
  EXPECT_DOUBLE_EQ(overlaps[0].dice, 0.8);
  EXPECT_NEAR(overlaps[0].hausdorff95_mm, 3, 1e-9);  // the shifted faces are a fifth of the surface
  EXPECT_NEAR(overlaps[0].hausdorff95_pooled_mm, 3, 1e-9);
  // Of 488 surface voxels: 100 on the face left behind are 3 mm away, 36 on the sides beside it 1.5 mm, and those on
  // the face inside the other box min(3, depth below the sides): 36 at 0, 28 at 1, 20 at 2, 16 at 3 mm; others 0.
  EXPECT_NEAR(overlaps[0].average_surface_distance_mm, (100 * 3 + 36 * 1.5 + 28 + 20 * 2 + 16 * 3) / 488.0, 1e-9);
  EXPECT_EQ(overlaps[1].label, 9);
  EXPECT_EQ(overlaps[1].dice, 0);
  EXPECT_TRUE(std::isnan(overlaps[1].hausdorff95_mm) && std::isnan(overlaps[1].hausdorff95_pooled_mm) && std::isnan(overlaps[1].average_surface_distance_mm));
  EXPECT_EQ(overlaps[1].voxels_a, 1000u);
  EXPECT_EQ(overlaps[1].voxels_b, 0u);
  EXPECT_DOUBLE_EQ(label_overlap(a, a)[0].dice, 1);
  EXPECT_EQ(label_overlap(a, a)[0].hausdorff95_mm, 0);
}

TEST(LabelOverlap, TellsTheLargerDirectionFromBothTogether) {
  // a -> b: 0; b -> a: 0, 2, ... 18 (single voxels, so all are surface).
  const Grid grid = make_grid({20, 1, 1}, {1, 1, 1});
  LabelImage a(grid), b(grid);
  a.at(0, 0, 0) = 1;
  for (int i = 0; i < 20; i += 2) b.at(i, 0, 0) = 1;
  const LabelOverlap overlap = label_overlap(a, b)[0];
  EXPECT_NEAR(overlap.hausdorff95_mm, 0.95 * 18, 1e-9);
  EXPECT_NEAR(overlap.hausdorff95_pooled_mm, 17, 1e-9);  // half-way between the last two of 0, 0, 2, ... 18
  EXPECT_NEAR(overlap.average_surface_distance_mm, 90.0 / 11, 1e-9);
}

TEST(LabelOverlap, OfASingleSliceIsThatOfItsOutlines) {
  const Grid grid = make_grid({20, 20, 1}, {1.5, 1, 3});
  LabelImage a(grid), b(grid);
  for (int j = 5; j < 15; ++j)
    for (int i = 5; i < 15; ++i) a.at(i, j, 0) = b.at(i + 2, j, 0) = 1;
  const LabelOverlap overlap = label_overlap(a, b)[0];
  EXPECT_DOUBLE_EQ(overlap.dice, 0.8);
  EXPECT_NEAR(overlap.hausdorff95_mm, 3, 1e-9);
  // Outline of 36: 10 at 3 mm, 2 at 1.5 mm, and on the inner side 2 each at 0, 1, 2 and 4 at 3 mm.
  EXPECT_NEAR(overlap.average_surface_distance_mm, (10 * 3 + 2 * 1.5 + 2 * 1 + 2 * 2 + 4 * 3) / 36.0, 1e-9);
}

TEST(LabelOverlap, RefusesDifferentGridsButNotRoundedHeaders) {
  Grid grid = make_grid({20, 20, 20}, {1.5, 1, 1});
  LabelImage a(grid);
  add_box(a, 5, 3);
  LabelImage b = a;
  b.grid.origin.x += 1e-5;
  EXPECT_DOUBLE_EQ(label_overlap(a, b)[0].dice, 1);
  b.grid.origin.x += 1;
  EXPECT_THROW(label_overlap(a, b), Error);
}

}  // namespace
}  // namespace mtled
