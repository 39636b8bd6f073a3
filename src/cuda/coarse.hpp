#pragma once
#include <algorithm>
#include <array>
#include <numeric>
#include <vector>

#include "cuda/block.hpp"
#include "cuda/step_load.hpp"

/// The coarse correction g += Z A^-1 Z^T f of core/coarse_space.hpp in three kernels: RestrictToCells and RightSide (Z^T f),
/// MatrixRows (dense_rows.hpp) with the inverse of A, and CoarseCorrection (Z y) inside the functor that uses it. Nodes are
/// sorted by spline cell, so that all nodes of a block share their 27 functions. Every sum has a fixed order.
namespace mtled {

inline constexpr int functions_per_cell = 27;

template <class Real>
struct alignas(16) CoarseNode {
  Real weight[9];
  Real active[3];
};

/// Z^T f of one cell per block: cell_sum[27 cell + function], function = i + 3 j + 9 k. Warp w adds every eighth node of the
/// cell from w on, lane by function; then the eight sums are added in order. Reads 20 bytes (slot, force) and 48 (weights)
/// per node in float.
template <class Real>
struct RestrictToCells {
  static constexpr int threads = block_threads, warp = 32, warps = threads / warp;
  struct Shared { Vec4<Real> sum[threads]; };
  const std::int32_t* begin;        ///< [cells + 1]
  const std::int32_t* slot;         ///< [nodes]
  const CoarseNode<Real>* node;     ///< [nodes]
  const Vec4<Real>* f;              ///< [slots] [mN]
  Vec4<Real>* cell_sum;             ///< [27 * cells]
  StepLoad step;

  template <class Block>
  MTLED_HD void operator()(Block& block) const {
    if (step.over()) return;
    const int cell = block.index();
    block.each_thread([&](int t) {
      const int lane = t % warp;
      Vec4<Real> sum{};
      if (lane < functions_per_cell)
        for (int n = begin[cell] + t / warp; n < begin[cell + 1]; n += warps) {
          const CoarseNode<Real>& a = node[n];
          const Real w = a.weight[lane % 3] * a.weight[3 + lane / 3 % 3] * a.weight[6 + lane / 9];
          const Vec4<Real> force = f[slot[n]];
          sum.x += w * a.active[0] * force.x, sum.y += w * a.active[1] * force.y, sum.z += w * a.active[2] * force.z;
        }
      block.shared().sum[t] = sum;
    });
    block.each_thread([&](int t) {
      if (t >= functions_per_cell) return;
      Vec4<Real> sum = block.shared().sum[t];
      for (int w = 1; w < warps; ++w) sum = sum + block.shared().sum[warp * w + t];
      cell_sum[functions_per_cell * cell + t] = sum;
    });
  }
};

/// right[3 v + c]: the sums of the cells that unknown function v reaches, in the order of the cells, in double. Index functor
/// over the functions.
template <class Real>
struct RightSide {
  const std::int32_t* begin;        ///< [unknown functions + 1]
  const std::int32_t* item;         ///< [entries] into cell_sum
  const Vec4<Real>* cell_sum;
  float* right;                     ///< [3 * unknown functions]
  StepLoad step;

  MTLED_HD void operator()(int v) const {
    if (step.over()) return;
    double x = 0, y = 0, z = 0;
    for (std::int32_t e = begin[v]; e < begin[v + 1]; ++e) {
      const Vec4<Real> s = cell_sum[item[e]];
      x += double(s.x), y += double(s.y), z += double(s.z);
    }
    right[3 * v] = float(x), right[3 * v + 1] = float(y), right[3 * v + 2] = float(z);
  }
};

/// Z y at a slot, from y by function (0 where a function is no unknown): for use inside other functors.
template <class Real>
struct CoarseCorrection {
  const std::int32_t* node_of_slot;  ///< [slots] -1: none; null: no correction anywhere
  const std::int32_t* first;         ///< [nodes]
  const CoarseNode<Real>* node;      ///< [nodes]
  const Vec4<float>* y;              ///< [functions] [mm]
  int stride_y, stride_z;

  MTLED_HD Vec4<Real> at(int slot) const {
    Vec4<Real> sum{};
    const int n = node_of_slot ? node_of_slot[slot] : -1;
    if (n < 0) return sum;
    const CoarseNode<Real>& a = node[n];
    for (int k = 0; k < 3; ++k)
      for (int j = 0; j < 3; ++j) {
        const Vec4<float>* from = y + first[n] + stride_z * k + stride_y * j;
        const Real w = a.weight[6 + k] * a.weight[3 + j];
        for (int i = 0; i < 3; ++i) {
          const Real wi = w * a.weight[i];
          sum.x += wi * Real(from[i].x), sum.y += wi * Real(from[i].y), sum.z += wi * Real(from[i].z);
        }
      }
    return {a.active[0] * sum.x, a.active[1] * sum.y, a.active[2] * sum.z, Real(0)};
  }
};

/// What these functors read, on the host.
template <class Real>
struct CoarseTables {
  int functions = 0, stride_y = 0, stride_z = 0, cells = 0, unknowns = 0;
  std::vector<std::int32_t> cell_begin{0};                ///< [cells + 1]
  std::vector<std::int32_t> slot, first, node_of_slot;
  std::vector<CoarseNode<Real>> node;
  std::vector<std::int32_t> right_begin{0}, right_item;
  std::vector<std::int32_t> place;                        ///< [unknowns] of y in an array of Vec4<float> by function, in floats

  /// From what a CoarseSpace says of itself: nodes(), functions(), used_functions().
  template <class Node>
  CoarseTables(const std::vector<Node>& nodes, const std::array<int, 3>& per_axis, const std::vector<int>& used, std::size_t slots);
};

template <class Real>
template <class Node>
CoarseTables<Real>::CoarseTables(const std::vector<Node>& nodes, const std::array<int, 3>& per_axis, const std::vector<int>& used, std::size_t slots)
    : functions(per_axis[0] * per_axis[1] * per_axis[2]), stride_y(per_axis[0]), stride_z(per_axis[0] * per_axis[1]), unknowns(3 * int(used.size())), node_of_slot(slots, -1) {
  std::vector<std::size_t> order(nodes.size());
  std::iota(order.begin(), order.end(), std::size_t(0));
  std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) { return nodes[a].first < nodes[b].first; });
  std::vector<std::vector<std::int32_t>> items(static_cast<std::size_t>(functions));
  for (std::size_t o : order) {
    const Node& from = nodes[o];
    if (first.empty() || from.first != first.back()) {
      if (!first.empty()) cell_begin.push_back(std::int32_t(first.size()));
      for (int f = 0; f < functions_per_cell; ++f)
        items[std::size_t(from.first + f % 3 + stride_y * (f / 3 % 3) + stride_z * (f / 9))].push_back(functions_per_cell * cells + f);
      ++cells;
    }
    node_of_slot[std::size_t(from.slot)] = std::int32_t(node.size());
    slot.push_back(from.slot), first.push_back(from.first);
    CoarseNode<Real>& to = node.emplace_back();
    std::copy(from.weight, from.weight + 9, to.weight), std::copy(from.active, from.active + 3, to.active);
  }
  if (cells > 0) cell_begin.push_back(std::int32_t(first.size()));
  for (int f : used) {
    right_item.insert(right_item.end(), items[std::size_t(f)].begin(), items[std::size_t(f)].end());
    right_begin.push_back(std::int32_t(right_item.size()));
    for (int c = 0; c < 3; ++c) place.push_back(4 * f + c);
  }
}

}  // namespace mtled
