#include <limits>
#include <string>

#include "imaging/colored_slices.hpp"

namespace mtled {
namespace {

constexpr double largest_soft_modulus = 5;  ///< [kPa] stiffer tissue (bone) has the same colour

/// |u| [mm] on a slice where the body covers it; NaN elsewhere.
Image displacement_on_slice(const VectorImage& displacement, const Mask& covered, const Grid& slice) {
  Image length(slice, std::numeric_limits<float>::quiet_NaN());
  for (int y = 0; y < slice.size[1]; ++y)
    for (int x = 0; x < slice.size[0]; ++x) {
      Vec3d u;
      const Vec3d point = slice.point(x, y, 0);
      if (nearest_value<std::uint8_t>(covered, point, 0) && linear_value(displacement, point, u))
        length.at(x, y, 0) = float(norm(u));
    }
  return length;
}

}  // namespace

Picture displacement_figure(const Image& moving, const VectorImage& displacement, const Mask& covered) {
  return colored_slices(
      moving, [&](const Grid& slice) { return displacement_on_slice(displacement, covered, slice); }, "|u| [mm]", 0, true);
}

Picture shear_modulus_figure(const Image& moving, const Image& shear_modulus) {
  const auto modulus_on = [&](const Grid& slice) {
    Image values(slice, std::numeric_limits<float>::quiet_NaN());
    for (int y = 0; y < slice.size[1]; ++y)
      for (int x = 0; x < slice.size[0]; ++x)
        if (const float mu = nearest_value<float>(shear_modulus, slice.point(x, y, 0), 0); mu > 0) values.at(x, y, 0) = mu;
    return values;
  };
  return colored_slices(moving, modulus_on, "mu [kPa]", largest_soft_modulus, false);
}

}  // namespace mtled
