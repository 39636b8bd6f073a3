#include "imaging/figures.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/error.hpp"
#include "imaging/drawing.hpp"
#include "imaging/evaluation.hpp"
#include "imaging/font.hpp"
#include "imaging/slices.hpp"
#include "imaging/warp.hpp"

namespace mtled {
namespace {

constexpr int picture_width = 1500;       ///< [pixels] text is then about 6.5 pt high on a page 180 mm wide
constexpr int margin = 12, gap = 8;       ///< [pixels] around the picture, between panels
constexpr int line_height = glyph_height + 9;
constexpr int bar_width = 24, bar_labels = 90;  ///< [pixels] of the colour bar
constexpr double edge_sigma_mm = 1.5;
constexpr double lower_edge = 0.0375, upper_edge = 0.1;  ///< [1/mm] of the window's width: 15 and 40 HU/mm for soft tissue
constexpr Color edge_color{255, 90, 0};
constexpr double color_weight = 0.65;     ///< of the displacement's colour against the image under it
constexpr int darkest = 70, brightest = 230;  ///< greys of the image under the displacement: colours stay readable on air
constexpr float nowhere = std::numeric_limits<float>::quiet_NaN();

struct PlaneLabels {
  Plane plane;
  const char *name, *left, *right, *top, *bottom;
};
constexpr PlaneLabels planes[] = {{Plane::axial, "axial", "R", "L", "A", "P"},
                                  {Plane::coronal, "coronal", "R", "L", "S", "I"},
                                  {Plane::sagittal, "sagittal", "A", "P", "S", "I"}};

/// The three slices of a picture and where they go.
struct Layout {
  Grid slices[3];
  int left[3]{};       ///< [pixels]
  int row_height = 0;  ///< [pixels]
  double pixel_mm = 1;
};

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

/// The image on a slice; NaN where it does not reach.
Image on_slice(const Image& image, const Grid& slice) {
  return warp_image_rigidly(image, slice, RigidMotion{}, Interpolation::linear, nowhere);
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

/// 1 where the slice and everything within `distance` pixels of it (in a square) is inside the image.
Mask well_inside(const Image& slice, int distance) {
  Mask mask(slice.grid, 1);
  const auto& n = slice.grid.size;
  for (int y = 0; y < n[1]; ++y)
    for (int x = 0; x < n[0]; ++x) {
      if (!std::isnan(slice.at(x, y, 0))) continue;
      for (int b = std::max(y - distance, 0); b <= std::min(y + distance, n[1] - 1); ++b)
        for (int a = std::max(x - distance, 0); a <= std::min(x + distance, n[0] - 1); ++a) mask.at(a, b, 0) = 0;
    }
  return mask;
}

/// Canny edges of a slice as they look through the window.
Mask slice_edges(const Image& slice, const Window& window) {
  Image clipped(slice.grid);
  for (std::size_t p = 0; p < slice.data.size(); ++p) {
    const double t = (slice.data[p] - window.low) / (window.high - window.low);
    clipped.data[p] = float(std::isnan(t) ? 0 : std::clamp(t, 0.0, 1.0));
  }
  const Mask inside = well_inside(slice, int(std::ceil(2 * edge_sigma_mm / slice.grid.spacing.x)));
  return canny_edges(clipped, {edge_sigma_mm, lower_edge, upper_edge}, &inside);
}

/// Draws edges three pixels wide.
void draw_edges(Picture& picture, const Mask& edges) {
  for (int y = 0; y < picture.height; ++y)
    for (int x = 0; x < picture.width; ++x)
      if (edges.at(x, y, 0)) {
        fill(picture, {x - 1, y, 3, 1}, edge_color);
        fill(picture, {x, y - 1, 1, 3}, edge_color);
      }
}

/// Letters of the patient's sides at the middle of the panel's edges.
void draw_sides(Picture& panel, const PlaneLabels& labels) {
  const int x = (panel.width - glyph_width) / 2, y = (panel.height - glyph_height) / 2;
  draw_text_on_image(panel, 4, y, labels.left);
  draw_text_on_image(panel, panel.width - glyph_width - 4, y, labels.right);
  draw_text_on_image(panel, x, 3, labels.top);
  draw_text_on_image(panel, x, panel.height - glyph_height, labels.bottom);
}

/// 1, 2 or 5 times a power of ten, the largest that is at most `value`.
double round_number_below(double value) {
  const double power = std::pow(10, std::floor(std::log10(value)));
  for (const double digit : {5.0, 2.0})
    if (digit * power <= value) return digit * power;
  return power;
}

std::string number(double value) { return concatenate(std::round(value * 1e6) / 1e6); }

/// A bar of round length at the lower left of a panel.
void draw_scale(Picture& panel, double pixel_mm) {
  const double length = round_number_below(0.25 * panel.width * pixel_mm);
  const int pixels = int(std::lround(length / pixel_mm));
  const int left = 10, top = panel.height - 12;
  fill(panel, {left - 1, top - 1, pixels + 2, 6}, black);
  fill(panel, {left, top, pixels, 4}, white);
  draw_text_on_image(panel, left, top - glyph_height - 1, number(length) + " mm");
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

void draw_legend(Picture& picture, int top) {
  const std::string grey = "grey: fixed image", edges = "edges of the image named above each row";
  draw_text(picture, margin, top, grey, black);
  const int line = margin + text_width(grey) + 4 * glyph_width, line_length = 4 * glyph_width;
  fill(picture, {line, top + glyph_height / 2 - 1, line_length, 2}, edge_color);
  draw_text(picture, line + line_length + glyph_width, top, edges, black);
}

/// Colours from 0 (bottom) to `largest` mm with labels at multiples of `step`.
void draw_color_bar(Picture& picture, const Rectangle& bar, double largest, double step) {
  for (int y = 0; y < bar.height; ++y)
    fill(picture, {bar.left, bar.top + y, bar.width, 1}, viridis(1 - (y + 0.5) / bar.height));
  for (int tick = 0; tick * step <= largest * (1 + 1e-9); ++tick) {
    const int y = bar.top + int(std::lround((bar.height - 1) * (1 - tick * step / largest)));
    fill(picture, {bar.left, y, bar.width + 6, 1}, black);
    const int text_top = std::clamp(y - glyph_height / 2, bar.top - 2, bar.top + bar.height - glyph_height + 4);
    draw_text(picture, bar.left + bar.width + 9, text_top, number(tick * step), black);
  }
}

/// |u| [mm] on a slice where the body covers it; NaN elsewhere.
Image displacement_on_slice(const VectorImage& displacement, const Mask& covered, const Grid& slice) {
  Image length(slice, nowhere);
  for (int y = 0; y < slice.size[1]; ++y)
    for (int x = 0; x < slice.size[0]; ++x) {
      Vec3d u;
      const Vec3d point = slice.point(x, y, 0);
      if (nearest_value<std::uint8_t>(covered, point, 0) && linear_value(displacement, point, u))
        length.at(x, y, 0) = float(norm(u));
    }
  return length;
}

/// The displacement's colours over a grey panel, with black lines at multiples of `step` [mm].
void draw_displacement(Picture& panel, const Image& length, double largest, double step) {
  const auto line_between = [step](float a, float b) { return std::floor(a / step) != std::floor(b / step); };
  for (int y = 0; y < panel.height; ++y)
    for (int x = 0; x < panel.width; ++x) {
      const float value = length.at(x, y, 0);
      if (std::isnan(value)) continue;
      const float right = x + 1 < panel.width ? length.at(x + 1, y, 0) : value;
      const float below = y + 1 < panel.height ? length.at(x, y + 1, 0) : value;
      const bool line = (!std::isnan(right) && line_between(value, right)) || (!std::isnan(below) && line_between(value, below));
      const int grey = panel.rgb[3 * (std::size_t(y) * std::size_t(panel.width) + std::size_t(x))];
      const auto under = static_cast<unsigned char>(darkest + grey * (brightest - darkest) / 255);
      set_pixel(panel, x, y, line ? black : blend({under, under, under}, viridis(value / largest), color_weight));
    }
}

}  // namespace

Picture overlay_figure(const Image& fixed, const std::vector<Candidate>& candidates) {
  require(!candidates.empty(), "no image to compare with the fixed image; give at least one");
  const Layout layout = arrange(fixed.grid, picture_width);
  const int row = line_height + layout.row_height + gap;
  const int height = margin + line_height + int(candidates.size()) * row + line_height;
  Picture picture = blank_picture(picture_width, height, white);
  draw_column_names(picture, layout, margin);
  draw_legend(picture, height - line_height);

  const Window fixed_window = display_window(fixed);
  int top = margin + line_height;
  for (const Candidate& candidate : candidates) {
    draw_text(picture, margin, top, candidate.title, black);
    const Window window = display_window(*candidate.image);
    for (int p = 0; p < 3; ++p) {
      const Grid fine = refined(layout.slices[p], 2);
      Picture panel = grey_picture(on_slice(fixed, fine), fixed_window);
      draw_edges(panel, slice_edges(on_slice(*candidate.image, fine), window));
      paste_panel(picture, layout, p, top + line_height, halved(panel));
    }
    top += row;
  }
  return picture;
}

Picture displacement_figure(const Image& moving, const VectorImage& displacement, const Mask& covered) {
  const int bar_left = picture_width - bar_labels - bar_width;
  const Layout layout = arrange(moving.grid, bar_left);
  Picture picture = blank_picture(picture_width, margin + line_height + layout.row_height + margin, white);
  const int top = margin + line_height;
  draw_column_names(picture, layout, margin);

  Image length[3];
  double largest = 0;
  for (int p = 0; p < 3; ++p) {
    length[p] = displacement_on_slice(displacement, covered, refined(layout.slices[p], 2));
    for (const float value : length[p].data) largest = std::max(largest, double(std::isnan(value) ? 0 : value));
  }
  if (largest == 0) largest = 1;
  const double step = round_number_below(largest / 4);
  const Window window = display_window(moving);
  for (int p = 0; p < 3; ++p) {
    Picture panel = grey_picture(on_slice(moving, length[p].grid), window);
    draw_displacement(panel, length[p], largest, step);
    paste_panel(picture, layout, p, top, halved(panel));
  }
  draw_text(picture, bar_left, margin, "|u| [mm]", black);
  draw_color_bar(picture, {bar_left, top, bar_width, layout.row_height}, largest, step);
  return picture;
}

}  // namespace mtled
