#pragma once
#include <cstddef>

#include "cuda/block.hpp"
#include "cuda/step_load.hpp"

namespace mtled {

/// result = M x for square matrices along a diagonal, one after the other and each row-major: block b has the rows and columns
/// [begin[b], begin[b + 1]). A warp per row: its lanes add every 32nd product, then a tree of fixed shape. Reads the matrices
/// once: 4 bytes per entry of a float.
template <class Element, class Result>
struct MatrixRows {
  static constexpr int threads = block_threads, warp = 32, rows_per_block = threads / warp, most = 3;
  struct Shared { Element sum[threads]; };
  int begin[most + 1];           ///< without further blocks the last value repeats
  const Element* matrix;
  const Element* x;              ///< [begin[most]]
  const std::int32_t* place;     ///< [begin[most]] of each row's result
  Result* result;
  StepLoad step;

  static constexpr int blocks(int rows) { return (rows + rows_per_block - 1) / rows_per_block; }

  template <class Block>
  MTLED_HD void operator()(Block& block) const {
    if (step.over()) return;
    block.each_thread([&](int t) {
      const int row = block.index() * rows_per_block + t / warp;
      int first = 0, size = begin[1];
      std::size_t from = 0;
      for (int b = 1; b < most; ++b)
        if (row >= begin[b]) from += std::size_t(size) * std::size_t(size), first = begin[b], size = begin[b + 1] - begin[b];
      Element sum = 0;
      if (row < begin[most]) {
        const Element* entry = matrix + from + std::size_t(row - first) * std::size_t(size);
        for (int c = t % warp; c < size; c += warp) sum += entry[c] * x[first + c];
      }
      block.shared().sum[t] = sum;
    });
    reduce<warp>(block, block.shared().sum, Add{});
    block.each_thread([&](int t) {
      const int row = block.index() * rows_per_block + t / warp;
      if (t % warp == 0 && row < begin[most]) result[place[row]] = Result(block.shared().sum[t]);
    });
  }
};

}  // namespace mtled
