#pragma once
#include "core/volume.hpp"

namespace mtled {

/// How many voxels are not 0.
std::size_t count(const Mask& mask);

/// Voxels whose centre lies within `radius_mm` of the centre of a voxel of `mask` (a ball in mm; exact). Linear in the
/// number of voxels times the radius in voxels, unlike a structuring element.
Mask dilate(const Mask& mask, double radius_mm);
/// Voxels with every voxel centre within `radius_mm` inside `mask`; what lies beyond the image counts as inside.
Mask erode(const Mask& mask, double radius_mm);
/// The largest 6-connected component (the first in memory order among equals); empty if `mask` is.
Mask largest_component(const Mask& mask);

/// Marks what is 6-connected to `seeds` through voxels of `where`; `frozen_axis` 0..2 forbids steps along that axis
/// (slice by slice), -1 allows all. Seeds outside `where` are ignored.
Mask flood(const Mask& where, const std::vector<std::size_t>& seeds, int frozen_axis);

}  // namespace mtled
