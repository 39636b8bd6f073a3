#include "imaging/warp.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/error.hpp"
#include "core/index_map.hpp"
#include "imaging/cubic_spline.hpp"
#include "imaging/voxel_loop.hpp"

namespace mtled {
namespace {

/// `source` at position(i, j, k, voxel) for every voxel of `grid`.
template <class Position>
Image sample_at(const Image& source, const Grid& grid, const Position& position, Interpolation interpolation, float outside) {
  Image result(grid);
  const auto fill = [&](const Image& samples) {
    for_each_voxel(grid, [&, view = view_of(samples)](int i, int j, int k, std::size_t voxel) { result.data[voxel] = sample(view, position(i, j, k, voxel), interpolation, outside); });
  };
  interpolation == Interpolation::cubic ? fill(spline_coefficients(source)) : fill(source);
  return result;
}

/// Label of the voxel nearest to position(i, j, k, voxel) for every voxel of `grid`, 0 outside.
template <class Position>
LabelImage nearest_labels(const LabelImage& labels, const Grid& grid, const Position& position) {
  LabelImage result(grid);
  for_each_voxel(grid, [&](int i, int j, int k, std::size_t voxel) { result.data[voxel] = nearest_value<std::uint16_t>(labels, position(i, j, k, voxel), 0); });
  return result;
}

/// True when a voxel of `grid` lies in `other`.
bool reaches_into(const Grid& grid, const Grid& other) {
  for (int k = 0; k < grid.size[2]; ++k)
    for (int j = 0; j < grid.size[1]; ++j)
      for (int i = 0; i < grid.size[0]; ++i) {
        const Vec3d c = other.index(grid.point(i, j, k));
        bool inside = true;
        for (int a = 0; a < 3; ++a) inside = inside && c[a] >= -0.5 && c[a] < other.size[std::size_t(a)] - 0.5;
        if (inside) return true;
      }
  return false;
}

/// y + v(y) at the voxels of a displacement field.
auto displaced_position(const VectorImage& field) {
  return [&field](int i, int j, int k, std::size_t voxel) {
    const Vec3f& v = field.data[voxel];
    return field.grid.point(i, j, k) + Vec3d{v.x, v.y, v.z};
  };
}

}  // namespace

Image warp_image(const Image& moving, const VectorImage& inverse, Interpolation interpolation, float outside, const SampleDisplaced& device) {
  if (device) return device(interpolation == Interpolation::cubic ? spline_coefficients(moving) : moving, inverse, interpolation, outside);
  return sample_at(moving, inverse.grid, displaced_position(inverse), interpolation, outside);
}

Image warp_continued(const Image& moving, const Grid& grid, const VectorImage* field, Mask& inside) {
  Image result(grid);
  inside = Mask(grid);
  const auto view = view_of(moving);
  const auto& n = moving.grid.size;
  Mat3d to_index = transpose(moving.grid.direction);
  for (int a = 0; a < 3; ++a)
    for (int b = 0; b < 3; ++b) to_index[a][b] /= moving.grid.spacing[a];
  const IndexMap index_of(grid, moving.grid);
  for_each_voxel(grid, [&](int i, int j, int k, std::size_t voxel) {
    Vec3d index = index_of(i, j, k);
    if (field) {
      const Vec3f& v = field->data[voxel];
      index += to_index * Vec3d{v.x, v.y, v.z};
    }
    bool in = true;
    for (int a = 0; a < 3; ++a) {
      in = in && index[a] >= -0.5 && index[a] <= n[std::size_t(a)] - 0.5;
      index[a] = std::clamp(index[a], 0.0, double(n[std::size_t(a)] - 1));
    }
    double value = 0;
    interpolate_at_index(view, index, value);
    result.data[voxel] = float(value);
    inside.data[voxel] = in;
  });
  return result;
}

LabelImage warp_labels(const LabelImage& labels, const VectorImage& inverse) { return nearest_labels(labels, inverse.grid, displaced_position(inverse)); }

LabelImage labels_at(const LabelImage& labels, const Grid& grid) {
  return nearest_labels(labels, grid, [&](int i, int j, int k, std::size_t) { return grid.point(i, j, k); });
}

Image warp_image_rigidly(const Image& moving, const Grid& fixed_grid, const RigidMotion& motion,
                         Interpolation interpolation, float outside) {
  const RigidMotion back = inverse(motion);
  const auto position = [&](int i, int j, int k, std::size_t) { return back.apply(fixed_grid.point(i, j, k)); };
  return sample_at(moving, fixed_grid, position, interpolation, outside);
}

std::vector<Vec3d> warp_points(const std::vector<Vec3d>& points, const DisplacementFunction& u,
                               const VectorImage& dense) {
  constexpr double nan = std::numeric_limits<double>::quiet_NaN();
  std::vector<Vec3d> warped(points.size());
  parallel_for(points.size(), [&](std::size_t p) {
    Vec3d value;
    const bool known = u(points[p], value) || linear_value(dense, points[p], value);
    warped[p] = known ? points[p] + value : Vec3d{nan, nan, nan};
  });
  return warped;
}

Image resample(const Image& image, const Vec3d& spacing_mm) {
  Grid grid = image.grid;
  Vec3d first;
  for (int a = 0; a < 3; ++a) {
    require(spacing_mm[a] > 0, "voxel spacing ", spacing_mm[a], " mm is not positive; give three spacings in mm");
    const double extent = image.grid.size[a] * image.grid.spacing[a];
    const double voxels = std::max(1.0, std::round(extent / spacing_mm[a]));
    require(voxels < std::numeric_limits<int>::max(), "voxel spacing ", spacing_mm[a], " mm would need ", voxels,
            " voxels along one axis; give a larger spacing");
    grid.size[a] = int(voxels);
    grid.spacing[a] = extent / voxels;
    first[a] = (grid.spacing[a] / image.grid.spacing[a] - 1) / 2;
  }
  grid.origin = image.grid.point(first);
  return sample_at(
      image, grid, [&](int i, int j, int k, std::size_t) { return grid.point(i, j, k); }, Interpolation::linear, 0);
}

LabelImage resample_labels(const LabelImage& labels, const Grid& grid) {
  const Vec3d p = labels.grid.origin, q = grid.origin;
  require(reaches_into(grid, labels.grid),
          "the label image and the image it belongs to do not overlap in space (origins ", p.x, " ", p.y, " ", p.z,
          " and ", q.x, " ", q.y, " ", q.z, " mm); check that the labels were drawn on this image");
  return labels_at(labels, grid);
}

}  // namespace mtled
