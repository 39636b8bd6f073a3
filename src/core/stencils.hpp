#pragma once
#include <cstdint>
#include <vector>

#include "core/cloud.hpp"
#include "core/approximation.hpp"

namespace mtled {

/// Where the solver keeps each node: a slot. On a lattice the slots form a dense box, ordered plane by plane (k slowest)
/// and, in a plane, by (j mod 4, i mod 4) first and block (j / 4, i / 4) last:
///   slot = k * plane + ((j % 4) * 4 + i % 4) * blocks + (j / 4) * blocks_x + i / 4.
/// Shape functions that repeat every four lattice steps then read consecutive slots, and a step of the lattice is the same
/// difference of slots everywhere. On other clouds slots are the nodes sorted along the longest axis.
struct SlotLayout {
  static constexpr int period = 4;
  int num_slots = 0;
  std::vector<int> slot_of_node;         ///< [num_nodes]
  bool lattice = false;
  int margin = 0;                        ///< empty lattice positions on every side
  int blocks_x = 0, blocks = 0, planes = 0;  ///< lattice only

  int lattice_slot(int i, int j, int k) const {
    return (k * period * period + (j % period) * period + i % period) * blocks + (j / period) * blocks_x + i / period;
  }
};
SlotLayout make_slot_layout(const Cloud& cloud, int margin);

/// Supports of all integration points. Point p has the nodes base[p] + offset[s] for s in
/// [begin[stencil[p]], begin[stencil[p] + 1]) with the same gradients as every other point of its stencil. On a general
/// cloud every point has a stencil of its own and base 0.
struct SupportTable {
  std::vector<int> begin;                ///< [num_stencils + 1]
  std::vector<int> offset;               ///< [entries] slot difference
  std::vector<Vec3d> gradient;           ///< [entries] [1/mm]
  std::vector<int> base;                 ///< [num_points] slot
  std::vector<int> stencil;              ///< [num_points]
  std::size_t enlarged = 0;              ///< supports that had to be enlarged
  std::vector<std::uint32_t> dropped;    ///< points without any usable support, ascending; they have stencil -1
  int num_stencils() const { return int(begin.size()) - 1; }
};
/// Multi-threaded; double precision; every distinct stencil is computed once.
SupportTable build_supports(const Approximation& field, const SlotLayout& layout, const IntegrationPoints& points);

}  // namespace mtled
