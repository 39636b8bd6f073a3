#include <algorithm>
#include <cmath>

#include "core/error.hpp"
#include "imaging/colored_slices.hpp"
#include "imaging/plot.hpp"

namespace mtled {
namespace {

constexpr int plot_height = 330, between = 40;  ///< [pixels]
constexpr int plot_width = (picture_width - 2 * margin - between) / 2 - tick_labels;
constexpr int bars = 40;                        ///< of the histogram, up to the 99.5th percentile
constexpr std::size_t most_dots = 4000;         ///< every so many-th point has a dot
constexpr Color bar_color{190, 214, 232}, dot_color{150, 185, 212};

/// A little more than the 99.5th percentile: the few points beyond it would squeeze the others.
double shown(const FieldDifference& d) { return d.percentile_99_5 > 0 ? 1.1 * d.percentile_99_5 : 1; }

/// Share of the points [%] that differ by up to so many mm, over a histogram whose highest bar reaches half the height.
Plot distribution(const FieldDifference& d) {
  const double high = shown(d);
  Plot plot(plot_width, plot_height, axis_from_zero(high, 5), axis_from_zero(100, 5));
  std::vector<double> count(bars);
  for (const double difference : d.difference_mm)
    if (difference < high) ++count[std::size_t(difference / high * bars)];
  const double highest = *std::max_element(count.begin(), count.end());
  for (int b = 0; b < bars; ++b)
    if (count[std::size_t(b)] > 0) plot.draw_bar(b * high / bars, (b + 1) * high / bars, 50 * count[std::size_t(b)] / highest, bar_color);
  for (const double percentile : {d.median, d.percentile_95, d.percentile_99_5}) plot.draw_dashed_up(percentile);
  double last = 0;
  for (std::size_t percent = 1; percent <= 100; ++percent) {
    const double next = std::min(d.curve_mm[percent - 1], high);
    plot.draw_segment(last, double(percent - 1), next, double(percent), 5, curve_color);
    last = next;
  }
  return plot;
}

/// The difference over the displacement of the reference: points, and the median and 95th percentile of each group.
Plot over_displacement(const FieldDifference& d, double largest) {
  Plot plot(plot_width, plot_height, axis_from_zero(largest, 5), axis_from_zero(shown(d), 5));
  const std::size_t step = 1 + d.difference_mm.size() / most_dots;
  for (std::size_t p = 0; p < d.difference_mm.size(); p += step) plot.draw_segment(d.reference_mm[p], d.difference_mm[p], d.reference_mm[p], d.difference_mm[p], 4, dot_color);
  const auto draw = [&](double DifferenceGroup::*value, Color color) {
    for (std::size_t g = 0; g < d.groups.size(); ++g) {
      const auto middle = [&](std::size_t n) { return 0.5 * (d.groups[n].from_mm + d.groups[n].to_mm); };
      if (g > 0) plot.draw_segment(middle(g - 1), d.groups[g - 1].*value, middle(g), d.groups[g].*value, 5, color);
      plot.draw_segment(middle(g), d.groups[g].*value, middle(g), d.groups[g].*value, 12, color);
    }
  };
  draw(&DifferenceGroup::median_mm, curve_color);
  draw(&DifferenceGroup::percentile_95_mm, mark_color);
  return plot;
}

}  // namespace

Picture field_difference_figure(const Image& image, const std::function<Image(const Grid&)>& difference_on, const FieldDifference& d, const std::string& colors) {
  const double largest = std::max(1e-3, double(*std::max_element(d.reference_mm.begin(), d.reference_mm.end())));
  const Picture slices = colored_slices(image, difference_on, "d [mm]", shown(d), false);
  Picture picture = blank_picture(picture_width, slices.height + plot_height + 4 * line_height + margin, white);
  paste(picture, slices, 0, 0);
  const int left = margin + tick_labels, right = left + plot_width + between + tick_labels, top = slices.height + line_height;
  const auto paste_plot = [&](const Plot& plot, int x, const std::string& up, const std::string& across) {
    draw_text(picture, x, top - line_height, up, black);
    plot.paste_into(picture, x, top);
    plot.label_across(picture, x, top + plot_height + gap);
    draw_text(picture, x + (plot_width - text_width(across)) / 2, top + plot_height + gap + line_height, across, black);
  };
  const Plot shares = distribution(d);
  paste_plot(shares, left, "points that differ by up to d [%], and histogram", "difference d [mm]");
  int row = top + plot_height / 2;
  for (const auto& [name, value] : {std::pair{"median", d.median}, {"95 %", d.percentile_95}, {"99.5 %", d.percentile_99_5}}) {
    const int column = shares.column(value), width = text_width(name);
    draw_text(picture, left + (column + 6 + width < plot_width ? column + 6 : column - 6 - width), row, name, mark_color);
    row += line_height;
  }
  paste_plot(over_displacement(d, largest), right, "difference d [mm]: points, median, 95 % (upper line)", "displacement of the reference [mm]");
  std::string note = concatenate("Colours: ", colors, ". ", d.difference_mm.size(), " points: median ", significant(d.median, 3), ", 95 % ", significant(d.percentile_95, 3), ", 99.5 % ", significant(d.percentile_99_5, 3), ", largest ",
                                 significant(d.maximum, 3), " mm");
  if (d.maximum > shown(d)) note += ", drawn at the end of scales and colours";
  draw_text(picture, margin, top + plot_height + gap + 2 * line_height, note, black);
  return picture;
}

}  // namespace mtled
