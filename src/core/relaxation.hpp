#pragma once
#include <deque>
#include <functional>
#include <memory>
#include <vector>

#include "core/coarse_space.hpp"
#include "core/constraint_operator.hpp"
#include "core/cpu_forces.hpp"
#include "core/springs.hpp"
#include "core/solver.hpp"

namespace mtled {

/// The discrete problem in slots: everything that relaxation needs.
template <class Real>
struct SlotModel {
  SlotLayout layout;
  std::vector<Vec3d> position;        ///< [num_slots] rest positions [mm]
  NodalField<Real> active;            ///< 1 where a parameter is free, 0 where it is prescribed or no node
  NodalField<Real> inverse_diagonal;  ///< [mm/mN] of the preconditioner; 0 where not active
  std::vector<std::uint8_t> watched;  ///< [num_slots] nodes whose increments make the error estimate (inside the body)
  SupportTable supports;
  const IntegrationPoints* points = nullptr;
  std::unique_ptr<CpuForces<Real>> forces;
  std::unique_ptr<SpringForces<Real>> springs;  ///< null: none
  std::unique_ptr<ConstraintOperator<Real>> constraints;
  std::unique_ptr<CoarseSpace<Real>> coarse;  ///< null: diagonal preconditioner only
  NodalField<Real> coarse_active;
  double largest_increment = 0;       ///< of a step, beyond which the iteration has diverged [mm]
  std::function<double(const NodalField<Real>&)> strain_energy;  ///< [mN mm], in double
  double largest_distance = 0;        ///< of a node to the nearest prescribed one, in node spacings

  /// f = internal force [mN] at displacement u [mm], the springs' at `load` of their targets included.
  VolumeRatioStatistics force(const NodalField<Real>& u, double load, NodalField<Real>& f) const {
    const VolumeRatioStatistics ratio = forces->force(u, f);
    if (springs) springs->add_force(u, load, f);
    return ratio;
  }
  /// f = K(u) v [mN]
  void tangent(const NodalField<Real>& u, const NodalField<Real>& v, NodalField<Real>& f) const {
    forces->tangent(u, v, f);
    if (springs) springs->add_tangent(v, f);
  }
};

struct RelaxationResult {
  bool converged = false;
  bool diverged = false;
  int steps = 0, force_evaluations = 0;
  double error_estimate = 0;
  double largest_eigenvalue = 0;  ///< of P K that the last steps were made for
  std::vector<HistoryEntry> history;
};

/// Heavy-ball iteration u+ = u + rho^2 (u - u-) - (1 + rho)^2 / lambda_max P f(u), i.e. central differences with
/// mass-proportional damping (Joldes, Wittek, Miller 2011), with P the inverse of a fictitious mass or the two-level
/// preconditioner. rho follows from the smallest eigenvalue, estimated by Rayleigh quotients of increments; lambda_max is
/// taken `safety` times its estimate. Before it stops, what is missing is found by conjugate gradients and added: increments
/// alone hide a mode that is much slower than rho says. Where more is missing than the tolerance, the two-level preconditioner
/// is assembled again and the iteration goes on.
template <class Real>
RelaxationResult relax(const SlotModel<Real>& model, const SolverOptions& options, double safety, NodalField<Real>& u);

/// Takes `u` from equilibrium at a smaller load (0: rest) to about equilibrium at `load`: one linearised (Newton) step, by
/// conjugate gradients with the two-level preconditioner down to `relative_residual`. From rest this is the
/// linear-elastic solution. Returns the number of products with the stiffness matrix and force evaluations.
template <class Real>
int advance_load(const SlotModel<Real>& model, double load, double relative_residual, NodalField<Real>& u);

}  // namespace mtled
