#include "imaging/slices.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "imaging/percentile.hpp"
#include "imaging/some_values.hpp"

namespace mtled {
namespace {

struct Box {
  Vec3d low, high;
};

Box bounding_box(const Grid& grid) {
  constexpr double infinity = std::numeric_limits<double>::infinity();
  Box box{{infinity, infinity, infinity}, {-infinity, -infinity, -infinity}};
  for (int corner = 0; corner < 8; ++corner) {
    Vec3d index;
    for (int a = 0; a < 3; ++a) index[a] = corner >> a & 1 ? grid.size[a] - 0.5 : -0.5;
    const Vec3d point = grid.point(index);
    for (int a = 0; a < 3; ++a) {
      box.low[a] = std::min(box.low[a], point[a]);
      box.high[a] = std::max(box.high[a], point[a]);
    }
  }
  return box;
}

}  // namespace

Grid slice_grid(const Grid& image, const Vec3d& through, Plane plane, double pixel_mm) {
  constexpr Vec3d left{1, 0, 0}, back{0, 1, 0}, down{0, 0, -1};
  const Vec3d across = plane == Plane::sagittal ? back : left;
  const Vec3d downward = plane == Plane::axial ? back : down;
  const Box box = bounding_box(image);
  const Vec3d extent = box.high - box.low, center = 0.5 * (box.low + box.high);
  const double width = std::abs(dot(across, extent)), height = std::abs(dot(downward, extent));

  Grid slice;
  slice.size = {std::max(1, int(std::lround(width / pixel_mm))), std::max(1, int(std::lround(height / pixel_mm))), 1};
  slice.spacing = {pixel_mm, pixel_mm, pixel_mm};
  const Vec3d normal = cross(across, downward);
  for (int a = 0; a < 3; ++a) {
    slice.direction[a][0] = across[a];
    slice.direction[a][1] = downward[a];
    slice.direction[a][2] = normal[a];
  }
  const Vec3d on_plane = center + dot(normal, through - center) * normal;
  const double to_first_column = 0.5 * (slice.size[0] - 1) * pixel_mm,
               to_first_row = 0.5 * (slice.size[1] - 1) * pixel_mm;
  slice.origin = on_plane - to_first_column * across - to_first_row * downward;
  return slice;
}

Grid refined(Grid slice, int factor) {
  const double first = 0.5 / factor - 0.5;
  slice.origin = slice.point(Vec3d{first, first, 0});
  for (int a = 0; a < 2; ++a) {
    slice.size[a] *= factor;
    slice.spacing[a] /= factor;
  }
  return slice;
}

Vec3d extent_mm(const Grid& image) {
  const Box box = bounding_box(image);
  return box.high - box.low;
}

Vec3d middle(const Grid& image) {
  return image.point(Vec3d{0.5 * (image.size[0] - 1), 0.5 * (image.size[1] - 1), 0.5 * (image.size[2] - 1)});
}

Window display_window(const Image& image) {
  const auto [smallest, largest] = std::minmax_element(image.data.begin(), image.data.end());
  if (*smallest < -500 && *largest > 100) return {-160, 240};
  if (*smallest == *largest) return {*smallest - 0.5, *smallest + 0.5};
  std::vector<float> foreground = some_values(image);
  std::erase(foreground, *smallest);
  const Window window{percentile(foreground, 1), percentile(foreground, 98)};
  return window.high > window.low ? window : Window{*smallest, *largest};
}

}  // namespace mtled
