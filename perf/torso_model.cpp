#include "torso_model.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "core/error.hpp"
#include "core/parallel.hpp"

namespace mtled {
namespace {

// Lengths in mm, LPS: the back is at positive y.
constexpr Vec3d half_size{190, 120, 250};
constexpr double spine_y = 55, vertebra_pitch = 36;
constexpr int vertebrae = 12;
constexpr double curvature = 7e-4;  ///< of the bent spine [1/mm]: 16 degrees from the first vertebra to the last

Vec3d vertebra_centre(int label) { return {0, spine_y, vertebra_pitch * (label - (vertebrae + 1) / 2.0)}; }

double squared_radius(const Vec3d& x, const Vec3d& centre, const Vec3d& radii) {
  double sum = 0;
  for (int a = 0; a < 3; ++a) sum += (x[a] - centre[a]) * (x[a] - centre[a]) / (radii[a] * radii[a]);
  return sum;
}

/// Scale of the cross-section at height z.
double taper(double z) {
  const double beyond = std::max(0.0, (std::abs(z) - 150) / 100);
  return 1 - 0.55 * beyond * beyond;
}

/// Distance to the skin, roughly; negative outside.
double depth(const Vec3d& x) {
  const double scale = taper(x.z), a = x.x / half_size.x, b = x.y / half_size.y;
  return std::min(half_size.y * (scale - std::sqrt(a * a + b * b)), half_size.z - std::abs(x.z));
}

/// Number of the vertebra to whose height z belongs; 0: none.
int level_at(double z) {
  const int label = int(std::floor(z / vertebra_pitch + vertebrae / 2.0)) + 1;
  return label < 1 || label > vertebrae ? 0 : label;
}

/// Label of the rib at x, which starts at its vertebra, sinks towards the front and ends beside the middle; 0: none.
int rib_at(const Vec3d& x) {
  constexpr double slope = 0.12;
  const double height = x.z + slope * (spine_y - x.y), below_skin = depth(x);
  const int label = level_at(height);
  const bool at_this_height = label > 0 && std::abs(height - vertebra_centre(label).z) < 5;
  return at_this_height && below_skin > 14 && below_skin < 20 && (x.y > 0 || std::abs(x.x) > 60) ? label : 0;
}

/// Label of the vertebra at x, a body with processes to the back and the sides, and ribs; 0: none.
int vertebra_at(const Vec3d& x) {
  if (const int rib = rib_at(x)) return rib;
  const int label = level_at(x.z);
  if (!label) return 0;
  const Vec3d d = x - vertebra_centre(label);
  const bool body = d.x * d.x / (22 * 22) + d.y * d.y / (16 * 16) < 1 && std::abs(d.z) < 14;
  const bool behind = std::abs(d.x) < 4 && d.y > 0 && d.y < 29 && std::abs(d.z) < 8;
  const bool sides = std::abs(d.x) < 34 && std::abs(d.y - 7) < 5 && std::abs(d.z) < 5;
  return body || behind || sides ? label : 0;
}

/// [kPa]
double shear_modulus(const Vec3d& x) {
  constexpr double lung = 0.53, fat = 1.07, muscle = 4.05, heart = 6, liver = 3.57;
  if (depth(x) < 12) return fat;
  if (squared_radius(x, {20, -45, 30}, {48, 40, 58}) < 1) return heart;
  if (squared_radius(x, {-60, -10, -95}, {95, 75, 55}) < 1) return liver;
  for (const double side : {-1.0, 1.0})
    if (squared_radius(x, {85 * side, -15, 50}, {62, 75, 115}) < 1) return lung;
  return muscle;
}

struct TorsoImage {
  Mask body;
  Image modulus;
  LabelImage labels;
};

TorsoImage voxelise(double voxel) {
  Grid grid;
  constexpr Vec3d half{200, 130, 260};
  for (int a = 0; a < 3; ++a) {
    grid.size[std::size_t(a)] = int(std::ceil(2 * half[a] / voxel));
    grid.origin[a] = voxel / 2 - half[a];
  }
  grid.spacing = {voxel, voxel, voxel};
  TorsoImage image{Mask(grid), Image(grid), LabelImage(grid)};
  parallel_for(std::size_t(grid.size[2]), [&](std::size_t k) {
    for (int j = 0; j < grid.size[1]; ++j)
      for (int i = 0; i < grid.size[0]; ++i) {
        const Vec3d x = grid.point(i, j, int(k));
        if (depth(x) <= 0) continue;
        image.body.at(i, j, int(k)) = 1;
        image.modulus.at(i, j, int(k)) = float(shear_modulus(x));
        image.labels.at(i, j, int(k)) = std::uint16_t(vertebra_at(x));
      }
  }, 1);
  return image;
}

SampledBody sample_at(double spacing) {
  constexpr double finest = 1, coarsest = 4;  // voxels, as in a CT image; not in step with the lattice, which would make supports alike
  const TorsoImage image = voxelise(std::clamp(0.31 * spacing, finest, coarsest));
  std::vector<LabelMotion> motions;
  for (int label = 1; label <= vertebrae; ++label) {
    const Vec3d centre = vertebra_centre(label);
    motions.push_back({label, {centre, rotation_matrix({curvature * centre.z, 0, 0}), torso_bending(centre)}});
  }
  SamplingOptions options;
  options.node_spacing_mm = spacing;
  return sample_body(image.body, image.modulus, image.labels, motions, options);
}

/// Node spacing for about `nodes` nodes, of which those outside the body go with its surface: nodes = volume / spacing^3 +
/// area / spacing^2.
double spacing_for(double nodes) {
  constexpr double coarse = 14;
  const SampledBody body = sample_at(coarse);
  const double volume = body.body_volume_mm3, area = (double(body.cloud.size()) - volume / std::pow(coarse, 3)) * coarse * coarse;
  double low = 0.1, high = 100;
  for (int i = 0; i < 60; ++i) {
    const double middle = (low + high) / 2;
    (volume / std::pow(middle, 3) + area / (middle * middle) > nodes ? low : high) = middle;
  }
  return (low + high) / 2;
}

/// Every node moved at random, the same in every run and with every library.
Cloud jittered(std::vector<Vec3d> nodes, double spacing) {
  std::uint32_t state = 12345;
  for (Vec3d& x : nodes)
    for (int a = 0; a < 3; ++a) {
      state = state * 1664525u + 1013904223u;
      x[a] += 0.6 * spacing * (double(state >> 8) / double(1 << 24) - 0.5);
    }
  return make_cloud(std::move(nodes), std::nullopt);
}

}  // namespace

Vec3d torso_bending(const Vec3d& x) {
  const double angle = curvature * x.z, out = x.y - spine_y;
  return {0, std::cos(angle) * out - (1 - std::cos(angle)) / curvature - out, std::sin(angle) * out + std::sin(angle) / curvature - x.z};
}

SampledBody sample_torso(std::size_t nodes, CloudKind kind) {
  constexpr std::size_t fewest = 500;
  require(nodes >= fewest, "a torso of ", nodes, " nodes is too coarse for its vertebrae; ask for at least ", fewest);
  SampledBody body = sample_at(spacing_for(double(nodes)));
  if (kind == CloudKind::general) {
    const double spacing = body.cloud.lattice->spacing;
    body.cloud = jittered(std::move(body.cloud.nodes), spacing);
  }
  return body;
}

}  // namespace mtled
