#include "core/relaxation.hpp"

#include <chrono>
#include <cmath>
#include <limits>

#include "core/error.hpp"

namespace mtled {
namespace {

constexpr double nan = std::numeric_limits<double>::quiet_NaN();

/// body(component pointers..., begin, end) over pieces of every component.
template <class Real, class Body>
void each_component(const NodalField<Real>& like, Body&& body) {
  parallel_pieces(like.slots(), 16384, [&](std::size_t begin, std::size_t end) {
    for (int c = 0; c < 3; ++c) body(c, begin, end);
  });
}

}  // namespace

template <class Real>
double dot(const NodalField<Real>& a, const NodalField<Real>& b) {
  return parallel_sum(a.slots(), [&](std::size_t begin, std::size_t end) {
    double sum = 0;
    for (int c = 0; c < 3; ++c) {
      const Real *x = a.component(c), *y = b.component(c);
      double part[8] = {};
      std::size_t s = begin;
      for (; s + 8 <= end; s += 8)
        for (int l = 0; l < 8; ++l) part[l] += double(x[s + l]) * double(y[s + l]);
      for (; s < end; ++s) part[0] += double(x[s]) * double(y[s]);
      for (double p : part) sum += p;
    }
    return sum;
  });
}

template <class Real>
double power_iteration(const std::function<void(NodalField<Real>&, NodalField<Real>&)>& stiffness, const std::function<void(const NodalField<Real>&, NodalField<Real>&)>& inverse,
                       int iterations, NodalField<Real>& v) {
  NodalField<Real> f(v.slots()), g(v.slots());
  double lambda = 0;
  for (int i = 0; i < iterations; ++i) {
    stiffness(v, f);
    inverse(f, g);
    const double vf = dot(v, f), gf = dot(g, f), gg = dot(g, g);
    if (!(gg > 0) || !std::isfinite(gg)) fail(Failure::numerical, "the stiffness of the body could not be estimated: it is zero or not finite");
    if (vf > 0) lambda = gf / vf;
    const Real scale = Real(1 / std::sqrt(gg));
    each_component(v, [&](int c, std::size_t begin, std::size_t end) {
      const Real* from = g.component(c);
      Real* to = v.component(c);
      for (std::size_t s = begin; s < end; ++s) to[s] = scale * from[s];
    });
  }
  return lambda;
}

template <class Real>
NodalField<Real> rough_vector(const SlotModel<Real>& model) {
  NodalField<Real> v(model.position.size());
  std::uint32_t state = 12345;
  for (int c = 0; c < 3; ++c)
    for (std::size_t s = 0; s < v.slots(); ++s) {
      state = state * 1664525u + 1013904223u;
      v.at(s, c) = model.active.at(s, c) * (Real(state >> 8) / Real(1 << 24) - Real(0.5));
    }
  return v;
}

namespace {

/// g = P f
template <class Real>
void precondition(const SlotModel<Real>& model, const NodalField<Real>& f, NodalField<Real>& g) {
  each_component(f, [&](int c, std::size_t begin, std::size_t end) {
    const Real *from = f.component(c), *d = model.inverse_diagonal.component(c);
    Real* to = g.component(c);
    for (std::size_t s = begin; s < end; ++s) to[s] = d[s] * from[s];
  });
  if (model.coarse) model.coarse->add_correction(f, g);
}

/// Largest eigenvalue of P K(u); see power_iteration.
template <class Real>
double largest_eigenvalue(const SlotModel<Real>& model, const NodalField<Real>& u, int iterations, NodalField<Real>& v) {
  const auto stiffness = [&](NodalField<Real>& x, NodalField<Real>& f) {
    model.constraints->impose(x, 0);
    model.tangent(u, x, f);
    model.constraints->reduce(f);
  };
  return power_iteration<Real>(stiffness, [&](const NodalField<Real>& f, NodalField<Real>& g) { precondition(model, f, g); }, iterations, v);
}

struct StepSizes {
  double rho = 0.7, lambda = 1;
};

/// One step: increment = rho^2 increment - scale P f, u += increment, change += increment. The increment is kept apart
/// from u because in single precision the difference of two u would lose it. Returns its largest component over the
/// watched nodes.
template <class Real>
double advance(const SlotModel<Real>& model, const StepSizes& step, const NodalField<Real>& g, NodalField<Real>& u, NodalField<Real>& increment, NodalField<Real>& change) {
  const Real inertia = Real(step.rho * step.rho), scale = Real((1 + step.rho) * (1 + step.rho) / step.lambda);
  constexpr std::size_t piece = 16384;
  std::vector<Real> largest((u.slots() + piece - 1) / piece);
  parallel_pieces(u.slots(), piece, [&](std::size_t begin, std::size_t end) {
    Real top = 0;
    for (int c = 0; c < 3; ++c) {
      const Real* push = g.component(c);
      Real *now = u.component(c), *d = increment.component(c), *sum = change.component(c);
      const std::uint8_t* watched = model.watched.data();
      for (std::size_t s = begin; s < end; ++s) {
        d[s] = inertia * d[s] - scale * push[s];
        now[s] += d[s];
        sum[s] += d[s];
        const Real size = watched[s] ? std::abs(d[s]) : Real(0);
        top = size > top || size != size ? size : top;
      }
    }
    largest[begin / piece] = top;
  });
  double top = 0;
  for (Real x : largest)
    if (!(x <= top)) top = double(x);
  return top;
}

/// Rayleigh quotient of P K for the change of u over the last steps: an upper bound of the smallest eigenvalue. With the
/// stiffness itself, not differences of forces, which drown in rounding when the slow modes are very slow.
/// Two-level: (K d).P (K d) / d.K d; plain: d.K d / d.M d. NaN where the change says nothing.
template <class Real>
double rayleigh_quotient(const SlotModel<Real>& model, const NodalField<Real>& u, NodalField<Real>& change, NodalField<Real>& f, NodalField<Real>& g) {
  model.constraints->impose(change, 0);
  model.tangent(u, change, f);
  model.constraints->reduce(f);
  const double stiffness = dot(change, f);
  double quotient;
  if (model.coarse) {
    precondition(model, f, g);
    quotient = dot(f, g) / stiffness;
  } else {
    each_component(change, [&](int c, std::size_t begin, std::size_t end) {
      const Real *d = change.component(c), *inverse_mass = model.inverse_diagonal.component(c);
      Real* to = g.component(c);
      for (std::size_t s = begin; s < end; ++s) to[s] = inverse_mass[s] > 0 ? d[s] / inverse_mass[s] : Real(0);
    });
    quotient = stiffness / dot(change, g);
  }
  return stiffness > 0 && quotient > 0 ? quotient : nan;
}

double optimal_rho(double omega_squared, double lambda) {
  const double root = std::sqrt(std::max(lambda / omega_squared, 1.0));
  return (root - 1) / (root + 1);
}

/// y = a x + b y
template <class Real>
void combine(NodalField<Real>& y, double a, const NodalField<Real>& x, double b) {
  each_component(y, [&](int c, std::size_t begin, std::size_t end) {
    const Real* from = x.component(c);
    Real* to = y.component(c);
    for (std::size_t s = begin; s < end; ++s) to[s] = Real(a) * from[s] + Real(b) * to[s];
  });
}

/// Preconditioned conjugate gradients for the reduced K(state) x = r, from x as it is; `r` holds the residual and becomes
/// the last one. Stops after `most_iterations`, when enough(iteration, residual relative to the first) says so, or where K
/// is not positive definite: what was gained so far is the answer. Returns the number of products with K.
template <class Real, class Enough>
int conjugate_gradients(const SlotModel<Real>& model, const NodalField<Real>& state, int most_iterations, Enough&& enough, NodalField<Real>& r, NodalField<Real>& x) {
  NodalField<Real> z(x.slots()), p(x.slots()), Kp(x.slots());
  precondition(model, r, z);
  double rz = dot(r, z);
  const double first = rz;
  if (!(first > 0)) return 0;
  p.copy_from(z);
  for (int i = 0; i < most_iterations; ++i) {
    if (enough(i, std::sqrt(rz / first))) return i;
    model.constraints->impose(p, 0);
    model.tangent(state, p, Kp);
    model.constraints->reduce(Kp);
    const double pKp = dot(p, Kp);
    if (!(pKp > 0)) return i + 1;
    const double alpha = rz / pKp;
    combine(x, alpha, p, 1);
    combine(r, -alpha, Kp, 1);
    precondition(model, r, z);
    const double next = dot(r, z);
    combine(p, 1, z, next / rz);
    rz = next;
  }
  return most_iterations;
}

/// The same by preconditioned conjugate residuals, which make the residual (in the inner product of P) as small as it can be
/// in every iteration. That of conjugate gradients rises where outer nodes have modes that hardly anything holds.
template <class Real, class Enough>
int conjugate_residuals(const SlotModel<Real>& model, const NodalField<Real>& state, int most_iterations, Enough&& enough, NodalField<Real>& r, NodalField<Real>& x) {
  NodalField<Real> z(x.slots()), Kz(x.slots()), p(x.slots()), Kp(x.slots()), PKp(x.slots());
  const auto stiffness = [&](NodalField<Real>& v, NodalField<Real>& Kv) {
    model.constraints->impose(v, 0);
    model.tangent(state, v, Kv);
    model.constraints->reduce(Kv);
    return dot(v, Kv);
  };
  precondition(model, r, z);
  const double first = dot(r, z);
  if (!(first > 0)) return 0;
  double zKz = stiffness(z, Kz);
  p.copy_from(z), Kp.copy_from(Kz);
  for (int i = 0; i < most_iterations; ++i) {
    if (enough(i, std::sqrt(std::max(dot(r, z), 0.0) / first))) return i + 1;
    precondition(model, Kp, PKp);
    const double KpPKp = dot(Kp, PKp);
    if (!(zKz > 0 && KpPKp > 0)) return i + 1;
    const double alpha = zKz / KpPKp;
    combine(x, alpha, p, 1);
    combine(r, -alpha, Kp, 1);
    combine(z, -alpha, PKp, 1);
    const double next = stiffness(z, Kz);
    combine(p, 1, z, next / zKz);
    combine(Kp, 1, Kz, next / zKz);
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
template <class Real>
Correction correct(const SlotModel<Real>& model, int window, double residual, double tolerance, NodalField<Real>& u) {
  NodalField<Real> r(u.slots()), x(u.slots()), before(u.slots());
  const long inverted = model.force(u, 1, r).inverted;
  model.constraints->reduce(r);
  combine(r, 0, r, -1);
  constexpr int most_windows = 12;
  Correction correction{0, true, 2};
  const auto settled = [&](int iteration, double relative) {
    if (iteration % window != 0) return false;
    correction.largest = model.largest_displacement(x);
    correction.settled = false;
    if (iteration == 0 || relative > residual) return false;
    combine(before, 1, x, -1);
    correction.settled = model.largest_displacement(before) < std::max(0.1 * tolerance, 0.05 * correction.largest);
    before.copy_from(x);
    return correction.settled;
  };
  const int products = conjugate_residuals(model, u, most_windows * window, settled, r, x);
  correction.products += products;
  if (products > most_windows * window) correction.settled = true;  // anything so slow would have been met; rounding may hold the residual up
  before.copy_from(u);
  combine(u, 1, x, 1);
  model.constraints->impose(u, 1);
  const VolumeRatioStatistics corrected = model.force(u, 1, r);
  if (corrected.inverted > inverted || !std::isfinite(corrected.smallest)) u.swap(before), correction.settled = false;
  return correction;
}

}  // namespace

template <class Real>
int advance_load(const SlotModel<Real>& model, double load, double relative_residual, NodalField<Real>& u) {
  NodalField<Real> state(u.slots()), step(u.slots()), f(u.slots()), r(u.slots());
  state.copy_from(u);
  // Residual of the linearised problem with only the prescribed nodes moved: -f(u) - K(u) (u with the new load - u).
  model.constraints->impose(u, load);
  step.copy_from(u);
  combine(step, -1, state, 1);
  model.tangent(state, step, r);
  model.force(state, load, f);
  combine(r, -1, f, -1);
  model.constraints->reduce(r);
  constexpr int most_iterations = 300;
  const int products = conjugate_gradients(model, state, most_iterations, [&](int, double residual) { return residual <= relative_residual; }, r, u);
  model.constraints->impose(u, load);
  return 2 + products;
}

template <class Real>
RelaxationResult relax(const SlotModel<Real>& model, const SolverOptions& options, double safety, NodalField<Real>& u) {
  RelaxationResult result;
  const bool two_level = model.coarse != nullptr;
  const int lag = two_level ? 20 : 40;
  const int ramp = two_level ? 0 : options.load_steps > 0 ? options.load_steps : std::max(200, int(12 * model.largest_distance));
  const int settle = two_level ? 60 : ramp + 40;  ///< no estimate of the rate before
  const auto started = std::chrono::steady_clock::now();
  const auto seconds = [&] { return std::chrono::duration<double>(std::chrono::steady_clock::now() - started).count(); };

  NodalField<Real> v = rough_vector(model), increment(u.slots()), change(u.slots()), f(u.slots()), g(u.slots());
  constexpr int first_power = 20, second_power = 30;
  StepSizes step;
  const auto set_step = [&](int iterations, double margin) {
    step.lambda = options.largest_eigenvalue > 0 ? options.largest_eigenvalue : safety * margin * largest_eigenvalue(model, u, iterations, v);
    result.force_evaluations += iterations;
    result.largest_eigenvalue = step.lambda;
  };
  set_step(first_power, 1.4);
  step.rho = two_level ? 0.7 : 0.97;
  double omega_squared = nan;
  std::deque<double> recent;
  int calm = 0, checked = ramp, inverted_for = 0;
  constexpr int longest_inversion = 1000;  ///< steps in a row with points inside out, after which it has diverged
  const int patience = two_level ? 300 : 3000;  ///< steps after which u is corrected although the estimate is too large
  bool suspicious = false;                      ///< a correction was larger than the rate foretold, or too large
  const auto record = [&](double estimate, double largest) {
    if (!result.history.empty() && result.history.back().step == result.steps) result.history.pop_back();
    // The energy takes as long as some steps: only now and then.
    const bool with_energy = result.history.size() % 5 == 0 || estimate < options.tolerance_mm;
    result.history.push_back({result.steps, estimate, largest, step.rho, with_energy ? model.strain_energy(u) : nan});
    if (!options.progress) return;
    const double left = estimate > options.tolerance_mm ? std::log(estimate / options.tolerance_mm) / (1 - step.rho) : nan;
    options.progress({"relaxation", result.steps, estimate, seconds(), left * seconds() / result.steps});
  };
  for (int n = 0; n < options.max_steps; ++n) {
    double load = 1;
    if (n < ramp) {
      const double t = double(n + 1) / ramp;
      load = t * t * t * (10 - 15 * t + 6 * t * t);
    }
    if (n <= ramp || !model.constraints->direct()) model.constraints->impose(u, load);
    if (n == (two_level ? 60 : ramp)) {  // the deformed body has other eigenvalues
      set_step(second_power, 1.2);
      if (!std::isnan(omega_squared)) step.rho = optimal_rho(omega_squared, step.lambda);
    }
    if (n >= settle && (n - settle) % lag == 0) {
      if (n > settle) {
        const double sample = rayleigh_quotient(model, u, change, f, g);
        ++result.force_evaluations;
        if (sample > 0 && !(omega_squared <= sample)) {
          omega_squared = sample;
          step.rho = std::max(step.rho, optimal_rho(omega_squared, step.lambda));
        }
      }
      change.clear();
    } else if (two_level && n < settle) {
      step.rho = n < 40 ? 0.7 : 0.9;
    }
    inverted_for = model.force(u, load, f).inverted > 0 ? inverted_for + 1 : 0;
    ++result.force_evaluations;
    model.constraints->reduce(f);
    precondition(model, f, g);
    const double largest = advance(model, step, g, u, increment, change);
    result.steps = n + 1;
    recent.push_back(largest);
    if (recent.size() > 10) recent.pop_front();
    const double recent_max = *std::max_element(recent.begin(), recent.end());
    const double slow = step.rho + 0.2 * (1 - step.rho);
    result.error_estimate = slow / (1 - slow) * recent_max;
    if (!(largest < model.largest_increment) || inverted_for == longest_inversion) {
      result.diverged = true;
      return result;
    }
    const bool may_stop = n >= settle + lag && !std::isnan(omega_squared) &&
                          n - (two_level ? 0 : ramp) >= 2 * std::sqrt(step.lambda / omega_squared);
    calm = may_stop && result.error_estimate < options.tolerance_mm ? calm + 1 : 0;
    if (n % 10 == 0) record(may_stop ? result.error_estimate : nan, largest);
    if (calm == options.consecutive_steps || (may_stop && n - checked >= patience)) {
      const int window = std::max(10, int(0.25 * (1 + step.rho) / (1 - step.rho)));
      if (two_level) model.coarse->assemble(model.supports, *model.points, u);  // what is slow is what the start's matrix does not know
      const Correction correction = correct(model, window, suspicious ? 0.15 : 0.3, options.tolerance_mm, u);
      result.force_evaluations += correction.products;
      // What the rate foretold is known well. A much larger correction met a slow mode: more of it may be missing.
      suspicious = suspicious || correction.largest > 1.5 * result.error_estimate;
      result.error_estimate = (suspicious ? 2 : 0.25) * correction.largest;
      record(result.error_estimate, largest);
      result.converged = correction.settled && result.error_estimate < options.tolerance_mm;
      if (result.converged) break;
      suspicious = true, checked = n, calm = 0;
      increment.clear(), change.clear(), recent.clear();
      if (two_level) omega_squared = nan, step.rho = 0.9;
      set_step(second_power, 1.2);
    }
  }
  model.constraints->impose(u, 1);
  return result;
}

template double dot<float>(const NodalField<float>&, const NodalField<float>&);
template double dot<double>(const NodalField<double>&, const NodalField<double>&);
template double power_iteration<double>(const std::function<void(NodalField<double>&, NodalField<double>&)>&,
                                        const std::function<void(const NodalField<double>&, NodalField<double>&)>&, int, NodalField<double>&);
template NodalField<double> rough_vector<double>(const SlotModel<double>&);
template RelaxationResult relax<float>(const SlotModel<float>&, const SolverOptions&, double, NodalField<float>&);
template RelaxationResult relax<double>(const SlotModel<double>&, const SolverOptions&, double, NodalField<double>&);
template int advance_load<float>(const SlotModel<float>&, double, double, NodalField<float>&);
template int advance_load<double>(const SlotModel<double>&, double, double, NodalField<double>&);

}  // namespace mtled
