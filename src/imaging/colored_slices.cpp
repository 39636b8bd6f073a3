#include "imaging/colored_slices.hpp"

#include <algorithm>
#include <cmath>

namespace mtled {
namespace {

constexpr int bar_width = 24, bar_labels = 90;  ///< [pixels] of the colour bar
constexpr double color_weight = 0.65;           ///< of the displacement's colour against the image under it
constexpr int darkest = 70,
              brightest = 230;  ///< greys of the image under the displacement: colours stay readable on air

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

/// The colours of `values` over a grey panel, with black lines at multiples of `step` unless it is 0.
void draw_values(Picture& panel, const Image& values, double largest, double step) {
  const auto line_between = [step](float a, float b) { return step > 0 && std::floor(a / step) != std::floor(b / step); };
  for (int y = 0; y < panel.height; ++y)
    for (int x = 0; x < panel.width; ++x) {
      const float value = values.at(x, y, 0);
      if (std::isnan(value)) continue;
      const float right = x + 1 < panel.width ? values.at(x + 1, y, 0) : value;
      const float below = y + 1 < panel.height ? values.at(x, y + 1, 0) : value;
      const bool line =
          (!std::isnan(right) && line_between(value, right)) || (!std::isnan(below) && line_between(value, below));
      const int grey = panel.rgb[3 * (std::size_t(y) * std::size_t(panel.width) + std::size_t(x))];
      const auto under = static_cast<unsigned char>(darkest + grey * (brightest - darkest) / 255);
      set_pixel(panel, x, y, line ? black : blend({under, under, under}, viridis(std::min(value / largest, 1.0)), color_weight));
    }
}

}  // namespace

Picture colored_slices(const Image& image, const std::function<Image(const Grid&)>& values_on, const std::string& title, double largest, bool lines) {
  const int bar_left = picture_width - bar_labels - bar_width;
  const Layout layout = arrange(image.grid, bar_left);
  Picture picture = blank_picture(picture_width, margin + line_height + layout.row_height + margin, white);
  const int top = margin + line_height;
  draw_column_names(picture, layout, margin);

  Image values[3];
  double found = 0;
  for (int p = 0; p < 3; ++p) {
    values[p] = values_on(refined(layout.slices[p], 2));
    for (const float value : values[p].data) found = std::max(found, double(std::isnan(value) ? 0 : value));
  }
  if (largest == 0) largest = found > 0 ? found : 1;
  const double step = round_number_below(largest / 4);
  const Window window = display_window(image);
  for (int p = 0; p < 3; ++p) {
    Picture panel = grey_picture(on_slice(image, values[p].grid), window);
    draw_values(panel, values[p], largest, lines ? step : 0);
    paste_panel(picture, layout, p, top, halved(panel));
  }
  draw_text(picture, bar_left, margin, title, black);
  draw_color_bar(picture, {bar_left, top, bar_width, layout.row_height}, largest, step);
  return picture;
}

}  // namespace mtled
