#pragma once
#include <tbb/blocked_range.h>
#include <tbb/global_control.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cstddef>
#include <vector>

namespace mtled {

/// Limits parallel loops to `threads` while it lives.
class ThreadLimit {
 public:
  explicit ThreadLimit(int threads) : control_(tbb::global_control::max_allowed_parallelism, std::size_t(threads)) {}

 private:
  tbb::global_control control_;
};

/// Calls body(begin, end) on pieces of [0, count) of `piece` items each. Pieces do not depend on the number of threads.
template <class Body>
void parallel_pieces(std::size_t count, std::size_t piece, Body&& body) {
  const std::size_t pieces = (count + piece - 1) / piece;
  tbb::parallel_for(
      tbb::blocked_range<std::size_t>(0, pieces, 1),
      [&](const tbb::blocked_range<std::size_t>& range) {
        for (std::size_t p = range.begin(); p < range.end(); ++p) body(p * piece, std::min(count, (p + 1) * piece));
      },
      tbb::simple_partitioner());
}

/// Calls body(i) for every i in [0, count).
template <class Body>
void parallel_for(std::size_t count, Body&& body, std::size_t piece = 4096) {
  parallel_pieces(count, piece, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) body(i);
  });
}

/// Sum of body(begin, end) over fixed pieces, added in order: the same bits for any number of threads.
template <class Body>
double parallel_sum(std::size_t count, Body&& body, std::size_t piece = 16384) {
  std::vector<double> part((count + piece - 1) / piece);
  parallel_pieces(count, piece, [&](std::size_t begin, std::size_t end) { part[begin / piece] = body(begin, end); });
  double sum = 0;
  for (double p : part) sum += p;
  return sum;
}

}  // namespace mtled
