#pragma once
#include <cstdint>
#include <memory>
#include <vector>

#include "core/approximation.hpp"

namespace mtled {

/// Moving least squares shape functions of a cloud at any place of the body.
///
/// On a lattice, cells that touch a node with a prescribed displacement are coupled with trilinear finite elements
/// (Krongauz & Belytschko 1996): with R = sum of the trilinear N_J over the prescribed corners,
///   phi~_I = R N_I + (1 - R) phi_I,
/// so that prescribed nodes are interpolated and u_I = prescribed value is exact on whole cells. On other clouds the
/// shape functions stay those of moving least squares (the solver then solves for the prescribed nodes' parameters).
///
/// On a lattice whose cells with body are known, a support does not reach across a gap: it holds the corners of the cells
/// that a walk from face to face through such cells reaches inside the ball (connectivity, cheap and without a surface;
/// gaps narrower than a cell cannot be told).
///
/// The support radius is dilatation * spacing on a lattice. In other clouds every node has a radius of its own and supports x
/// where |x - x_I| is smaller, as in Joldes' and Mountris' ExplicitSim: dilatation * spacing at that node (from the mean
/// distance of its 8 nearest), or the ball that holds `count` nodes. These radii do not depend on x, so gradients are exact
/// (up to the penalty of the modified basis, which is scaled by a mean radius). A support that is too small or badly
/// conditioned is enlarged by 12 % up to eight times.
class ShapeEvaluator : public Approximation {
 public:
  /// Keeps a reference to `cloud`. `prescribed`: [num_nodes] nonzero where any component is prescribed; may be empty.
  ShapeEvaluator(const Cloud& cloud, std::vector<std::uint8_t> prescribed, const MlsOptions& options);
  ~ShapeEvaluator() override;
  ShapeEvaluator(ShapeEvaluator&&) noexcept;

  /// False, and no shapes, where no support is good enough (outside the body, or a stray place). Thread-safe.
  /// `enlargements`: how often the support had to be enlarged.
  bool at(const Vec3d& x, ShapeFunctions& shapes, int* enlargements = nullptr) const override;
  /// Whether x lies in a cell whose eight corners are nodes (lattice), or within one local spacing of a node.
  bool covers(const Vec3d& x) const;
  /// Whether x lies in a cell with at least one node (lattice: also in cells that the body only grazes), or covers(x).
  bool touches(const Vec3d& x) const override;
  int reach() const override;

  const MlsOptions& options() const { return options_; }
  /// Whether lattice cell (i, j, k) is coupled: all eight corners are nodes and at least one is prescribed.
  bool coupled(const std::array<int, 3>& cell) const;

 private:
  struct Neighbours;
  int support(const Vec3d& x, ShapeFunctions& shapes) const;
  void couple(const Vec3d& x, ShapeFunctions& shapes) const;

  MlsOptions options_;
  std::unique_ptr<Neighbours> neighbours_;
};

}  // namespace mtled
