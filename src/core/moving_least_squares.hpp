#pragma once
#include <vector>

#include "core/tensor.hpp"

namespace mtled {

/// Polynomials that the shape functions reproduce.
enum class Basis {
  linear,              ///< 1, x, y, z
  quadratic,           ///< all ten up to second order; needs wide supports
  modified_quadratic,  ///< quadratic terms with a penalty (Joldes, Chowdhury, Wittek, Doyle, Miller 2015): solvable
                       ///< whenever the linear one is
};

struct MlsOptions {
  Basis basis = Basis::linear;
  double dilatation = 1.75;      ///< support radius in node spacings (2.25 for the quadratic bases)
  int count = 0;                 ///< clouds that are no lattice: instead of the dilatation, nodes within the radius of a node; 0: none
  double quadratic_penalty = 0.05;  ///< of the modified basis, in coordinates scaled by the support radius
  double worst_condition() const { return basis == Basis::linear ? 100.0 : 1e4; }
  std::size_t smallest_support() const { return basis == Basis::linear ? 8 : 14; }
};

/// Values and gradients at one place; node numbers are the caller's.
struct ShapeFunctions {
  std::vector<int> node;
  std::vector<double> value;     ///< [1]
  std::vector<Vec3d> gradient;   ///< [1/mm]
  void clear() { node.clear(), value.clear(), gradient.clear(); }
  void add(int n, double v, const Vec3d& g) { node.push_back(n), value.push_back(v), gradient.push_back(g); }
};

/// Moving least squares (Lancaster & Salkauskas 1981) with quartic spline weight w(s) = 1 - 6 s^2 + 8 s^3 - 3 s^4,
/// s = |x - x_I| / radius, and full (not diffuse) derivatives. The basis is shifted to the evaluation point and scaled by
/// the radius. The penalty of the modified basis is a number in these coordinates, so it does not depend on units.
/// `neighbours`: node numbers, `relative`: their positions minus the evaluation point [mm]; nodes at or beyond the radius
/// take no part. With `own_radius` [neighbours] every node has a radius of its own [mm] for its weight (constant, so the
/// derivatives stay exact), and `radius` is that of the scaling only. Returns false, and leaves `shapes` empty, when fewer than smallest_support() nodes take part or the
/// moment matrix is worse conditioned than worst_condition().
bool moving_least_squares(const std::vector<int>& neighbours, const std::vector<Vec3d>& relative, double radius,
                          const MlsOptions& options, ShapeFunctions& shapes, const std::vector<double>* own_radius = nullptr);

}  // namespace mtled
