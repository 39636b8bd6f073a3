#include "imaging/contour.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/error.hpp"
#include "core/parallel.hpp"
#include "imaging/nearest_point.hpp"
#include "imaging/percentile.hpp"
#include "imaging/same_grid.hpp"
#include "imaging/voxel_loop.hpp"

namespace mtled {
namespace {

std::vector<Vec3d> points_of_slice(const Mask& contours, int k) {
  std::vector<Vec3d> points;
  for (int j = 0; j < contours.grid.size[1]; ++j)
    for (int i = 0; i < contours.grid.size[0]; ++i)
      if (contours.at(i, j, k)) points.push_back(contours.grid.point(i, j, k));
  return points;
}

void add_distances(const std::vector<Vec3d>& from, const std::vector<Vec3d>& to, std::vector<double>& distances, std::size_t& unmatched) {
  if (to.empty()) {
    unmatched += from.size();
    return;
  }
  const NearestPoint nearest(to);
  const std::size_t before = distances.size();
  distances.resize(before + from.size());
  parallel_for(from.size(), [&](std::size_t p) { distances[before + p] = std::sqrt(nearest(from[p]).squared_distance); }, 256);
}

ContourDistance describe_distances(std::vector<double> distances, std::size_t unmatched) {
  constexpr double none = std::numeric_limits<double>::quiet_NaN();
  if (distances.empty()) return {0, unmatched, none, none, none, none};
  double sum = 0;
  for (const double d : distances) sum += d;
  std::sort(distances.begin(), distances.end());
  return {distances.size(), unmatched, sum / double(distances.size()), percentile_of_sorted(distances, 50), percentile_of_sorted(distances, 95), distances.back()};
}

}  // namespace

Mask contours_of_slices(const Mask& organ, const Mask& where) {
  require(same_grid(organ.grid, where.grid), "the organ and the mask lie on different grids; resample the mask");
  Mask contours(organ.grid);
  const auto& n = organ.grid.size;
  for_each_voxel(organ.grid, [&](int i, int j, int k, std::size_t voxel) {
    const auto outside = [&](int a, int b) {
      if (a < 0 || b < 0 || a >= n[0] || b >= n[1]) return false;
      const std::size_t neighbour = organ.grid.offset(a, b, k);
      return where.data[neighbour] && !organ.data[neighbour];
    };
    contours.data[voxel] = organ.data[voxel] && where.data[voxel] && (outside(i - 1, j) || outside(i + 1, j) || outside(i, j - 1) || outside(i, j + 1));
  });
  return contours;
}

ContourComparison compare_contours(const Mask& contours_a, const Mask& contours_b) {
  require(same_grid(contours_a.grid, contours_b.grid), "the contours lie on different grids; resample one image to the other");
  std::vector<double> from_a, from_b;
  std::size_t unmatched_a = 0, unmatched_b = 0;
  for (int k = 0; k < contours_a.grid.size[2]; ++k) {
    const std::vector<Vec3d> a = points_of_slice(contours_a, k), b = points_of_slice(contours_b, k);
    add_distances(a, b, from_a, unmatched_a);
    add_distances(b, a, from_b, unmatched_b);
  }
  return {describe_distances(std::move(from_a), unmatched_a), describe_distances(std::move(from_b), unmatched_b)};
}

}  // namespace mtled
