#pragma once
#include <vector>

#include "core/volume.hpp"
#include "imaging/warp.hpp"

namespace mtled {

/// Some of the points, by the displacement that the reference gives them.
struct DifferenceGroup {
  double from_mm = 0, to_mm = 0;  ///< smallest and largest displacement of the reference
  std::size_t points = 0;
  double median_mm = 0, percentile_95_mm = 0;  ///< of the difference
};

/// How far a displacement is from a reference, such as one by finite elements, at the same points [mm].
struct FieldDifference {
  std::vector<float> difference_mm;  ///< per point |u - reference|
  std::vector<float> reference_mm;   ///< per point |reference|
  std::size_t unknown = 0;           ///< points of the reference that u does not know; they are left out
  double mean = 0, root_mean_square = 0, median = 0, percentile_95 = 0, percentile_99_5 = 0, maximum = 0;
  double within_half_mm = 0;            ///< fraction of the points
  std::vector<double> curve_mm;         ///< [100] percentiles 1 to 100
  std::vector<DifferenceGroup> groups;  ///< at most ten of (nearly) as many points each, by rising displacement
};
/// At points with known displacements [LPS mm]. Input errors: lists of different length; u knows none of the points.
FieldDifference compare_displacements(const DisplacementFunction& u, const std::vector<Vec3d>& points, const std::vector<Vec3d>& reference);
/// At the voxels of `grid` that the reference knows. Input error: no voxel is known to both.
FieldDifference compare_displacements(const DisplacementFunction& u, const DisplacementFunction& reference, const Grid& grid);

/// |u - reference| [mm] on a slice, NaN where one of them is unknown.
Image difference_on_slice(const DisplacementFunction& u, const DisplacementFunction& reference, const Grid& slice);
/// |u - reference| [mm] at points on a slice: each a disc as wide as the points are apart, wherever it lies along the
/// line of sight; the largest difference is in front. NaN where there are none, and at points that u does not know.
Image differences_along_sight(const DisplacementFunction& u, const std::vector<Vec3d>& points, const std::vector<Vec3d>& reference, const Grid& slice);

}  // namespace mtled
