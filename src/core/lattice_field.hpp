#pragma once
#include <cstdint>
#include <vector>

#include "core/moment_solve.hpp"
#include "core/rest_position.hpp"

namespace mtled {

class ShapeEvaluator;

/// Displacement of a node by its lattice position; one aligned load on a device.
struct alignas(16) LatticeParameter {
  float x, y, z;  ///< [mm]
  float is_node;  ///< 1; 0 where the lattice has no node
};

/// u(X) of moving least squares on a lattice: ShapeEvaluator's values without gradients, in a form that devices run. It takes the
/// same decisions in the same arithmetic (when the compiler does not contract products and sums), and gives up, undecided, where they take more than it has:
///  - supports that have to be enlarged: too few nodes, or a matrix whose condition is not surely good enough,
///  - cells coupled with finite elements,
///  - gaps nearby when the support reaches further than `longest_walk` cells.
struct LatticeFieldView {
  /// About the cell whose lowest corner is at a lattice position.
  enum CellFlag : std::uint8_t {
    complete = 1,    ///< its eight corners are nodes
    body = 2,        ///< it holds body
    surrounded = 4,  ///< so do all cells that a support from it may touch: no gap
    coupled = 8,     ///< with finite elements
  };
  static constexpr double edge_tolerance = 1e-6;  ///< as in cell_of()
  static constexpr int longest_walk = 3;          ///< reach [cells]

  Vec3d origin;
  double spacing = 1;
  int size[3] = {0, 0, 0};
  bool quadratic = false;
  double penalty = 0;           ///< of the quadratic terms
  double worst_condition = 0;
  int smallest_support = 0;
  double radius = 0;            ///< of a support [mm]
  int reach = 0;                ///< of a support [cells], rounded up
  const LatticeParameter* parameter = nullptr;  ///< [size]
  const std::uint8_t* flags = nullptr;          ///< [size]

  /// u [mm] at x: outside where the cell of x lacks a corner. M: terms of the basis, 10 when it is quadratic, else 4.
  template <int M>
  MTLED_HD Coverage displacement(const Vec3d& x, Vec3d& u) const {
    Cell cell;
    if (!complete_cell(x, cell)) return Coverage::outside;
    const int f = flags[offset(cell.i[0], cell.i[1], cell.i[2])];
    if (f & coupled) return Coverage::undecided;
    const int first[3] = {cell.i[0] - reach + 1, cell.i[1] - reach + 1, cell.i[2] - reach + 1};
    Walk reachable;
    const bool gap = !(f & surrounded);
    if (gap) {
      if (reach > longest_walk) return Coverage::undecided;
      walk(x, first, reachable);
    }
    int low[3], high[3];
    for (int a = 0; a < 3; ++a) {
      const int l = int(std::ceil((x[a] - radius - origin[a]) / spacing)), h = int(std::floor((x[a] + radius - origin[a]) / spacing));
      low[a] = l > 0 ? l : 0;
      high[a] = h < size[a] - 1 ? h : size[a] - 1;
    }
    Moments<M> moments;
    int nodes = 0;
    const double inverse_radius = 1 / radius;
    for (int k = low[2]; k <= high[2]; ++k)
      for (int j = low[1]; j <= high[1]; ++j)
        for (int i = low[0]; i <= high[0]; ++i) {
          const Vec3d d = origin + spacing * Vec3d{double(i), double(j), double(k)} - x;
          const double squared = squared_norm(d);
          if (!(squared < radius * radius)) continue;
          const LatticeParameter p = parameter[offset(i, j, k)];
          if (p.is_node == 0 || (gap && !reachable.holds(i - first[0], j - first[1], k - first[2]))) continue;
          const double s = std::sqrt(squared) * inverse_radius;
          if (s >= 1) continue;
          moments.add(1 + s * s * (-6 + s * (8 - 3 * s)), inverse_radius * d, Vec3d{p.x, p.y, p.z});
          ++nodes;
        }
    if (nodes < smallest_support || !moments.solve(penalty, worst_condition, u)) return Coverage::undecided;
    return Coverage::covered;
  }

