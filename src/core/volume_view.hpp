#pragma once
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "core/host_device.hpp"
#include "core/tensor.hpp"
#include "core/volume.hpp"

namespace mtled {

/// Linear; interpolating cubic B-spline (Unser 1999), which is sharper and overshoots at steep edges; nearest voxel.
enum class Interpolation { linear, cubic, nearest };

/// A grid as CPU and device code see it: the same formulas as in Grid.
struct GridView {
  int size[3];
  Vec3d origin, spacing;
  Mat3d direction;

  GridView() = default;
  explicit GridView(const Grid& g) : size{g.size[0], g.size[1], g.size[2]}, origin(g.origin), spacing(g.spacing), direction(g.direction) {}
  MTLED_HD std::size_t offset(int i, int j, int k) const {
    return std::size_t(i) + std::size_t(size[0]) * (std::size_t(j) + std::size_t(size[1]) * std::size_t(k));
  }
  MTLED_HD Vec3d point(const Vec3d& index) const { return origin + direction * Vec3d{spacing.x * index.x, spacing.y * index.y, spacing.z * index.z}; }
  /// Centre of the voxel with this offset.
  MTLED_HD Vec3d point_at(std::size_t voxel) const {
    const std::size_t row = voxel / std::size_t(size[0]), slice = row / std::size_t(size[1]);
    return point(Vec3d{double(voxel - row * std::size_t(size[0])), double(row - slice * std::size_t(size[1])), double(slice)});
  }
  /// Continuous index of a point [mm].
  MTLED_HD Vec3d index(const Vec3d& p) const {
    const Vec3d d = transpose(direction) * (p - origin);
    return {d.x / spacing.x, d.y / spacing.y, d.z / spacing.z};
  }
};

/// A volume that someone else owns, on the host or on a device.
template <class T>
struct VolumeView {
  GridView grid;
  const T* data = nullptr;
  MTLED_HD const T& at(int i, int j, int k) const { return data[grid.offset(i, j, k)]; }
};
template <class T>
VolumeView<T> view_of(const Volume<T>& volume) {
  return {GridView(volume.grid), volume.data.data()};
}

/// The two neighbours of a continuous index along an axis of n voxels.
struct BetweenVoxels {
  int low, high;
  double t;  ///< [0, 1] from low to high
};
MTLED_HD inline double clamped(double value, double low, double high) { return value < low ? low : high < value ? high : value; }
/// Clamped to the border within half a voxel outside the voxel centres. False beyond that.
MTLED_HD inline bool between_voxels(double index, int n, BetweenVoxels& b) {
  if (!(index >= -0.5 && index <= n - 0.5)) return false;
  const double c = clamped(index, 0.0, double(n - 1));
  const int before_last = n > 2 ? n - 2 : 0;
  b.low = int(c) < before_last ? int(c) : before_last;
  b.high = b.low + 1 < n ? b.low + 1 : n - 1;
  b.t = c - b.low;
  return true;
}

MTLED_HD inline void add_to(double& sum, double weight, float value) { sum += weight * value; }
MTLED_HD inline void add_to(Vec3d& sum, double weight, const Vec3f& value) { sum += weight * Vec3d{value.x, value.y, value.z}; }

/// Trilinear value at a continuous index, see linear_value(). R is double for scalars, Vec3d for vectors.
template <class T, class R>
MTLED_HD bool interpolate_at_index(const VolumeView<T>& volume, const Vec3d& c, R& value) {
  BetweenVoxels b[3];
  for (int a = 0; a < 3; ++a)
    if (!between_voxels(c[a], volume.grid.size[a], b[a])) return false;
  const double x[2] = {1 - b[0].t, b[0].t}, y[2] = {1 - b[1].t, b[1].t}, z[2] = {1 - b[2].t, b[2].t};
  value = R{};
  for (int k = 0; k < 2; ++k)
    for (int j = 0; j < 2; ++j) {
      const T* row = &volume.at(0, j ? b[1].high : b[1].low, k ? b[2].high : b[2].low);
      add_to(value, x[0] * y[j] * z[k], row[b[0].low]);
      add_to(value, x[1] * y[j] * z[k], row[b[0].high]);
    }
  return true;
}
/// The same at a point [mm].
template <class T, class R>
MTLED_HD bool interpolate_linearly(const VolumeView<T>& volume, const Vec3d& point, R& value) {
  return interpolate_at_index(volume, volume.grid.index(point), value);
}

/// Value of the voxel that holds a point [mm]; false where the volume does not reach.
template <class T>
MTLED_HD bool interpolate_nearest(const VolumeView<T>& volume, const Vec3d& point, T& value) {
  const Vec3d c = volume.grid.index(point);
  const int i = int(std::floor(c.x + 0.5)), j = int(std::floor(c.y + 0.5)), k = int(std::floor(c.z + 0.5));
  const int* n = volume.grid.size;
  if (i < 0 || j < 0 || k < 0 || i >= n[0] || j >= n[1] || k >= n[2]) return false;
  value = volume.at(i, j, k);
  return true;
}

/// Cubic B-spline at the four coefficients around a position t in [0, 1] between the middle two.
MTLED_HD inline void cubic_weights(double t, double weight[4]) {
  const double s = 1 - t;
  weight[0] = s * s * s / 6;
  weight[1] = (4 - 6 * t * t + 3 * t * t * t) / 6;
  weight[2] = (4 - 6 * s * s + 3 * s * s * s) / 6;
  weight[3] = t * t * t / 6;
}
/// Index of the voxel that mirrors `i` into [0, n).
MTLED_HD inline int mirrored(int i, int n) {
  if (n == 1) return 0;
  const int last = n - 1, from_low = i < 0 ? -i : i;
  return last - (last < from_low ? from_low - last : last - from_low);
}
/// Cubic B-spline with these coefficients at a point [mm]; mirror boundaries; clamped to the border within half a voxel
/// outside the voxel centres. False beyond that.
MTLED_HD inline bool interpolate_cubically(const VolumeView<float>& coefficients, const Vec3d& point, double& value) {
  const Vec3d c = coefficients.grid.index(point);
  double weight[3][4];
  int tap[3][4];
  for (int a = 0; a < 3; ++a) {
    const int n = coefficients.grid.size[a];
    BetweenVoxels b;
    if (!between_voxels(c[a], n, b)) return false;
    cubic_weights(b.t, weight[a]);
    for (int i = 0; i < 4; ++i) tap[a][i] = mirrored(b.low - 1 + i, n);
  }
  value = 0;
  for (int k = 0; k < 4; ++k)
    for (int j = 0; j < 4; ++j) {
      const float* row = &coefficients.at(0, tap[1][j], tap[2][k]);
      double sum = 0;
      for (int i = 0; i < 4; ++i) sum += weight[0][i] * row[tap[0][i]];
      value += weight[1][j] * weight[2][k] * sum;
    }
  return true;
}

/// Value at a point [mm] of an image, or of the cubic spline with these coefficients; `outside` beyond.
MTLED_HD inline float sample(const VolumeView<float>& samples, const Vec3d& point, Interpolation interpolation, float outside) {
  if (interpolation == Interpolation::nearest) {
    float value;
    return interpolate_nearest(samples, point, value) ? value : outside;
  }
  double value;
  const bool inside = interpolation == Interpolation::cubic ? interpolate_cubically(samples, point, value) : interpolate_linearly(samples, point, value);
  return inside ? float(value) : outside;
}

}  // namespace mtled
