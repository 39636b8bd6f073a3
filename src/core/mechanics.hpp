#pragma once
#include <memory>
#include <vector>

#include "core/discrete_model.hpp"
#include "core/step_control.hpp"
#include "core/volume_ratio.hpp"

namespace mtled {

/// Three components per slot, kept where a backend computes. Only the backend that made it can read it.
struct Vector {
  virtual ~Vector() = default;
};
using VectorPointer = std::unique_ptr<Vector>;

/// What relaxation and the linear-elastic start need of a discrete model, computed by a backend: forces, their tangent, the
/// preconditioner, constraints and sums. All calls give the same bits in every run. Vectors start at zero.
class Mechanics {
 public:
  virtual ~Mechanics() = default;

  virtual VectorPointer vector() const = 0;
  /// From and to host memory: [num_slots] [mm].
  virtual void upload(const std::vector<Vec3d>& values, Vector& to) const = 0;
  virtual std::vector<Vec3d> download(const Vector& from) const = 0;
  virtual void copy(const Vector& from, Vector& to) const = 0;
  virtual void clear(Vector& y) const = 0;
  /// y = a x + b y
  virtual void combine(Vector& y, double a, const Vector& x, double b) const = 0;
  /// Sum of products, in double.
  virtual double dot(const Vector& a, const Vector& b) const = 0;

  /// f = internal force [mN] at displacement u [mm], the springs' at `load` of their targets included, less `load` times
  /// the external force.
  virtual VolumeRatioStatistics force(const Vector& u, double load, Vector& f) const = 0;
  /// f = K(u) v [mN]
  virtual void tangent(const Vector& u, const Vector& v, Vector& f) const = 0;
  /// Sets the prescribed parameters of u for `load` (0..1) times the prescribed displacement.
  virtual void impose(Vector& u, double load) const = 0;
  /// Reduces a force to the free parameters; prescribed entries become zero.
  virtual void reduce(Vector& f) const = 0;

  /// g = P f: the inverse of the model's diagonal, plus the coarse correction of a two-level model.
  virtual void precondition(const Vector& f, Vector& g) const = 0;
  /// g = D d with the model's diagonal D; 0 where not active.
  virtual void multiply_by_diagonal(const Vector& d, Vector& g) const = 0;
  /// Assembles and inverts the coarse matrix at displacement u. Two-level models only.
  virtual void assemble_coarse(const Vector& u) = 0;

  /// Up to `count` steps of the heavy-ball iteration, fewer when `control` stops them:
  ///   increment = rho^2 increment - (1 + rho)^2 / lambda P f(u),  u += increment,  change += increment.
  /// The increment is kept apart from u because in single precision the difference of two u would lose it. The load of each
  /// step follows from `control`; prescribed parameters are imposed before a step up to control.ramp, and before every step
  /// where they depend on free ones.
  virtual void steps(int count, const StepSizes& sizes, StepControl& control, Vector& u, Vector& increment, Vector& change) = 0;

  /// Strain energy [mN mm] without springs, in double sums.
  virtual double strain_energy(const Vector& u) const = 0;
  /// Largest component of the field with parameters x at the watched nodes [mm].
  virtual double largest_displacement(const Vector& x) const = 0;

  virtual int coarse_unknowns() const = 0;  ///< 0: diagonal preconditioner only
  virtual double bytes() const = 0;         ///< of tables and state, with the working vectors of the relaxation
};

}  // namespace mtled
