#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>

#include "core/error.hpp"
#include "imaging/figure_layout.hpp"

namespace mtled {
namespace {

constexpr int panel_height = 220, tick_labels = 100;  ///< [pixels]
constexpr Color curve_color{0, 114, 178}, tolerance_color{213, 94, 0}, grid_color{215, 215, 215};  ///< blue and vermilion of Okabe and Ito: told apart by the colour blind
constexpr int dash = 24;  ///< [half pixels]

std::string significant(double value, int digits) {
  char text[32];
  if (std::abs(value) >= 1000 && std::abs(value) < 1e9) std::snprintf(text, sizeof text, "%.0f", value);
  else std::snprintf(text, sizeof text, "%.*g", digits, value);
  return text;
}

/// Values from `low` to `high` (their logarithms where it is logarithmic) on [0, 1], and the values at lines across.
struct Axis {
  double low = 0, high = 1;
  bool logarithmic = false;
  std::vector<double> ticks;

  double position(double value) const { return ((logarithmic ? std::log10(value) : value) - low) / (high - low); }
};

/// From a little below `low` to `high`, widened to whole steps.
Axis linear_axis(double low, double high) {
  if (!(high > low)) high = low + std::max(1e-3 * std::abs(low), 1e-9);  // a constant, or nothing
  low -= 0.03 * (high - low);
  const double step = round_number_below((high - low) / 3);
  Axis axis;
  axis.low = std::floor(low / step + 1e-9) * step, axis.high = std::ceil(high / step - 1e-9) * step;
  for (int tick = 0; axis.low + tick * step <= axis.high + step / 2; ++tick) axis.ticks.push_back(axis.low + tick * step);
  return axis;
}

/// The decades that hold all positive values.
Axis logarithmic_axis(const std::vector<double>& values) {
  Axis axis{std::numeric_limits<double>::infinity(), -std::numeric_limits<double>::infinity(), true, {}};
  for (const double value : values)
    if (value > 0) axis.low = std::min(axis.low, std::floor(std::log10(value))), axis.high = std::max(axis.high, std::ceil(std::log10(value)));
  if (axis.low == axis.high) ++axis.high;
  for (double decade = axis.low; decade <= axis.high; ++decade) axis.ticks.push_back(std::pow(10, decade));
  return axis;
}

/// Quantities of the history over the step, one below the other.
class Panels {
 public:
  Panels(std::vector<double> steps, int count)
      : steps_(std::move(steps)), picture_(blank_picture(picture_width, 2 * margin + count * (line_height + panel_height + gap) + 3 * line_height, white)) {
    across_.high = std::max(1.0, steps_.back());
    const double step = round_number_below(across_.high / 5);
    for (double tick = 0; tick <= across_.high; tick += step) across_.ticks.push_back(tick);
  }
  /// `values` [steps]: NaN is left out, and interrupts the line unless it is `bridged`. `tolerance`: a dashed line; NaN: none.
  void add(const std::string& title, const std::vector<double>& values, const Axis& axis, bool bridged, double tolerance) {
    draw_text(picture_, left, top_, title, black);
    top_ += line_height;
    Picture panel = blank_picture(2 * width, 2 * panel_height, white);
    const auto x = [&](double step) { return across_.position(step) * (panel.width - 1); };
    const auto y = [&](double value) { return std::clamp(1 - axis.position(value), 0.0, 1.0) * (panel.height - 1); };
    for (const double tick : across_.ticks) draw_line(panel, x(tick), 0, x(tick), panel.height, 1, grid_color);
    for (const double tick : axis.ticks) draw_line(panel, 0, y(tick), panel.width, y(tick), 1, grid_color);
    for (int from = 0; !std::isnan(tolerance) && from < panel.width; from += 2 * dash) draw_line(panel, from, y(tolerance), from + dash, y(tolerance), 4, tolerance_color);
    for (std::size_t i = 0, last = values.size(); i < values.size(); ++i) {
      if (std::isnan(values[i])) {
        if (!bridged) last = values.size();
        continue;
      }
      if (last < values.size()) draw_line(panel, x(steps_[last]), y(values[last]), x(steps_[i]), y(values[i]), 4, curve_color);
      draw_line(panel, x(steps_[i]), y(values[i]), x(steps_[i]), y(values[i]), 10, curve_color);
      last = i;
    }
    fill(picture_, {left - 1, top_ - 1, width + 2, panel_height + 2}, black);
    paste(picture_, halved(panel), left, top_);
    if (!std::isnan(tolerance)) draw_text(picture_, left + 8, top_ + int(y(tolerance) / 2) - glyph_height - 4, "tolerance " + significant(tolerance, 3) + " mm", tolerance_color);
    for (const double tick : axis.ticks) {
      const std::string text = significant(tick, 6);
      draw_text(picture_, left - text_width(text) - 8, top_ + int(y(tick) / 2) - glyph_height / 2, text, black);
    }
    top_ += panel_height + gap;
  }
  /// With the name of the axis across and a note below it.
  Picture finish(const std::string& name, const std::string& note) {
    for (const double tick : across_.ticks) {
      const std::string text = significant(tick, 6);
      draw_text(picture_, left + int(across_.position(tick) * width) - text_width(text) / 2, top_, text, black);
    }
    draw_text(picture_, left + (width - text_width(name)) / 2, top_ + line_height, name, black);
    draw_text(picture_, left, top_ + 2 * line_height, note, black);
    return std::move(picture_);
  }

 private:
  static constexpr int left = margin + tick_labels, width = picture_width - left - 3 * margin;
  std::vector<double> steps_;
  Picture picture_;
  Axis across_;
  int top_ = margin;
};

}  // namespace

Picture convergence_figure(const std::vector<HistoryEntry>& history, double tolerance_mm) {
  require(!history.empty(), "there is no history of the relaxation to draw");
  constexpr double none = std::numeric_limits<double>::quiet_NaN();
  std::vector<double> step, error, rate, energy;
  double least_energy = none, most_energy = none, last_energy = none;
  for (const HistoryEntry& entry : history) {
    step.push_back(entry.step), error.push_back(entry.error_estimate_mm), rate.push_back(entry.convergence_rate), energy.push_back(entry.strain_energy);
    if (std::isnan(entry.strain_energy)) continue;
    last_energy = entry.strain_energy, least_energy = std::fmin(least_energy, last_energy), most_energy = std::fmax(most_energy, last_energy);
  }
  std::vector<double> errors = error;
  errors.push_back(tolerance_mm);
  Panels panels(step, 3);
  panels.add("estimated displacement error [mm], logarithmic; at the end " + significant(error.back(), 3) + " mm", error, logarithmic_axis(errors), false, tolerance_mm);
  panels.add("convergence rate: share of the error that a step leaves, as found or assumed so far; at the end " + significant(rate.back(), 3), rate, linear_axis(*std::min_element(rate.begin(), rate.end()), 1), false, none);
  panels.add("strain energy of the soft tissue [mN mm]; at the end " + significant(last_energy, 6) + " mN mm", energy, linear_axis(least_energy, most_energy), true, none);
  return panels.finish("relaxation step", "The error has gaps where there is no estimate: at first and after a correction, where it may jump (see docs/method.md).");
}

}  // namespace mtled
