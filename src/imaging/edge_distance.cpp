#include <algorithm>
#include <cmath>

#include "core/error.hpp"
#include "core/parallel.hpp"
#include "imaging/evaluation.hpp"
#include "imaging/nearest_point.hpp"
#include "imaging/percentile.hpp"

namespace mtled {
namespace {

constexpr double reported_percents[] = {60, 75, 85, 95};
constexpr double largest_counted_mm = 10;  ///< distances beyond it count as it in the modified Hausdorff distance

std::vector<Vec3d> edge_points(const Mask& edges) {
  std::vector<Vec3d> points;
  for (int k = 0; k < edges.grid.size[2]; ++k)
    for (int j = 0; j < edges.grid.size[1]; ++j)
      for (int i = 0; i < edges.grid.size[0]; ++i)
        if (edges.at(i, j, k)) points.push_back(edges.grid.point(i, j, k));
  return points;
}

/// Distances from every point of one set to the other set.
struct Directed {
  std::vector<double> all;         ///< [mm]
  std::vector<double> consistent;  ///< [mm] those that pass the round trip
};

Directed directed_distances(const std::vector<Vec3d>& from, const NearestPoint& nearest_from,
                            const std::vector<Vec3d>& to, const NearestPoint& nearest_to, double round_trip_mm) {
  Directed result;
  result.all.resize(from.size());
  std::vector<std::uint8_t> passes(from.size());
  parallel_for(from.size(), [&](std::size_t p) {
    const auto there = nearest_to(from[p]);
    const auto back = nearest_from(to[there.index]);
    result.all[p] = std::sqrt(there.squared_distance);
    // On a voxel grid the way back often has several equally near ends; p itself may be one that was not returned.
    const bool tie = back.squared_distance >= there.squared_distance * (1 - 1e-9);
    passes[p] = tie || squared_norm(from[back.index] - from[p]) <= round_trip_mm * round_trip_mm;
  });
  for (std::size_t p = 0; p < from.size(); ++p)
    if (passes[p]) result.consistent.push_back(result.all[p]);
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

double fraction_below(const std::vector<double>& a, const std::vector<double>& b, double limit) {
  const double strictly = limit * (1 - 1e-9);  // distances on a voxel grid often equal the limit but for rounding
  const auto below = [strictly](double v) { return v < strictly; };
  const auto count = std::count_if(a.begin(), a.end(), below) + std::count_if(b.begin(), b.end(), below);
  return double(count) / double(a.size() + b.size());
}

double largest_spacing(const Grid& grid) { return std::max({grid.spacing.x, grid.spacing.y, grid.spacing.z}); }

}  // namespace

EdgeDistance compare_edges(const Mask& edges_a, const Mask& edges_b, double round_trip_mm) {
  require(round_trip_mm >= 0, "round-trip distance is ", round_trip_mm, " mm; give zero or a positive distance");
  const std::vector<Vec3d> a = edge_points(edges_a), b = edge_points(edges_b);
  require(!a.empty() && !b.empty(), "no edges to compare (", a.size(), " edge voxels in the first image, ", b.size(),
          " in the second); lower the edge thresholds or check the images and their mask");
  const NearestPoint nearest_a(a), nearest_b(b);
  Directed ab = directed_distances(a, nearest_a, b, nearest_b, round_trip_mm);
  Directed ba = directed_distances(b, nearest_b, a, nearest_a, round_trip_mm);

  EdgeDistance result;
  result.edges_a = a.size();
  result.edges_b = b.size();
  result.kept_a = double(ab.consistent.size()) / double(a.size());
  result.kept_b = double(ba.consistent.size()) / double(b.size());
  result.mean_mm = std::max(mean(ab.consistent), mean(ba.consistent));
  result.modified_hausdorff_mm =
      std::max(mean_up_to(ab.all, largest_counted_mm), mean_up_to(ba.all, largest_counted_mm));
  const double two_voxels = 2 * std::max(largest_spacing(edges_a.grid), largest_spacing(edges_b.grid));
  result.within_two_voxels = fraction_below(ab.consistent, ba.consistent, two_voxels);
  result.within_two_voxels_all = fraction_below(ab.all, ba.all, two_voxels);
  for (const double percent : reported_percents) {
    result.percents.push_back(percent);
    result.hausdorff_mm.push_back(std::max(percentile(ab.consistent, percent), percentile(ba.consistent, percent)));
    result.hausdorff_all_mm.push_back(std::max(percentile(ab.all, percent), percentile(ba.all, percent)));
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
