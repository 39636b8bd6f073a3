#include "imaging/tissue.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "core/error.hpp"
#include "core/material.hpp"
#include "core/parallel.hpp"

namespace mtled {
namespace {

constexpr double ct_anchors[] = {-826, -537, -326, -90, -32, 43, 274, 661};  ///< [HU] seeds of Li et al., case II
constexpr std::size_t largest_histogram = std::size_t(1) << 24;              ///< bins
constexpr int table_intervals = 1 << 16;  ///< lookup table between the first and the last centre (CT: steps of 0.02 HU)

/// u_j = 1 / sum_l (d_j / d_l)^(2 / (q - 1)), with d_j = |x - center_j|; equal shares where several d_j are 0.
/// Ratios to the smallest distance keep the powers within [0, 1].
void unclamped_memberships(const std::vector<double>& centers, double fuzziness, double x, double* u) {
  const std::size_t n = centers.size();
  double nearest = INFINITY;
  for (std::size_t j = 0; j < n; ++j) nearest = std::min(nearest, std::abs(x - centers[j]));
  double sum = 0;
  for (std::size_t j = 0; j < n; ++j) {
    const double d = std::abs(x - centers[j]);
    const double ratio = d == nearest ? 1 : nearest / d;
    u[j] = fuzziness == 2 ? ratio * ratio : std::pow(ratio, 2 / (fuzziness - 1));
    sum += u[j];
  }
  for (std::size_t j = 0; j < n; ++j) u[j] /= sum;
}

double objective(const Histogram& samples, const std::vector<double>& centers, double q) {
  std::vector<double> u(centers.size());
  double sum = 0;
  for (std::size_t i = 0; i < samples.values.size(); ++i) {
    unclamped_memberships(centers, q, samples.values[i], u.data());
    for (std::size_t j = 0; j < centers.size(); ++j) {
      const double d = samples.values[i] - centers[j];
      sum += samples.counts[i] * std::pow(u[j], q) * d * d;
    }
  }
  return sum;
}

/// theta_j = sum u^q x / sum u^q.
std::vector<double> improved_centers(const Histogram& samples, const std::vector<double>& centers, double q) {
  std::vector<double> u(centers.size()), weight(centers.size()), moment(centers.size());
  for (std::size_t i = 0; i < samples.values.size(); ++i) {
    unclamped_memberships(centers, q, samples.values[i], u.data());
    for (std::size_t j = 0; j < centers.size(); ++j) {
      const double w = samples.counts[i] * (q == 2 ? u[j] * u[j] : std::pow(u[j], q));
      weight[j] += w;
      moment[j] += w * samples.values[i];
    }
  }
  for (std::size_t j = 0; j < centers.size(); ++j) moment[j] = weight[j] > 0 ? moment[j] / weight[j] : centers[j];
  return moment;
}

/// Values at the middle of equal shares of the samples, moved apart where they fall together.
std::vector<double> quantile_centers(const Histogram& samples, int classes) {
  const double total = std::accumulate(samples.counts.begin(), samples.counts.end(), 0.0);
  std::vector<double> centers;
  std::size_t i = 0;
  double below = samples.counts[0];
  for (int c = 0; c < classes; ++c) {
    while (below < total * (c + 0.5) / classes && i + 1 < samples.values.size()) below += samples.counts[++i];
    centers.push_back(samples.values[i]);
  }
  const double step = (samples.values.back() - samples.values.front()) * 1e-3 / classes;
  for (int c = 1; c < classes; ++c) centers[c] = std::max(centers[c], centers[c - 1] + step);
  return centers;
}

std::vector<double> start_centers(const Histogram& samples, const FuzzyCMeansOptions& options) {
  const auto check_count = [&](const std::vector<double>& centers, const char* what) {
    require(int(centers.size()) == options.classes, "there are ", centers.size(), " ", what, " for ", options.classes,
            " tissue classes; give one per class");
  };
  if (!options.fixed_centers.empty()) {
    check_count(options.fixed_centers, "fixed centres");
    return options.fixed_centers;
  }
  if (!options.initial_centers.empty()) {
    check_count(options.initial_centers, "initial centres");
    return options.initial_centers;
  }
  const bool looks_like_ct = samples.values.front() < -300 && samples.values.back() > 100;
  if (options.classes == int(std::size(ct_anchors)) && looks_like_ct)
    return {std::begin(ct_anchors), std::end(ct_anchors)};
  return quantile_centers(samples, options.classes);
}

void require_same_grid(const Image& image, const Mask& mask) {
  require(image.grid == mask.grid, "the body mask lies on another voxel grid than the image; resample it to the image");
}

/// What `value_of` says for every intensity inside the mask, through a table over the range of the centres.
template <class T, class ValueOf>
Volume<T> look_up(const Image& image, const Mask& mask, const FuzzyClasses& classes, ValueOf value_of) {
  require_same_grid(image, mask);
  const double low = classes.centers.front(), range = classes.centers.back() - low;
  std::vector<T> table(table_intervals + 1);
  for (int i = 0; i <= table_intervals; ++i) table[i] = value_of(low + range * i / table_intervals);
  const double per_unit = range > 0 ? table_intervals / range : 0;

  Volume<T> result(image.grid);
  parallel_for(
      image.data.size(),
      [&](std::size_t v) {
        if (mask.data[v])
          result.data[v] =
              table[std::size_t(std::clamp((image.data[v] - low) * per_unit, 0.0, double(table_intervals)) + 0.5)];
      },
      65536);
  return result;
}

}  // namespace

Histogram histogram(const Image& image, const Mask& mask, double bin_width) {
  require_same_grid(image, mask);
  require(bin_width > 0, "the histogram's bin width is ", bin_width, "; it must be positive");
  double low = INFINITY, high = -INFINITY;
  for (std::size_t v = 0; v < image.data.size(); ++v)
    if (mask.data[v]) {
      low = std::min(low, double(image.data[v]));
      high = std::max(high, double(image.data[v]));
    }
  require(low <= high,
          "the mask is empty, so there are no intensities to classify; check the mask or the body threshold");
  const double first = std::round(low / bin_width), bins = std::round(high / bin_width) - first + 1;
  require(bins <= double(largest_histogram), "intensities from ", low, " to ", high, " need ", bins,
          " histogram bins of ", bin_width, "; use a larger bin width or remove the outliers");

  std::vector<std::size_t> counts(static_cast<std::size_t>(bins));
  for (std::size_t v = 0; v < image.data.size(); ++v)
    if (mask.data[v]) ++counts[std::size_t(std::round(image.data[v] / bin_width) - first)];
  Histogram result;
  for (std::size_t b = 0; b < counts.size(); ++b)
    if (counts[b] > 0) {
      result.values.push_back((first + double(b)) * bin_width);
      result.counts.push_back(double(counts[b]));
    }
  return result;
}

FuzzyClasses fuzzy_c_means(const Histogram& samples, const FuzzyCMeansOptions& options) {
  require(options.classes >= 2, "fuzzy C-means with ", options.classes, " classes makes no sense; use at least 2");
  require(options.fuzziness > 1, "the fuzziness of fuzzy C-means is ", options.fuzziness,
          "; it must be greater than 1");
  require(int(samples.values.size()) >= options.classes, "the image has fewer distinct intensities (",
          samples.values.size(), ") than classes (", options.classes,
          "); use fewer classes, a smaller bin width, or check image and mask");

  FuzzyClasses result;
  result.fuzziness = options.fuzziness;
  result.centers = start_centers(samples, options);
  result.converged = !options.fixed_centers.empty();
  while (!result.converged && result.iterations < options.max_iterations) {
    std::vector<double> next = improved_centers(samples, result.centers, options.fuzziness);
    double largest_move = 0;
    for (std::size_t j = 0; j < next.size(); ++j)
      largest_move = std::max(largest_move, std::abs(next[j] - result.centers[j]));
    result.centers = std::move(next);
    ++result.iterations;
    result.converged = largest_move <= options.tolerance;
  }
  std::sort(result.centers.begin(), result.centers.end());
  require(result.centers.front() < result.centers.back(), "all class centres are ", result.centers.front(),
          "; give centres that differ");
  result.objective = objective(samples, result.centers, options.fuzziness);
  return result;
}

void memberships(const FuzzyClasses& classes, double intensity, double* membership) {
  const double x = std::clamp(intensity, classes.centers.front(), classes.centers.back());
  unclamped_memberships(classes.centers, classes.fuzziness, x, membership);
}

std::vector<TissueProperties> default_tissue_table() {
  return {{"lung 1", 0.53, false},   {"lung 2", 0.53, false}, {"lung 3", 0.53, false}, {"fat", 1.07, false},
          {"ligament", 3.57, false}, {"muscle", 4.05, false}, {"bone 1", 40.5, true},  {"bone 2", 40.5, true}};
}

namespace {

/// Membership-weighted mean of modulus_of(tissue).
template <class ModulusOf>
Image modulus_map(const Image& image, const Mask& mask, const FuzzyClasses& classes,
                  const std::vector<TissueProperties>& table, const ModulusOf& modulus_of) {
  require(table.size() == classes.centers.size(), "the tissue table has ", table.size(), " rows for ",
          classes.centers.size(), " classes; give one row per class, in the order of their intensity");
  for (const auto& tissue : table)
    require(tissue.shear_modulus_kpa > 0, "tissue '", tissue.name, "' has a shear modulus of ",
            tissue.shear_modulus_kpa, " kPa; it must be positive (lung is about 0.5 kPa)");
  std::vector<double> u(table.size());
  return look_up<float>(image, mask, classes, [&](double intensity) {
    memberships(classes, intensity, u.data());
    double modulus = 0;
    for (std::size_t j = 0; j < table.size(); ++j) modulus += u[j] * modulus_of(table[j]);
    return float(modulus);
  });
}

}  // namespace

Image shear_modulus_map(const Image& image, const Mask& mask, const FuzzyClasses& classes,
                        const std::vector<TissueProperties>& table) {
  return modulus_map(image, mask, classes, table, [](const TissueProperties& tissue) { return tissue.shear_modulus_kpa; });
}

Image bulk_modulus_map(const Image& image, const Mask& mask, const FuzzyClasses& classes,
                       const std::vector<TissueProperties>& table) {
  for (const auto& tissue : table)
    require(tissue.poisson_ratio && *tissue.poisson_ratio >= 0 && *tissue.poisson_ratio < 0.5, "tissue '", tissue.name,
            "' has no Poisson ratio that is at least 0 and below 0.5; give all tissues one (0.49 is usual), or none");
  return modulus_map(image, mask, classes, table, [](const TissueProperties& tissue) { return bulk_modulus(tissue.shear_modulus_kpa, *tissue.poisson_ratio); });
}

LabelImage hard_classes(const Image& image, const Mask& mask, const FuzzyClasses& classes) {
  std::vector<double> u(classes.centers.size());
  return look_up<std::uint16_t>(image, mask, classes, [&](double intensity) {
    memberships(classes, intensity, u.data());
    return std::uint16_t(1 + std::max_element(u.begin(), u.end()) - u.begin());
  });
}

}  // namespace mtled
