#pragma once
#include <deque>
#include <functional>
#include <memory>
#include <vector>

#include "core/coarse_space.hpp"
#include "core/constraint_operator.hpp"
#include "core/cpu_forces.hpp"
#include "core/nodal_pressure.hpp"
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
  std::unique_ptr<NodalPressure<Real>> nodal_pressure;  ///< null: each point has a pressure of its own
  NodalField<Real> external;          ///< dead loads [mN]; no slots: none
  std::unique_ptr<ConstraintOperator<Real>> constraints;
  std::unique_ptr<CoarseSpace<Real>> coarse;  ///< null: diagonal preconditioner only
  NodalField<Real> coarse_active;
  double largest_increment = 0;       ///< of a step, beyond which the iteration has diverged [mm]
  std::function<double(const NodalField<Real>&)> strain_energy;  ///< [mN mm], in double
  std::function<double(const NodalField<Real>&)> largest_displacement;  ///< component of the field at the watched nodes [mm]
  double largest_distance = 0;        ///< of a node to the nearest place that is held, in node spacings

  /// f = internal force [mN] at displacement u [mm], the springs' at `load` of their targets included, less `load` times
  /// the external force.
  VolumeRatioStatistics force(const NodalField<Real>& u, double load, NodalField<Real>& f) const {
    const VolumeRatioStatistics ratio = forces->force(u, f);
    if (springs) springs->add_force(u, load, f);
    if (nodal_pressure) nodal_pressure->add_force(u, f);
    if (external.slots() > 0)
      parallel_pieces(f.slots(), 16384, [&](std::size_t begin, std::size_t end) {
        for (int c = 0; c < 3; ++c)
          for (std::size_t s = begin; s < end; ++s) f.at(s, c) -= Real(load) * external.at(s, c);
      });
    return ratio;
  }
  /// f = K(u) v [mN]
  void tangent(const NodalField<Real>& u, const NodalField<Real>& v, NodalField<Real>& f) const {
    forces->tangent(u, v, f);
    if (springs) springs->add_tangent(v, f);
    if (nodal_pressure) nodal_pressure->add_tangent(u, v, f);
  }
};

/// What every analysis needs of the model: layout, supports, positions and forces. Points without a usable support give
/// their volume to others in `points`, which the model refers to.
template <class Real>
SlotModel<Real> build_base_model(const Approximation& field, IntegrationPoints& points);

/// Strain energy [mN mm] and volume ratios at displacement u, into `solution`; where the smallest ratio is.
template <class Real>
void measure_state(const SlotModel<Real>& model, const NodalField<Real>& u, Solution& solution, Vec3d& worst_place);

/// Sum of products, in double; the same bits for any number of threads.
template <class Real>
double dot(const NodalField<Real>& a, const NodalField<Real>& b);

/// Largest eigenvalue of P K by power iteration, with Rayleigh quotients in the energy norm of K. `stiffness`: f = K v,
/// after making v admissible; `inverse`: g = P f, P symmetric. The result is a lower bound that is within a few percent
/// after 20 iterations. `v` is the start vector and the eigenvector on return.
template <class Real>
double power_iteration(const std::function<void(NodalField<Real>& v, NodalField<Real>& f)>& stiffness,
                       const std::function<void(const NodalField<Real>& f, NodalField<Real>& g)>& inverse, int iterations, NodalField<Real>& v);
/// A rough vector that contains every mode of the active parameters; the same in every run.
template <class Real>
NodalField<Real> rough_vector(const SlotModel<Real>& model);

struct RelaxationResult {
  bool converged = false;
  bool diverged = false;              ///< a step too large, or points inside out for too long
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
