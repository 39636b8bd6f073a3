#pragma once
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "core/tensor.hpp"

namespace mtled {

/// Where the voxels of a 3-D image lie: LPS physical coordinates in mm, ITK's conventions.
/// point = origin + direction * (spacing .* index); the centre of voxel (0,0,0) is at the origin.
struct Grid {
  std::array<int, 3> size{};                   ///< voxels along i, j, k
  Vec3d origin{};                              ///< [mm]
  Vec3d spacing{1, 1, 1};                      ///< [mm], positive
  Mat3d direction = Mat3d::identity();         ///< orthonormal; columns are the axes i, j, k

  std::size_t count() const { return std::size_t(size[0]) * std::size_t(size[1]) * std::size_t(size[2]); }
  std::size_t offset(int i, int j, int k) const {
    return std::size_t(i) + std::size_t(size[0]) * (std::size_t(j) + std::size_t(size[1]) * std::size_t(k));
  }
  Vec3d point(const Vec3d& index) const {
    return origin + direction * Vec3d{spacing.x * index.x, spacing.y * index.y, spacing.z * index.z};
  }
  Vec3d point(int i, int j, int k) const { return point(Vec3d{double(i), double(j), double(k)}); }
  /// Continuous index of a point [mm].
  Vec3d index(const Vec3d& point) const {
    const Vec3d d = transpose(direction) * (point - origin);
    return {d.x / spacing.x, d.y / spacing.y, d.z / spacing.z};
  }
  double voxel_volume() const { return spacing.x * spacing.y * spacing.z; }
  bool operator==(const Grid& b) const {
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j)
        if (direction[i][j] != b.direction[i][j]) return false;
    return size == b.size && origin == b.origin && spacing == b.spacing;
  }
};

/// A 3-D image: `data` has grid.count() values, i fastest (ITK's order).
template <class T>
struct Volume {
  Grid grid;
  std::vector<T> data;

  Volume() = default;
  explicit Volume(const Grid& g, T value = T{}) : grid(g), data(g.count(), value) {}
  T& at(int i, int j, int k) { return data[grid.offset(i, j, k)]; }
  const T& at(int i, int j, int k) const { return data[grid.offset(i, j, k)]; }
};

using Image = Volume<float>;               ///< intensity (HU for CT), modulus, ...
using Mask = Volume<std::uint8_t>;         ///< 0 outside, 1 inside
using LabelImage = Volume<std::uint16_t>;  ///< 0 background, else the label of a rigid body
using VectorImage = Volume<Vec3f>;         ///< displacement [mm], LPS components

/// Value of the voxel that holds `point`, or `outside` where the image does not reach.
template <class T>
T nearest_value(const Volume<T>& volume, const Vec3d& point, T outside) {
  const Vec3d c = volume.grid.index(point);
  const int i = int(std::floor(c.x + 0.5)), j = int(std::floor(c.y + 0.5)), k = int(std::floor(c.z + 0.5));
  const auto& n = volume.grid.size;
  if (i < 0 || j < 0 || k < 0 || i >= n[0] || j >= n[1] || k >= n[2]) return outside;
  return volume.at(i, j, k);
}

/// Trilinear value at `point`; clamped to the border within half a voxel outside the voxel centres. False beyond that.
/// Result is float for scalar images and Vec3d for vector images.
bool linear_value(const Image& volume, const Vec3d& point, double& value);
bool linear_value(const VectorImage& volume, const Vec3d& point, Vec3d& value);

}  // namespace mtled
