#pragma once
#include <functional>
#include <map>
#include <string>
#include <vector>

#include "core/approximation.hpp"
#include "core/cloud.hpp"
#include "core/loads.hpp"
#include "core/solver.hpp"
#include "core/springs.hpp"

namespace mtled {

/// Energies and reactions at one time. Without error, kinetic + strain + springs + dissipated = work_of_loads +
/// work_of_motions; of a viscoelastic body the strain energy is that of the long-term moduli, and what memory holds and
/// dissipates is missing from the balance.
struct DynamicsEntry {
  int step = 0;
  double time = 0;                   ///< [s]
  double kinetic = 0, strain = 0, springs = 0;     ///< [mN mm]
  double dissipated = 0;             ///< by damping so far [mN mm]
  double work_of_loads = 0, work_of_motions = 0;   ///< so far; motions: of the constraints and of the springs' targets
  double smallest_volume_ratio = 0;  ///< min det F over the integration points
  std::map<std::string, Vec3d> reactions;          ///< per set: force of constraint or springs on the body [mN]
  double balance_error() const { return kinetic + strain + springs + dissipated - work_of_loads - work_of_motions; }
};

/// What an observer sees; parameters are those of the shape functions.
struct DynamicsFrame {
  DynamicsEntry entry;
  std::vector<Vec3d> parameter;           ///< [num_nodes] [mm]
  std::vector<Vec3d> velocity_parameter;  ///< [num_nodes] [mm/s]
};

struct DynamicsOptions {
  double duration = 0;               ///< > 0 [s]
  double time_step = 0;              ///< [s]; 0: `safety` times the stable one. Shortened so that outputs fall on steps
  double safety = 0.8;               ///< of the stable step at rest; large deformation makes the stable one up to 20 % shorter (docs/solve.md)
  double damping = 0;                ///< proportional to mass, >= 0 [1/s]: free motion decays as exp(-damping t)
  double output_every = 0;           ///< [s]; 0: only start and end. Changed so that a whole number fills the duration
  std::map<std::string, History> histories;  ///< per set of constraints, springs and loads. Without one, displacements
                                             ///< grow smoothly over the whole duration, and loads are constant from the start
  std::function<void(const Progress&)> progress;
  std::function<void(const DynamicsFrame&)> observe;  ///< start, every `output_every`, and end
};

struct DynamicsResult {
  int steps = 0;
  double time_step = 0;              ///< [s]
  double stable_time_step = 0;       ///< of the body at rest [s]
  double mass = 0;                   ///< [kg]
  double smallest_nodal_mass = 0;    ///< [kg]
  std::size_t massless_nodes = 0;    ///< nodes that support no integration point; they rest unless prescribed
  double largest_balance_error = 0;  ///< of the outputs, over the largest sum of energies or work among them [1]; NaN: viscoelastic
  std::size_t points = 0, stencils = 0, enlarged_supports = 0, dropped_points = 0;
  std::map<std::string, double> seconds;
  std::vector<DynamicsEntry> history;  ///< one per output
};

/// Motion of the body from rest by explicit central differences, with the physical mass lumped to the nodes
/// (lumped_mass), damping proportional to mass, and prescribed motion by projection (ConstraintProjection). In double
/// precision. The body need not be held. Input errors: a time step beyond the stable one, a history of no set, a motion
/// that begins with a jump, nodes of negative mass; numerical error: the motion grows without bound (with step and time).
DynamicsResult run_dynamics(const Approximation& field, IntegrationPoints points, const Constraints& constraints, const Springs& springs, const Loads& loads,
                            const DynamicsOptions& options);

}  // namespace mtled
