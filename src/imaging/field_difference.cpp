#include "imaging/field_difference.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/error.hpp"
#include "imaging/order_statistics.hpp"
#include "imaging/voxel_loop.hpp"

namespace mtled {
namespace {

constexpr std::size_t most_groups = 10;
constexpr double half_mm = 0.5;
constexpr float unknown = std::numeric_limits<float>::quiet_NaN();

float difference_at(const DisplacementFunction& u, const Vec3d& point, const Vec3d& reference) {
  Vec3d value;
  return u(point, value) ? float(norm(value - reference)) : unknown;
}

/// Where a group begins: with a value of the reference, after so many points that have the same.
struct Border {
  float value;
  std::size_t equals_before;
};

/// The points of every group, in their order: sorted by the reference, then by their place in the list.
std::vector<std::vector<float>> divide(const std::vector<float>& difference, const std::vector<float>& reference, const std::vector<Border>& borders) {
  std::vector<std::vector<float>> values(borders.size() + 1);
  std::vector<std::size_t> seen(borders.size());  // points with the value of a border; of the first one among equals
  for (std::size_t p = 0; p < difference.size(); ++p) {
    std::size_t g = std::size_t(std::partition_point(borders.begin(), borders.end(), [&](const Border& b) { return b.value < reference[p]; }) - borders.begin());
    if (g < borders.size() && borders[g].value == reference[p]) {
      const std::size_t equals = seen[g]++;
      while (g < borders.size() && borders[g].value == reference[p] && borders[g].equals_before <= equals) ++g;
    }
    values[g].push_back(difference[p]);
  }
  return values;
}

/// Groups of as many points each, in the order of the reference's displacement.
std::vector<DifferenceGroup> groups_of(const std::vector<float>& difference, const std::vector<float>& reference) {
  OrderStatistics order(reference);
  const std::size_t count = std::min(most_groups, reference.size());
  const auto first = [&](std::size_t g) { return g * reference.size() / count; };
  std::vector<Border> borders;
  for (std::size_t g = 1; g < count; ++g) borders.push_back({order.at(first(g)), order.equals_before(first(g))});
  std::vector<DifferenceGroup> groups;
  for (const std::vector<float>& values : divide(difference, reference, borders)) {
    OrderStatistics differences(values);
    const std::size_t g = groups.size();
    groups.push_back({order.at(first(g)), order.at(first(g + 1) - 1), values.size(), differences.percentile(50), differences.percentile(95)});
  }
  return groups;
}

/// Drops the points that u does not know, and describes the others.
FieldDifference describe_differences(std::vector<float> difference, std::vector<float> reference, std::size_t known_to_reference) {
  FieldDifference result;
  std::size_t kept = 0;
  for (std::size_t p = 0; p < difference.size(); ++p)
    if (!std::isnan(difference[p])) difference[kept] = difference[p], reference[kept] = reference[p], ++kept;
  require(kept > 0, "none of the ", known_to_reference, " points of the reference is known to the transform; both must be maps from the same image, in LPS mm");
  difference.resize(kept), reference.resize(kept);
  result.unknown = known_to_reference - kept;
  double sum = 0, squares = 0;
  for (const double d : difference) sum += d, squares += d * d;
  result.mean = sum / double(kept), result.root_mean_square = std::sqrt(squares / double(kept));
  result.within_half_mm = double(std::count_if(difference.begin(), difference.end(), [](float d) { return d <= half_mm; })) / double(kept);
  result.groups = groups_of(difference, reference);
  OrderStatistics order(difference);
  for (int percent = 1; percent <= 100; ++percent) result.curve_mm.push_back(order.percentile(percent));
  result.median = result.curve_mm[49], result.percentile_95 = result.curve_mm[94], result.percentile_99_5 = order.percentile(99.5), result.maximum = order.at(kept - 1);
  result.difference_mm = std::move(difference), result.reference_mm = std::move(reference);
  return result;
}

}  // namespace

FieldDifference compare_displacements(const DisplacementFunction& u, const std::vector<Vec3d>& points, const std::vector<Vec3d>& reference) {
  require(points.size() == reference.size(), "cannot compare displacements at ", points.size(), " points with ", reference.size(), " of a reference; give one for every point");
  std::vector<float> difference(points.size()), length(points.size());
  parallel_for(points.size(), [&](std::size_t p) { difference[p] = difference_at(u, points[p], reference[p]), length[p] = float(norm(reference[p])); });
  return describe_differences(std::move(difference), std::move(length), points.size());
}

FieldDifference compare_displacements(const DisplacementFunction& u, const DisplacementFunction& reference, const Grid& grid) {
  std::vector<float> difference(grid.count(), unknown), length(grid.count(), unknown);
  for_each_voxel(grid, [&](int i, int j, int k, std::size_t voxel) {
    const Vec3d point = grid.point(i, j, k);
    Vec3d expected;
    if (reference(point, expected)) length[voxel] = float(norm(expected)), difference[voxel] = difference_at(u, point, expected);
  });
  const auto known = std::count_if(length.begin(), length.end(), [](float l) { return !std::isnan(l); });
  return describe_differences(std::move(difference), std::move(length), std::size_t(known));
}

Image difference_on_slice(const DisplacementFunction& u, const DisplacementFunction& reference, const Grid& slice) {
  Image values(slice, unknown);
  for_each_voxel(slice, [&](int x, int y, int, std::size_t pixel) {
    const Vec3d point = slice.point(x, y, 0);
    Vec3d expected;
    if (reference(point, expected)) values.data[pixel] = difference_at(u, point, expected);
  });
  return values;
}

Image differences_along_sight(const DisplacementFunction& u, const std::vector<Vec3d>& points, const std::vector<Vec3d>& reference, const Grid& slice) {
  Image values(slice, unknown);
  if (points.empty()) return values;
  Vec3d low = points.front(), high = low;
  for (const Vec3d& p : points)
    for (int a = 0; a < 3; ++a) low[a] = std::min(low[a], p[a]), high[a] = std::max(high[a], p[a]);
  const Vec3d extent = high - low;
  const double apart = std::cbrt(extent.x * extent.y * extent.z / double(points.size())), radius = std::max(1.0, 0.5 * apart / slice.spacing.x);
  for (std::size_t p = 0; p < points.size(); ++p) {
    const float difference = difference_at(u, points[p], reference[p]);
    const Vec3d at = slice.index(points[p]);
    if (std::isnan(difference)) continue;
    for (int y = std::max(0, int(std::ceil(at.y - radius))); y <= std::min(slice.size[1] - 1, int(std::floor(at.y + radius))); ++y)
      for (int x = std::max(0, int(std::ceil(at.x - radius))); x <= std::min(slice.size[0] - 1, int(std::floor(at.x + radius))); ++x)
        if (std::hypot(x - at.x, y - at.y) <= radius) values.at(x, y, 0) = std::fmax(values.at(x, y, 0), difference);
  }
  return values;
}

}  // namespace mtled
