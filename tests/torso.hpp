#pragma once
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <vector>

#include "core/motion.hpp"
#include "core/volume.hpp"
#include "image_io/image_io.hpp"
#include "io/tables.hpp"

/// A small torso made of formulas: any grid shows the same body, and where its bones go is known exactly.
namespace mtled::torso {

constexpr double edge_mm = 4;  ///< width of all transitions between tissues

/// 1 well inside (`depth` [mm] positive), 0 well outside, smooth between.
inline double inside(double depth) {
  const double t = std::clamp(depth / edge_mm + 0.5, 0.0, 1.0);
  return t * t * (3 - 2 * t);
}

/// Depth [mm], roughly, in an ellipsoid; its ends along z are blunt.
inline double ellipsoid_depth(const Vec3d& d, const Vec3d& radii) {
  const double x = d.x / radii.x, y = d.y / radii.y, z = d.z / radii.z;
  return (1 - std::pow(x * x + y * y + z * z * z * z, 0.5)) * std::min(radii.x, radii.y);
}

inline double box_depth(const Vec3d& d, const Vec3d& half) {
  return std::min({half.x - std::abs(d.x), half.y - std::abs(d.y), half.z - std::abs(d.z)});
}

constexpr int bones = 4;
inline Vec3d bone_center(int label) { return {0, 36, -84.0 + 32 * label + 4}; }  // z = -48, -16, 16, 48
/// Body of a vertebra with a process to the back and one to each side, so that every turn of it can be seen.
inline double bone_depth(const Vec3d& x, int label) {
  const Vec3d d = x - bone_center(label);
  return std::max({box_depth(d, {15, 13, 11}), box_depth(d - Vec3d{0, 18, -2}, {5, 12, 8}), box_depth(d - Vec3d{0, 6, 2}, {28, 5, 6})});
}

inline double intensity(const Vec3d& x) {
  const double body = ellipsoid_depth(x, {104, 78, 74});
  double value = -1000 + 900 * inside(body) + 140 * inside(body - 14);  // air, fat rim, muscle
  for (const double side : {-1.0, 1.0}) {
    const double lung = inside(ellipsoid_depth(x - Vec3d{45 * side, -14, 6}, {30, 34, 46}));
    value += lung * (-840 - (value - 40));
  }
  double bone = 0;
  for (int label = 1; label <= bones; ++label) bone = std::max(bone, inside(bone_depth(x, label)));
  return value + bone * (500 - value);
}

inline std::vector<LabelMotion> motions() {
  std::vector<LabelMotion> result;
  for (int label = 1; label <= bones; ++label) {
    const double s = label - 2.5;
    RigidMotion m;
    m.center = bone_center(label);
    m.rotation = rotation_matrix({0.03 * s, 0.01 * s, 0.01});
    m.translation = {3 + 0.6 * s, 1.2 * s * s - 7, 2 + 0.5 * s};
    result.push_back({label, m});
  }
  return result;
}

/// Where the point y of the fixed image was in the moving one: rigid around every bone, blended between them.
inline Vec3d rest_position(const Vec3d& y) {
  static const std::vector<LabelMotion> moves = motions();
  const double at = std::clamp((y.z - bone_center(1).z) / 32, 0.0, bones - 1.0);
  const int low = std::min(int(at), bones - 2);
  const double t = std::clamp((at - low - 0.45) / 0.1, 0.0, 1.0);
  const Vec3d a = inverse(moves[std::size_t(low)].motion).apply(y), b = inverse(moves[std::size_t(low) + 1].motion).apply(y);
  return (1 - t) * a + t * b;
}

inline Grid straight_grid() {
  Grid grid;
  grid.size = {61, 51, 41};
  grid.origin = {-120, -100, -80};
  grid.spacing = {4, 4, 4};
  return grid;
}

/// The same voxels in another order: axes exchanged and two of them reversed.
inline Grid flipped_grid() {
  Grid grid;
  grid.size = {51, 41, 61};
  grid.spacing = {4, 4, 4};
  grid.origin = {-120, 100, 80};
  grid.direction = {};
  grid.direction[1][0] = -1, grid.direction[2][1] = -1, grid.direction[0][2] = 1;
  return grid;
}

/// Other voxels, turned about two axes and anisotropic; they hold the whole body too.
inline Grid oblique_grid() {
  Grid grid;
  grid.size = {72, 61, 52};
  grid.spacing = {3.6, 3.8, 4};
  grid.direction = rotation_matrix({0.1, -0.06, 0.25});
  grid.origin = grid.direction * Vec3d{-3.6 * 35.5, -3.8 * 30, -4 * 25.5};
  return grid;
}

template <class T, class F>
Volume<T> on_grid(const Grid& grid, const F& value) {
  Volume<T> volume(grid);
  for (int k = 0; k < grid.size[2]; ++k)
    for (int j = 0; j < grid.size[1]; ++j)
      for (int i = 0; i < grid.size[0]; ++i) volume.at(i, j, k) = T(value(grid.point(i, j, k)));
  return volume;
}

inline int label_at(const Vec3d& x) {
  for (int label = 1; label <= bones; ++label)
    if (bone_depth(x, label) > 0) return label;
  return 0;
}

inline Image moving_image(const Grid& grid) { return on_grid<float>(grid, intensity); }
inline Image fixed_image(const Grid& grid) {
  return on_grid<float>(grid, [](const Vec3d& y) { return intensity(rest_position(y)); });
}
inline LabelImage moving_labels(const Grid& grid) { return on_grid<std::uint16_t>(grid, label_at); }
inline LabelImage fixed_labels(const Grid& grid) {
  return on_grid<std::uint16_t>(grid, [](const Vec3d& y) { return label_at(rest_position(y)); });
}

/// moving, fixed, moving_labels, fixed_labels (.nii.gz) and motions.json in `folder`.
inline void write_pair(const std::filesystem::path& folder, const Grid& grid) {
  std::filesystem::create_directories(folder);
  write_image(folder / "moving.nii.gz", moving_image(grid));
  write_image(folder / "fixed.nii.gz", fixed_image(grid));
  write_labels(folder / "moving_labels.nii.gz", moving_labels(grid));
  write_labels(folder / "fixed_labels.nii.gz", fixed_labels(grid));
  write_motions(folder / "motions.json", motions());
}

}  // namespace mtled::torso