 private:
  struct Cell {
    int i[3];
  };
  /// Cells [first, first + width) along each axis that a walk inside the ball reaches, one bit each in rows of `pitch`
  /// bits; slice 0 is the empty one below.
  struct Walk {
    static constexpr int most = 2 * longest_walk - 1, pitch = most + 2;
    std::uint64_t reached[most + 2];
    static MTLED_HD std::uint64_t bit(int i, int j) { return std::uint64_t(1) << (i + 1 + pitch * (j + 1)); }
    int width;
    /// Whether a corner (i, j, k) belongs to a cell that is reached. Rounding can take a node at exactly the radius, beside the cells.
    MTLED_HD bool holds(int i, int j, int k) const {
      if (i < 0 || j < 0 || k < 0 || i > width || j > width || k > width) return false;
      const std::uint64_t corners = bit(-1, -1) | bit(0, -1) | bit(-1, 0) | bit(0, 0);
      return ((reached[k] | reached[k + 1]) >> (i + pitch * j)) & corners;
    }
  };

  MTLED_HD std::size_t offset(int i, int j, int k) const {
    return std::size_t(i) + std::size_t(size[0]) * (std::size_t(j) + std::size_t(size[1]) * std::size_t(k));
  }
  MTLED_HD int flags_of(int i, int j, int k) const {
    return i >= 0 && j >= 0 && k >= 0 && i < size[0] && j < size[1] && k < size[2] ? flags[offset(i, j, k)] : 0;
  }

  /// cell_of(); false when no cell of x is complete.
  MTLED_HD bool complete_cell(const Vec3d& x, Cell& cell) const {
    Cell upper;
    bool on_plane[3];
    for (int a = 0; a < 3; ++a) {
      const double c = (x[a] - origin[a]) / spacing;
      if (!(c > -1 && c < size[a])) return false;
      upper.i[a] = int(std::floor(c + edge_tolerance));
      on_plane[a] = c - upper.i[a] < edge_tolerance;
    }
    bool found = false;
    for (int side = 0; side < 8; ++side) {
      Cell candidate = upper;
      bool possible = true;
      for (int a = 0; a < 3; ++a)
        if (side >> a & 1) possible = possible && on_plane[a], --candidate.i[a];
      if (!possible) continue;
      const int f = flags_of(candidate.i[0], candidate.i[1], candidate.i[2]);
      if (!(f & complete)) continue;
      if (!found || f & body) cell = candidate;
      found = true;
      if (f & body) break;
    }
    return found;
  }

  /// ShapeEvaluator's walk from face to face through cells with body that the ball touches.
  MTLED_HD void walk(const Vec3d& x, const int first[3], Walk& w) const {
    const int width = 2 * reach - 1;
    std::uint64_t open[Walk::most + 2];
    for (int k = 0; k < Walk::most + 2; ++k) open[k] = w.reached[k] = 0;
    for (int k = 0; k < width; ++k)
      for (int j = 0; j < width; ++j)
        for (int i = 0; i < width; ++i) {
          double squared = 0;  // distance of the cell [spacings]
          const int cell[3] = {first[0] + i, first[1] + j, first[2] + k};
          for (int a = 0; a < 3; ++a) {
            const double c = (x[a] - origin[a]) / spacing, below = cell[a] - c, above = c - cell[a] - 1;
            const double d = below > 0 ? below : above > 0 ? above : 0;
            squared += d * d;
          }
          if (flags_of(cell[0], cell[1], cell[2]) & body && squared * spacing * spacing < radius * radius) open[k + 1] |= Walk::bit(i, j);
        }
    w.width = 2 * reach - 1;
    w.reached[reach] = Walk::bit(reach - 1, reach - 1);
    open[reach] |= w.reached[reach];
    for (bool grows = true; grows;) {
      grows = false;
      for (int k = 1; k <= width; ++k) {
        std::uint64_t r = (w.reached[k - 1] | w.reached[k] | w.reached[k + 1]) & open[k];
        r = (r | r << 1 | r >> 1 | r << Walk::pitch | r >> Walk::pitch) & open[k];
        grows = grows || r != w.reached[k];
        w.reached[k] = r;
      }
    }
  }
};

/// A displacement for SolveForRestPosition.
template <int M>
struct LatticeDisplacement {
  LatticeFieldView lattice;
  MTLED_HD Coverage operator()(const Vec3d& X, Vec3d& u) const { return lattice.displacement<M>(X, u); }
};

/// The same with its memory.
struct LatticeField {
  LatticeFieldView view;  ///< without memory of its own
  std::vector<LatticeParameter> parameter;
  std::vector<std::uint8_t> flags;
  LatticeFieldView host_view() const {
    LatticeFieldView v = view;
    v.parameter = parameter.data(), v.flags = flags.data();
    return v;
  }
};
/// `parameter`: [num_nodes] of the solution [mm]. Input error unless the evaluator's cloud is a lattice.
LatticeField make_lattice_field(const ShapeEvaluator& evaluator, const std::vector<Vec3d>& parameter);

}  // namespace mtled
