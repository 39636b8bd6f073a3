#include "core/relaxation.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>

#include "core/error.hpp"

namespace mtled {

std::vector<Vec3d> rough_vector(const std::vector<std::uint8_t>& active) {
  std::vector<Vec3d> v(active.size() / 3);
  std::uint32_t state = 12345;
  for (int c = 0; c < 3; ++c)
    for (std::size_t s = 0; s < v.size(); ++s) {
      state = state * 1664525u + 1013904223u;
      v[s][c] = active[std::size_t(c) * v.size() + s] * (double(state >> 8) / double(1 << 24) - 0.5);
    }
  return v;
}

namespace {

constexpr double nan = std::numeric_limits<double>::quiet_NaN();

/// f = K(state) v reduced to the free parameters, after making v admissible.
void reduced_tangent(const Mechanics& mechanics, const Vector& state, Vector& v, Vector& f) {
  mechanics.impose(v, 0);
  mechanics.tangent(state, v, f);
  mechanics.reduce(f);
}

}  // namespace

double largest_eigenvalue(const Mechanics& mechanics, const Vector& u, int iterations, Vector& v) {
  const VectorPointer f = mechanics.vector(), g = mechanics.vector();
  double lambda = 0;
  for (int i = 0; i < iterations; ++i) {
    reduced_tangent(mechanics, u, v, *f);
    mechanics.precondition(*f, *g);
    const double vf = mechanics.dot(v, *f), gf = mechanics.dot(*g, *f), gg = mechanics.dot(*g, *g);
    if (!(gg > 0) || !std::isfinite(gg)) fail(Failure::numerical, "the stiffness of the body could not be estimated: it is zero or not finite");
    if (vf > 0) lambda = gf / vf;
    mechanics.combine(v, 1 / std::sqrt(gg), *g, 0);
  }
  return lambda;
}

namespace {

/// Rayleigh quotient of P K for the change of u over the last steps: an upper bound of the smallest eigenvalue. With the
/// stiffness itself, not differences of forces, which drown in rounding when the slow modes are very slow.
/// Two-level: (K d).P (K d) / d.K d; plain: d.K d / d.M d. NaN where the change says nothing.
double rayleigh_quotient(const Mechanics& mechanics, bool two_level, const Vector& u, Vector& change) {
  const VectorPointer f = mechanics.vector(), g = mechanics.vector();
  reduced_tangent(mechanics, u, change, *f);
  const double stiffness = mechanics.dot(change, *f);
  double quotient;
  if (two_level) {
    mechanics.precondition(*f, *g);
    quotient = mechanics.dot(*f, *g) / stiffness;
  } else {
    mechanics.multiply_by_diagonal(change, *g);
    quotient = stiffness / mechanics.dot(change, *g);
  }
  return stiffness > 0 && quotient > 0 ? quotient : nan;
}

double optimal_rho(double omega_squared, double lambda) {
  const double root = std::sqrt(std::max(lambda / omega_squared, 1.0));
  return (root - 1) / (root + 1);
}

/// Preconditioned conjugate gradients for the reduced K(state) x = r, from x as it is; `r` holds the residual and becomes
/// the last one. Stops after `most_iterations`, when enough(iteration, residual relative to the first) says so, or where K
/// is not positive definite: what was gained so far is the answer. Returns the number of products with K.
template <class Enough>
int conjugate_gradients(const Mechanics& mechanics, const Vector& state, int most_iterations, Enough&& enough, Vector& r, Vector& x) {
  const VectorPointer z = mechanics.vector(), p = mechanics.vector(), Kp = mechanics.vector();
  mechanics.precondition(r, *z);
  double rz = mechanics.dot(r, *z);
  const double first = rz;
  if (!(first > 0)) return 0;
  mechanics.copy(*z, *p);
  for (int i = 0; i < most_iterations; ++i) {
    if (enough(i, std::sqrt(rz / first))) return i;
    reduced_tangent(mechanics, state, *p, *Kp);
    const double pKp = mechanics.dot(*p, *Kp);
    if (!(pKp > 0)) return i + 1;
    const double alpha = rz / pKp;
    mechanics.combine(x, alpha, *p, 1);
    mechanics.combine(r, -alpha, *Kp, 1);
    mechanics.precondition(r, *z);
    const double next = mechanics.dot(r, *z);
    mechanics.combine(*p, 1, *z, next / rz);
    rz = next;
  }
  return most_iterations;
}

/// The same by preconditioned conjugate residuals, which make the residual (in the inner product of P) as small as it can be
/// in every iteration. That of conjugate gradients rises where outer nodes have modes that hardly anything holds.
template <class Enough>
int conjugate_residuals(const Mechanics& mechanics, const Vector& state, int most_iterations, Enough&& enough, Vector& r, Vector& x) {
  const VectorPointer z = mechanics.vector(), Kz = mechanics.vector(), p = mechanics.vector(), Kp = mechanics.vector(), PKp = mechanics.vector();
  const auto stiffness = [&] {
    reduced_tangent(mechanics, state, *z, *Kz);
    return mechanics.dot(*z, *Kz);
  };
  mechanics.precondition(r, *z);
  const double first = mechanics.dot(r, *z);
  if (!(first > 0)) return 0;
  double zKz = stiffness();
  mechanics.copy(*z, *p), mechanics.copy(*Kz, *Kp);
  for (int i = 0; i < most_iterations; ++i) {
    if (enough(i, std::sqrt(std::max(mechanics.dot(r, *z), 0.0) / first))) return i + 1;
    mechanics.precondition(*Kp, *PKp);
    const double KpPKp = mechanics.dot(*Kp, *PKp);
    if (!(zKz > 0 && KpPKp > 0)) return i + 1;
    const double alpha = zKz / KpPKp;
    mechanics.combine(x, alpha, *p, 1);
    mechanics.combine(r, -alpha, *Kp, 1);
    mechanics.combine(*z, -alpha, *PKp, 1);
    const double next = stiffness();
    mechanics.combine(*p, 1, *z, next / zKz);
    mechanics.combine(*Kp, 1, *Kz, next / zKz);
    zKz = next;
  }
  return most_iterations + 1;
}

struct Correction {
  double largest = 0;    ///< component of the field at the watched nodes [mm]
  bool settled = false;  ///< whether it can be trusted
  int products = 0;      ///< with K, and forces
};

/// Adds to u what is missing to equilibrium, by conjugate residuals on the linearised problem. They find a mode that is much
/// slower than rho says, which increments hide. The correction has settled when it changed by less than a tenth of the
/// tolerance (or a twentieth of itself) between two times, `window` iterations or more apart, when the residual was below
/// `residual` times the first: where a slow mode is still missing, the residual does not fall. A correction that turns points
/// inside out is taken back (the body has modes without stiffness, or the linearised problem is too far off).
Correction correct(const Mechanics& mechanics, int window, double residual, double tolerance, Vector& u) {
  const VectorPointer r = mechanics.vector(), x = mechanics.vector(), before = mechanics.vector();
  const long inverted = mechanics.force(u, 1, *r).inverted;
  mechanics.reduce(*r);
  mechanics.combine(*r, 0, *r, -1);
  constexpr int most_windows = 12;
  Correction correction{0, true, 2};
  const auto settled = [&](int iteration, double relative) {
    if (iteration % window != 0) return false;
    correction.largest = mechanics.largest_displacement(*x);
    correction.settled = false;
    if (iteration == 0 || relative > residual) return false;
    mechanics.combine(*before, 1, *x, -1);
    correction.settled = mechanics.largest_displacement(*before) < std::max(0.1 * tolerance, 0.05 * correction.largest);
    mechanics.copy(*x, *before);
    return correction.settled;
  };
  const int products = conjugate_residuals(mechanics, u, most_windows * window, settled, *r, *x);
  correction.products += products;
  if (products > most_windows * window) correction.settled = true;  // anything so slow would have been met; rounding may hold the residual up
  mechanics.copy(u, *before);
  mechanics.combine(u, 1, *x, 1);
  mechanics.impose(u, 1);
  const VolumeRatioStatistics corrected = mechanics.force(u, 1, *r);
  if (corrected.inverted > inverted || !std::isfinite(corrected.smallest)) mechanics.copy(*before, u), correction.settled = false;
  return correction;
}

}  // namespace

int advance_load(const Mechanics& mechanics, double load, double relative_residual, Vector& u) {
  const VectorPointer state = mechanics.vector(), step = mechanics.vector(), f = mechanics.vector(), r = mechanics.vector();
  mechanics.copy(u, *state);
  // Residual of the linearised problem with only the prescribed nodes moved: -f(u) - K(u) (u with the new load - u).
  mechanics.impose(u, load);
  mechanics.copy(u, *step);
  mechanics.combine(*step, -1, *state, 1);
  mechanics.tangent(*state, *step, *r);
  mechanics.force(*state, load, *f);
  mechanics.combine(*r, -1, *f, -1);
  mechanics.reduce(*r);
  constexpr int most_iterations = 300;
  const int products = conjugate_gradients(mechanics, *state, most_iterations, [&](int, double residual) { return residual <= relative_residual; }, *r, u);
  mechanics.impose(u, load);
  return 2 + products;
}

RelaxationResult relax(const DiscreteModel& model, Mechanics& mechanics, const SolverOptions& options, double safety, Vector& u) {
  RelaxationResult result;
  const bool two_level = options.relaxation == Relaxation::two_level;
  const int lag = two_level ? 20 : 40;
  const int ramp = two_level ? 0 : options.load_steps > 0 ? options.load_steps : std::max(200, int(12 * model.largest_distance));
  const int settle = two_level ? 60 : ramp + 40;  ///< no estimate of the rate before
  const int deformed = two_level ? settle : ramp;  ///< the deformed body has other eigenvalues: lambda is estimated again
  constexpr int early = 40, most_at_once = 10;    ///< two-level steps with a small rho; steps between two entries of the history
  const auto started = std::chrono::steady_clock::now();
  const auto seconds = [&] { return std::chrono::duration<double>(std::chrono::steady_clock::now() - started).count(); };

  const VectorPointer v = mechanics.vector(), increment = mechanics.vector(), change = mechanics.vector();
  mechanics.upload(rough_vector(model.active), *v);
  constexpr int first_power = 20, second_power = 30;
  StepSizes sizes;
  const auto set_step = [&](int iterations, double margin) {
    sizes.lambda = options.largest_eigenvalue > 0 ? options.largest_eigenvalue : safety * margin * largest_eigenvalue(mechanics, u, iterations, *v);
    result.force_evaluations += iterations;
    result.largest_eigenvalue = sizes.lambda;
  };
  set_step(first_power, 1.4);
  sizes.rho = two_level ? 0.7 : 0.97;
  double omega_squared = nan;
  const int patience = two_level ? 300 : 3000;  ///< steps after which u is corrected although the estimate is too large
  bool suspicious = false;                      ///< a correction was larger than the rate foretold, or too large
  StepControl control;
  control.ramp = ramp;
  control.tolerance = options.tolerance_mm, control.consecutive = options.consecutive_steps;
  control.largest_increment = model.largest_increment;
  int checked = ramp;
  const auto record = [&](double estimate) {
    if (!result.history.empty() && result.history.back().step == control.step) result.history.pop_back();
    // The energy takes as long as some steps: only now and then.
    const bool with_energy = result.history.size() % 5 == 0 || estimate < options.tolerance_mm;
    result.history.push_back({control.step, estimate, control.largest, sizes.rho, with_energy ? mechanics.strain_energy(u) : nan});
    if (!options.progress) return;
    const double left = estimate > options.tolerance_mm ? std::log(estimate / options.tolerance_mm) / (1 - sizes.rho) : nan;
    options.progress({"relaxation", control.step, estimate, seconds(), left * seconds() / control.step});
  };
  while (control.step < options.max_steps) {
    const int n = control.step;
    const bool sampled = n >= settle && (n - settle) % lag == 0;
    if (!model.constraints->direct() && (n == deformed || sampled)) mechanics.impose(u, control.load());  // before K(u) is looked at
    if (n == deformed) {
      set_step(second_power, 1.2);
      if (!std::isnan(omega_squared)) sizes.rho = optimal_rho(omega_squared, sizes.lambda);
    }
    if (sampled) {
      if (n > settle) {
        const double sample = rayleigh_quotient(mechanics, two_level, u, *change);
        ++result.force_evaluations;
        if (sample > 0 && !(omega_squared <= sample)) {
          omega_squared = sample;
          sizes.rho = std::max(sizes.rho, optimal_rho(omega_squared, sizes.lambda));
        }
      }
      mechanics.clear(*change);
    } else if (two_level && n < settle) {
      sizes.rho = n < early ? 0.7 : 0.9;
    }
    // Until something of the above is due, a history entry, or a verdict, the steps go on by themselves.
    int end = std::min(options.max_steps, n - n % most_at_once + most_at_once);
    for (int due : {early, deformed, n < settle ? settle : settle + ((n - settle) / lag + 1) * lag})
      if (due > n) end = std::min(end, due);
    const double slow = sizes.rho + 0.2 * (1 - sizes.rho);
    control.factor = slow / (1 - slow);
    const double periods = std::isnan(omega_squared) ? options.max_steps : ramp + std::ceil(2 * std::sqrt(sizes.lambda / omega_squared));
    control.may_stop_from = std::max(settle + lag, int(std::min<double>(periods, options.max_steps)));
    control.impatient_from = checked + patience;
    mechanics.steps(end - n, sizes, control, u, *increment, *change);
    result.force_evaluations += control.step - n;
    result.steps = control.step;
    result.error_estimate = control.estimate;
    if (control.verdict == StepControl::diverged) {
      result.diverged = true;
      return result;
    }
    if (control.step % most_at_once == 0) record(control.step > control.may_stop_from ? control.estimate : nan);
    if (control.verdict == StepControl::going) continue;

    const int window = std::max(10, int(0.25 * (1 + sizes.rho) / (1 - sizes.rho)));
    if (two_level) mechanics.assemble_coarse(u);  // what is slow is what the start's matrix does not know
    const Correction correction = correct(mechanics, window, suspicious ? 0.15 : 0.3, options.tolerance_mm, u);
    result.force_evaluations += correction.products;
    // What the rate foretold is known well. A much larger correction met a slow mode: more of it may be missing.
    suspicious = suspicious || correction.largest > 1.5 * result.error_estimate;
    result.error_estimate = (suspicious ? 2 : 0.25) * correction.largest;
    record(result.error_estimate);
    result.converged = correction.settled && result.error_estimate < options.tolerance_mm;
    if (result.converged) break;
    suspicious = true, checked = control.step - 1;
    control.verdict = StepControl::going, control.calm_for = 0, control.remembered = 0;
    mechanics.clear(*increment), mechanics.clear(*change);
    if (two_level) omega_squared = nan, sizes.rho = 0.9;
    set_step(second_power, 1.2);
  }
  mechanics.impose(u, 1);
  return result;
}

}  // namespace mtled
