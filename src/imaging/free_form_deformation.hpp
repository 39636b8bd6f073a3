#pragma once
#include <algorithm>
#include <array>
#include <vector>

#include "core/volume.hpp"
#include "core/volume_view.hpp"

namespace mtled {

/// Free-form deformation (Rueckert et al. 1999): a displacement that is a tensor product of cubic B-splines on a coarse
/// grid of control points. The same as itk::BSplineTransform of order 3.
struct FreeFormDeformation {
  Grid control;                         ///< control points
  std::vector<Vec3d> coefficients;      ///< [control.count()] [mm], LPS components

  FreeFormDeformation() = default;
  /// Zero displacement; `mesh` cells per axis over the whole extent of an image, and one control point more at the lower
  /// and two at the upper end.
  FreeFormDeformation(const Grid& image, const std::array<int, 3>& mesh) {
    Vec3d first;
    for (int a = 0; a < 3; ++a) {
      const double cell = double(image.size[a]) / mesh[std::size_t(a)];  // in voxels
      control.size[std::size_t(a)] = mesh[std::size_t(a)] + 3;
      control.spacing[a] = image.spacing[a] * cell;
      first[a] = -0.5 - cell;
    }
    control.direction = image.direction;
    control.origin = image.point(first);
    coefficients.resize(control.count());
  }

  /// The 64 control points that matter at a point: (i, j, k) above the offset `first`, i, j, k = 0..3.
  struct Weights {
    std::size_t first = 0;
    double axis[3][4]{};
  };
  /// False outside the image.
  bool weights(const Vec3d& point, Weights& w) const {
    const Vec3d c = control.index(point);
    int low[3];
    for (int a = 0; a < 3; ++a) {
      const int cells = control.size[std::size_t(a)] - 3;
      if (!(c[a] >= 1 && c[a] <= cells + 1)) return false;
      low[a] = std::min(int(c[a]), cells);
      cubic_weights(c[a] - low[a], w.axis[a]);
    }
    w.first = control.offset(low[0] - 1, low[1] - 1, low[2] - 1);
    return true;
  }
  /// Calls body(control point, weight) for the 64 of them.
  template <class Body>
  void for_each_control(const Weights& w, const Body& body) const {
    for (int k = 0; k < 4; ++k)
      for (int j = 0; j < 4; ++j) {
        const double across = w.axis[1][j] * w.axis[2][k];
        const std::size_t row = w.first + control.offset(0, j, k);
        for (int i = 0; i < 4; ++i) body(row + std::size_t(i), w.axis[0][i] * across);
      }
  }
  /// Displacement [mm] of a point; 0 outside the image.
  Vec3d displacement(const Vec3d& point) const {
    Weights w;
    Vec3d b;
    if (weights(point, w)) for_each_control(w, [&](std::size_t c, double weight) { b += weight * coefficients[c]; });
    return b;
  }
};

}  // namespace mtled
