#pragma once
#include "cuda/vec4.hpp"

/// Kernels are functors that a launcher runs: serial_device.hpp on the host (tests: the very same functor, so that an index
/// out of bounds shows without a GPU), cuda_device.cuh on a GPU.
///  - Index functor: void operator()(int i) const, one thread per index. The launcher alone guards the bounds.
///  - Block functor: static constexpr int threads, struct Shared (trivial), template <class Block> void operator()(Block&) const
///    with block.index(), block.shared() and block.each_thread(body): body(t) for every thread of the block is one phase,
///    which ends with a barrier. What lives across phases lies in shared memory.
/// All threads of a block take the same way through its phases.
namespace mtled {

inline constexpr int block_threads = 256;
MTLED_HD constexpr int blocks_for(int items) { return (items + block_threads - 1) / block_threads; }

/// The first of every `group` values becomes combine() of all of them, by a tree of fixed shape: the same bits in every run.
/// The values are written in an earlier phase.
template <int group, class Block, class T, int threads, class Combine>
MTLED_HD void reduce(Block& block, T (&value)[threads], const Combine& combine) {
  static_assert((group & (group - 1)) == 0 && threads % group == 0);
  for (int width = group / 2; width > 0; width /= 2)
    block.each_thread([&](int t) {
      if (t % group < width) value[t] = combine(value[t], value[t + width]);
    });
}

struct Add {
  template <class T> MTLED_HD T operator()(const T& a, const T& b) const { return a + b; }
};
struct Larger {
  template <class T> MTLED_HD T operator()(const T& a, const T& b) const { return larger(a, b); }
};

/// One block reduces `count` values to *result. Reads each once.
template <class T, class Combine>
struct ReduceValues {
  static constexpr int threads = block_threads;
  struct Shared { T value[threads]; };
  int count;
  const T* value;  ///< [count]
  T none;          ///< leaves any value as it is
  T* result;

  template <class Block>
  MTLED_HD void operator()(Block& block) const {
    const Combine combine{};
    block.each_thread([&](int t) {
      T own = none;
      for (int i = t; i < count; i += threads) own = combine(own, value[i]);
      block.shared().value[t] = own;
    });
    reduce<threads>(block, block.shared().value, combine);
    block.each_thread([&](int t) {
      if (t == 0) *result = block.shared().value[0];
    });
  }
};

}  // namespace mtled
