#include "imaging/morphology.hpp"

#include <algorithm>
#include <cmath>

#include "core/parallel.hpp"

namespace mtled {
namespace {

/// distance(v) = min(distance(v), distance(v + k steps along the axis) + (k * spacing)^2) for |k| <= reach: one of the
/// three separable passes of the squared Euclidean distance.
void spread_along(std::vector<float>& distance, const Grid& grid, int axis, double radius_mm) {
  const double spacing = grid.spacing[axis];
  const int n = grid.size[axis], reach = int(radius_mm / spacing);
  const std::ptrdiff_t stride = axis == 0 ? 1 : axis == 1 ? grid.size[0] : std::ptrdiff_t(grid.size[0]) * grid.size[1];
  // Lines along i are handled one by one; along j and k, a whole row of i at a time, which the compiler vectorises.
  const int width = axis == 0 ? 1 : grid.size[0];
  const std::ptrdiff_t lines = std::ptrdiff_t(grid.count()) / (std::ptrdiff_t(n) * width);
  parallel_pieces(std::size_t(lines), 64, [&](std::size_t first, std::size_t last) {
    std::vector<float> line(std::size_t(n) * width);
    for (std::ptrdiff_t l = std::ptrdiff_t(first); l < std::ptrdiff_t(last); ++l) {
      const std::ptrdiff_t start = axis == 0   ? l * n
                                   : axis == 1 ? l * std::ptrdiff_t(grid.size[0]) * grid.size[1]
                                               : l * std::ptrdiff_t(grid.size[0]);
      for (int a = 0; a < n; ++a) std::copy_n(&distance[start + a * stride], width, &line[std::size_t(a) * width]);
      for (int a = 0; a < n; ++a) {
        float* out = &distance[start + a * stride];
        for (int b = std::max(a - reach, 0); b <= std::min(a + reach, n - 1); ++b) {
          const float step = float((b - a) * spacing * (b - a) * spacing);
          const float* in = &line[std::size_t(b) * width];
          for (int i = 0; i < width; ++i) out[i] = std::min(out[i], in[i] + step);
        }
      }
    }
  });
}

/// Voxels within `radius_mm` of those that have `value`.
Mask within(const Mask& mask, bool value, double radius_mm) {
  std::vector<float> squared_distance(mask.data.size());
  for (std::size_t v = 0; v < mask.data.size(); ++v) squared_distance[v] = (mask.data[v] != 0) == value ? 0 : INFINITY;
  for (int axis = 0; axis < 3; ++axis) spread_along(squared_distance, mask.grid, axis, radius_mm);
  Mask result(mask.grid);
  const float limit = float(radius_mm * radius_mm * (1 + 1e-6));
  for (std::size_t v = 0; v < mask.data.size(); ++v) result.data[v] = squared_distance[v] <= limit;
  return result;
}

/// Calls visit(offset) for every voxel that is 6-connected to `seed` through `where`, and clears it there.
template <class Visit>
void consume(Mask& where, std::size_t seed, int frozen_axis, std::vector<std::size_t>& stack, Visit visit) {
  if (!where.data[seed]) return;
  const auto& n = where.grid.size;
  const std::size_t stride[3] = {1, std::size_t(n[0]), std::size_t(n[0]) * std::size_t(n[1])};
  where.data[seed] = 0;
  stack.assign(1, seed);
  while (!stack.empty()) {
    const std::size_t v = stack.back();
    stack.pop_back();
    visit(v);
    const int index[3] = {int(v % stride[1]), int(v / stride[1] % std::size_t(n[1])), int(v / stride[2])};
    for (int axis = 0; axis < 3; ++axis) {
      if (axis == frozen_axis) continue;
      for (const bool up : {false, true}) {
        if (index[axis] == (up ? n[axis] - 1 : 0)) continue;
        const std::size_t next = up ? v + stride[axis] : v - stride[axis];
        if (!where.data[next]) continue;
        where.data[next] = 0;
        stack.push_back(next);
      }
    }
  }
}

}  // namespace

std::size_t count(const Mask& mask) { return std::size_t(std::count_if(mask.data.begin(), mask.data.end(), [](auto v) { return v != 0; })); }

Mask dilate(const Mask& mask, double radius_mm) { return within(mask, true, radius_mm); }

Mask erode(const Mask& mask, double radius_mm) {
  Mask result = within(mask, false, radius_mm);
  for (auto& voxel : result.data) voxel = !voxel;
  return result;
}

Mask largest_component(const Mask& mask) {
  Mask remaining = mask;
  std::vector<std::size_t> stack;
  std::size_t best_seed = 0, best_size = 0;
  for (std::size_t v = 0; v < remaining.data.size(); ++v) {
    std::size_t size = 0;
    consume(remaining, v, -1, stack, [&](std::size_t) { ++size; });
    if (size > best_size) best_seed = v, best_size = size;
  }
  return flood(mask, best_size > 0 ? std::vector{best_seed} : std::vector<std::size_t>{}, -1);
}

Mask flood(const Mask& where, const std::vector<std::size_t>& seeds, int frozen_axis) {
  Mask remaining = where, result(where.grid);
  std::vector<std::size_t> stack;
  for (const std::size_t seed : seeds)
    consume(remaining, seed, frozen_axis, stack, [&](std::size_t v) { result.data[v] = 1; });
  return result;
}

}  // namespace mtled
