#pragma once
#include <cmath>

#include "core/tensor.hpp"

namespace mtled {

/// Volume ratios below this value are treated as this value in the isochoric part: a point that inverts on the way can
/// come back; that it is there is found by the solver (inverted points are counted).
inline constexpr float smallest_isochoric_volume_ratio = 0.05f;

MTLED_HD inline float inverse_cube_root(float x) { return 1.0f / cbrtf(x); }
MTLED_HD inline double inverse_cube_root(double x) { return 1.0 / cbrt(x); }
MTLED_HD inline float at_least(float x, float floor) { return x > floor ? x : floor; }
MTLED_HD inline double at_least(double x, float floor) { return x > floor ? x : floor; }

/// k of Poisson ratio nu in [0, 0.5): k = 2 mu (1 + nu) / (3 (1 - 2 nu)) [kPa].
MTLED_HD inline double bulk_modulus(double shear_modulus, double poisson_ratio) {
  return 2 * shear_modulus * (1 + poisson_ratio) / (3 * (1 - 2 * poisson_ratio));
}

/// Nearly incompressible neo-Hookean solid, W = mu/2 (J^(-2/3) I1 - 3) + k/2 (J - 1)^2 [kPa = mN mm / mm^3],
/// J = det F, I1 = tr(F^T F). T is a scalar, or a pack of scalars where core/lanes.hpp was included before this header
/// (packs are built-in types, so their functions must be known by then).
template <class T>
struct NeoHookean {
  T shear_modulus;  ///< mu [kPa]
  T bulk_modulus;   ///< k [kPa]

  /// First Piola-Kirchhoff stress P = dW/dF = mu J^(-2/3) (F - I1/3 F^-T) + k (J - 1) J F^-T [kPa]; `volume_ratio` = J.
  MTLED_HD Mat3<T> stress(const Mat3<T>& F, T& volume_ratio) const {
    const Mat3<T> cof = cofactors(F);  // J F^-T
    const T J = F[0][0] * cof[0][0] + F[0][1] * cof[0][1] + F[0][2] * cof[0][2];
    volume_ratio = J;
    const T Ji = at_least(J, smallest_isochoric_volume_ratio);
    const T r = inverse_cube_root(Ji);
    const T a = shear_modulus * r * r;
    const T b = bulk_modulus * (J - 1) - a * first_invariant(F) * (r * r * r) * ((T{} + 1) / 3);
    Mat3<T> P;
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) P[i][j] = a * F[i][j] + b * cof[i][j];
    return P;
  }

  /// Directional derivative of stress(): dP = d2W/dF2 : dF [kPa]. At F = I this is linear elasticity.
  MTLED_HD Mat3<T> stress_derivative(const Mat3<T>& F, const Mat3<T>& dF) const {
    const Mat3<T> cof = cofactors(F);
    const T J = F[0][0] * cof[0][0] + F[0][1] * cof[0][1] + F[0][2] * cof[0][2];
    const T Ji = at_least(J, smallest_isochoric_volume_ratio);
    const T r = inverse_cube_root(Ji), third = (T{} + 1) / 3;
    const T a = shear_modulus * r * r, I1 = first_invariant(F), inverse_J = r * r * r;
    const T b = bulk_modulus * (J - 1) - a * I1 * inverse_J * third;
    T dJ = T{}, dI1 = T{};
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) dJ += cof[i][j] * dF[i][j], dI1 += 2 * F[i][j] * dF[i][j];
    const T da = -2 * third * a * inverse_J * dJ;
    const T db = bulk_modulus * dJ - third * inverse_J * (da * I1 + a * dI1 - a * I1 * inverse_J * dJ);
    Mat3<T> dP;
    for (int i = 0; i < 3; ++i) {
      const int p = (i + 1) % 3, q = (i + 2) % 3;
      for (int j = 0; j < 3; ++j) {
        const int s = (j + 1) % 3, t = (j + 2) % 3;
        const T dcof = dF[p][s] * F[q][t] + F[p][s] * dF[q][t] - dF[p][t] * F[q][s] - F[p][t] * dF[q][s];
        dP[i][j] = da * F[i][j] + a * dF[i][j] + db * cof[i][j] + b * dcof;
      }
    }
    return dP;
  }

  /// W [kPa].
  MTLED_HD T energy(const Mat3<T>& F) const {
    const T J = determinant(F);
    const T r = inverse_cube_root(at_least(J, smallest_isochoric_volume_ratio));
    return (shear_modulus * (r * r * first_invariant(F) - 3) + bulk_modulus * (J - 1) * (J - 1)) / 2;
  }

  MTLED_HD static T first_invariant(const Mat3<T>& F) {
    T sum = T{};
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) sum += F[i][j] * F[i][j];
    return sum;
  }
};

}  // namespace mtled
