#pragma once
#include <memory>

#include "core/volume.hpp"

namespace mtled {

/// Four numbers per voxel of `grid`, whose memory is first touched by the threads that compute them.
struct Gradient {
  Grid grid;
  std::unique_ptr<float[]> along[3];   ///< [intensity/mm] components along the grid's axes
  std::unique_ptr<float[]> magnitude;  ///< [intensity/mm]
};

/// Gradient of the image smoothed by a Gaussian of `sigma_mm` > 0, by the recursive filters of ITK (Farneback & Westin
/// 2006) to the last bit, but in parallel over many lines at once and with the passes shared by the components. Beyond its
/// border the image continues with the border's values. Axes of fewer than four voxels are neither smoothed nor
/// differentiated.
Gradient gaussian_gradient(const Image& image, double sigma_mm);

}  // namespace mtled
