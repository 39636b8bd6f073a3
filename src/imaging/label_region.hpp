#pragma once
#include <vector>

#include "core/volume.hpp"

namespace mtled {

/// One label of a label map, in physical space.
struct LabelRegion {
  int label = 0;
  std::vector<Vec3d> voxels;       ///< centres of the label's voxels [LPS mm]
  std::vector<Vec3d> points;       ///< the same and those within a margin that belong to no other label [LPS mm]
  std::vector<Vec3d> octants;      ///< centres of the eight parts of every voxel of the label [LPS mm]
  Vec3d centroid{};                ///< of the voxels [LPS mm]
  Mat3d axes = Mat3d::identity();  ///< columns: principal axes, longest first, right-handed; signs are arbitrary
  bool touches_border = false;     ///< has voxels on the faces of the label map
};

/// The labels of a map in ascending order. `margin_mm` >= 0 is the width of the margin in `points`.
std::vector<LabelRegion> label_regions(const LabelImage& labels, double margin_mm);

}  // namespace mtled
