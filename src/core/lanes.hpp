#pragma once
#include <cstdint>

namespace mtled {

/// Packs of scalars that one instruction (or a few) processes together: GCC/Clang vector types, 64 bytes.
template <class Real>
struct LaneTraits;
template <>
struct LaneTraits<float> {
  typedef float Pack __attribute__((vector_size(64)));
  typedef float Quad __attribute__((vector_size(16)));
  typedef std::int32_t Bits __attribute__((vector_size(64)));
  static constexpr int width = 16;
};
template <>
struct LaneTraits<double> {
  typedef double Pack __attribute__((vector_size(64)));
  typedef double Quad __attribute__((vector_size(32)));
  typedef std::int64_t Bits __attribute__((vector_size(64)));
  static constexpr int width = 8;
};

/// A pack that may start at any element.
template <class Real>
inline typename LaneTraits<Real>::Pack load_pack(const Real* from) {
  typename LaneTraits<Real>::Pack pack;
  __builtin_memcpy(&pack, from, sizeof pack);
  return pack;
}
template <class Real>
inline void store_pack(Real* to, const typename LaneTraits<Real>::Pack& pack) {
  __builtin_memcpy(to, &pack, sizeof pack);
}

/// x^(-1/3) of every lane, x > 0: a guess from the exponent bits, then Newton steps y <- y (4 - x y^3) / 3.
inline LaneTraits<float>::Pack inverse_cube_root(const LaneTraits<float>::Pack& x) {
  typedef LaneTraits<float>::Bits Bits;
  const Bits third = __builtin_convertvector(__builtin_convertvector((Bits)x, LaneTraits<float>::Pack) * (1.0f / 3.0f), Bits);
  LaneTraits<float>::Pack y = (LaneTraits<float>::Pack)(0x54a2fa8c - third);
  for (int i = 0; i < 4; ++i) y = y * (4.0f / 3.0f - (1.0f / 3.0f) * (x * y * y * y));
  return y;
}
inline LaneTraits<double>::Pack inverse_cube_root(const LaneTraits<double>::Pack& x) {
  typedef LaneTraits<double>::Bits Bits;
  const Bits third = (Bits)x / 3;
  LaneTraits<double>::Pack y = (LaneTraits<double>::Pack)(0x553ef0ff289dd796L - third);
  for (int i = 0; i < 5; ++i) y = y * (4.0 / 3.0 - (1.0 / 3.0) * (x * y * y * y));
  return y;
}

inline LaneTraits<float>::Pack at_least(const LaneTraits<float>::Pack& x, float floor) { return x > floor ? x : floor; }
inline LaneTraits<double>::Pack at_least(const LaneTraits<double>::Pack& x, float floor) { return x > floor ? x : floor; }

inline LaneTraits<float>::Pack square_root(LaneTraits<float>::Pack x) {
  for (int lane = 0; lane < LaneTraits<float>::width; ++lane) x[lane] = __builtin_sqrtf(x[lane]);
  return x;
}
inline LaneTraits<double>::Pack square_root(LaneTraits<double>::Pack x) {
  for (int lane = 0; lane < LaneTraits<double>::width; ++lane) x[lane] = __builtin_sqrt(x[lane]);
  return x;
}
/// x^exponent, lane by lane.
inline LaneTraits<float>::Pack power(LaneTraits<float>::Pack x, const LaneTraits<float>::Pack& exponent) {
  for (int lane = 0; lane < LaneTraits<float>::width; ++lane) x[lane] = __builtin_powf(x[lane], exponent[lane]);
  return x;
}
inline LaneTraits<double>::Pack power(LaneTraits<double>::Pack x, const LaneTraits<double>::Pack& exponent) {
  for (int lane = 0; lane < LaneTraits<double>::width; ++lane) x[lane] = __builtin_pow(x[lane], exponent[lane]);
  return x;
}
/// See core/symmetric_power.hpp.
inline float near_coincidence(const LaneTraits<float>::Pack&) { return 0.04f; }
inline float near_coincidence(const LaneTraits<double>::Pack&) { return 7e-4f; }

}  // namespace mtled
