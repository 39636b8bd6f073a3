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

namespace mtled {
namespace {

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
  return differs(i - 1, j, k) || differs(i + 1, j, k) || differs(i, j - 1, k) || differs(i, j + 1, k) ||
         differs(i, j, k - 1) || differs(i, j, k + 1);
}

std::map<int, Region> regions_of(const LabelImage& labels) {
  std::map<int, Region> regions;
  for (int k = 0; k < labels.grid.size[2]; ++k)
    for (int j = 0; j < labels.grid.size[1]; ++j)
      for (int i = 0; i < labels.grid.size[0]; ++i) {
        const int label = labels.at(i, j, k);
        if (label == 0) continue;
        Region& region = regions[label];
        ++region.voxels;
        if (on_surface(labels, i, j, k)) region.surface.push_back(labels.grid.point(i, j, k));
      }
  return regions;
}

double directed_percentile(const std::vector<Vec3d>& from, const std::vector<Vec3d>& to, double percent) {
  const NearestPoint nearest(to);
  std::vector<double> distances(from.size());
  parallel_for(from.size(), [&](std::size_t p) { distances[p] = std::sqrt(nearest(from[p]).squared_distance); });
  return percentile(distances, percent);
}

}  // namespace

std::vector<LabelOverlap> label_overlap(const LabelImage& a, const LabelImage& b) {
  require(same_grid(a.grid, b.grid), "the two label images lie on different grids; resample one to the other");
  std::map<int, std::size_t> shared;
  for (std::size_t v = 0; v < a.data.size(); ++v)
    if (a.data[v] != 0 && a.data[v] == b.data[v]) ++shared[a.data[v]];
  std::map<int, Region> regions_a = regions_of(a), regions_b = regions_of(b);
  for (const auto& [label, region] : regions_b) regions_a[label];

  std::vector<LabelOverlap> result;
  for (const auto& [label, in_a] : regions_a) {
    const Region& in_b = regions_b[label];
    LabelOverlap overlap{label, 2 * double(shared[label]) / double(in_a.voxels + in_b.voxels),
                         std::numeric_limits<double>::quiet_NaN()};
    if (in_a.voxels > 0 && in_b.voxels > 0)
      overlap.hausdorff95_mm = std::max(directed_percentile(in_a.surface, in_b.surface, 95),
                                        directed_percentile(in_b.surface, in_a.surface, 95));
    result.push_back(overlap);
  }
  return result;
}

}  // namespace mtled
