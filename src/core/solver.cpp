#include "core/solver.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>

#include "core/discrete_model.hpp"
#include "core/error.hpp"
#include "core/nodal_pressure.hpp"
#include "core/relaxation.hpp"

namespace mtled {
namespace {

class Stopwatch {
 public:
  explicit Stopwatch(std::map<std::string, double>& seconds) : seconds_(seconds) {}
  /// Books the time since the last call under `stage`.
  void lap(const std::string& stage) {
    const auto now = std::chrono::steady_clock::now();
    seconds_[stage] += std::chrono::duration<double>(now - last_).count();
    last_ = now;
  }

 private:
  std::map<std::string, double>& seconds_;
  std::chrono::steady_clock::time_point last_ = std::chrono::steady_clock::now();
};

/// Where the body is compressed most, for messages.
std::string at_worst_place(const StateOfPoints& state) {
  const Vec3d& x = state.worst_place;
  return concatenate("(smallest volume ratio ", state.smallest_volume_ratio, " at (", x.x, ", ", x.y, ", ", x.z, ") mm)");
}

/// Linear-elastic start in `fewest_increments` load increments, and more, each linearised about the last, when one leaves points (nearly)
/// inside out. The coarse matrix is left assembled at the start. Returns the products with the stiffness matrix.
int start_two_level(const DiscreteModel& model, Mechanics& mechanics, const SolverOptions& options, int fewest_increments, Solution& solution, Vector& u) {
  constexpr double start_residual = 2e-3;   // relative; the relaxation does the rest
  constexpr double smallest_ratio = 0.1;    // volume ratio of a usable start
  constexpr int most_increments = 16;
  const VectorPointer f = mechanics.vector();
  int products = 0;
  for (int increments = fewest_increments;; increments *= 2) {
    mechanics.clear(u);
    VolumeRatioStatistics ratio;
    for (int i = 1; i <= increments; ++i) {
      if (options.progress) options.progress({"start", i, std::nan(""), 0, std::nan("")});
      mechanics.assemble_coarse(u);
      products += advance_load(mechanics, double(i) / increments, start_residual, u);
      ratio = mechanics.force(u, double(i) / increments, *f);
      ++products;
      if (ratio.smallest < smallest_ratio) break;
    }
    if (ratio.smallest >= smallest_ratio || increments >= most_increments) {
      solution.load_increments = increments;
      if (ratio.inverted > 0)
        fail(Failure::numerical, "the prescribed motions turn ", ratio.inverted, " integration points inside out even when applied in ", increments,
             " increments ", at_worst_place(measure_points(model, mechanics.download(u))), ": they ask for more than the tissue between the rigid bodies can follow; check the motions there (do two bodies run into each other?), or use a smaller node spacing");
      mechanics.assemble_coarse(u);
      return products;
    }
  }
}

/// Energies and reactions that the points do not give, at the end.
void add_springs_and_reactions(const DiscreteModel& model, const Constraints& constraints, const std::vector<Vec3d>& u, const std::vector<Vec3d>& force, Solution& solution) {
  NodalField<double> values(u.size());
  for (std::size_t s = 0; s < u.size(); ++s)
    for (int c = 0; c < 3; ++c) values.at(s, c) = u[s][c];
  if (model.field->averages_pressure()) solution.strain_energy += NodalPressure<double>(model.supports, *model.points).energy(values);
  if (model.springs.size() > 0) {
    const SpringForces<double> springs(model.springs, model.layout);
    solution.strain_energy += springs.energy(values, 1);
    solution.reactions = springs.reactions(values, 1);
  }
  const std::vector<Vec3d> reaction = model.constraints->reactions(force);
  for (const std::string& name : constraints.set_names) solution.reactions.try_emplace(name);
  for (std::size_t b = 0; b < reaction.size(); ++b) solution.reactions[constraints.set_names[std::size_t(constraints.set[b])]] += reaction[b];
}

}  // namespace

Solution solve(const Approximation& field, IntegrationPoints points, const Constraints& constraints, const SolverOptions& options, const Springs& springs, const Loads& loads,
               const MakeMechanics& make_mechanics) {
  const bool held_by_springs = std::any_of(springs.set.begin(), springs.set.end(), [](int s) { return s >= 0; });
  require(!constraints.node.empty() || held_by_springs, "there are no prescribed displacements: nothing moves the body; give at least one rigid body or constraint");
  points = long_term(std::move(points));
  Solution solution;
  Stopwatch watch(solution.seconds);
  const DiscreteModel model = make_static_model(field, points, constraints, springs, loads, options, solution.points_per_node);
  solution.points = points.size(), solution.stencils = std::size_t(model.supports.num_stencils());
  solution.enlarged_supports = model.supports.enlarged, solution.dropped_points = model.supports.dropped.size();
  watch.lap("shape functions");
  const std::unique_ptr<Mechanics> mechanics = make_mechanics ? make_mechanics(model, options) : make_cpu_mechanics(model, options);
  solution.coarse_unknowns = std::size_t(mechanics->coarse_unknowns());
  solution.bytes = mechanics->bytes();
  watch.lap("model");

  // Where the start is too far from equilibrium the relaxation diverges or turns points inside out; then again with a finer start and shorter steps.
  const VectorPointer u = mechanics->vector();
  std::vector<Vec3d> values;
  RelaxationResult relaxed;
  StateOfPoints state;
  double safety = 1;
  for (int increments : {1, 4, 16}) {
    mechanics->clear(*u);
    if (options.relaxation == Relaxation::two_level) {
      solution.force_evaluations += start_two_level(model, *mechanics, options, increments, solution, *u);
      watch.lap("start");
    }
    relaxed = relax(model, *mechanics, options, safety, *u);
    solution.force_evaluations += relaxed.force_evaluations;
    values = mechanics->download(*u);
    state = measure_points(model, values);
    if (!relaxed.diverged && !(relaxed.converged && state.inverted > 0)) break;
    safety *= 2;
  }
  if (relaxed.diverged)
    fail(Failure::numerical, "the solution diverged at step ", relaxed.steps, ", also with shorter steps and a finer start, and ", state.inverted, " integration points are inside out ", at_worst_place(state),
         ": the prescribed motions deform the body too strongly between some nodes; check the motions there, or use a smaller node spacing");
  watch.lap("relaxation");
  solution.converged = relaxed.converged;
  solution.steps = relaxed.steps;
  solution.error_estimate_mm = relaxed.error_estimate;
  solution.history = relaxed.history;
  solution.strain_energy = state.strain_energy;
  solution.smallest_volume_ratio = state.smallest_volume_ratio, solution.inverted_points = state.inverted;
  const VectorPointer f = mechanics->vector();
  mechanics->force(*u, 1, *f);
  add_springs_and_reactions(model, constraints, values, mechanics->download(*f), solution);

  const Cloud& cloud = field.cloud();
  solution.parameter.resize(cloud.size());
  for (std::size_t n = 0; n < cloud.size(); ++n) solution.parameter[n] = values[std::size_t(model.layout.slot_of_node[n])];
  solution.displacement.resize(cloud.size());
  parallel_for(cloud.size(), [&](std::size_t n) {
    if (!displacement_at(field, solution.parameter, cloud.nodes[n], solution.displacement[n])) solution.displacement[n] = solution.parameter[n];
  }, 256);
  watch.lap("field at nodes");
  if (solution.inverted_points > 0)
    fail(Failure::numerical, solution.inverted_points, " integration points are turned inside out at the end ", at_worst_place(state), ": the prescribed motions ask for more than the tissue between them can follow; check the motions there, or use a smaller node spacing");
  return solution;
}

bool displacement_at(const Approximation& field, const std::vector<Vec3d>& parameter, const Vec3d& x, Vec3d& u) {
  thread_local ShapeFunctions shapes;
  if (!field.at(x, shapes)) return false;
  u = {};
  for (std::size_t i = 0; i < shapes.node.size(); ++i) u += shapes.value[i] * parameter[std::size_t(shapes.node[i])];
  return true;
}

}  // namespace mtled
