#include "core/relaxation.hpp"

#include <chrono>
#include <cmath>
#include <limits>

#include "core/error.hpp"

namespace mtled {
namespace {

constexpr double nan = std::numeric_limits<double>::quiet_NaN();

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

/// body(component pointers..., begin, end) over pieces of every component.
template <class Real, class Body>
void each_component(const NodalField<Real>& like, Body&& body) {
  parallel_pieces(like.slots(), 16384, [&](std::size_t begin, std::size_t end) {
    for (int c = 0; c < 3; ++c) body(c, begin, end);
  });
}

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

/// Largest eigenvalue of P K(u) by power iteration, with Rayleigh quotients in the energy norm of K. The result is a
/// lower bound that is within a few percent after 20 iterations. `v` is the start vector and the eigenvector on return.
template <class Real>
double largest_eigenvalue(const SlotModel<Real>& model, const NodalField<Real>& u, int iterations, NodalField<Real>& v) {
  NodalField<Real> f(u.slots()), g(u.slots());
  double lambda = 0;
  for (int i = 0; i < iterations; ++i) {
    model.constraints->impose(v, 0);
    model.forces->tangent(u, v, f);
    model.constraints->reduce(f);
    precondition(model, f, g);
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

/// A rough vector that contains every mode; the same in every run.
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

struct StepSizes {
  double rho = 0.7, lambda = 1;
};

/// One step; returns the largest |u+ - u| over the watched nodes. `previous` holds u- and receives u+, then the two swap.
template <class Real>
double advance(const SlotModel<Real>& model, const StepSizes& step, const NodalField<Real>& g, NodalField<Real>& u, NodalField<Real>& previous) {
  const Real inertia = Real(step.rho * step.rho), scale = Real((1 + step.rho) * (1 + step.rho) / step.lambda);
  constexpr std::size_t piece = 16384;
  std::vector<Real> largest((u.slots() + piece - 1) / piece);
  parallel_pieces(u.slots(), piece, [&](std::size_t begin, std::size_t end) {
    Real top = 0;
    for (int c = 0; c < 3; ++c) {
      const Real *now = u.component(c), *push = g.component(c);
      Real* old = previous.component(c);
      const std::uint8_t* watched = model.watched.data();
      for (std::size_t s = begin; s < end; ++s) {
        const Real increment = inertia * (now[s] - old[s]) - scale * push[s];
        old[s] = now[s] + increment;
        const Real size = watched[s] ? std::abs(increment) : Real(0);
        top = size > top || size != size ? size : top;
      }
    }
    largest[begin / piece] = top;
  });
  u.swap(previous);
  double top = 0;
  for (Real x : largest)
    if (!(x <= top)) top = double(x);
  return top;
}

/// Estimates the smallest eigenvalue of P K from what changed between saved states, and the optimal rho from it.
template <class Real>
class RateEstimate {
 public:
  explicit RateEstimate(std::size_t slots) : u_(slots), f_(slots), g_(slots), du_(slots), df_(slots), dg_(slots) {}
  void save(const NodalField<Real>& u, const NodalField<Real>& f, const NodalField<Real>& g) {
    u_.copy_from(u), f_.copy_from(f), g_.copy_from(g);
    saved_ = true;
  }
  bool saved() const { return saved_; }
  /// df.P df / du.df since save(), or NaN where it says nothing.
  double sample(const NodalField<Real>& u, const NodalField<Real>& f, const NodalField<Real>& g) {
    subtract(u, u_, du_), subtract(f, f_, df_), subtract(g, g_, dg_);
    const double uf = dot(du_, df_), fg = dot(df_, dg_);
    return uf > 0 && fg > 0 ? fg / uf : nan;
  }

 private:
  static void subtract(const NodalField<Real>& a, const NodalField<Real>& b, NodalField<Real>& d) {
    each_component(a, [&](int c, std::size_t begin, std::size_t end) {
      const Real *x = a.component(c), *y = b.component(c);
      Real* to = d.component(c);
      for (std::size_t s = begin; s < end; ++s) to[s] = x[s] - y[s];
    });
  }
  NodalField<Real> u_, f_, g_, du_, df_, dg_;
  bool saved_ = false;
};

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
  model.forces->tangent(state, p, Kp);
  model.forces->force(state, r);
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
    model.forces->tangent(state, p, Kp);
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

namespace {

enum class End { converged, exhausted, diverged };

/// One try with the largest eigenvalue taken `safety` times its estimate.
template <class Real>
End attempt_relaxation(const SlotModel<Real>& model, const SolverOptions& options, double safety, RelaxationResult& result, NodalField<Real>& u) {
  const bool two_level = model.coarse != nullptr;
  const int lag = two_level ? 20 : 40;
  const int ramp = two_level ? 0 : options.load_steps > 0 ? options.load_steps : std::max(200, int(12 * model.largest_distance));
  const int settle = two_level ? 60 : ramp + 40;  ///< no estimate of the rate before
  const auto started = std::chrono::steady_clock::now();
  const auto seconds = [&] { return std::chrono::duration<double>(std::chrono::steady_clock::now() - started).count(); };

  NodalField<Real> v = rough_vector(model), previous(u.slots()), f(u.slots()), g(u.slots());
  constexpr int first_power = 20, second_power = 30;
  StepSizes step;
  step.lambda = safety * 1.4 * largest_eigenvalue(model, u, first_power, v);
  result.force_evaluations += first_power;
  step.rho = two_level ? 0.7 : 0.97;
  previous.copy_from(u);
  RateEstimate<Real> rate(u.slots());
  double omega_squared = nan;
  std::deque<double> recent;
  int calm = 0, saved_at = -1;
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
    model.forces->force(u, f);
    ++result.force_evaluations;
    model.constraints->reduce(f);
    precondition(model, f, g);
    if (n >= settle) {
      if (rate.saved() && n - saved_at == lag) {
        const double sample = rate.sample(u, f, g);
        if (sample > 0 && !(omega_squared <= sample)) {
          omega_squared = sample;
          step.rho = std::max(step.rho, optimal_rho(omega_squared, step.lambda));
        }
      }
      if (!rate.saved() || n - saved_at == lag) rate.save(u, f, g), saved_at = n;
    } else if (two_level) {
      step.rho = n < 40 ? 0.7 : 0.9;
    }
    const double increment = advance(model, step, g, u, previous);
    result.steps = n + 1;
    recent.push_back(increment);
    if (recent.size() > 10) recent.pop_front();
    const double recent_max = *std::max_element(recent.begin(), recent.end());
    const double slow = step.rho + 0.2 * (1 - step.rho);
    result.error_estimate = slow / (1 - slow) * recent_max;
    if (!(increment < model.largest_increment)) return End::diverged;
    const bool may_stop = n >= settle + 2 * lag && !std::isnan(omega_squared) &&
                          n - (two_level ? 0 : ramp) >= 2 * std::sqrt(step.lambda / omega_squared);
    calm = may_stop && result.error_estimate < options.tolerance_mm ? calm + 1 : 0;
    if (n % 10 == 0 || calm == options.consecutive_steps) {
      result.history.push_back({n + 1, may_stop ? result.error_estimate : nan, increment, step.rho});
      if (options.progress) {
        const double left = may_stop && result.error_estimate > options.tolerance_mm
                                ? std::log(result.error_estimate / options.tolerance_mm) / (1 - step.rho) : nan;
        options.progress({"relaxation", n + 1, may_stop ? result.error_estimate : nan, seconds(), left * seconds() / (n + 1)});
      }
    }
    if (calm >= options.consecutive_steps) {
      model.constraints->impose(u, 1);
      return End::converged;
    }
  }
  model.constraints->impose(u, 1);
  return End::exhausted;
}

}  // namespace

template <class Real>
RelaxationResult relax(const SlotModel<Real>& model, const SolverOptions& options, NodalField<Real>& u) {
  NodalField<Real> start(u.slots());
  start.copy_from(u);
  RelaxationResult result;
  for (double safety : {1.0, 2.0, 4.0}) {
    u.copy_from(start);
    result.history.clear();
    const End end = attempt_relaxation(model, options, safety, result, u);
    if (end == End::diverged) continue;
    result.converged = end == End::converged;
    return result;
  }
  fail(Failure::numerical, "the solution diverged at step ", result.steps, ", also with a time step half as long; "
       "the prescribed motions deform the body too strongly between some nodes: check them, or use a smaller node spacing");
}

template RelaxationResult relax<float>(const SlotModel<float>&, const SolverOptions&, NodalField<float>&);
template RelaxationResult relax<double>(const SlotModel<double>&, const SolverOptions&, NodalField<double>&);
template int advance_load<float>(const SlotModel<float>&, double, double, NodalField<float>&);
template int advance_load<double>(const SlotModel<double>&, double, double, NodalField<double>&);

}  // namespace mtled
