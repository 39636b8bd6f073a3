#pragma once
#include <vector>

#include "core/mechanics.hpp"

namespace mtled {

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
/// taken `safety` times its estimate. Before it stops, what is missing is found by conjugate residuals and added: increments
/// alone hide a mode that is much slower than rho says. Where more is missing than the tolerance, the two-level preconditioner
/// is assembled again and the iteration goes on.
RelaxationResult relax(const DiscreteModel& model, Mechanics& mechanics, const SolverOptions& options, double safety, Vector& u);

/// Takes `u` from equilibrium at a smaller load (0: rest) to about equilibrium at `load`: one linearised (Newton) step, by
/// conjugate gradients with the two-level preconditioner down to `relative_residual`. From rest this is the
/// linear-elastic solution. Returns the number of products with the stiffness matrix and force evaluations.
int advance_load(const Mechanics& mechanics, double load, double relative_residual, Vector& u);

/// Largest eigenvalue of P K(u) by power iteration, with Rayleigh quotients in the energy norm of K: a lower bound that is
/// within a few percent after 20 iterations. `v` is the start vector and the eigenvector on return.
double largest_eigenvalue(const Mechanics& mechanics, const Vector& u, int iterations, Vector& v);

/// [num_slots] a rough vector that contains every mode of the active parameters; the same in every run.
std::vector<Vec3d> rough_vector(const std::vector<std::uint8_t>& active);

}  // namespace mtled
