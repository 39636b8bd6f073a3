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

}  // namespace

template <class Real>
int advance_load(const SlotModel<Real>& model, double load, double relative_residual, NodalField<Real>& u) {
  const std::size_t slots = u.slots();
  NodalField<Real> state(slots), r(slots), z(slots), p(slots), Kp(slots);
  state.copy_from(u);
  const auto combine = [&](NodalField<Real>& y, double a, const NodalField<Real>& x, double b) {  // y = a x + b y
    each_component(y, [&](int c, std::size_t begin, std::size_t end) {
      const Real* from = x.component(c);
      Real* to = y.component(c);
      for (std::size_t s = begin; s < end; ++s) to[s] = Real(a) * from[s] + Real(b) * to[s];
    });
  };
  // Residual of the linearised problem with only the prescribed nodes moved: f(u) + K(u) (u with the new load - u).
  model.constraints->impose(u, load);
  p.copy_from(u);
  combine(p, -1, state, 1);
  model.tangent(state, p, Kp);
  model.force(state, load, r);
  combine(r, 1, Kp, 1);
  model.constraints->reduce(r);
  int products = 2;
  precondition(model, r, z);
  double rz = dot(r, z);
  const double first = rz;
  if (!(first > 0)) return products;
  combine(p, -1, z, 0);
  constexpr int most_iterations = 300;
  for (int i = 0; i < most_iterations && rz > relative_residual * relative_residual * first; ++i) {
    model.constraints->impose(p, 0);
    model.tangent(state, p, Kp);
    model.constraints->reduce(Kp);
    ++products;
    const double pKp = dot(p, Kp);
    if (!(pKp > 0)) break;  // not positive definite: what was gained so far is the step
    const double alpha = rz / pKp;
    combine(u, alpha, p, 1);
    combine(r, alpha, Kp, 1);
    precondition(model, r, z);
    const double next = dot(r, z);
    combine(p, -1, z, next / rz);
    rz = next;
  }
  model.constraints->impose(u, load);
  return products;
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
  step.lambda = safety * 1.4 * largest_eigenvalue(model, u, first_power, v);
  result.force_evaluations += first_power;
  step.rho = two_level ? 0.7 : 0.97;
  double omega_squared = nan;
  std::deque<double> recent;
  int calm = 0;
  for (int n = 0; n < options.max_steps; ++n) {
    double load = 1;
    if (n < ramp) {
      const double t = double(n + 1) / ramp;
      load = t * t * t * (10 - 15 * t + 6 * t * t);
    }
    if (n <= ramp || !model.constraints->direct()) model.constraints->impose(u, load);
    if (n == (two_level ? 60 : ramp)) {  // the deformed body has other eigenvalues
      step.lambda = safety * 1.2 * largest_eigenvalue(model, u, second_power, v);
      result.force_evaluations += second_power;
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
    model.force(u, load, f);
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
    if (!(largest < model.largest_increment)) {
      result.diverged = true;
      return result;
    }
    const bool may_stop = n >= settle + 2 * lag && !std::isnan(omega_squared) &&
                          n - (two_level ? 0 : ramp) >= 2 * std::sqrt(step.lambda / omega_squared);
    calm = may_stop && result.error_estimate < options.tolerance_mm ? calm + 1 : 0;
    if (n % 10 == 0 || calm == options.consecutive_steps) {
      result.history.push_back({n + 1, may_stop ? result.error_estimate : nan, largest, step.rho});
      if (options.progress) {
        const double left = may_stop && result.error_estimate > options.tolerance_mm
                                ? std::log(result.error_estimate / options.tolerance_mm) / (1 - step.rho) : nan;
        options.progress({"relaxation", n + 1, may_stop ? result.error_estimate : nan, seconds(), left * seconds() / (n + 1)});
      }
    }
    if (calm >= options.consecutive_steps) {
      result.converged = true;
      break;
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
