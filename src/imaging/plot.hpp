#pragma once
#include <string>
#include <vector>

#include "imaging/drawing.hpp"

namespace mtled {

constexpr Color curve_color{0, 114, 178}, mark_color{213, 94, 0}, grid_color{215, 215, 215};  ///< blue and vermilion of Okabe and Ito: told apart by the colour blind
constexpr int tick_labels = 100;  ///< [pixels] left of a plot

/// Values from `low` to `high` (their logarithms where it is logarithmic) on [0, 1], and the values at lines across.
struct Axis {
  double low = 0, high = 1;
  bool logarithmic = false;
  std::vector<double> ticks;

  double position(double value) const;
};
/// From a little below `low` to `high`, widened to whole steps.
Axis linear_axis(double low, double high);
/// From 0 to `high`, with about `steps` lines at round values.
Axis axis_from_zero(double high, int steps);
/// The decades that hold all positive values.
Axis logarithmic_axis(const std::vector<double>& values);

/// Text of a value with so many significant digits; whole numbers from 1000 on.
std::string significant(double value, int digits);

/// A diagram, drawn at twice its size for smooth lines: the lines of its grid, then what is drawn on it in the units of
/// its axes. What lies beyond the upward axis is drawn at its end.
class Plot {
 public:
  Plot(int width, int height, const Axis& across, const Axis& up);
  /// A line with round ends; a dot where both ends are the same. `thickness` in half pixels.
  void draw_segment(double x0, double y0, double x1, double y1, int thickness, Color color);
  void draw_bar(double x0, double x1, double height, Color color);
  void draw_dashed_across(double y);
  void draw_dashed_up(double x);
  /// [pixels] from the left and from the top of the plot.
  int column(double x) const { return int(pixel_x(x) / 2); }
  int row(double y) const { return int(pixel_y(y) / 2); }
  /// Puts it into a frame, with the values of the upward axis on the left.
  void paste_into(Picture& picture, int left, int top) const;
  /// Values of the axis across, to the line whose top is given.
  void label_across(Picture& picture, int left, int top) const;

 private:
  double pixel_x(double x) const { return across_.position(x) * (panel_.width - 1); }
  double pixel_y(double y) const;
  Axis across_, up_;
  Picture panel_;
};

}  // namespace mtled
