#pragma once
#include "core/volume.hpp"

namespace mtled {

/// The outline of an organ in every slice along k: its voxels with an edge neighbour in the slice that is not of the
/// organ. Only inside `where`, and neighbours outside it (or the image) do not count: where an organ is cut it has no
/// contour. Input error: different grids.
Mask contours_of_slices(const Mask& organ, const Mask& where);

/// Distances [mm] of contour voxels to the nearest contour voxel of the same slice of another organ; NaN without any.
struct ContourDistance {
  std::size_t voxels = 0;     ///< with a distance
  std::size_t unmatched = 0;  ///< whose slice has no contour of the other
  double mean = 0, median = 0, percentile_95 = 0, maximum = 0;
};
struct ContourComparison {
  ContourDistance from_a, from_b;  ///< to the other one
};
/// Both on the same grid (input error otherwise).
ContourComparison compare_contours(const Mask& contours_a, const Mask& contours_b);

}  // namespace mtled
