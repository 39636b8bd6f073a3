#include <algorithm>
#include <cmath>

#include "core/error.hpp"
#include "core/parallel.hpp"
#include "imaging/evaluation.hpp"
#include "imaging/nearest_point.hpp"
#include "imaging/percentile.hpp"
#include "imaging/same_grid.hpp"

namespace mtled {
namespace {

constexpr int reported_percents[] = {60, 75, 85, 95};
constexpr double largest_counted_mm = 10;  ///< distances beyond it count as it in the modified Hausdorff distance

/// Centres of the edge voxels [mm]: all in one group, or one group per slice.
std::vector<std::vector<Vec3d>> edge_points(const Mask& edges, EdgeSpace space) {
  std::vector<std::vector<Vec3d>> groups(space == EdgeSpace::slices ? std::size_t(edges.grid.size[2]) : 1);
  for (int k = 0; k < edges.grid.size[2]; ++k)
    for (int j = 0; j < edges.grid.size[1]; ++j)
      for (int i = 0; i < edges.grid.size[0]; ++i)
        if (edges.at(i, j, k)) groups[space == EdgeSpace::slices ? std::size_t(k) : 0].push_back(edges.grid.point(i, j, k));
  return groups;
}

/// Distances from every point of one set to the other set.
struct Directed {
  std::vector<double> all;         ///< [mm]
  std::vector<double> consistent;  ///< [mm] those that pass the round trip
};

void add_distances(const std::vector<Vec3d>& from, const NearestPoint& nearest_from,
                   const std::vector<Vec3d>& to, const NearestPoint& nearest_to, double round_trip_mm, Directed& result) {
  const std::size_t before = result.all.size();
  result.all.resize(before + from.size());
  std::vector<std::uint8_t> passes(from.size());
  parallel_for(from.size(), [&](std::size_t p) {
    const auto there = nearest_to(from[p]);
    const auto back = nearest_from(to[there.index]);
    result.all[before + p] = std::sqrt(there.squared_distance);
    // On a voxel grid the way back often has several equally near ends; p itself may be one that was not returned.
    const bool tie = back.squared_distance >= there.squared_distance * (1 - 1e-9);
    passes[p] = tie || squared_norm(from[back.index] - from[p]) <= round_trip_mm * round_trip_mm;
  });
  for (std::size_t p = 0; p < from.size(); ++p)
    if (passes[p]) result.consistent.push_back(result.all[before + p]);
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

double largest_spacing(const Grid& grid, EdgeSpace space) {
  return std::max({grid.spacing.x, grid.spacing.y, space == EdgeSpace::slices ? 0 : grid.spacing.z});
}

/// Percentiles 1 to 100, max of both directions.
std::vector<double> percentile_curve(std::vector<double> a, std::vector<double> b) {
  std::sort(a.begin(), a.end());
  std::sort(b.begin(), b.end());
  std::vector<double> curve;
  for (int percent = 1; percent <= 100; ++percent) curve.push_back(std::max(percentile_of_sorted(a, percent), percentile_of_sorted(b, percent)));
  return curve;
}

}  // namespace

EdgeDistance compare_edges(const Mask& edges_a, const Mask& edges_b, double round_trip_mm, EdgeSpace space, double source_voxel_mm) {
  require(round_trip_mm >= 0, "round-trip distance is ", round_trip_mm, " mm; give zero or a positive distance");
  require(space == EdgeSpace::volume || same_grid(edges_a.grid, edges_b.grid), "edges of slices lie on different grids; resample one image to the other");
  const auto a = edge_points(edges_a, space), b = edge_points(edges_b, space);
  EdgeDistance result;
  result.two_voxels_mm = 2 * std::max({largest_spacing(edges_a.grid, space), largest_spacing(edges_b.grid, space), source_voxel_mm});
  Directed ab, ba;
  for (std::size_t g = 0; g < a.size(); ++g) {
    result.edges_a += a[g].size();
    result.edges_b += b[g].size();
    if (a[g].empty() || b[g].empty()) {
      result.unmatched_a += a[g].size();
      result.unmatched_b += b[g].size();
      continue;
    }
    const NearestPoint nearest_a(a[g]), nearest_b(b[g]);
    add_distances(a[g], nearest_a, b[g], nearest_b, round_trip_mm, ab);
    add_distances(b[g], nearest_b, a[g], nearest_a, round_trip_mm, ba);
  }
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
