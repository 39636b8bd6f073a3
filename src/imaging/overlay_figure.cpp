#include <algorithm>
#include <cmath>

#include "core/error.hpp"
#include "imaging/evaluation.hpp"
#include "imaging/figure_layout.hpp"

namespace mtled {
namespace {

constexpr double edge_sigma_mm = 1.5;
constexpr double lower_edge = 0.0375,
                 upper_edge = 0.1;  ///< [1/mm] of the window's width: 15 and 40 HU/mm for soft tissue
constexpr Color edge_color{255, 90, 0};

/// 1 where the image reaches everything within `distance` pixels (in a square) that is on the slice. An image is
/// convex, so the corners of the square decide.
Mask well_inside(const Image& slice, int distance) {
  Mask mask(slice.grid);
  const auto& n = slice.grid.size;
  for (int y = 0; y < n[1]; ++y)
    for (int x = 0; x < n[0]; ++x) {
      const int left = std::max(x - distance, 0), right = std::min(x + distance, n[0] - 1);
      const int top = std::max(y - distance, 0), bottom = std::min(y + distance, n[1] - 1);
      mask.at(x, y, 0) = !std::isnan(slice.at(left, top, 0)) && !std::isnan(slice.at(right, top, 0)) &&
                         !std::isnan(slice.at(left, bottom, 0)) && !std::isnan(slice.at(right, bottom, 0));
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

void draw_legend(Picture& picture, int top) {
  const std::string grey = "grey: fixed image", edges = "edges of the image named above each row";
  draw_text(picture, margin, top, grey, black);
  const int line = margin + text_width(grey) + 4 * glyph_width, line_length = 4 * glyph_width;
  fill(picture, {line, top + glyph_height / 2 - 1, line_length, 2}, edge_color);
  draw_text(picture, line + line_length + glyph_width, top, edges, black);
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

}  // namespace mtled
