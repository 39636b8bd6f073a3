#include <algorithm>
#include <cmath>
#include <limits>

#include "core/error.hpp"
#include "imaging/figure_layout.hpp"
#include "imaging/plot.hpp"

namespace mtled {
namespace {

constexpr int panel_height = 220;  ///< [pixels]

/// Quantities of the history over the step, one below the other.
class Panels {
 public:
  Panels(std::vector<double> steps, int count)
      : steps_(std::move(steps)), across_(axis_from_zero(std::max(1.0, steps_.back()), 5)),
        picture_(blank_picture(picture_width, 2 * margin + count * (line_height + panel_height + gap) + 3 * line_height, white)) {}
  /// `values` [steps]: NaN is left out, and interrupts the line unless it is `bridged`. `tolerance`: a dashed line; NaN: none.
  void add(const std::string& title, const std::vector<double>& values, const Axis& axis, bool bridged, double tolerance) {
    draw_text(picture_, left, top_, title, black);
    top_ += line_height;
    Plot plot(width, panel_height, across_, axis);
    if (!std::isnan(tolerance)) plot.draw_dashed_across(tolerance);
    for (std::size_t i = 0, last = values.size(); i < values.size(); ++i) {
      if (std::isnan(values[i])) {
        if (!bridged) last = values.size();
        continue;
      }
      if (last < values.size()) plot.draw_segment(steps_[last], values[last], steps_[i], values[i], 4, curve_color);
      plot.draw_segment(steps_[i], values[i], steps_[i], values[i], 10, curve_color);
      last = i;
    }
    plot.paste_into(picture_, left, top_);
    if (!std::isnan(tolerance)) draw_text(picture_, left + 8, top_ + plot.row(tolerance) - glyph_height - 4, "tolerance " + significant(tolerance, 3) + " mm", mark_color);
    top_ += panel_height + gap;
  }
  /// With the name of the axis across and a note below it.
  Picture finish(const std::string& name, const std::string& note) {
    Plot(width, panel_height, across_, {}).label_across(picture_, left, top_);
    draw_text(picture_, left + (width - text_width(name)) / 2, top_ + line_height, name, black);
    draw_text(picture_, left, top_ + 2 * line_height, note, black);
    return std::move(picture_);
  }

 private:
  static constexpr int left = margin + tick_labels, width = picture_width - left - 3 * margin;
  std::vector<double> steps_;
  Axis across_;
  Picture picture_;
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
