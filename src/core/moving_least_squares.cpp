#include "core/moving_least_squares.hpp"

#include <Eigen/Dense>

namespace mtled {
namespace {

/// Basis at q = (x_I - x) / radius; at the evaluation point itself it is (1, 0, ..., 0).
template <int M>
Eigen::Matrix<double, M, 1> basis_at(const Vec3d& q) {
  Eigen::Matrix<double, M, 1> p;
  p[0] = 1, p[1] = q.x, p[2] = q.y, p[3] = q.z;
  if constexpr (M == 10) {
    p[4] = q.x * q.x, p[5] = q.y * q.y, p[6] = q.z * q.z;
    p[7] = q.x * q.y, p[8] = q.y * q.z, p[9] = q.z * q.x;
  }
  return p;
}

/// Ratio of the extreme eigenvalues of a symmetric positive matrix; infinite when it is not positive.
template <int M>
double condition(const Eigen::Matrix<double, M, M>& A) {
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix<double, M, M>> eigen(A, Eigen::EigenvaluesOnly);
  const double low = eigen.eigenvalues()[0], high = eigen.eigenvalues()[M - 1];
  return low > 0 ? high / low : std::numeric_limits<double>::infinity();
}

/// Condition numbers are costly; the product of the trace and the trace of the inverse bounds them from above.
template <int M>
bool well_conditioned(const Eigen::Matrix<double, M, M>& A, const Eigen::Matrix<double, M, M>& inverse, double worst) {
  const double bound = A.trace() * inverse.trace();
  return std::isfinite(bound) && bound > 0 && (bound <= worst || condition<M>(A) <= worst);
}

template <int M>
bool evaluate(const std::vector<int>& neighbours, const std::vector<Vec3d>& relative, double radius,
              const MlsOptions& options, ShapeFunctions& shapes, const std::vector<double>* own_radius) {
  using Vector = Eigen::Matrix<double, M, 1>;
  using Matrix = Eigen::Matrix<double, M, M>;
  shapes.clear();
  // With the shifted basis, gamma = A^-1 e0 and gamma_k = A^-1 (e_k / r - A_k gamma) give
  // phi_I = w_I gamma.p_I and phi_I,k = w_I gamma_k.p_I + w_I,k gamma.p_I.
  Matrix A = Matrix::Zero();
  Matrix dA[3] = {Matrix::Zero(), Matrix::Zero(), Matrix::Zero()};
  const double inverse_radius = 1 / radius;
  for (std::size_t i = 0; i < neighbours.size(); ++i) {
    const double inverse_own = own_radius ? 1 / (*own_radius)[i] : inverse_radius, s = norm(relative[i]) * inverse_own;
    if (s >= 1) continue;
    const double w = 1 + s * s * (-6 + s * (8 - 3 * s));
    // dw/dx = (-12 + 24 s - 12 s^2) (x - x_I) / r^2
    const Vec3d dw = (12 - 24 * s + 12 * s * s) * inverse_own * inverse_own * relative[i];
    const Vector p = basis_at<M>(inverse_radius * relative[i]);
    const Matrix pp = p * p.transpose();
    A += w * pp;
    for (int k = 0; k < 3; ++k) dA[k] += dw[k] * pp;
    shapes.add(neighbours[i], w, dw);
  }
  if constexpr (M == 10)
    if (options.basis == Basis::modified_quadratic)
      for (int k = 4; k < 10; ++k) A(k, k) += options.quadratic_penalty;
  if (shapes.node.size() < options.smallest_support()) return shapes.clear(), false;
  const Matrix inverse = A.inverse();
  if (!well_conditioned<M>(A, inverse, options.worst_condition())) return shapes.clear(), false;
  const Vector gamma = inverse.col(0);
  Vector gamma_k[3];
  for (int k = 0; k < 3; ++k) gamma_k[k] = inverse * (Vector::Unit(k + 1) * inverse_radius - dA[k] * gamma);
  std::size_t out = 0;
  for (std::size_t i = 0; i < neighbours.size(); ++i) {
    if (norm(relative[i]) * (own_radius ? 1 / (*own_radius)[i] : inverse_radius) >= 1) continue;
    const Vector p = basis_at<M>(inverse_radius * relative[i]);
    const double w = shapes.value[out], gp = gamma.dot(p);
    const Vec3d dw = shapes.gradient[out];
    shapes.value[out] = w * gp;
    for (int k = 0; k < 3; ++k) shapes.gradient[out][k] = w * gamma_k[k].dot(p) + dw[k] * gp;
    ++out;
  }
  return true;
}

}  // namespace

bool moving_least_squares(const std::vector<int>& neighbours, const std::vector<Vec3d>& relative, double radius,
                          const MlsOptions& options, ShapeFunctions& shapes, const std::vector<double>* own_radius) {
  return options.basis == Basis::linear ? evaluate<4>(neighbours, relative, radius, options, shapes, own_radius)
                                        : evaluate<10>(neighbours, relative, radius, options, shapes, own_radius);
}

}  // namespace mtled
