#pragma once
#include <cmath>
#include <cstring>
#include <type_traits>

#include "core/dual.hpp"
#include "core/symmetric_power.hpp"
#include "core/tensor.hpp"

namespace mtled {

/// Volume ratios below this value are treated as this value in the isochoric part: a point that inverts on the way can
/// come back; that it is there is found by the solver (inverted points are counted).
inline constexpr float smallest_isochoric_volume_ratio = 0.05f;

MTLED_HD inline float inverse_cube_root(float x) {
#if defined(__CUDA_ARCH__)
  return rcbrtf(x);  // within 1 ulp, and without a division
#else
  return 1.0f / cbrtf(x);
#endif
}
MTLED_HD inline double inverse_cube_root(double x) { return 1.0 / cbrt(x); }
template <class T>
MTLED_HD Dual<T> inverse_cube_root(const Dual<T>& x) {
  const T r = inverse_cube_root(x.value);
  return {r, -(r / x.value) * x.derivative / 3};
}
template <class T>
MTLED_HD Dual<T> at_least(const Dual<T>& x, float floor) {
  return {at_least(x.value, floor), x.value > floor ? x.derivative : T{}};
}

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

/// What the further materials share: their energies are functions of the isochoric C~ = J^(-2/3) F^T F, plus the volumetric
/// k/2 (J - 1)^2 of NeoHookean. J in the isochoric part is at least smallest_isochoric_volume_ratio.
template <class T>
struct Kinematics {
  Mat3<T> cof;      ///< J F^-T
  T J, r, I1;       ///< det F, J^(-1/3), tr(C~)
  MTLED_HD explicit Kinematics(const Mat3<T>& F) : cof(cofactors(F)) {
    J = F[0][0] * cof[0][0] + F[0][1] * cof[0][1] + F[0][2] * cof[0][2];
    r = inverse_cube_root(at_least(J, smallest_isochoric_volume_ratio));
    I1 = r * r * NeoHookean<T>::first_invariant(F);
  }
  /// C~
  MTLED_HD Mat3<T> isochoric(const Mat3<T>& F) const {
    Mat3<T> C = transpose(F) * F;
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) C[i][j] = r * r * C[i][j];
    return C;
  }
  /// P = J^(-2/3) F S~ - (C~ : S~) / 3 F^-T + k (J - 1) J F^-T for the fictitious stress S~ = 2 dW/dC~, given F S~ and C~ : S~
  /// (Holzapfel 2000, section 6.4).
  MTLED_HD Mat3<T> stress(const Mat3<T>& FS, const T& CS, const T& bulk_modulus) const {
    const T b = bulk_modulus * (J - 1) - CS * (r * r * r) / 3;
    Mat3<T> P;
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) P[i][j] = r * r * FS[i][j] + b * cof[i][j];
    return P;
  }
  MTLED_HD T volumetric_energy(const T& bulk_modulus) const { return bulk_modulus * (J - 1) * (J - 1) / 2; }
};

template <class T>
MTLED_HD Mat3<T> scaled(const T& s, const Mat3<T>& A) {
  Mat3<T> B;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) B[i][j] = s * A[i][j];
  return B;
}
template <class T>
MTLED_HD T contraction(const Mat3<T>& A, const Mat3<T>& B) {
  T sum = T{};
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) sum += A[i][j] * B[i][j];
  return sum;
}

/// Mooney-Rivlin, W = c10 (I1~ - 3) + c01 (I2~ - 3) + k/2 (J - 1)^2 [kPa] with I2~ = ((tr C~)^2 - tr C~^2) / 2 and
/// mu = 2 (c10 + c01).
template <class T>
struct MooneyRivlin {
  T shear_modulus, bulk_modulus;  ///< at rest [kPa]
  T c01;                          ///< [kPa]

  MTLED_HD Mat3<T> stress(const Mat3<T>& F, T& volume_ratio) const {
    const Kinematics<T> k(F);
    volume_ratio = k.J;
    const Mat3<T> C = k.isochoric(F), FC = F * C;
    const T a = shear_modulus + 2 * c01 * (k.I1 - 1), b = 2 * c01;  // S~ = a I - b C~
    Mat3<T> FS;
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) FS[i][j] = a * F[i][j] - b * FC[i][j];
    return k.stress(FS, a * k.I1 - b * contraction(C, C), bulk_modulus);
  }
  MTLED_HD T energy(const Mat3<T>& F) const {
    const Kinematics<T> k(F);
    const Mat3<T> C = k.isochoric(F);
    const T I2 = (k.I1 * k.I1 - contraction(C, C)) / 2;
    return (shear_modulus / 2 - c01) * (k.I1 - 3) + c01 * (I2 - 3) + k.volumetric_energy(bulk_modulus);
  }
};

/// Yeoh, W = mu/2 y + c2 y^2 + c3 y^3 + k/2 (J - 1)^2 [kPa], y = I1~ - 3; c1 = mu/2.
template <class T>
struct Yeoh {
  T shear_modulus, bulk_modulus;  ///< at rest [kPa]
  T c2, c3;                       ///< [kPa]

