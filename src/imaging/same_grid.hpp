#pragma once
#include <algorithm>

#include "core/volume.hpp"

namespace mtled {

/// True when both grids have the same voxels: equal sizes, and corner voxels that agree within 1 % of a voxel (file
/// formats store directions and origins in single precision).
inline bool same_grid(const Grid& a, const Grid& b) {
  if (a.size != b.size) return false;
  const double tolerance = 0.01 * std::min({a.spacing.x, a.spacing.y, a.spacing.z});
  for (int corner = 0; corner < 8; ++corner) {
    const int i = corner & 1 ? a.size[0] - 1 : 0, j = corner & 2 ? a.size[1] - 1 : 0,
              k = corner & 4 ? a.size[2] - 1 : 0;
    if (!(norm(a.point(i, j, k) - b.point(i, j, k)) <= tolerance)) return false;
  }
  return true;
}

}  // namespace mtled
