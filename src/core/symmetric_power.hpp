#pragma once
#include "core/dual.hpp"
#include "core/tensor.hpp"

// Functions of scalars; those of packs are in core/lanes.hpp, which must come first where packs are used.
namespace mtled {

MTLED_HD inline float at_least(float x, float floor) { return x > floor ? x : floor; }
MTLED_HD inline double at_least(double x, float floor) { return x > floor ? x : floor; }
MTLED_HD inline float square_root(float x) { return sqrtf(x); }
MTLED_HD inline double square_root(double x) { return sqrt(x); }
MTLED_HD inline float power(float x, float exponent) { return powf(x, exponent); }
MTLED_HD inline double power(double x, double exponent) { return pow(x, exponent); }
/// Fifth root of the rounding unit: see divided_difference().
MTLED_HD inline float near_coincidence(float) { return 0.04f; }
MTLED_HD inline float near_coincidence(double) { return 7e-4f; }

/// Eigenvalues and eigenvectors (columns) of a symmetric matrix.
template <class T>
struct SymmetricEigen {
  Vec3<T> value;
  Mat3<T> vector;
};

/// By cyclic Jacobi rotations, a fixed number without branches, so that packs can do it: coincident eigenvalues are no
/// special case, and the vectors are orthonormal to rounding. After 5 sweeps the rest is below rounding also in double.
template <class T>
MTLED_HD SymmetricEigen<T> symmetric_eigen(Mat3<T> A) {
  constexpr int sweeps = 5;
  Mat3<T> V;
  for (int i = 0; i < 3; ++i) V[i][i] += 1;
  for (int n = 0; n < 3 * sweeps; ++n) {
    const int p = n % 3, q = (n + 1) % 3, r = (n + 2) % 3;
    const T d = A[q][q] - A[p][p], o = 2 * A[p][q];
    const T length = square_root(d * d + o * o) + (d < 0 ? -d : d);
    const T t = (d < 0 ? -o : o) / (length + 1e-30f);  // tangent of the angle that makes A[p][q] vanish
    const T c = 1 / square_root(1 + t * t), s = t * c;
    const T pp = A[p][p], qq = A[q][q], pq = A[p][q], pr = A[p][r], qr = A[q][r];
    A[p][p] = c * c * pp - 2 * c * s * pq + s * s * qq;
    A[q][q] = s * s * pp + 2 * c * s * pq + c * c * qq;
    A[p][q] = A[q][p] = c * s * (pp - qq) + (c * c - s * s) * pq;
    A[p][r] = A[r][p] = c * pr - s * qr;
    A[q][r] = A[r][q] = s * pr + c * qr;
    for (int i = 0; i < 3; ++i) {
      const T vp = V[i][p], vq = V[i][q];
      V[i][p] = c * vp - s * vq;
      V[i][q] = s * vp + c * vq;
    }
  }
  return {{A[0][0], A[1][1], A[2][2]}, V};
}

/// (x^p - y^p) / (x - y), given the powers; for x near y by a series, whose first neglected term is as small as the
/// rounding of the difference at the limit between the two.
template <class T>
MTLED_HD T divided_difference(const T& x, const T& y, const T& x_power, const T& y_power, const T& p) {
  const T m = (x + y) / 2, d = (x - y) / 2, q = d / m;
  const T slope = p * (x_power / x + y_power / y) / 2;
  const T series = slope * (1 - (p - 1) * (p - 2) * q * q / 3);
  const auto coincide = q * q < near_coincidence(q) * near_coincidence(q);
  const T distance = coincide ? m : x - y;  // no division by zero
  return coincide ? series : (x_power - y_power) / distance;
}

/// C^p of a symmetric positive matrix; eigenvalues below `floor` count as `floor`.
template <class T>
MTLED_HD Mat3<T> symmetric_power(const Mat3<T>& C, const T& p, float floor) {
  const SymmetricEigen<T> eigen = symmetric_eigen(C);
  Mat3<T> scaled;
  for (int j = 0; j < 3; ++j) {
    const T g = power(at_least(eigen.value[j], floor), p);
    for (int i = 0; i < 3; ++i) scaled[i][j] = eigen.vector[i][j] * g;
  }
  return scaled * transpose(eigen.vector);
}

/// With its derivative for constant p, V (G o V^T dC V) V^T with the divided differences G (Daleckii and Krein 1965).
template <class T>
MTLED_HD Mat3<Dual<T>> symmetric_power(const Mat3<Dual<T>>& C, const Dual<T>& exponent, float floor) {
  const T p = exponent.value;
  Mat3<T> value, derivative;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) value[i][j] = C[i][j].value, derivative[i][j] = C[i][j].derivative;
  const SymmetricEigen<T> eigen = symmetric_eigen(value);
  const Mat3<T>& V = eigen.vector;
  Vec3<T> e, g;
  Mat3<T> scaled;
  for (int j = 0; j < 3; ++j) {
    e[j] = at_least(eigen.value[j], floor), g[j] = power(e[j], p);
    for (int i = 0; i < 3; ++i) scaled[i][j] = V[i][j] * g[j];
  }
  Mat3<T> inner = transpose(V) * derivative * V;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) inner[i][j] *= divided_difference(e[i], e[j], g[i], g[j], p);
  value = scaled * transpose(V), derivative = V * inner * transpose(V);
  Mat3<Dual<T>> result;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) result[i][j] = {value[i][j], derivative[i][j]};
  return result;
}

}  // namespace mtled
