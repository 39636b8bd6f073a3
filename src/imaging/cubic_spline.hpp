#pragma once
#include "core/volume.hpp"

namespace mtled {

/// Coefficients, on the grid of the image, of its interpolating cubic B-spline with mirror boundaries (Unser 1999); for
/// interpolate_cubically().
Image spline_coefficients(const Image& image);

}  // namespace mtled
