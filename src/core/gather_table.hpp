#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

#include "core/host_device.hpp"
#include "core/stencils.hpp"

namespace mtled {

/// One term of a row: the index of what is gathered, and the gradient that it is multiplied with [1/mm].
template <class Real>
struct alignas(4 * sizeof(Real)) GatherEntry {
  Real x, y, z;
  std::int32_t index;
};

/// Rows of gathers laid out for wide machines: thread t computes one row, and 32 threads in a row (a warp) read memory side by side.
///  - Threads [0, shared_threads) have a stencil that other rows have, too: their entries are relative to `base`, are stored
///    once, and neighbouring threads read the same ones. Within a region of slots, rows with the same stencil follow each
///    other, by rising base.
///  - Later threads have entries of their own, in slices of 32 rows stored entry by entry: thread t reads
///    own[slice_begin[s] + 32 * e + t % 32], s = (t - shared_threads) / 32, index absolute. Short rows end with
///    zero gradients at their last index.
/// Idle threads (the end of either part) have row -1 and no terms.
/// Pass one gathers nodal displacements into points, pass two stresses into nodes: both are such tables.
template <class Real>
struct GatherTableView {
  static constexpr int slice = 32;
  int threads = 0, shared_threads = 0;   ///< both multiples of 32
  const std::int32_t* row = nullptr;     ///< [threads] where the result goes, -1: nowhere
  const std::int32_t* base = nullptr;    ///< [shared_threads]
  const std::int32_t* stencil = nullptr; ///< [shared_threads]
  const std::uint32_t* stencil_begin = nullptr;       ///< [stencils + 1]
  const GatherEntry<Real>* stencil_entry = nullptr;   ///< index relative to base
  const std::uint64_t* slice_begin = nullptr;         ///< [slices + 1]
  const GatherEntry<Real>* own = nullptr;

  /// visit(index, entry) for every term of a thread's row, in ascending order of its index.
  template <class Visit>
  MTLED_HD void each(int thread, const Visit& visit) const {
    if (row[thread] < 0) return;
    if (thread < shared_threads) {
      const std::int32_t from = base[thread];
      const std::uint32_t end = stencil_begin[stencil[thread] + 1];
      for (std::uint32_t e = stencil_begin[stencil[thread]]; e < end; ++e) visit(from + stencil_entry[e].index, stencil_entry[e]);
    } else {
      const int s = (thread - shared_threads) / slice, terms = int(slice_begin[s + 1] - slice_begin[s]) / slice;
      const GatherEntry<Real>* entry = own + slice_begin[s] + thread % slice;
      for (int e = 0; e < terms; ++e) visit(entry[e * slice].index, entry[e * slice]);  // counted, so that nvcc unrolls it
    }
  }
};

/// The same, owning its memory.
template <class Real>
struct GatherTable {
  int threads = 0, shared_threads = 0;
  std::vector<std::int32_t> row, base, stencil;
  std::vector<std::uint32_t> stencil_begin{0};
  std::vector<GatherEntry<Real>> stencil_entry;
  std::vector<std::uint64_t> slice_begin{0};
  std::vector<GatherEntry<Real>> own;
  std::size_t terms = 0;                 ///< of all rows, without padding

  GatherTableView<Real> view() const;
  std::size_t bytes() const;
};

/// Both passes of a model. Points are kept at places: on a lattice, points with the same shared stencil lie as in the slot
/// layout (place = first of the stencil + plane / period * blocks + block), so that a step of the lattice is the same
/// difference of places everywhere, and the nodes' rows repeat as the points' do. Other points follow by rising slot.
/// Gradients are rounded to Real; entries of a row rise by index.
template <class Real>
struct GatherTables {
  GatherTable<Real> of_points;           ///< rows: places; indices: slots
  GatherTable<Real> of_nodes;            ///< rows: slots; indices: places
  std::vector<std::int32_t> point;       ///< [of_points.threads] integration point of each thread, -1: idle
  int places = 0;                        ///< some of them may be empty
};
/// Multi-threaded, with the same result for any number of threads. Points without a stencil take no part; slots without any
/// point have no row.
template <class Real>
GatherTables<Real> make_gather_tables(const SupportTable& supports, const SlotLayout& layout);

}  // namespace mtled
