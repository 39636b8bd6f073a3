#pragma once
#include <cmath>

#include "core/host_device.hpp"

namespace mtled {

/// Vector of three components; T is float, double or a pack of them (see lanes.hpp).
template <class T>
struct Vec3 {
  T x{}, y{}, z{};
  MTLED_HD T& operator[](int i) { return i == 0 ? x : i == 1 ? y : z; }
  MTLED_HD const T& operator[](int i) const { return i == 0 ? x : i == 1 ? y : z; }
  MTLED_HD Vec3& operator+=(const Vec3& b) { x += b.x, y += b.y, z += b.z; return *this; }
  MTLED_HD Vec3& operator-=(const Vec3& b) { x -= b.x, y -= b.y, z -= b.z; return *this; }
  bool operator==(const Vec3&) const = default;
};

template <class T> MTLED_HD Vec3<T> operator+(Vec3<T> a, const Vec3<T>& b) { return a += b; }
template <class T> MTLED_HD Vec3<T> operator-(Vec3<T> a, const Vec3<T>& b) { return a -= b; }
template <class T> MTLED_HD Vec3<T> operator*(const T& s, const Vec3<T>& a) { return {s * a.x, s * a.y, s * a.z}; }
template <class T> MTLED_HD T dot(const Vec3<T>& a, const Vec3<T>& b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
template <class T> MTLED_HD T squared_norm(const Vec3<T>& a) { return dot(a, a); }
MTLED_HD inline double norm(const Vec3<double>& a) { return std::sqrt(squared_norm(a)); }
template <class T> MTLED_HD Vec3<T> cross(const Vec3<T>& a, const Vec3<T>& b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

/// 3x3 matrix, row-major: m[row][column].
template <class T>
struct Mat3 {
  T m[3][3]{};
  MTLED_HD T* operator[](int row) { return m[row]; }
  MTLED_HD const T* operator[](int row) const { return m[row]; }
  MTLED_HD static Mat3 identity() {
    Mat3 a;
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) a.m[i][j] = T{} + (i == j ? 1 : 0);
    return a;
  }
};

template <class T> MTLED_HD Vec3<T> operator*(const Mat3<T>& a, const Vec3<T>& v) {
  return {a.m[0][0] * v.x + a.m[0][1] * v.y + a.m[0][2] * v.z, a.m[1][0] * v.x + a.m[1][1] * v.y + a.m[1][2] * v.z,
          a.m[2][0] * v.x + a.m[2][1] * v.y + a.m[2][2] * v.z};
}
template <class T> MTLED_HD Mat3<T> operator*(const Mat3<T>& a, const Mat3<T>& b) {
  Mat3<T> c;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) c.m[i][j] = a.m[i][0] * b.m[0][j] + a.m[i][1] * b.m[1][j] + a.m[i][2] * b.m[2][j];
  return c;
}
template <class T> MTLED_HD Mat3<T> transpose(const Mat3<T>& a) {
  Mat3<T> t;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) t.m[i][j] = a.m[j][i];
  return t;
}
/// Matrix of cofactors; inverse(a) = transpose(cofactors(a)) / determinant(a).
template <class T> MTLED_HD Mat3<T> cofactors(const Mat3<T>& a) {
  Mat3<T> c;
  for (int i = 0; i < 3; ++i) {
    const int p = (i + 1) % 3, q = (i + 2) % 3;
    for (int j = 0; j < 3; ++j) {
      const int r = (j + 1) % 3, s = (j + 2) % 3;
      c.m[i][j] = a.m[p][r] * a.m[q][s] - a.m[p][s] * a.m[q][r];
    }
  }
  return c;
}
template <class T> MTLED_HD T determinant(const Mat3<T>& a) {
  const Mat3<T> c = cofactors(a);
  return a.m[0][0] * c.m[0][0] + a.m[0][1] * c.m[0][1] + a.m[0][2] * c.m[0][2];
}
template <class T> MTLED_HD Mat3<T> inverse(const Mat3<T>& a) {
  const Mat3<T> c = cofactors(a);
  const T scale = T{} + 1 / (a.m[0][0] * c.m[0][0] + a.m[0][1] * c.m[0][1] + a.m[0][2] * c.m[0][2]);
  Mat3<T> b;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) b.m[i][j] = scale * c.m[j][i];
  return b;
}

using Vec3d = Vec3<double>;
using Vec3f = Vec3<float>;
using Mat3d = Mat3<double>;

}  // namespace mtled
