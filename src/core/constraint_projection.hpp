#pragma once
#include <memory>
#include <vector>

#include "core/approximation.hpp"
#include "core/nodal_field.hpp"
#include "core/stencils.hpp"

namespace mtled {

/// Imposes prescribed displacements in time: u <- u + M^-1 Phi^T (Phi M^-1 Phi^T)^-1 (value - Phi u), the M-orthogonal
/// projection on the constraint (Joldes, Chowdhury, Wittek, Miller 2017; Phi: shape functions at the prescribed nodes).
/// The correction is the impulse of the forces at these nodes, so momentum and energy are those of the body. On a
/// coupled lattice Phi is the identity, and the projection assigns.
class ConstraintProjection {
 public:
  /// `inverse_mass`: [num_slots] [1/kg], 0 where there is no mass. Keeps a reference to `constraints`.
  /// Input error when the prescribed nodes' shape functions are not independent or have no mass.
  ConstraintProjection(const Approximation& field, const SlotLayout& layout, const Constraints& constraints, const std::vector<double>& inverse_mass);
  ~ConstraintProjection();

  /// Takes u + d to the prescribed `value` [n] [mm] by changing d. Returns the multipliers [n] [kg mm]: d has changed by
  /// M^-1 Phi^T times them.
  std::vector<Vec3d> project(const NodalField<double>& u, const std::vector<Vec3d>& value, NodalField<double>& d) const;

 private:
  struct Component;
  std::vector<std::unique_ptr<Component>> component_;
  const std::vector<double>* inverse_mass_;
  std::size_t rows_;
};

}  // namespace mtled
