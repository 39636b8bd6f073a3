#pragma once
#include <array>
#include <cstdint>
#include <memory>
#include <vector>

#include "core/cloud.hpp"
#include "core/nodal_field.hpp"
#include "core/springs.hpp"
#include "core/stencils.hpp"

namespace mtled {

/// Coarse correction of the two-level preconditioner: smooth displacements of the whole body, which relaxation alone
/// removes slowly. The coarse functions Z are tensor products of quadratic B-splines of `spacing` (tens of mm), one set
/// per displacement component, restricted to the free nodes; the correction is Z A^-1 Z^T f with A = Z^T K(u) Z.
class CoarseSpace {
 public:
  /// A node with a free parameter.
  struct Node {
    int slot, first;     ///< first: the lowest of the 27 functions that it feels; (i, j, k) above it is first + i + stride_y j + stride_z k
    float weight[9];     ///< of the functions i = 0, 1, 2 along x, then y, then z
    float active[3];     ///< 1 where the component is free to follow the coarse functions, else 0
  };

  /// `position`: [num_slots] rest positions [mm]; `active`: [3 * num_slots] by component, 1 where a parameter is free to follow
  /// the coarse functions, 0 where it is prescribed or there is no node. Keeps references to both. The spacing is chosen so that
  /// about `unknowns` functions result, but is at least `smallest_spacing` [mm]. Where nothing is active there are no functions
  /// and no correction.
  CoarseSpace(const std::vector<Vec3d>& position, const std::vector<std::uint8_t>& active, int unknowns, double smallest_spacing);
  ~CoarseSpace();

  /// Makes the stiffness of the springs that belong to a set part of every A assembled from now on. The others stabilise
  /// modes that no smooth function contains, and are left out.
  void add_springs(const Springs& springs, const SlotLayout& layout);
  /// Assembles and inverts A at displacement u [num_slots] [mm]. The integration points' gradients of Z are those of the moving
  /// least squares interpolation of Z, to first order.
  void assemble(const SupportTable& supports, const IntegrationPoints& points, const std::vector<Vec3d>& u);
  /// g += Z A^-1 Z^T f
  template <class Real>
  void add_correction(const NodalField<Real>& f, NodalField<Real>& g) const;
  int unknowns() const;
  std::size_t bytes() const;

  // For backends that apply the correction themselves.
  const std::vector<Node>& nodes() const;
  std::array<int, 3> functions() const;          ///< per axis
  const std::vector<int>& used_functions() const;  ///< [unknowns / 3] numbers of those that touch a node; unknown 3 v + c is component c of used_functions()[v]
  const float* inverse() const;                  ///< [unknowns * unknowns] A^-1, symmetric; after assemble()

 private:
  struct Grid;
  std::unique_ptr<Grid> grid_;
};

}  // namespace mtled
