#pragma once
#include <cstdint>

#include "core/host_device.hpp"

namespace mtled {

/// Three components of a slot or one row of a stress, moved by one instruction; the fourth is 0.
template <class Real>
struct alignas(4 * sizeof(Real)) Vec4 {
  Real x, y, z, w;
};

template <class Real> MTLED_HD Vec4<Real> operator+(const Vec4<Real>& a, const Vec4<Real>& b) { return {a.x + b.x, a.y + b.y, a.z + b.z, Real(0)}; }
template <class Real> MTLED_HD Vec4<Real> operator-(const Vec4<Real>& a, const Vec4<Real>& b) { return {a.x - b.x, a.y - b.y, a.z - b.z, Real(0)}; }
template <class Real> MTLED_HD Vec4<Real> operator*(Real s, const Vec4<Real>& a) { return {s * a.x, s * a.y, s * a.z, Real(0)}; }
/// Component by component.
template <class Real> MTLED_HD Vec4<Real> operator*(const Vec4<Real>& a, const Vec4<Real>& b) { return {a.x * b.x, a.y * b.y, a.z * b.z, Real(0)}; }

/// The larger of two, or the one that is not a number.
template <class Real> MTLED_HD Real larger(Real a, Real b) { return b > a || b != b ? b : a; }
/// Largest component without its sign; not a number where any component is.
template <class Real> MTLED_HD Real largest_component(const Vec4<Real>& a) {
  const auto size = [](Real x) { return x < 0 ? -x : x; };
  return larger(larger(size(a.x), size(a.y)), size(a.z));
}

}  // namespace mtled