  MTLED_HD Mat3<T> stress(const Mat3<T>& F, T& volume_ratio) const {
    const Kinematics<T> k(F);
    volume_ratio = k.J;
    const T y = k.I1 - 3, a = shear_modulus + y * (4 * c2 + 6 * c3 * y);  // S~ = a I
    return k.stress(scaled(a, F), a * k.I1, bulk_modulus);
  }
  MTLED_HD T energy(const Mat3<T>& F) const {
    const Kinematics<T> k(F);
    const T y = k.I1 - 3;
    return y * (shear_modulus / 2 + y * (c2 + y * c3)) + k.volumetric_energy(bulk_modulus);
  }
};

/// One-term Ogden, W = 2 mu / a^2 (sum_i lambda_i~^a - 3) + k/2 (J - 1)^2 [kPa]; lambda_i~^2 are the eigenvalues of C~.
template <class T>
struct Ogden {
  T shear_modulus, bulk_modulus;  ///< at rest [kPa]
  T exponent;                     ///< a != 0

  MTLED_HD Mat3<T> stress(const Mat3<T>& F, T& volume_ratio) const {
    const Kinematics<T> k(F);
    volume_ratio = k.J;
    const Mat3<T> C = k.isochoric(F), S = scaled(2 * shear_modulus / exponent, power_of(C));
    return k.stress(F * S, contraction(C, S), bulk_modulus);
  }
  MTLED_HD T energy(const Mat3<T>& F) const {
    const Kinematics<T> k(F);
    const Mat3<T> C = k.isochoric(F);
    return 2 * shear_modulus / (exponent * exponent) * (contraction(C, power_of(C)) - 3) + k.volumetric_energy(bulk_modulus);
  }
  /// C~^(a/2 - 1). Stretches count as at least smallest_isochoric_volume_ratio, so that flattened points stay finite.
  MTLED_HD Mat3<T> power_of(const Mat3<T>& C) const {
    return symmetric_power(C, exponent / 2 - 1, smallest_isochoric_volume_ratio * smallest_isochoric_volume_ratio);
  }
};

/// Neo-Hookean with one family of fibres, W = NeoHookean + eta/2 (I4~ - 1)^2 [kPa], I4~ = a . C~ a with the fibre a at rest
/// (as in NiftySim, whose parameter is 2 eta).
template <class T>
struct TransverselyIsotropic {
  T shear_modulus, bulk_modulus;  ///< of the matrix, at rest [kPa]
  T fibre_modulus;                ///< eta [kPa]
  Vec3<T> fibre;                  ///< unit vector a

  MTLED_HD Mat3<T> stress(const Mat3<T>& F, T& volume_ratio) const {
    const Kinematics<T> k(F);
    volume_ratio = k.J;
    const Vec3<T> stretched = F * fibre;
    const T I4 = k.r * k.r * squared_norm(stretched), c = 2 * fibre_modulus * (I4 - 1);  // S~ = mu I + c a (x) a
    Mat3<T> FS;
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) FS[i][j] = shear_modulus * F[i][j] + c * stretched[i] * fibre[j];
    return k.stress(FS, shear_modulus * k.I1 + c * I4, bulk_modulus);
  }
  MTLED_HD T energy(const Mat3<T>& F) const {
    const Kinematics<T> k(F);
    const T I4 = k.r * k.r * squared_norm(F * fibre);
    return (shear_modulus * (k.I1 - 3) + fibre_modulus * (I4 - 1) * (I4 - 1)) / 2 + k.volumetric_energy(bulk_modulus);
  }
};

/// A material is its parameters one after the other: mu, k and the further ones.
template <template <class> class Material>
inline constexpr int parameter_count = sizeof(Material<double>) / sizeof(double);
template <template <class> class Material, class T>
MTLED_HD Material<T> material_of(const T* parameters) {
  static_assert(std::is_trivially_copyable_v<Material<T>> && sizeof(Material<T>) == parameter_count<Material> * sizeof(T));
  Material<T> material;
  memcpy(static_cast<void*>(&material), parameters, sizeof material);
  return material;
}

/// Directional derivative of the stress: dP = d2W/dF2 : dF [kPa]; written out for NeoHookean, by dual numbers for the others.
template <template <class> class Material, class T>
MTLED_HD Mat3<T> stress_derivative(const Material<T>& material, const Mat3<T>& F, const Mat3<T>& dF) {
  T parameters[parameter_count<Material>];
  memcpy(parameters, static_cast<const void*>(&material), sizeof parameters);
  Dual<T> constants[parameter_count<Material>];
  for (int i = 0; i < parameter_count<Material>; ++i) constants[i] = {parameters[i], T{}};
  Mat3<Dual<T>> seeded;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) seeded[i][j] = {F[i][j], dF[i][j]};
  Dual<T> J;
  const Mat3<Dual<T>> P = material_of<Material>(constants).stress(seeded, J);
  Mat3<T> dP;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) dP[i][j] = P[i][j].derivative;
  return dP;
}
template <class T>
MTLED_HD Mat3<T> stress_derivative(const NeoHookean<T>& material, const Mat3<T>& F, const Mat3<T>& dF) {
  return material.stress_derivative(F, dF);
}

}  // namespace mtled
