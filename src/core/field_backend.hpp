#pragma once
#include <functional>

#include "core/rest_position.hpp"
#include "core/volume.hpp"
#include "core/volume_view.hpp"

namespace mtled {

/// The dense fields of one deformed body by a device, which leaves undecided what it cannot compute as the CPU does.
class FieldBackend {
 public:
  virtual ~FieldBackend() = default;
  /// For every voxel X of their grid: `coverage` (outside, covered or undecided), and u(X) [mm] where covered.
  virtual void forward(VectorImage& u, Volume<Coverage>& coverage) = 0;
  /// For every voxel y of their grid: `coverage`, and X - y [mm] where covered; see SolveForRestPosition, which starts on `forward`.
  /// Returns the largest residual [mm] of covered voxels.
  virtual double inverse(const VectorImage& forward, double tolerance_mm, VectorImage& v, Volume<Coverage>& coverage) = 0;
};

/// Values of an image, or of the spline with these coefficients, at the voxels of a displacement field moved by it; `outside` beyond.
using SampleDisplaced = std::function<Image(const Image& samples, const VectorImage& displacement, Interpolation, float outside)>;

}  // namespace mtled
