#include <algorithm>
#include <cmath>
#include <limits>
#include <map>

#include "core/error.hpp"
#include "core/parallel.hpp"
#include "imaging/evaluation.hpp"
#include "imaging/nearest_point.hpp"
#include "imaging/percentile.hpp"
#include "imaging/same_grid.hpp"
#include "imaging/surface_elements.hpp"

namespace mtled {
namespace {

constexpr double no_value = std::numeric_limits<double>::quiet_NaN();

struct Region {
  std::size_t voxels = 0;
  std::vector<Vec3d>
      surface;  ///< [mm] centres of voxels with a face neighbour of another value, or at the image's border
};

bool on_surface(const LabelImage& labels, int i, int j, int k) {
  const auto& n = labels.grid.size;
  const std::uint16_t label = labels.at(i, j, k);
  const auto differs = [&](int a, int b, int c) {
    if (a < 0 || b < 0 || c < 0 || a >= n[0] || b >= n[1] || c >= n[2]) return true;
    return labels.at(a, b, c) != label;
  };
  return (n[0] > 1 && (differs(i - 1, j, k) || differs(i + 1, j, k))) || (n[1] > 1 && (differs(i, j - 1, k) || differs(i, j + 1, k))) ||
         (n[2] > 1 && (differs(i, j, k - 1) || differs(i, j, k + 1)));
}

std::map<int, Region> regions_of(const LabelImage& labels) {
  std::vector<std::map<int, Region>> slices(std::size_t(labels.grid.size[2]));
  parallel_for(
      slices.size(),
      [&](std::size_t slice) {
        const int k = int(slice);
        for (int j = 0; j < labels.grid.size[1]; ++j)
          for (int i = 0; i < labels.grid.size[0]; ++i) {
            const int label = labels.at(i, j, k);
            if (label == 0) continue;
            Region& region = slices[slice][label];
            ++region.voxels;
            if (on_surface(labels, i, j, k)) region.surface.push_back(labels.grid.point(i, j, k));
          }
      },
      1);
  std::map<int, Region> regions;
  for (const std::map<int, Region>& in_slice : slices)
    for (const auto& [label, part] : in_slice) {
      Region& region = regions[label];
      region.voxels += part.voxels;
      region.surface.insert(region.surface.end(), part.surface.begin(), part.surface.end());
    }
  return regions;
}

double area_of(const std::vector<SurfaceElement>& elements) {
  double sum = 0;
  for (const SurfaceElement& element : elements) sum += element.area;
  return sum;
}

std::vector<double> directed_distances(const std::vector<Vec3d>& from, const std::vector<Vec3d>& to) {
  const NearestPoint nearest(to);
  std::vector<double> distances(from.size());
  parallel_for(from.size(), [&](std::size_t p) { distances[p] = std::sqrt(nearest(from[p]).squared_distance); });
  return distances;
}

/// Distances between two surfaces; without voxels there are none.
void compare_surfaces(const Region& a, const Region& b, LabelOverlap& overlap) {
  overlap.hausdorff95_mm = overlap.hausdorff95_pooled_mm = overlap.average_surface_distance_mm = no_value;
  if (a.surface.empty() || b.surface.empty()) return;
  std::vector<double> ab = directed_distances(a.surface, b.surface), ba = directed_distances(b.surface, a.surface);
  overlap.hausdorff95_mm = std::max(percentile(ab, 95), percentile(ba, 95));
  ab.insert(ab.end(), ba.begin(), ba.end());
  overlap.hausdorff95_pooled_mm = percentile(ab, 95);
  double sum = 0;
  for (const double d : ab) sum += d;
  overlap.average_surface_distance_mm = sum / double(ab.size());
}

}  // namespace

std::vector<LabelOverlap> label_overlap(const LabelImage& a, const LabelImage& b) {
  require(same_grid(a.grid, b.grid), "the two label images lie on different grids; resample one to the other");
  std::map<int, std::size_t> shared;
  for (std::size_t v = 0; v < a.data.size(); ++v)
    if (a.data[v] != 0 && a.data[v] == b.data[v]) ++shared[a.data[v]];
  std::map<int, Region> regions_a = regions_of(a), regions_b = regions_of(b);
  const bool volume = std::find(a.grid.size.begin(), a.grid.size.end(), 1) == a.grid.size.end();
  std::map<int, std::vector<SurfaceElement>> elements_a, elements_b;
  if (volume) elements_a = surface_elements(a), elements_b = surface_elements(b);
  for (const auto& [label, region] : regions_b) regions_a[label];

  std::vector<LabelOverlap> result;
  for (const auto& [label, in_a] : regions_a) {
    const Region& in_b = regions_b[label];
    LabelOverlap overlap{.label = label, .dice = 2 * double(shared[label]) / double(in_a.voxels + in_b.voxels), .voxels_a = in_a.voxels, .voxels_b = in_b.voxels};
    compare_surfaces(in_a, in_b, overlap);
    overlap.surface_area_a_mm2 = volume ? area_of(elements_a[label]) : no_value, overlap.surface_area_b_mm2 = volume ? area_of(elements_b[label]) : no_value;
    overlap.hausdorff95_learn2reg_mm = hausdorff_by_area(elements_a[label], elements_b[label], 95);
    result.push_back(overlap);
  }
  return result;
}

}  // namespace mtled
