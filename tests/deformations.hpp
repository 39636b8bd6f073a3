#pragma once
#include <algorithm>
#include <cmath>
#include <random>

#include "core/tensor.hpp"

/// Deformation gradients for the tests of materials.
namespace mtled {

template <class T>
Mat3<T> combine(T a, const Mat3<T>& A, T b, const Mat3<T>& B) {
  Mat3<T> C;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) C[i][j] = a * A[i][j] + b * B[i][j];
  return C;
}
inline double contract(const Mat3d& A, const Mat3d& B) {
  double sum = 0;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) sum += A[i][j] * B[i][j];
  return sum;
}
inline double largest(const Mat3d& A) {
  double top = 0;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) top = std::max(top, std::abs(A[i][j]));
  return top;
}

/// Deformations with strains of tens of percent, and directions.
struct Samples {
  std::mt19937 random{11};
  std::uniform_real_distribution<double> unit{-1, 1};
  Mat3d direction() {
    Mat3d D;
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) D[i][j] = unit(random);
    return D;
  }
  Mat3d deformation() { return combine(1.0, Mat3d::identity(), 0.3, direction()); }
  Mat3d rotation() {  // from a random quaternion
    double q[4], n = 0;
    for (double& c : q) c = unit(random), n += c * c;
    for (double& c : q) c /= std::sqrt(n);
    const double w = q[0], x = q[1], y = q[2], z = q[3];
    return {{{1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)},
             {2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)},
             {2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)}}};
  }
};

}  // namespace mtled
