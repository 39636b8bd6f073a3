#pragma once
#include <cstdint>
#include <vector>

#include "core/cloud.hpp"
#include "core/moving_least_squares.hpp"

namespace mtled {

/// A displacement field u(x) = sum_I phi_I(x) u_I over the nodes of a cloud: moving least squares, or finite elements.
class Approximation {
 public:
  /// Keeps a reference to `cloud`. `prescribed`: [num_nodes] nonzero where any component is prescribed; may be empty.
  Approximation(const Cloud& cloud, std::vector<std::uint8_t> prescribed) : cloud_(&cloud), prescribed_(std::move(prescribed)) {}
  virtual ~Approximation() = default;

  /// Values and gradients at x. False, and no shapes, where there are none (outside the body, or a stray place).
  /// Thread-safe. `enlargements`: how often the support had to be enlarged.
  virtual bool at(const Vec3d& x, ShapeFunctions& shapes, int* enlargements = nullptr) const = 0;
  /// Whether x lies in the body or so near to it that the field may be asked there.
  virtual bool touches(const Vec3d& x) const = 0;
  /// On a lattice: how many cells away from that of x a node may be that matters at x.
  virtual int reach() const = 0;
  /// Whether pressure is averaged at the nodes (core/nodal_pressure.hpp).
  virtual bool averages_pressure() const { return false; }

  const Cloud& cloud() const { return *cloud_; }
  bool prescribed(int node) const { return !prescribed_.empty() && prescribed_[std::size_t(node)]; }
  bool any_prescribed() const { return !prescribed_.empty(); }

 private:
  const Cloud* cloud_;
  std::vector<std::uint8_t> prescribed_;
};

/// Lattice position of the cell that holds x; on a face, edge or corner: one that has all its nodes and holds body, else one
/// that has all its nodes.
std::array<int, 3> cell_of(const Lattice& lattice, const Vec3d& x);

}  // namespace mtled
