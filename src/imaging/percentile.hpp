#pragma once
#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

namespace mtled {

/// Percentile of `values` with linear interpolation between order statistics: rank = percent / 100 * (n - 1), as NumPy
/// does by default. `percent` in [0, 100]. Reorders `values`; NaN when there are none.
template <class T>
double percentile(std::vector<T>& values, double percent) {
  if (values.empty()) return std::numeric_limits<double>::quiet_NaN();
  const double rank = percent / 100 * double(values.size() - 1);
  const auto low = std::min(std::size_t(rank), values.size() - 1);
  const auto split = values.begin() + std::ptrdiff_t(low);
  std::nth_element(values.begin(), split, values.end());
  const double below = double(*split), fraction = rank - double(low);
  if (fraction <= 0 || low + 1 == values.size()) return below;
  return below + fraction * (double(*std::min_element(split + 1, values.end())) - below);
}

/// The same of values that are in ascending order already.
template <class T>
double percentile_of_sorted(const std::vector<T>& values, double percent) {
  if (values.empty()) return std::numeric_limits<double>::quiet_NaN();
  const double rank = percent / 100 * double(values.size() - 1);
  const auto low = std::min(std::size_t(rank), values.size() - 1), high = std::min(low + 1, values.size() - 1);
  return std::lerp(double(values[low]), double(values[high]), rank - double(low));
}

}  // namespace mtled
