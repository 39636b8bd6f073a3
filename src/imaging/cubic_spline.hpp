#pragma once
#include "core/volume.hpp"

namespace mtled {

/// Interpolating cubic B-spline of a scalar image with mirror boundaries (Unser 1999). Copies the image's grid and
/// keeps its coefficients (one float a voxel); evaluation is safe from many threads.
class CubicSpline {
 public:
  explicit CubicSpline(const Image& image);
  /// Value at `point` [LPS mm]; clamped to the border within half a voxel outside the voxel centres. False beyond that.
  bool evaluate(const Vec3d& point, double& value) const;

 private:
  Image coefficients_;
};

}  // namespace mtled
