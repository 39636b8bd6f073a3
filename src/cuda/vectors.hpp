#pragma once
#include "cuda/block.hpp"

namespace mtled {

/// y = a x + b y. Index functor over slots: 32 bytes read, 16 written (float).
template <class Real>
struct Combine {
  Real a, b;
  const Vec4<Real>* x;
  Vec4<Real>* y;
  MTLED_HD void operator()(int slot) const { y[slot] = a * x[slot] + b * y[slot]; }
};

/// g = D d for the diagonal D with the given inverse, 0 where that is 0. Index functor over slots.
template <class Real>
struct MultiplyByDiagonal {
  const Vec4<Real>* inverse_diagonal;
  const Vec4<Real>* d;
  Vec4<Real>* g;
  MTLED_HD void operator()(int slot) const {
    const Vec4<Real> i = inverse_diagonal[slot], a = d[slot];
    g[slot] = {i.x > 0 ? a.x / i.x : Real(0), i.y > 0 ? a.y / i.y : Real(0), i.z > 0 ? a.z / i.z : Real(0), Real(0)};
  }
};

/// Sum of products in double, one part per block. The number of blocks depends on the size alone; ReduceValues adds the parts.
template <class Real>
struct DotProduct {
  static constexpr int threads = block_threads, most_blocks = 1024;
  struct Shared { double sum[threads]; };
  int slots;
  const Vec4<Real>* a;
  const Vec4<Real>* b;
  double* part;  ///< [blocks(slots)]

  MTLED_HD static constexpr int blocks(int slots) { return blocks_for(slots) < most_blocks ? blocks_for(slots) : most_blocks; }

  template <class Block>
  MTLED_HD void operator()(Block& block) const {
    block.each_thread([&](int t) {
      double sum = 0;
      for (int s = block.index() * threads + t; s < slots; s += blocks(slots) * threads) {
        const Vec4<Real> x = a[s], y = b[s];
        sum += double(x.x) * double(y.x) + double(x.y) * double(y.y) + double(x.z) * double(y.z);
      }
      block.shared().sum[t] = sum;
    });
    reduce<threads>(block, block.shared().sum, Add{});
    block.each_thread([&](int t) {
      if (t == 0) part[block.index()] = block.shared().sum[0];
    });
  }
};

}  // namespace mtled
