#pragma once
#include "core/volume.hpp"

namespace mtled {

/// Continuous index in one grid of the point at an index of another: affine, so that loops over voxels need no points.
class IndexMap {
 public:
  IndexMap(const Grid& from, const Grid& to)
      : first_(to.index(from.origin)), step_{to.index(from.point(1, 0, 0)) - first_, to.index(from.point(0, 1, 0)) - first_, to.index(from.point(0, 0, 1)) - first_} {}
  Vec3d operator()(double i, double j, double k) const { return first_ + i * step_[0] + j * step_[1] + k * step_[2]; }
  /// Of one voxel along an axis of `from`.
  const Vec3d& step(int axis) const { return step_[axis]; }

 private:
  Vec3d first_, step_[3];
};

}  // namespace mtled
