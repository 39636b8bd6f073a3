#pragma once
#include <functional>
#include <memory>
#include <vector>

#include "core/cloud.hpp"
#include "core/constraint_tables.hpp"
#include "core/nodal_field.hpp"
#include "core/approximation.hpp"
#include "core/stencils.hpp"

namespace mtled {

inline constexpr double interpolation_tolerance = 1e-9;  ///< |phi_I(x_J) - delta_IJ| of a node that is interpolated

/// Shape functions at the prescribed nodes, in the order of Constraints::node. Input error where there are none.
std::vector<ShapeFunctions> shapes_at_prescribed_nodes(const Approximation& field, const Constraints& constraints);

/// Imposes prescribed displacements exactly on the field, u(x_B) = value, whether or not the shape functions interpolate.
/// With the shape functions at the prescribed nodes, Phi_BB u_B + Phi_BF u_F = value: the parameters u_B follow from the
/// free ones (Phi_BB is the identity on a coupled lattice, sparse and factorised otherwise), and internal forces are
/// reduced to the free parameters, f_F - Phi_BF^T Phi_BB^-T f_B. This is the collocation form of the correction of
/// essential boundary conditions by Joldes, Chowdhury, Wittek and Miller 2017, solved for the parameters.
class ConstraintOperator {
 public:
  /// Input error when the prescribed nodes' shape functions cannot be inverted, or not without magnifying rounding too much.
  ConstraintOperator(const Approximation& field, const SlotLayout& layout, const Constraints& constraints);
  ~ConstraintOperator();

  /// Sets the prescribed parameters for `load` (0..1) times the prescribed displacement.
  template <class Real>
  void impose(NodalField<Real>& u, double load) const;
  /// Reduces a force to the free parameters; prescribed entries become zero.
  template <class Real>
  void reduce(NodalField<Real>& f) const;
  /// Force of each constraint on the body [mN], in the order of Constraints::node, from the unreduced internal force [num_slots].
  std::vector<Vec3d> reactions(const std::vector<Vec3d>& internal) const;
  /// Whether every prescribed node is interpolated by the shape functions (a coupled lattice).
  bool direct() const;
  /// Entries of all matrices ConstraintTable::inverse.
  double inverse_entries() const;
  /// Calls body(slot, component) for the prescribed parameters, and, when `neighbours`, for those they depend on.
  void each_dependent(bool neighbours, const std::function<void(int slot, int component)>& body) const;
  /// One displacement component as plain data, with the dense inverse of Phi_BB where it is needed.
  ConstraintTable table(int component) const;

 private:
  struct Component;
  std::vector<std::unique_ptr<Component>> component_;
  const Constraints* constraints_;
};

}  // namespace mtled
