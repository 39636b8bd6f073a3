#include "report/view.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <vector>

#include "core/error.hpp"
#include "core/index_map.hpp"
#include "core/volume_view.hpp"
#include "imaging/voxel_loop.hpp"
#include "report/encode.hpp"
#include "report/packing.hpp"

namespace mtled {
namespace {

constexpr int block = 8;              ///< [pixels] of JPEG: slices share none, so that they do not blur each other
constexpr int jpeg_quality = 90;
constexpr int most_samples = 2;       ///< along an axis, for the mean over a voxel

struct Box {
  Vec3d low{std::numeric_limits<double>::infinity(), std::numeric_limits<double>::infinity(), std::numeric_limits<double>::infinity()};
  Vec3d high = -1.0 * low;
  void add(const Vec3d& point) {
    for (int a = 0; a < 3; ++a) low[a] = std::min(low[a], point[a]), high[a] = std::max(high[a], point[a]);
  }
};

/// Voxels [first, last] along every axis that hold what is not 0; the whole grid without a mask.
std::array<std::array<int, 2>, 3> occupied(const Grid& grid, const Mask* where) {
  std::array<std::array<int, 2>, 3> range;
  for (int a = 0; a < 3; ++a) range[std::size_t(a)] = {0, grid.size[std::size_t(a)] - 1};
  if (!where) return range;
  for (auto& r : range) r = {std::numeric_limits<int>::max(), -1};
  for (int k = 0; k < grid.size[2]; ++k)
    for (int j = 0; j < grid.size[1]; ++j)
      for (int i = 0; i < grid.size[0]; ++i)
        if (where->at(i, j, k)) {
          const int index[3] = {i, j, k};
          for (std::size_t a = 0; a < 3; ++a) range[a] = {std::min(range[a][0], index[a]), std::max(range[a][1], index[a])};
        }
  require(range[0][1] >= 0, "there is nothing to show: no voxel is marked");
  return range;
}

/// Box of whole voxels along the axes of LPS.
Box box_of(const Grid& grid, const Mask* where, double margin_mm) {
  Box all, part;
  for (const auto& [box, range] : {std::pair{&all, occupied(grid, nullptr)}, std::pair{&part, occupied(grid, where)}})
    for (int corner = 0; corner < 8; ++corner) {
      Vec3d index;
      for (int a = 0; a < 3; ++a) index[a] = corner >> a & 1 ? range[std::size_t(a)][1] + 0.5 : range[std::size_t(a)][0] - 0.5;
      box->add(grid.point(index));
    }
  for (int a = 0; a < 3; ++a) {
    part.low[a] = std::max(all.low[a], part.low[a] - margin_mm);
    part.high[a] = std::min(all.high[a], part.high[a] + margin_mm);
  }
  return part;
}

double smallest(const Vec3d& v) { return std::min({v.x, v.y, v.z}); }

/// Calls body(view voxel) for all that hold, or whose centre lies in, a voxel that is not 0.
template <class Body>
void for_each_marked(const Grid& view, const Mask& mask, Body&& body) {
  for (int k = 0; k < mask.grid.size[2]; ++k)
    for (int j = 0; j < mask.grid.size[1]; ++j)
      for (int i = 0; i < mask.grid.size[0]; ++i) {
        if (!mask.at(i, j, k)) continue;
        const Vec3d c = view.index(mask.grid.point(i, j, k));
        const int a = int(std::lround(c.x)), b = int(std::lround(c.y)), d = int(std::lround(c.z));
        if (a >= 0 && b >= 0 && d >= 0 && a < view.size[0] && b < view.size[1] && d < view.size[2]) body(view.offset(a, b, d));
      }
  for_each_voxel(view, [&](int i, int j, int k, std::size_t v) {
    if (nearest_value<std::uint8_t>(mask, view.point(i, j, k), 0)) body(v);
  });
}

struct Mosaic {
  GreyPicture picture;
  int tile_width, tile_height, columns;
};

Mosaic arrange_slices(const ByteVolume& volume) {
  const auto& n = volume.grid.size;
  const auto whole_blocks = [](int size) { return (size + block - 1) / block * block; };
  Mosaic m{{}, whole_blocks(n[0]), whole_blocks(n[1]), 1};
  m.columns = std::clamp(int(std::lround(std::sqrt(double(n[2]) * m.tile_height / m.tile_width))), 1, n[2]);
  const int rows = (n[2] + m.columns - 1) / m.columns;
  m.picture = {m.tile_width * m.columns, m.tile_height * rows, {}};
  m.picture.grey.resize(std::size_t(m.picture.width) * std::size_t(m.picture.height));
  for (int k = 0; k < n[2]; ++k)
    for (int j = 0; j < n[1]; ++j)
      std::copy_n(&volume.at(0, j, k), n[0], m.picture.grey.begin() + (std::ptrdiff_t(k / m.columns) * m.tile_height + j) * m.picture.width + std::ptrdiff_t(k % m.columns) * m.tile_width);
  return m;
}

Json describe(const Mosaic& m, std::string picture) { return {{"tile", {m.tile_width, m.tile_height}}, {"columns", m.columns}, {"picture", std::move(picture)}}; }

}  // namespace

Grid view_grid(const Grid& image, std::size_t most_voxels, const Mask* where, double margin_mm) {
  const Box box = box_of(image, where, margin_mm);
  const Vec3d extent = box.high - box.low;
  double spacing = std::max(smallest(image.spacing), std::cbrt(extent.x * extent.y * extent.z / double(most_voxels)));
  Grid view;
  for (;; spacing *= 1.02) {
    for (int a = 0; a < 3; ++a) view.size[std::size_t(a)] = std::max(1, int(std::ceil(extent[a] / spacing - 1e-6)));
    if (view.count() <= most_voxels) break;
  }
  view.spacing = {spacing, spacing, spacing};
  for (int a = 0; a < 3; ++a) view.origin[a] = 0.5 * (box.low[a] + box.high[a]) - 0.5 * spacing * (view.size[std::size_t(a)] - 1);
  return view;
}

ByteVolume grey_bytes(const Image& image, const Grid& view, const ByteRange& range) {
  ByteVolume bytes(view);
  // Samples along the axes of LPS, as many as there are voxels of the image in one of the view.
  const IndexMap index_of(view, image.grid);
  std::array<std::vector<double>, 3> along;  // in voxels of the view, from the centre
  for (int a = 0; a < 3; ++a) {
    const Vec3d& step = index_of.step(a);
    const int samples = std::clamp(int(std::ceil(std::max({std::abs(step.x), std::abs(step.y), std::abs(step.z)}) - 1e-6)), 1, most_samples);
    for (int s = 0; s < samples; ++s) along[std::size_t(a)].push_back((s + 0.5) / samples - 0.5);
  }
  for_each_voxel(view, [&, source = view_of(image)](int i, int j, int k, std::size_t v) {
    double sum = 0;
    int found = 0;
    for (const double c : along[2])
      for (const double b : along[1])
        for (const double a : along[0]) {
          double value;
          if (interpolate_at_index(source, index_of(i + a, j + b, k + c), value)) sum += value, ++found;
        }
    if (found) bytes.data[v] = std::uint8_t(std::lround(255 * std::clamp((sum / found - range.low) / (range.high - range.low), 0.0, 1.0)));
  });
  return bytes;
}

ByteVolume scalar_bytes(const Image& image, const Grid& view, const ByteRange& range) {
  ByteVolume bytes(view);
  for_each_voxel(view, [&](int i, int j, int k, std::size_t v) {
    const float value = nearest_value(image, view.point(i, j, k), std::numeric_limits<float>::quiet_NaN());
    if (!std::isnan(value)) bytes.data[v] = std::uint8_t(1 + std::lround(254 * std::clamp((value - range.low) / (range.high - range.low), 0.0, 1.0)));
  });
  return bytes;
}

void set_bits(ByteVolume& view, const Mask& mask, std::uint8_t bit) {
  for_each_marked(view.grid, mask, [&](std::size_t v) { view.data[v] = std::uint8_t(view.data[v] | bit); });
}

void set_lowest(ByteVolume& view, const Mask& mask) {
  for_each_marked(view.grid, mask, [&](std::size_t v) { view.data[v] = 1; });
}

Json mosaic_as_jpeg(const ByteVolume& volume) {
  const Mosaic m = arrange_slices(volume);
  return describe(m, jpeg_address(m.picture, jpeg_quality));
}

Json mosaic_as_png(const ByteVolume& volume) {
  const Mosaic m = arrange_slices(volume);
  return describe(m, png_address(m.picture));
}

Json describe_view(const Grid& view) { return {{"size", view.size}, {"spacing_mm", view.spacing.x}, {"origin_mm", {view.origin.x, view.origin.y, view.origin.z}}}; }

Json coarse_vectors(const VectorImage& field, const Mask& known, const Grid& view, std::size_t most) {
  Grid coarse = view_grid(view, most);
  PackedVectors packed;
  for (int k = 0; k < coarse.size[2]; ++k)
    for (int j = 0; j < coarse.size[1]; ++j)
      for (int i = 0; i < coarse.size[0]; ++i) {
        const Vec3d point = coarse.point(i, j, k);
        Vec3d v;
        if (nearest_value<std::uint8_t>(known, point, 0) && linear_value(field, point, v)) packed.add(v);
        else packed.add_unknown();
      }
  Json j = describe_view(coarse);
  j["scale_mm"] = PackedVectors::scale_mm, j["data"] = packed.text();
  return j;
}

}  // namespace mtled
