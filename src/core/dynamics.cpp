#include "core/dynamics.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <set>

#include "core/constraint_projection.hpp"
#include "core/error.hpp"
#include "core/cpu_forces.hpp"
#include "core/discrete_model.hpp"
#include "core/nodal_pressure.hpp"
#include "core/relaxation.hpp"

namespace mtled {
namespace {

using Field = NodalField<double>;

/// body(component, slot) for all; multi-threaded.
template <class Body>
void each_parameter(std::size_t slots, Body&& body) {
  parallel_pieces(slots, 16384, [&](std::size_t begin, std::size_t end) {
    for (int c = 0; c < 3; ++c)
      for (std::size_t s = begin; s < end; ++s) body(c, s);
  });
}

/// Springs of one set, whose targets have one history.
struct SpringSet {
  SpringForces<double> forces;
  const History* history;  ///< null: internal springs, which have no target
  double load(double t) const { return history ? history->at(t) : 0; }
  /// Derivative of the energy with respect to the load [mN mm]: the energy is quadratic.
  double energy_per_load(const Field& u, double l) const { return (forces.energy(u, l + 1) - forces.energy(u, l - 1)) / 2; }
};

/// The histories of all sets by name, defaults included.
std::map<std::string, History> complete_histories(const Constraints& constraints, const Springs& springs, const Loads& loads, const DynamicsOptions& options) {
  std::set<std::string> motions(constraints.set_names.begin(), constraints.set_names.end()), forces(loads.set_names.begin(), loads.set_names.end());
  motions.insert(springs.set_names.begin(), springs.set_names.end());
  if (loads.gravity != Vec3d{}) forces.insert("gravity");
  std::map<std::string, History> histories = options.histories;
  for (const auto& [name, history] : histories)
    require(motions.count(name) || forces.count(name), "there is a history of '", name, "', but no set of constraints or loads has that name; correct the name or remove the history");
  for (const std::string& name : motions) {
    require(!forces.count(name), "'", name, "' names a set of constraints and one of loads; rename one, so that each has its own history");
    histories.try_emplace(name, History{{0, options.duration}, {0, 1}, true});
  }
  for (const std::string& name : forces) histories.try_emplace(name, History{{0}, {1}, false});
  const auto starts_at_rest = [&](const std::string& name, const Vec3d& displacement) {
    const double first = histories.at(name).at(0);
    require(first == 0 || displacement == Vec3d{}, "the motion of '", name, "' begins with a jump: its factor at time 0 is ", first, "; begin with 0");
  };
  for (std::size_t b = 0; b < constraints.node.size(); ++b) starts_at_rest(constraints.set_names[std::size_t(constraints.set[b])], constraints.displacement[b]);
  for (std::size_t r = 0; r < springs.size(); ++r)
    if (springs.set[r] >= 0) starts_at_rest(springs.set_names[std::size_t(springs.set[r])], springs.target[r]);
  return histories;
}

std::vector<SpringSet> split_springs(const Springs& springs, const SlotLayout& layout, const std::map<std::string, History>& histories) {
  std::vector<SpringSet> sets;
  for (int set = -1; set < int(springs.set_names.size()); ++set) {
    Springs part;
    part.set_names = springs.set_names;
    for (std::size_t r = 0; r < springs.size(); ++r) {
      if (springs.set[r] != set) continue;
      const auto begin = std::ptrdiff_t(springs.begin[r]), end = std::ptrdiff_t(springs.begin[r + 1]);
      part.add({springs.node.begin() + begin, springs.node.begin() + end}, {springs.coefficient.begin() + begin, springs.coefficient.begin() + end}, springs.stiffness[r], springs.target[r], set);
    }
    if (part.size() > 0) sets.push_back({SpringForces<double>(part, layout), set < 0 ? nullptr : &histories.at(springs.set_names[std::size_t(set)])});
  }
  return sets;
}

/// Largest eigenvalue of P K by power iteration, see largest_eigenvalue() in relaxation.cpp. `stiffness`: f = K v; `inverse`:
/// g = P f, P symmetric. `v`: the start vector, and the eigenvector on return.
template <class Stiffness, class Inverse>
double power_iteration(const Stiffness& stiffness, const Inverse& inverse, int iterations, Field& v) {
  Field f(v.slots()), g(v.slots());
  double lambda = 0;
  for (int i = 0; i < iterations; ++i) {
    stiffness(v, f);
    inverse(f, g);
    const double vf = dot(v, f), gf = dot(g, f), gg = dot(g, g);
    if (!(gg > 0) || !std::isfinite(gg)) fail(Failure::numerical, "the stiffness of the body could not be estimated: it is zero or not finite");
    if (vf > 0) lambda = gf / vf;
    each_parameter(v.slots(), [&](int c, std::size_t s) { v.at(s, c) = g.at(s, c) / std::sqrt(gg); });
  }
  return lambda;
}

/// Largest stable step at rest, 2 / omega_max: power iteration on M^-1 K until it gains less than 1e-4 in 20 iterations.
/// `forces`: those of the moduli at once, the stiffest that a viscoelastic body has.
double stable_step(const CpuForces<double>& forces, const NodalPressure<double>* nodal_pressure, const std::vector<SpringSet>& springs, const ConstraintProjection& projection, std::size_t prescribed,
                   const std::vector<double>& inverse_mass) {
  const Field rest(inverse_mass.size());
  const std::vector<Vec3d> held(prescribed);
  const auto stiffness = [&](Field& v, Field& f) {
    forces.tangent(rest, v, f);
    if (nodal_pressure) nodal_pressure->add_tangent(rest, v, f);
    for (const SpringSet& s : springs) s.forces.add_tangent(v, f);
  };
  const auto inverse = [&](const Field& f, Field& g) {
    each_parameter(g.slots(), [&](int c, std::size_t s) { g.at(s, c) = inverse_mass[s] * f.at(s, c); });
    projection.project(rest, held, g);
  };
  std::vector<std::uint8_t> active;
  for (int c = 0; c < 3; ++c)
    for (double m : inverse_mass) active.push_back(m > 0);
  Field v(inverse_mass.size());
  const std::vector<Vec3d> rough = rough_vector(active);
  each_parameter(rough.size(), [&](int c, std::size_t s) { v.at(s, c) = rough[s][c]; });
  projection.project(rest, held, v);
  constexpr int most_iterations = 600;
  double lambda = 0;
  for (int i = 0; i < most_iterations; i += 20) {
    const double next = power_iteration(stiffness, inverse, 20, v);
    const bool settled = next - lambda < 1e-4 * next;
    lambda = next;
    if (settled) break;
  }
  return 2 / std::sqrt(lambda);
}

}  // namespace

DynamicsResult run_dynamics(const Approximation& field, IntegrationPoints points, const Constraints& constraints, const Springs& springs, const Loads& loads,
                            const DynamicsOptions& options) {
  const auto started = std::chrono::steady_clock::now();
  const auto seconds = [&] { return std::chrono::duration<double>(std::chrono::steady_clock::now() - started).count(); };
  require(options.duration > 0, "the duration of the motion is ", options.duration, " s; it must be positive");
  require(options.damping >= 0, "the damping is ", options.damping, " per second; it must not be negative");
  const std::map<std::string, History> histories = complete_histories(constraints, springs, loads, options);
  DynamicsResult result;

  DiscreteModel model = make_discrete_model(field, points);
  CpuForces<double> forces(model.supports, model.layout, points);
  const std::unique_ptr<NodalPressure<double>> nodal_pressure = field.averages_pressure() ? std::make_unique<NodalPressure<double>>(model.supports, points) : nullptr;
  const std::size_t slots = model.slots(), nodes = field.cloud().size(), prescribed = constraints.node.size();
  const std::vector<int>& slot_of = model.layout.slot_of_node;
  result.points = points.size(), result.stencils = std::size_t(model.supports.num_stencils());
  result.enlarged_supports = model.supports.enlarged, result.dropped_points = model.supports.dropped.size();

  const IntegrationPoints faded = long_term(points);
  model.points = &faded;  // whose energy is the strain energy
  const std::vector<double> nodal_mass = lumped_mass(field, points);
  std::vector<double> mass(slots, 0.0), inverse_mass(slots, 0.0);
  result.smallest_nodal_mass = 1e300;
  for (std::size_t n = 0; n < nodes; ++n) {
    const double m = nodal_mass[n];
    const Vec3d& x = field.cloud().nodes[n];
    require(m >= 0, "node ", n, " at (", x.x, ", ", x.y, ", ", x.z, ") mm has a negative mass (", m,
            " kg): it lies too far outside the integration points; remove it, or put points around it");
    result.mass += m;
    if (m == 0) {
      ++result.massless_nodes;
      continue;
    }
    result.smallest_nodal_mass = std::min(result.smallest_nodal_mass, m);
    const std::size_t s = std::size_t(slot_of[n]);
    mass[s] = m, inverse_mass[s] = 1 / m;
  }
  const ConstraintProjection projection(field, model.layout, constraints, inverse_mass);
  const std::vector<SpringSet> spring_sets = split_springs(springs, model.layout, histories);
  std::vector<std::pair<const History*, Field>> external;
  for (const auto& [name, force] : nodal_forces(field, loads, nodal_mass)) {
    external.emplace_back(&histories.at(name), Field(slots));
    for (std::size_t n = 0; n < nodes; ++n)
      for (int c = 0; c < 3; ++c) external.back().second.at(std::size_t(slot_of[n]), c) = force[n][c];
  }
  const auto prescribed_at = [&](double t) {
    std::vector<double> factor;
    for (const std::string& name : constraints.set_names) factor.push_back(histories.at(name).at(t));
    std::vector<Vec3d> value(prescribed);
    for (std::size_t b = 0; b < prescribed; ++b) value[b] = factor[std::size_t(constraints.set[b])] * constraints.displacement[b];
    return value;
  };

  IntegrationPoints at_once = points;
  at_once.prony.clear();
  result.stable_time_step = stable_step(CpuForces<double>(model.supports, model.layout, at_once), nodal_pressure.get(), spring_sets, projection, prescribed, inverse_mass);
  require(options.time_step <= result.stable_time_step, "the time step of ", options.time_step, " s is not stable; this body needs one below ", result.stable_time_step,
          " s (its stiffest and lightest part decides): give a shorter one, or none");
  const double wanted = options.time_step > 0 ? options.time_step : options.safety * result.stable_time_step;
  const double outputs = options.output_every > 0 ? std::max(1.0, std::round(options.duration / options.output_every)) : 1;
  const double every = std::ceil(options.duration / outputs / wanted * (1 - 1e-12)), steps = outputs * every;
  require(steps < 2e9, "the duration of ", options.duration, " s needs ", steps, " steps of at most ", wanted, " s; shorten it");
  result.steps = int(steps);
  const double dt = result.time_step = options.duration / steps;
  result.seconds["setup"] = seconds();

  // u(n + 1) = u(n) + d(n + 1), d(n + 1) = keep d(n) + push M^-1 (R - f(u(n))) + projection; the first step is half of one.
  const double keep = (2 - options.damping * dt) / (2 + options.damping * dt);
  Field u(slots), d(slots), next(slots), f(slots), R(slots), last_R(slots);
  std::vector<Vec3d> value = prescribed_at(0), last_value = value, last_force(prescribed);
  std::vector<double> last_spring_force(spring_sets.size(), 0.0);
  DynamicsEntry entry;
  double last_drag = 0;     // M v . d of the last step [kg mm^2/s]
  double work_done = 0;     // sum of the sizes of all work so far
  double energy_scale = 0;
  for (int n = 0; n <= result.steps; ++n) {
    const double t = n * dt, push = n == 0 ? dt * dt / 2 : 2 * dt * dt / (2 + options.damping * dt);
    R.clear();
    for (const auto& [history, force] : external) {
      const double factor = history->at(t);
      each_parameter(slots, [&](int c, std::size_t s) { R.at(s, c) += factor * force.at(s, c); });
    }
    forces.force_in_time(u, n == 0 ? 0 : dt, f);
    if (nodal_pressure) nodal_pressure->add_force(u, f);
    for (const SpringSet& s : spring_sets) s.forces.add_force(u, s.load(t), f);
    each_parameter(slots, [&](int c, std::size_t s) { next.at(s, c) = keep * d.at(s, c) + push * inverse_mass[s] * (R.at(s, c) - f.at(s, c)); });
    std::vector<Vec3d> next_value = prescribed_at(t + dt);
    const std::vector<Vec3d> impulse = projection.project(u, next_value, next);

    // Work of the step that led here, by the trapezoidal rule, for which the discrete balance is exact; the first step
    // begins with half a step of force.
    const double first = n == 1 ? 0.5 : 1;
    const double begin_work = first * dot(last_R, d) / 2, end_work = dot(R, d) / 2;
    entry.work_of_loads += begin_work + end_work;
    work_done += std::abs(begin_work) + std::abs(end_work);
    for (std::size_t b = 0; b < prescribed; ++b) {
      const Vec3d force = (1 / push) * impulse[b], path = value[b] - last_value[b];
      const double begin_part = first * dot(last_force[b], path) / 2, end_part = dot(force, path) / 2;
      entry.work_of_motions += begin_part + end_part;
      work_done += std::abs(begin_part) + std::abs(end_part);
      last_force[b] = force;
    }
    for (std::size_t s = 0; s < spring_sets.size(); ++s) {
      const double load = spring_sets[s].load(t), per_load = spring_sets[s].energy_per_load(u, load);
      const double work = n == 0 ? 0 : (last_spring_force[s] + per_load) / 2 * (load - spring_sets[s].load(t - dt));
      entry.work_of_motions += work;
      work_done += std::abs(work);
      last_spring_force[s] = per_load;
    }
    const auto inertia = [&](const Field& a, const Field& b) {  // a . M b
      return parallel_sum(slots, [&](std::size_t begin, std::size_t end) {
        double sum = 0;
        for (int c = 0; c < 3; ++c)
          for (std::size_t s = begin; s < end; ++s) sum += mass[s] * a.at(s, c) * b.at(s, c);
        return sum;
      });
    };
    const double here = inertia(d, d), across = inertia(d, next), there = inertia(next, next);
    if (n > 0) entry.dissipated += options.damping * (last_drag + (here + across) / (2 * dt)) / 2;
    last_drag = n == 0 ? 0 : (across + there) / (2 * dt);
    entry.kinetic = n == 0 ? 0 : across / (2 * dt * dt);

    // The velocity between two steps holds at most 1 / (1 - (w dt / 2)^2) times the energy of a mode of frequency w: 50 at
    // 0.99 of the stable step. More than 100 times all the work ever done is growth without bound.
    constexpr double growth = 100;
    if (!std::isfinite(there) || here / (2 * dt * dt) > growth * work_done)
      fail(Failure::numerical, "the motion grows without bound at step ", n, " (time ", t, " s): the body has deformed so far that the time step of ", dt,
           " s is no longer stable, or points have turned inside out; give a smaller dynamics.safety or time_step_s, or drive the body less");

    if (n % int(every) == 0) {
      std::vector<Vec3d> values(slots);
      each_parameter(slots, [&](int c, std::size_t s) { values[s][c] = u.at(s, c); });
      StateOfPoints state = measure_points(model, values);
      if (nodal_pressure) state.strain_energy += nodal_pressure->energy(u);
      entry.step = n, entry.time = t, entry.strain = state.strain_energy, entry.smallest_volume_ratio = state.smallest_volume_ratio;
      entry.springs = 0;
      entry.reactions.clear();
      for (const std::string& name : constraints.set_names) entry.reactions[name] = {};
      for (std::size_t b = 0; b < prescribed; ++b) entry.reactions[constraints.set_names[std::size_t(constraints.set[b])]] += last_force[b];
      for (const SpringSet& s : spring_sets) {
        entry.springs += s.forces.energy(u, s.load(t));
        for (const auto& [name, force] : s.forces.reactions(u, s.load(t))) entry.reactions[name] += force;
      }
      result.history.push_back(entry);
      energy_scale = std::max({energy_scale, std::abs(entry.work_of_loads) + std::abs(entry.work_of_motions), entry.kinetic + entry.strain + entry.springs + entry.dissipated});
      if (options.observe) {
        DynamicsFrame frame{entry, std::vector<Vec3d>(nodes), std::vector<Vec3d>(nodes)};
        for (std::size_t m = 0; m < nodes; ++m)
          for (int c = 0; c < 3; ++c) {
            const std::size_t s = std::size_t(slot_of[m]);
            frame.parameter[m][c] = u.at(s, c);
            frame.velocity_parameter[m][c] = n == 0 ? 0 : (d.at(s, c) + next.at(s, c)) / (2 * dt);
          }
        options.observe(frame);
      }
    }
    if (options.progress && n % 100 == 0) options.progress({"dynamics", n, std::nan(""), seconds(), n > 0 ? seconds() / n * (result.steps - n) : std::nan("")});
    each_parameter(slots, [&](int c, std::size_t s) { u.at(s, c) += next.at(s, c); });
    d.swap(next);
    last_R.swap(R);
    last_value.swap(value);
    value.swap(next_value);
  }
  if (points.viscoelastic()) result.largest_balance_error = std::numeric_limits<double>::quiet_NaN();
  for (const DynamicsEntry& e : result.history)
    if (energy_scale > 0 && !points.viscoelastic()) result.largest_balance_error = std::max(result.largest_balance_error, std::abs(e.balance_error()) / energy_scale);
  result.seconds["dynamics"] = seconds() - result.seconds["setup"];
  return result;
}

}  // namespace mtled
