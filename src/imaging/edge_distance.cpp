#include <tbb/parallel_sort.h>

#include <algorithm>
#include <cmath>
#include <utility>

#include "core/error.hpp"
#include "core/parallel.hpp"
#include "imaging/evaluation.hpp"
#include "imaging/nearest_point.hpp"
#include "imaging/nearest_voxel.hpp"
#include "imaging/percentile.hpp"
#include "imaging/same_grid.hpp"

namespace mtled {
namespace {

constexpr int reported_percents[] = {60, 75, 85, 95};
constexpr double largest_counted_mm = 10;  ///< distances beyond it count as it in the modified Hausdorff distance

/// Marked voxels, in the order of the image: all in one group, or one group per slice.
std::vector<std::vector<Index>> edge_voxels(const Mask& edges, EdgeSpace space) {
  std::vector<std::vector<Index>> groups(std::size_t(edges.grid.size[2]));
  parallel_for(
      groups.size(),
      [&](std::size_t k) {
        for (int j = 0; j < edges.grid.size[1]; ++j)
          for (int i = 0; i < edges.grid.size[0]; ++i)
            if (edges.at(i, j, int(k))) groups[k].push_back({i, j, int(k)});
      },
      1);
  if (space == EdgeSpace::slices) return groups;
  std::vector<std::vector<Index>> all(1);
  for (const std::vector<Index>& group : groups) all[0].insert(all[0].end(), group.begin(), group.end());
  return all;
}

/// Distances from every point of one set to the other set.
struct Directed {
  std::vector<double> all;         ///< [mm]
  std::vector<double> consistent;  ///< [mm] those that pass the round trip
};

/// `nearest_from`, `nearest_to`: the nearest point of a set and its squared distance; `squared_distance` of two points of
/// `from`.
template <class Point, class NearestFrom, class NearestTo, class SquaredDistance>
void add_distances(const std::vector<Point>& from, const NearestFrom& nearest_from, const NearestTo& nearest_to, const SquaredDistance& squared_distance, double round_trip_mm, Directed& result) {
  const std::size_t before = result.all.size();
  result.all.resize(before + from.size());
  std::vector<std::uint8_t> passes(from.size());
  parallel_for(from.size(), [&](std::size_t p) {
    const auto [there, squared_there] = nearest_to(from[p]);
    const auto [back, squared_back] = nearest_from(there);
    result.all[before + p] = std::sqrt(squared_there);
    // On a voxel grid the way back often has several equally near ends; p itself may be one that was not returned.
    const bool tie = squared_back >= squared_there * (1 - 1e-9);
    passes[p] = tie || squared_distance(back, from[p]) <= round_trip_mm * round_trip_mm;
  });
  for (std::size_t p = 0; p < from.size(); ++p)
    if (passes[p]) result.consistent.push_back(result.all[before + p]);
}

struct BothWays {
  Directed ab, ba;
};

/// Voxels of one grid.
BothWays distances_on_grid(const Mask& edges_a, const std::vector<std::vector<Index>>& a, const Mask& edges_b, const std::vector<std::vector<Index>>& b, double round_trip_mm, EdgeSpace space) {
  const NearestVoxel nearest_a(edges_a), nearest_b(edges_b);
  const auto find_in = [space](const NearestVoxel& set) {
    return [&set, space](const Index& voxel) { return space == EdgeSpace::slices ? set.in_slice(voxel) : set.anywhere(voxel); };
  };
  const auto squared_distance = [&spacing = edges_a.grid.spacing](const Index& p, const Index& q) { return squared_norm(Vec3d{spacing.x * (p[0] - q[0]), spacing.y * (p[1] - q[1]), spacing.z * (p[2] - q[2])}); };
  BothWays result;
  for (std::size_t g = 0; g < a.size(); ++g) {
    if (a[g].empty() || b[g].empty()) continue;
    add_distances(a[g], find_in(nearest_a), find_in(nearest_b), squared_distance, round_trip_mm, result.ab);
    add_distances(b[g], find_in(nearest_b), find_in(nearest_a), squared_distance, round_trip_mm, result.ba);
  }
  return result;
}

/// Voxel centres of two grids.
BothWays distances_between_grids(const Grid& grid_a, const std::vector<Index>& a, const Grid& grid_b, const std::vector<Index>& b, double round_trip_mm) {
  if (a.empty() || b.empty()) return {};
  const auto centers = [](const Grid& grid, const std::vector<Index>& voxels) {
    std::vector<Vec3d> points;
    for (const auto& [i, j, k] : voxels) points.push_back(grid.point(i, j, k));
    return points;
  };
  const std::vector<Vec3d> points_a = centers(grid_a, a), points_b = centers(grid_b, b);
  const NearestPoint nearest_a(points_a), nearest_b(points_b);
  const auto find_in = [](const NearestPoint& set, const std::vector<Vec3d>& points) {
    return [&](const Vec3d& x) {
      const auto found = set(x);
      return std::pair(points[found.index], found.squared_distance);
    };
  };
  const auto squared_distance = [](const Vec3d& p, const Vec3d& q) { return squared_norm(p - q); };
  BothWays result;
  add_distances(points_a, find_in(nearest_a, points_a), find_in(nearest_b, points_b), squared_distance, round_trip_mm, result.ab);
  add_distances(points_b, find_in(nearest_b, points_b), find_in(nearest_a, points_a), squared_distance, round_trip_mm, result.ba);
  return result;
}

double mean(const std::vector<double>& values) {
  double sum = 0;
  for (const double v : values) sum += v;
  return sum / double(values.size());
}

double mean_up_to(const std::vector<double>& values, double limit) {
  double sum = 0;
  for (const double v : values) sum += std::min(v, limit);
  return sum / double(values.size());
}

double count_below(const std::vector<double>& a, const std::vector<double>& b, double limit) {
  const double strictly = limit * (1 - 1e-9);  // distances on a voxel grid often equal the limit but for rounding
  const auto below = [strictly](double v) { return v < strictly; };
  return double(std::count_if(a.begin(), a.end(), below) + std::count_if(b.begin(), b.end(), below));
}

/// Percentiles 1 to 100, max of both directions.
std::vector<double> percentile_curve(std::vector<double> a, std::vector<double> b) {
  tbb::parallel_sort(a);
  tbb::parallel_sort(b);
  std::vector<double> curve;
  for (int percent = 1; percent <= 100; ++percent) curve.push_back(std::max(percentile_of_sorted(a, percent), percentile_of_sorted(b, percent)));
  return curve;
}

}  // namespace

double largest_spacing(const Grid& grid, EdgeSpace space) { return std::max({grid.spacing.x, grid.spacing.y, space == EdgeSpace::slices ? 0 : grid.spacing.z}); }

EdgeDistance compare_edges(const Mask& edges_a, const Mask& edges_b, double round_trip_mm, EdgeSpace space, double source_voxel_mm) {
  require(round_trip_mm >= 0, "round-trip distance is ", round_trip_mm, " mm; give zero or a positive distance");
  require(space == EdgeSpace::volume || same_grid(edges_a.grid, edges_b.grid), "edges of slices lie on different grids; resample one image to the other");
  const auto a = edge_voxels(edges_a, space), b = edge_voxels(edges_b, space);
  EdgeDistance result;
  result.two_voxels_mm = 2 * std::max({largest_spacing(edges_a.grid, space), largest_spacing(edges_b.grid, space), source_voxel_mm});
  for (std::size_t g = 0; g < a.size(); ++g) {
    result.edges_a += a[g].size();
    result.edges_b += b[g].size();
    if (b[g].empty()) result.unmatched_a += a[g].size();
    if (a[g].empty()) result.unmatched_b += b[g].size();
  }
  auto [ab, ba] = same_grid(edges_a.grid, edges_b.grid) ? distances_on_grid(edges_a, a, edges_b, b, round_trip_mm, space) : distances_between_grids(edges_a.grid, a[0], edges_b.grid, b[0], round_trip_mm);
  if (ab.all.empty()) return result;
  result.kept_a = double(ab.consistent.size()) / double(ab.all.size());
  result.kept_b = double(ba.consistent.size()) / double(ba.all.size());
  result.mean_mm = std::max(mean(ab.consistent), mean(ba.consistent));
  result.modified_hausdorff_mm =
      std::max(mean_up_to(ab.all, largest_counted_mm), mean_up_to(ba.all, largest_counted_mm));
  result.within_two_voxels = count_below(ab.consistent, ba.consistent, result.two_voxels_mm) / double(ab.consistent.size() + ba.consistent.size());
  result.within_two_voxels_all = count_below(ab.all, ba.all, result.two_voxels_mm) / double(result.edges_a + result.edges_b);
  result.curve_mm = percentile_curve(std::move(ab.consistent), std::move(ba.consistent));
  result.curve_all_mm = percentile_curve(std::move(ab.all), std::move(ba.all));
  for (const int percent : reported_percents) {
    result.percents.push_back(percent);
    result.hausdorff_mm.push_back(result.curve_mm[std::size_t(percent - 1)]);
    result.hausdorff_all_mm.push_back(result.curve_all_mm[std::size_t(percent - 1)]);
  }
  return result;
}

PointErrors point_errors(const std::vector<Vec3d>& a, const std::vector<Vec3d>& b) {
  require(a.size() == b.size(), "cannot compare ", a.size(), " points with ", b.size(),
          "; both lists need the same points "
          "in the same order");
  require(!a.empty(), "no points to compare; give at least one pair");
  PointErrors result;
  for (std::size_t p = 0; p < a.size(); ++p) result.distance_mm.push_back(norm(a[p] - b[p]));
  std::vector<double> values = result.distance_mm;
  result.mean = mean(values);
  result.median = percentile(values, 50);
  result.percentile_95 = percentile(values, 95);
  result.maximum = *std::max_element(values.begin(), values.end());
  return result;
}

}  // namespace mtled
