#pragma once
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "core/cloud.hpp"
#include "core/approximation.hpp"
#include "core/loads.hpp"
#include "core/springs.hpp"

namespace mtled {

/// How equilibrium is approached.
enum class Relaxation {
  plain,      ///< dynamic relaxation with lumped mass from rest, load applied smoothly (the published scheme)
  two_level,  ///< dynamic relaxation with a two-level preconditioner from the linear-elastic solution
};

/// Where the solver is.
struct Progress {
  const char* stage = "";        ///< "start", "relaxation"
  int step = 0;
  double error_estimate_mm = 0;  ///< NaN while there is none
  double seconds = 0;            ///< since the start of the solver
  double seconds_left = 0;       ///< estimated from the convergence rate; NaN while unknown
};

struct SolverOptions {
  Relaxation relaxation = Relaxation::two_level;
  double tolerance_mm = 0.05;        ///< of the estimated error; 0.05 keeps the true error below 0.1
  int consecutive_steps = 20;        ///< for which the estimate must stay below the tolerance
  int max_steps = 20000;
  int load_steps = 0;                ///< plain: steps of the load ramp; 0 = chosen from the distance to prescribed nodes
  int coarse_unknowns = 2400;        ///< two_level
  double largest_eigenvalue = 0;     ///< of P K, sets the step; 0 = estimated with a margin
  bool double_precision = false;     ///< of the state and the forces
  double stabilisation = 0;          ///< strength, where integration points are too few (stabilisation.hpp); 0 = none
  std::function<void(const Progress&)> progress;
};

/// One line of the history.
struct HistoryEntry {
  int step;
  double error_estimate_mm, largest_increment_mm, convergence_rate;
  double strain_energy;              ///< [mN mm]; springs not included
};

struct Solution {
  std::vector<Vec3d> parameter;       ///< [num_nodes] nodal parameters [mm]: coefficients of the shape functions
  std::vector<Vec3d> displacement;    ///< [num_nodes] field at the nodes [mm]
  bool converged = false;
  int steps = 0;                      ///< relaxation steps
  int force_evaluations = 0;          ///< all internal-force and tangent products, setup and start included
  int load_increments = 1;            ///< of the two-level start
  double error_estimate_mm = 0;
  double strain_energy = 0;           ///< [mN mm]
  std::map<std::string, Vec3d> reactions;  ///< per set: force of the constraint on the body [mN]
  double smallest_volume_ratio = 0;   ///< min det F over the integration points
  std::size_t inverted_points = 0;
  std::size_t points = 0, stencils = 0, enlarged_supports = 0, dropped_points = 0, coarse_unknowns = 0;
  double bytes = 0;                   ///< of the solver's tables and state
  std::vector<double> points_per_node;    ///< [num_nodes] integration points per node around there; 0: seen by none; of use without elements only
  std::map<std::string, double> seconds;  ///< per stage
  std::vector<HistoryEntry> history;
};

class Mechanics;
struct DiscreteModel;
/// Makes the mechanics of a model on some device (core/mechanics.hpp); empty: make_cpu_mechanics. The model outlives the mechanics.
using MakeMechanics = std::function<std::unique_ptr<Mechanics>(const DiscreteModel& model, const SolverOptions& options)>;
std::unique_ptr<Mechanics> make_cpu_mechanics(const DiscreteModel& model, const SolverOptions& options);

/// Static equilibrium of the body under prescribed displacements, springs and loads; of a viscoelastic body with its
/// long-term moduli.
/// Input errors: no constraints, too few to hold the body, or no free node; numerical errors: divergence, inverted points
/// at the end (with position and remedy). Without convergence within max_steps the result says so and holds the state
/// reached.
Solution solve(const Approximation& field, IntegrationPoints points, const Constraints& constraints, const SolverOptions& options,
               const Springs& springs = {}, const Loads& loads = {}, const MakeMechanics& make_mechanics = {});

/// u(x) of a solution [mm]; false where the cloud has no usable support.
bool displacement_at(const Approximation& field, const std::vector<Vec3d>& parameter, const Vec3d& x, Vec3d& u);

}  // namespace mtled
