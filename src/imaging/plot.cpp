#include "imaging/plot.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>

#include "imaging/figure_layout.hpp"

namespace mtled {
namespace {

constexpr int dash = 24;  ///< [half pixels]

}  // namespace

double Axis::position(double value) const { return ((logarithmic ? std::log10(value) : value) - low) / (high - low); }

Axis linear_axis(double low, double high) {
  if (!(high > low)) high = low + std::max(1e-3 * std::abs(low), 1e-9);  // a constant, or nothing
  low -= 0.03 * (high - low);
  const double step = round_number_below((high - low) / 3);
  Axis axis;
  axis.low = std::floor(low / step + 1e-9) * step, axis.high = std::ceil(high / step - 1e-9) * step;
  for (int tick = 0; axis.low + tick * step <= axis.high + step / 2; ++tick) axis.ticks.push_back(axis.low + tick * step);
  return axis;
}

Axis axis_from_zero(double high, int steps) {
  Axis axis;
  axis.high = high;
  const double step = round_number_below(high / steps);
  for (double tick = 0; tick <= high; tick += step) axis.ticks.push_back(tick);
  return axis;
}

Axis logarithmic_axis(const std::vector<double>& values) {
  Axis axis{std::numeric_limits<double>::infinity(), -std::numeric_limits<double>::infinity(), true, {}};
  for (const double value : values)
    if (value > 0) axis.low = std::min(axis.low, std::floor(std::log10(value))), axis.high = std::max(axis.high, std::ceil(std::log10(value)));
  if (axis.low == axis.high) ++axis.high;
  for (double decade = axis.low; decade <= axis.high; ++decade) axis.ticks.push_back(std::pow(10, decade));
  return axis;
}

std::string significant(double value, int digits) {
  char text[32];
  if (std::abs(value) >= 1000 && std::abs(value) < 1e9) std::snprintf(text, sizeof text, "%.0f", value);
  else std::snprintf(text, sizeof text, "%.*g", digits, value);
  return text;
}

Plot::Plot(int width, int height, const Axis& across, const Axis& up) : across_(across), up_(up), panel_(blank_picture(2 * width, 2 * height, white)) {
  for (const double tick : across_.ticks) draw_line(panel_, pixel_x(tick), 0, pixel_x(tick), panel_.height, 1, grid_color);
  for (const double tick : up_.ticks) draw_line(panel_, 0, pixel_y(tick), panel_.width, pixel_y(tick), 1, grid_color);
}

double Plot::pixel_y(double y) const { return std::clamp(1 - up_.position(y), 0.0, 1.0) * (panel_.height - 1); }

void Plot::draw_segment(double x0, double y0, double x1, double y1, int thickness, Color color) {
  draw_line(panel_, pixel_x(x0), pixel_y(y0), pixel_x(x1), pixel_y(y1), thickness, color);
}

void Plot::draw_bar(double x0, double x1, double height, Color color) {
  const int left = int(pixel_x(x0)), top = int(pixel_y(height));
  fill(panel_, {left, top, std::max(1, int(pixel_x(x1)) - left - 1), panel_.height - top}, color);
}

void Plot::draw_dashed_across(double y) {
  for (int from = 0; from < panel_.width; from += 2 * dash) draw_line(panel_, from, pixel_y(y), from + dash, pixel_y(y), 4, mark_color);
}

void Plot::draw_dashed_up(double x) {
  for (int from = 0; from < panel_.height; from += 2 * dash) draw_line(panel_, pixel_x(x), from, pixel_x(x), from + dash, 4, mark_color);
}

void Plot::paste_into(Picture& picture, int left, int top) const {
  const Picture panel = halved(panel_);
  fill(picture, {left - 1, top - 1, panel.width + 2, panel.height + 2}, black);
  paste(picture, panel, left, top);
  for (const double tick : up_.ticks) {
    const std::string text = significant(tick, 6);
    draw_text(picture, left - text_width(text) - 8, top + row(tick) - glyph_height / 2, text, black);
  }
}

void Plot::label_across(Picture& picture, int left, int top) const {
  for (const double tick : across_.ticks) {
    const std::string text = significant(tick, 6);
    draw_text(picture, left + int(across_.position(tick) * (panel_.width / 2)) - text_width(text) / 2, top, text, black);
  }
}

}  // namespace mtled
