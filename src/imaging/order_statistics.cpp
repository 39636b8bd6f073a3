#include "imaging/order_statistics.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>

#include "core/parallel.hpp"

namespace mtled {
namespace {

constexpr std::uint32_t half_bits = 16, bins = 1u << half_bits, lower_half = bins - 1, sign = 1u << 31;
constexpr std::size_t pieces = 32;  ///< each with a histogram of its own

/// Unsigned numbers in the order of the floats.
std::uint32_t key_of(float value) {
  const auto bits = std::bit_cast<std::uint32_t>(value);
  return bits & sign ? ~bits : bits | sign;
}
float value_of(std::uint32_t key) { return std::bit_cast<float>(key & sign ? key ^ sign : ~key); }

/// How many numbers have each bin(key); those with bin(key) >= bins do not count.
template <class Bin>
std::vector<std::size_t> histogram(const std::vector<float>& values, const Bin& bin) {
  const std::size_t piece = values.size() / pieces + 1;
  std::vector<std::vector<std::uint32_t>> counts(pieces);
  parallel_pieces(values.size(), piece, [&](std::size_t begin, std::size_t end) {
    std::vector<std::uint32_t>& mine = counts[begin / piece];
    mine.resize(bins);
    for (std::size_t v = begin; v < end; ++v)
      if (!std::isnan(values[v]))
        if (const std::uint32_t b = bin(key_of(values[v])); b < bins) ++mine[b];
  });
  std::vector<std::size_t> sum(bins);
  for (const std::vector<std::uint32_t>& mine : counts)
    for (std::size_t b = 0; b < mine.size(); ++b) sum[b] += mine[b];
  return sum;
}

/// The bin that holds `rank`, which becomes the rank within it.
std::uint32_t bin_of(const std::vector<std::size_t>& counts, std::size_t& rank) {
  std::uint32_t bin = 0;
  for (; rank >= counts[bin]; ++bin) rank -= counts[bin];
  return bin;
}

}  // namespace

OrderStatistics::OrderStatistics(const std::vector<float>& values) : values_(values), upper_(histogram(values, [](std::uint32_t key) { return key >> half_bits; })) {
  for (const std::size_t n : upper_) count_ += n;
}

OrderStatistics::Found OrderStatistics::find(std::size_t rank) {
  const std::uint32_t upper = bin_of(upper_, rank);
  Histogram& lower = lower_[upper];
  if (lower.empty()) lower = histogram(values_, [upper](std::uint32_t key) { return key >> half_bits == upper ? key & lower_half : bins; });
  const std::uint32_t key = upper << half_bits | bin_of(lower, rank);
  return {value_of(key), rank};
}

double OrderStatistics::percentile(double percent) {
  if (count_ == 0) return std::numeric_limits<double>::quiet_NaN();
  const double rank = percent / 100 * double(count_ - 1);
  const std::size_t low = std::min(std::size_t(rank), count_ - 1), high = std::min(low + 1, count_ - 1);
  const double below = at(low);
  return below + (rank - double(low)) * (double(at(high)) - below);
}

}  // namespace mtled
