#pragma once
#include <array>
#include <cstdint>
#include <memory>

#include "core/volume.hpp"

namespace mtled {

using Index = std::array<int, 3>;  ///< i, j, k of a voxel

/// Exact nearest marked voxel of a mask, for voxels of its grid: within each slice along k by lower envelopes of parabolas
/// (Felzenszwalb & Huttenlocher 2012), then slice by slice up and down from the voxel. Of equally near ones always the
/// same is found. Queries are safe from many threads. Needs 4 bytes per voxel.
class NearestVoxel {
 public:
  /// Input error: axes i or j of 65535 voxels or more.
  explicit NearestVoxel(const Mask& marked);

  struct Found {
    Index voxel;
    double squared_distance;  ///< [mm^2] between the centres; infinite when there is no marked voxel
  };
  /// In the slice of `voxel` only.
  Found in_slice(const Index& voxel) const;
  Found anywhere(const Index& voxel) const;

 private:
  struct InSlice {
    std::uint16_t i, j;
  };
  Grid grid_;
  std::unique_ptr<InSlice[]> nearest_;  ///< per voxel, in its slice; no_voxel where the slice has none
};

}  // namespace mtled
