#pragma once
#include <cmath>

#include "core/host_device.hpp"
#include "core/tensor.hpp"

namespace mtled {

/// Moments of moving least squares at one place, of the weights and of the displacements: what u = sum_I phi_I u_I needs when no
/// shape functions are asked for. With the basis p shifted to the place, A = sum w p p^T and B = sum w p u^T give
/// u = e0^T A^-1 B. M: 4 (1, q) or 10 (and the products of q).
template <int M>
class Moments {
 public:
  /// A node at q = (x_I - x) / radius with weight w and displacement u.
  MTLED_HD void add(double w, const Vec3d& q, const Vec3d& u) {
    double p[M];
    p[0] = 1, p[1] = q.x, p[2] = q.y, p[3] = q.z;
    if constexpr (M == 10) {
      p[4] = q.x * q.x, p[5] = q.y * q.y, p[6] = q.z * q.z;
      p[7] = q.x * q.y, p[8] = q.y * q.z, p[9] = q.z * q.x;
    }
    for (int r = 0, e = 0; r < M; ++r) {
      const double wp = w * p[r];
      B[r] += wp * u;
      for (int c = 0; c <= r; ++c, ++e) A[e] += wp * p[c];
    }
  }

  /// u; false when the condition of A, with `penalty` on its quadratic terms, may be worse than `worst_condition`. Its bound is
  /// trace(A) trace(A^-1), of which moving_least_squares() accepts the same places, and others by their eigenvalues.
  MTLED_HD bool solve(double penalty, double worst_condition, Vec3d& u) {
    // Cholesky: A = L L^T, and u = (L^-1 e0)^T (L^-1 B).
    if constexpr (M == 10)
      for (int k = 4; k < M; ++k) A[at(k, k)] += penalty;
    double trace = 0;
    for (int r = 0; r < M; ++r) trace += A[at(r, r)];
    double inverse_pivot[M];
    for (int c = 0; c < M; ++c) {
      double pivot = A[at(c, c)];
      for (int k = 0; k < c; ++k) pivot -= A[at(c, k)] * A[at(c, k)];
      if (!(pivot > 0)) return false;
      inverse_pivot[c] = 1 / std::sqrt(pivot);
      for (int r = c + 1; r < M; ++r) {
        double sum = A[at(r, c)];
        for (int k = 0; k < c; ++k) sum -= A[at(r, k)] * A[at(c, k)];
        A[at(r, c)] = sum * inverse_pivot[c];
      }
    }
    // trace(A^-1) is the sum of squares of L^-1, column by column; the first column is L^-1 e0.
    double trace_of_inverse = 0;
    u = {};
    for (int c = 0; c < M; ++c) {
      double column[M];
      for (int r = c; r < M; ++r) {
        double sum = r == c ? 1 : 0;
        for (int k = c; k < r; ++k) sum -= A[at(r, k)] * column[k];
        column[r] = sum * inverse_pivot[r];
        trace_of_inverse += column[r] * column[r];
      }
      if (c > 0) continue;
      for (int r = 0; r < M; ++r) {
        for (int k = 0; k < r; ++k) B[r] -= A[at(r, k)] * B[k];
        B[r] = inverse_pivot[r] * B[r];
        u += column[r] * B[r];
      }
    }
    constexpr double rounding = 1e-9;
    return trace * trace_of_inverse <= (1 - rounding) * worst_condition;
  }

 private:
  static constexpr MTLED_HD int at(int row, int column) { return row * (row + 1) / 2 + column; }
  double A[M * (M + 1) / 2] = {};  ///< lower triangle, row by row
  Vec3d B[M] = {};
};

}  // namespace mtled
