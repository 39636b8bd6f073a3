#include "imaging/figure_layout.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/error.hpp"
#include "imaging/warp.hpp"

namespace mtled {
namespace {

struct PlaneLabels {
  Plane plane;
  const char *name, *left, *right, *top, *bottom;
};
constexpr PlaneLabels planes[] = {{Plane::axial, "axial", "R", "L", "A", "P"},
                                  {Plane::coronal, "coronal", "R", "L", "S", "I"},
                                  {Plane::sagittal, "sagittal", "A", "P", "S", "I"}};

/// Letters of the patient's sides at the middle of the panel's edges.
void draw_sides(Picture& panel, const PlaneLabels& labels) {
  const int x = (panel.width - glyph_width) / 2, y = (panel.height - glyph_height) / 2;
  draw_text_on_image(panel, 4, y, labels.left);
  draw_text_on_image(panel, panel.width - glyph_width - 4, y, labels.right);
  draw_text_on_image(panel, x, 3, labels.top);
  draw_text_on_image(panel, x, panel.height - glyph_height, labels.bottom);
}

/// A bar of round length at the lower left of a panel.
void draw_scale(Picture& panel, double pixel_mm) {
  const double length = round_number_below(0.25 * panel.width * pixel_mm);
  const int pixels = int(std::lround(length / pixel_mm));
  const int left = 10, top = panel.height - 12;
  fill(panel, {left - 1, top - 1, pixels + 2, 6}, black);
  fill(panel, {left, top, pixels, 4}, white);
  draw_text_on_image(panel, left, top - glyph_height - 1, number(length) + " mm");
}

}  // namespace

Layout arrange(const Grid& image, int width) {
  const Vec3d extent = extent_mm(image);
  Layout layout;
  layout.pixel_mm = (2 * extent.x + extent.y) / (width - 2 * margin - 2 * gap);
  int x = margin;
  for (int p = 0; p < 3; ++p) {
    layout.slices[p] = slice_grid(image, middle(image), planes[p].plane, layout.pixel_mm);
    layout.left[p] = x;
    x += layout.slices[p].size[0] + gap;
    layout.row_height = std::max(layout.row_height, layout.slices[p].size[1]);
  }
  return layout;
}

Image on_slice(const Image& image, const Grid& slice) {
  return warp_image_rigidly(image, slice, RigidMotion{}, Interpolation::linear,
                            std::numeric_limits<float>::quiet_NaN());
}

Picture grey_picture(const Image& slice, const Window& window) {
  Picture picture = blank_picture(slice.grid.size[0], slice.grid.size[1], black);
  for (int y = 0; y < picture.height; ++y)
    for (int x = 0; x < picture.width; ++x) {
      const double t = (slice.at(x, y, 0) - window.low) / (window.high - window.low);
      const auto grey = static_cast<unsigned char>(std::isnan(t) ? 0 : std::lround(255 * std::clamp(t, 0.0, 1.0)));
      set_pixel(picture, x, y, {grey, grey, grey});
    }
  return picture;
}

void draw_column_names(Picture& picture, const Layout& layout, int top) {
  for (int p = 0; p < 3; ++p) {
    const int middle_x = layout.left[p] + layout.slices[p].size[0] / 2;
    draw_text(picture, middle_x - text_width(planes[p].name) / 2, top, planes[p].name, black);
  }
}

void paste_panel(Picture& picture, const Layout& layout, int plane, int top, Picture panel) {
  draw_sides(panel, planes[plane]);
  if (plane == 0) draw_scale(panel, layout.pixel_mm);
  paste(picture, panel, layout.left[plane], top);
}

double round_number_below(double value) {
  const double power = std::pow(10, std::floor(std::log10(value)));
  for (const double digit : {5.0, 2.0})
    if (digit * power <= value) return digit * power;
  return power;
}

std::string number(double value) { return concatenate(std::round(value * 1e6) / 1e6); }

}  // namespace mtled
