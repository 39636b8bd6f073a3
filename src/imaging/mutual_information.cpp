#include "imaging/mutual_information.hpp"

#include <algorithm>
#include <cmath>
#include <random>

#include "core/error.hpp"
#include "core/parallel.hpp"
#include "core/volume_view.hpp"
#include "imaging/cubic_spline.hpp"

namespace mtled {
namespace {

constexpr int padding = 2;              ///< empty bins at either end, for the windows' tails
constexpr std::size_t piece = 8192;     ///< samples with a histogram of their own
constexpr double smallest_density = 1e-16;

/// Cubic B-spline window and its derivative at a distance in bins.
double window(double x) {
  const double a = std::abs(x);
  return a < 1 ? (4 - 6 * a * a + 3 * a * a * a) / 6 : a < 2 ? (2 - a) * (2 - a) * (2 - a) / 6 : 0;
}
double window_slope(double x) {
  const double a = std::abs(x), slope = a < 1 ? (3 * a - 4) * a / 2 : a < 2 ? -(2 - a) * (2 - a) / 2 : 0;
  return x < 0 ? -slope : slope;
}

/// Value and gradient [1/mm] of the cubic spline with these coefficients, which goes on beyond the border as it is there.
double interpolate_with_gradient(const VolumeView<float>& coefficients, const Vec3d& point, Vec3d& gradient) {
  const Vec3d c = coefficients.grid.index(point);
  double weight[3][4], slope[3][4];
  int tap[3][4];
  for (int a = 0; a < 3; ++a) {
    const int n = coefficients.grid.size[a];
    const double index = clamped(c[a], 0.0, double(n - 1));
    const int low = std::min(int(index), std::max(n - 2, 0));
    const double t = index - low;
    cubic_weights(t, weight[a]);
    for (int i = 0; i < 4; ++i) slope[a][i] = index == c[a] ? -window_slope(i - 1 - t) : 0, tap[a][i] = mirrored(low - 1 + i, n);
  }
  double value = 0;
  Vec3d by_index;
  for (int k = 0; k < 4; ++k)
    for (int j = 0; j < 4; ++j) {
      const float* row = &coefficients.at(0, tap[1][j], tap[2][k]);
      double sum = 0, along = 0;
      for (int i = 0; i < 4; ++i) sum += weight[0][i] * row[tap[0][i]], along += slope[0][i] * row[tap[0][i]];
      value += weight[1][j] * weight[2][k] * sum;
      by_index += Vec3d{weight[1][j] * weight[2][k] * along, slope[1][j] * weight[2][k] * sum, weight[1][j] * slope[2][k] * sum};
    }
  for (int a = 0; a < 3; ++a) by_index[a] /= coefficients.grid.spacing[a];
  gradient = coefficients.grid.direction * by_index;
  return value;
}

/// The bins of an image: value = lowest + width * (bin - padding).
struct Bins {
  double lowest, width;
};
Bins bins_between(double lowest, double highest, int bins) { return {lowest, (highest - lowest) / (bins - 2 * padding)}; }

/// Whether intensities differ by more than the rounding of single precision, in which they are smoothed and interpolated.
bool differ(double lowest, double highest) { return highest - lowest > 1e-5 * std::max(std::abs(lowest), std::abs(highest)); }

/// The bin of a position on the scale of bins, away from the ends as far as a window reaches.
int bin_at(double position, int bins) { return std::clamp(int(position), padding, bins - padding - 1); }

}  // namespace

std::vector<IntensitySample> draw_samples(const Image& image, const Mask* inside, std::size_t count, std::uint64_t seed) {
  const GridView grid(image.grid);
  std::vector<std::size_t> voxels;
  for (std::size_t v = 0; v < image.data.size(); ++v)
    if (!inside || nearest_value<std::uint8_t>(*inside, grid.point_at(v), 0)) voxels.push_back(v);
  require(!voxels.empty(), "the mask marks no voxel of the fixed image; check that it was drawn on this image");
  const Image coefficients = spline_coefficients(image);
  std::mt19937_64 random(seed);  // its distributions differ between libraries; its numbers do not
  const auto anywhere_in_voxel = [&] { return double(random()) * 0x1p-64 - 0.5; };
  std::vector<IntensitySample> samples(count);
  for (IntensitySample& s : samples) {
    Vec3d index = grid.index(grid.point_at(voxels[random() % voxels.size()]));
    for (int a = 0; a < 3; ++a) index[a] = std::clamp(index[a] + anywhere_in_voxel(), 0.0, double(grid.size[a] - 1));
    s.place = grid.point(index);
    interpolate_cubically(view_of(coefficients), s.place, s.value);
  }
  return samples;
}

MattesMutualInformation::MattesMutualInformation(const Image& moving, const std::vector<IntensitySample>& samples, int bins)
    : coefficients_(spline_coefficients(moving)), bins_(bins), counts_(samples.size(), 1), window_(samples.size()), gradient_(samples.size()) {
  require(bins > 2 * padding + 1, bins, " histogram bins are too few; give at least ", 2 * padding + 2);
  require(!samples.empty(), "there are no samples to compare the images at; give at least one");
  const auto [first, last] = std::minmax_element(samples.begin(), samples.end(), [](const auto& a, const auto& b) { return a.value < b.value; });
  require(differ(first->value, last->value), "the fixed image is constant (", first->value, ") where it is compared, so that nothing can be registered; is it the right file, and the mask?");
  const auto [low, high] = std::minmax_element(moving.data.begin(), moving.data.end());
  require(differ(*low, *high), "the moving image is constant (", *low, "), so that nothing can be registered; is it the right file?");
  const Bins of_fixed = bins_between(first->value, last->value, bins), of_moving = bins_between(*low, *high, bins);
  lowest_ = of_moving.lowest, bin_width_ = of_moving.width;
  for (const IntensitySample& s : samples) fixed_bin_.push_back(bin_at((s.value - of_fixed.lowest) / of_fixed.width + padding, bins));
}

double MattesMutualInformation::count_inside(const std::vector<Vec3d>& position) {
  std::size_t total = 0;
  for (std::size_t s = 0; s < position.size(); ++s) {
    const Vec3d c = coefficients_.grid.index(position[s]);
    counts_[s] = 1;
    for (int a = 0; a < 3; ++a) counts_[s] = counts_[s] && c[a] >= -0.5 && c[a] <= coefficients_.grid.size[std::size_t(a)] - 0.5;
    total += counts_[s];
  }
  return double(total) / double(position.size());
}

double MattesMutualInformation::evaluate(const std::vector<Vec3d>& position, std::vector<Vec3d>& derivative) {
  const std::size_t count = fixed_bin_.size(), entries = std::size_t(bins_) * std::size_t(bins_);
  std::vector<std::vector<double>> part((count + piece - 1) / piece);
  parallel_pieces(count, piece, [&](std::size_t begin, std::size_t end) {
    std::vector<double>& histogram = part[begin / piece];
    histogram.assign(entries, 0);
    for (std::size_t s = begin; s < end; ++s) {
      if (!counts_[s]) continue;
      Vec3d gradient;
      const double w = (interpolate_with_gradient(view_of(coefficients_), position[s], gradient) - lowest_) / bin_width_ + padding;
      window_[s] = clamped(w, padding, bins_ - padding);  // a spline overshoots: the ends are then the nearest intensities,
      gradient_[s] = window_[s] == w ? (1 / bin_width_) * gradient : Vec3d{};  // and do not change
      const int first = bin_at(window_[s], bins_) - 1;
      for (int m = first; m < first + 4; ++m) histogram[std::size_t(fixed_bin_[s] * bins_ + m)] += window(m - window_[s]);
    }
  });
  std::vector<double> joint(entries, 0), fixed_density(std::size_t(bins_), 0), moving_density(std::size_t(bins_), 0);
  for (const std::vector<double>& histogram : part)
    for (std::size_t e = 0; e < entries; ++e) joint[e] += histogram[e];
  derivative.assign(count, Vec3d{});
  const double total = double(std::count(counts_.begin(), counts_.end(), 1));
  if (total == 0) return 0;

  for (std::size_t e = 0; e < entries; ++e) {
    joint[e] /= total;
    fixed_density[e / std::size_t(bins_)] += joint[e], moving_density[e % std::size_t(bins_)] += joint[e];
  }
  double information = 0;
  std::vector<double> log_ratio(entries, 0);  // of joint to moving density: the fixed density does not change
  for (std::size_t e = 0; e < entries; ++e) {
    const double f = fixed_density[e / std::size_t(bins_)], m = moving_density[e % std::size_t(bins_)];
    if (joint[e] < smallest_density || f < smallest_density || m < smallest_density) continue;
    log_ratio[e] = std::log(joint[e] / m);
    information += joint[e] * (log_ratio[e] - std::log(f));
  }
  parallel_for(count, [&](std::size_t s) {
    if (!counts_[s]) return;
    const int first = bin_at(window_[s], bins_) - 1;
    double slope = 0;
    for (int m = first; m < first + 4; ++m) slope -= window_slope(m - window_[s]) * log_ratio[std::size_t(fixed_bin_[s] * bins_ + m)];
    derivative[s] = (slope / total) * gradient_[s];
  });
  return information;
}

}  // namespace mtled
