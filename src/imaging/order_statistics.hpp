#pragma once
#include <cstdint>
#include <map>
#include <vector>

namespace mtled {

/// Exact order statistics and percentiles of many numbers by counting their bits, without sorting or copying them; NaN
/// are left out. For lists that would take seconds to sort.
class OrderStatistics {
 public:
  /// `values` must outlive this object.
  explicit OrderStatistics(const std::vector<float>& values);
  /// Of numbers.
  std::size_t count() const { return count_; }
  /// The `rank` smallest number, from 0; `rank` < count().
  float at(std::size_t rank) { return find(rank).value; }
  /// How many of the numbers before it, in this order, have the same bits.
  std::size_t equals_before(std::size_t rank) { return find(rank).equals_before; }
  /// As percentile() in percentile.hpp; NaN when there are no numbers.
  double percentile(double percent);

 private:
  struct Found {
    float value;
    std::size_t equals_before;
  };
  Found find(std::size_t rank);

  using Histogram = std::vector<std::size_t>;
  const std::vector<float>& values_;
  Histogram upper_;                        ///< numbers by the upper half of their bits
  std::map<std::uint32_t, Histogram> lower_;  ///< by the lower half, of those with one upper half
  std::size_t count_ = 0;
};

}  // namespace mtled
