#pragma once
#include "cuda/block.hpp"

namespace mtled {

/// Largest component of sum value x over each block's rows of (slot, value), one thread per row; not a number where any is
/// not. Reads 8 bytes per entry (float) and 16 of x.
template <class Real>
struct LargestOfRows {
  static constexpr int threads = block_threads;
  struct Shared { Real largest[threads]; };
  int rows;
  const std::uint32_t* begin;  ///< [rows + 1]
  const std::int32_t* slot;    ///< [entries]
  const float* value;          ///< [entries]
  const Vec4<Real>* x;         ///< [slots]
  Real* largest;               ///< [blocks]

  template <class Block>
  MTLED_HD void operator()(Block& block) const {
    block.each_thread([&](int t) {
      const int row = block.index() * threads + t;
      Vec4<Real> sum{};
      if (row < rows)
        for (std::uint32_t e = begin[row]; e < begin[row + 1]; ++e) sum = sum + Real(value[e]) * x[slot[e]];
      block.shared().largest[t] = largest_component(sum);
    });
    reduce<threads>(block, block.shared().largest, Larger{});
    block.each_thread([&](int t) {
      if (t == 0) largest[block.index()] = block.shared().largest[0];
    });
  }
};

}  // namespace mtled
