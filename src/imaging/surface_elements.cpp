#include "imaging/surface_elements.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>
#include <utility>

#include "core/parallel.hpp"
#include "imaging/nearest_point.hpp"

namespace mtled {
namespace {

using Polygon = std::vector<Vec3d>;  ///< [cell edges]

/// An edge of the cell, by its ends in ascending order.
int edge(int p, int q) { return std::min(p, q) * 8 + std::max(p, q); }

Vec3d middle_of(int an_edge) {
  const int p = an_edge / 8, q = an_edge % 8;
  Vec3d middle;
  for (int a = 0; a < 3; ++a) middle[a] = 0.5 * ((p >> a & 1) + (q >> a & 1));
  return middle;
}

/// On every face, the lines that join the cut edges; each cut edge has one on either of its faces.
std::map<int, std::vector<int>> lines_on_faces(int inside) {
  std::map<int, std::vector<int>> joined;
  const auto join = [&](int a, int b) { joined[a].push_back(b), joined[b].push_back(a); };
  for (int axis = 0; axis < 3; ++axis)
    for (const int side : {0, 1 << axis}) {
      const int u = 1 << (axis + 1) % 3, v = 1 << (axis + 2) % 3;
      const int corner[4] = {side, side + u, side + u + v, side + v};
      std::vector<int> cut;
      for (int c = 0; c < 4; ++c)
        if ((inside >> corner[c] & 1) != (inside >> corner[(c + 1) % 4] & 1)) cut.push_back(edge(corner[c], corner[(c + 1) % 4]));
      if (cut.size() == 2) join(cut[0], cut[1]);
      if (cut.size() != 4) continue;  // else edges 0 to 3 in turn, the edge c between the corners c and c + 1
      for (const int c : {1, 2, 3, 4})
        if (inside >> corner[c % 4] & 1) join(cut[std::size_t(c - 1)], cut[std::size_t(c % 4)]);
    }
  return joined;
}

std::vector<Polygon> polygons_in_cell(int inside) {
  if (std::popcount(unsigned(inside)) > 4) inside = 255 - inside;
  std::map<int, std::vector<int>> joined = lines_on_faces(inside);
  std::vector<Polygon> polygons;
  while (!joined.empty()) {
    Polygon polygon;
    for (int at = joined.begin()->first, from = -1; joined.contains(at);) {
      const std::vector<int> ends = joined.extract(at).mapped();
      const int next = ends[0] != from ? ends[0] : ends[1];
      polygon.push_back(middle_of(at));
      from = at, at = next;
    }
    polygons.push_back(polygon);
  }
  return polygons;
}

struct Area {
  double in_cells = 0, in_mm2 = 0;
};

/// Of the corners `first` to `last` of a polygon, divided as said in the header.
Area largest_area(const Polygon& polygon, std::size_t first, std::size_t last, const Vec3d& scale) {
  constexpr double rounding = 1e-9;
  Area best;
  for (std::size_t apex = first + 1; apex < last; ++apex) {
    const Vec3d n = 0.5 * cross(polygon[apex] - polygon[first], polygon[last] - polygon[first]);
    const Area left = largest_area(polygon, first, apex, scale), right = largest_area(polygon, apex, last, scale);
    const Area sum{left.in_cells + right.in_cells + norm(n), left.in_mm2 + right.in_mm2 + norm(Vec3d{n.x * scale.x, n.y * scale.y, n.z * scale.z})};
    if (sum.in_cells > best.in_cells + rounding) best = sum;
  }
  return best;
}

using Elements = std::map<int, std::vector<SurfaceElement>>;

/// A row of voxels along i with a 0 before and behind it; all 0 beyond the image.
std::vector<std::uint16_t> padded_row(const LabelImage& labels, int j, int k) {
  const auto& n = labels.grid.size;
  std::vector<std::uint16_t> row(std::size_t(n[0]) + 2);
  if (j >= 0 && k >= 0 && j < n[1] && k < n[2]) std::copy_n(&labels.at(0, j, k), n[0], row.begin() + 1);
  return row;
}

/// The elements between the slices k and k + 1.
Elements elements_between(const LabelImage& labels, const std::array<double, 256>& areas, int k) {
  const auto& n = labels.grid.size;
  Elements elements;
  for (int j = -1; j < n[1]; ++j) {
    const std::vector<std::uint16_t> rows[4] = {padded_row(labels, j, k), padded_row(labels, j + 1, k), padded_row(labels, j, k + 1), padded_row(labels, j + 1, k + 1)};
    for (std::size_t i = 0; i <= std::size_t(n[0]); ++i) {
      std::uint16_t corner[8];
      bool same = true;
      for (std::size_t b = 0; b < 8; ++b) corner[b] = rows[b >> 1][i + (b & 1)], same = same && corner[b] == corner[0];
      if (same) continue;
      for (std::size_t b = 0; b < 8; ++b) {
        if (corner[b] == 0 || std::find(corner, corner + b, corner[b]) != corner + b) continue;
        std::size_t inside = 0;
        for (std::size_t c = 0; c < 8; ++c) inside |= std::size_t(corner[c] == corner[b]) << c;
        elements[corner[b]].push_back({labels.grid.point(Vec3d{double(i) - 0.5, j + 0.5, k + 0.5}), areas[inside]});
      }
    }
  }
  return elements;
}

double distance_by_area(const std::vector<SurfaceElement>& from, const NearestPoint& to, double percent) {
  std::vector<std::pair<double, double>> distance_and_area(from.size());
  parallel_for(from.size(), [&](std::size_t e) { distance_and_area[e] = {std::sqrt(to(from[e].position).squared_distance), from[e].area}; });
  std::sort(distance_and_area.begin(), distance_and_area.end());
  double total = 0, sum = 0;
  for (const SurfaceElement& element : from) total += element.area;
  for (const auto& [distance, area] : distance_and_area)
    if ((sum += area) >= percent / 100 * total) return distance;
  return distance_and_area.back().first;
}

}  // namespace

std::array<double, 256> surface_areas_in_cells(const Vec3d& spacing) {
  const Vec3d scale{spacing.y * spacing.z, spacing.x * spacing.z, spacing.x * spacing.y};  // of the components of an area
  std::array<double, 256> areas{};
  for (int inside = 0; inside < 256; ++inside)
    for (const Polygon& polygon : polygons_in_cell(inside)) areas[std::size_t(inside)] += largest_area(polygon, 0, polygon.size() - 1, scale).in_mm2;
  return areas;
}

std::map<int, std::vector<SurfaceElement>> surface_elements(const LabelImage& labels) {
  const std::array<double, 256> areas = surface_areas_in_cells(labels.grid.spacing);
  std::vector<Elements> slices(std::size_t(labels.grid.size[2] + 1));
  parallel_for(slices.size(), [&](std::size_t slice) { slices[slice] = elements_between(labels, areas, int(slice) - 1); }, 1);
  Elements elements;
  for (const Elements& slice : slices)
    for (const auto& [label, some] : slice) elements[label].insert(elements[label].end(), some.begin(), some.end());
  return elements;
}

double hausdorff_by_area(const std::vector<SurfaceElement>& a, const std::vector<SurfaceElement>& b, double percent) {
  if (a.empty() || b.empty()) return std::numeric_limits<double>::quiet_NaN();
  const auto positions = [](const std::vector<SurfaceElement>& elements) {
    std::vector<Vec3d> points;
    for (const SurfaceElement& element : elements) points.push_back(element.position);
    return points;
  };
  const std::vector<Vec3d> at_a = positions(a), at_b = positions(b);
  return std::max(distance_by_area(a, NearestPoint(at_b), percent), distance_by_area(b, NearestPoint(at_a), percent));
}

}  // namespace mtled
