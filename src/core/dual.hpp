#pragma once
#include "core/host_device.hpp"

namespace mtled {

/// Value and directional derivative (forward-mode differentiation): code written for T and run with Dual<T> also gives its
/// exact derivative in the direction of the seeds. T is a scalar or a pack of scalars; whole numbers are short because only
/// those fit into packs of float without rounding.
template <class T>
struct Dual {
  T value{}, derivative{};

  MTLED_HD friend Dual operator-(const Dual& a) { return {-a.value, -a.derivative}; }
  MTLED_HD friend Dual operator+(const Dual& a, const Dual& b) { return {a.value + b.value, a.derivative + b.derivative}; }
  MTLED_HD friend Dual operator-(const Dual& a, const Dual& b) { return {a.value - b.value, a.derivative - b.derivative}; }
  MTLED_HD friend Dual operator*(const Dual& a, const Dual& b) { return {a.value * b.value, a.derivative * b.value + a.value * b.derivative}; }
  MTLED_HD friend Dual operator/(const Dual& a, const Dual& b) {
    const T q = a.value / b.value;
    return {q, (a.derivative - q * b.derivative) / b.value};
  }
  MTLED_HD friend Dual operator+(const Dual& a, short b) { return {a.value + b, a.derivative}; }
  MTLED_HD friend Dual operator-(const Dual& a, short b) { return {a.value - b, a.derivative}; }
  MTLED_HD friend Dual operator*(short a, const Dual& b) { return {a * b.value, a * b.derivative}; }
  MTLED_HD friend Dual operator/(const Dual& a, short b) { return {a.value / b, a.derivative / b}; }
  MTLED_HD Dual& operator+=(const Dual& b) { return *this = *this + b; }
};

}  // namespace mtled
