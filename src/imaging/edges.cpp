#include <algorithm>
#include <array>
#include <cmath>
#include <type_traits>

#include "core/error.hpp"
#include "core/parallel.hpp"
#include "imaging/evaluation.hpp"
#include "imaging/gaussian_gradient.hpp"
#include "imaging/same_grid.hpp"
#include "imaging/voxel_loop.hpp"

namespace mtled {
namespace {

/// Trilinear value of the gradient's magnitude at a continuous index; false outside the voxel centres.
bool magnitude_at_index(const Gradient& g, const Vec3d& index, double& value) {
  int low[3], high[3];
  double t[3];
  for (int a = 0; a < 3; ++a) {
    const int last = g.grid.size[a] - 1;
    if (!(index[a] >= 0 && index[a] <= last)) return false;
    low[a] = int(index[a]);
    high[a] = std::min(low[a] + 1, last);
    t[a] = index[a] - low[a];
  }
  value = 0;
  for (int corner = 0; corner < 8; ++corner) {
    const bool i = corner & 1, j = corner & 2, k = corner & 4;
    value += (i ? t[0] : 1 - t[0]) * (j ? t[1] : 1 - t[1]) * (k ? t[2] : 1 - t[2]) *
             g.magnitude[g.grid.offset(i ? high[0] : low[0], j ? high[1] : low[1], k ? high[2] : low[2])];
  }
  return true;
}

/// True where the gradient's magnitude is largest along the physical direction of the gradient. Compared with the
/// values where that line leaves the 3x3x3 neighbourhood; a voxel whose line leaves the image is no edge.
bool is_ridge(const Gradient& g, int i, int j, int k, std::size_t voxel) {
  Vec3d step;
  double largest = 0;
  for (int a = 0; a < 3; ++a) {
    step[a] = g.along[a][voxel] / g.grid.spacing[a];
    largest = std::max(largest, std::abs(step[a]));
  }
  if (largest == 0) return false;
  step = (1 / largest) * step;
  const Vec3d here{double(i), double(j), double(k)};
  double ahead, behind;
  if (!magnitude_at_index(g, here + step, ahead) || !magnitude_at_index(g, here - step, behind))
    return false;
  const double m = g.magnitude[voxel];
  return m > ahead && m >= behind;
}

enum : std::uint8_t { none = 0, edge = 1, candidate = 2 };

/// Keeps the candidates that a chain of 26-neighbours connects to an edge; clears the others.
void follow_edges(Mask& state) {
  const auto& n = state.grid.size;
  std::vector<std::vector<std::array<int, 3>>> starts(state.data.size() / state.grid.offset(0, 0, 1));
  parallel_for(
      starts.size(),
      [&](std::size_t k) {
        for (int j = 0; j < n[1]; ++j)
          for (int i = 0; i < n[0]; ++i)
            if (state.at(i, j, int(k)) == edge) starts[k].push_back({i, j, int(k)});
      },
      1);
  for (std::vector<std::array<int, 3>>& open : starts)
    while (!open.empty()) {
      const auto [i, j, k] = open.back();
      open.pop_back();
      for (int c = std::max(k - 1, 0); c <= std::min(k + 1, n[2] - 1); ++c)
        for (int b = std::max(j - 1, 0); b <= std::min(j + 1, n[1] - 1); ++b)
          for (int a = std::max(i - 1, 0); a <= std::min(i + 1, n[0] - 1); ++a)
            if (state.at(a, b, c) == candidate) {
              state.at(a, b, c) = edge;
              open.push_back({a, b, c});
            }
    }
  for_each_voxel(state.grid, [&](int, int, int, std::size_t v) {
    if (state.data[v] == candidate) state.data[v] = none;
  });
}

}  // namespace

Mask canny_edges(const Image& image, const CannyOptions& options, const Mask* where) {
  require(options.sigma_mm > 0, "smoothing of the edges is ", options.sigma_mm, " mm; give a positive width such as 2");
  require(options.lower_threshold > 0 && options.upper_threshold >= options.lower_threshold, "edge thresholds ",
          options.lower_threshold, " and ", options.upper_threshold, " per mm are not 0 < lower <= upper");
  require(!where || same_grid(image.grid, where->grid),
          "the image and the mask of its edges lie on different grids; "
          "resample the mask to the image");
  const Gradient g = gaussian_gradient(image, options.sigma_mm);
  Mask state(image.grid);
  for_each_voxel(image.grid, [&](int i, int j, int k, std::size_t v) {
    const float magnitude = g.magnitude[v];
    if ((where && !where->data[v]) || magnitude < options.lower_threshold || !is_ridge(g, i, j, k, v)) return;
    state.data[v] = magnitude >= options.upper_threshold ? edge : candidate;
  });
  follow_edges(state);
  return state;
}

Mask canny_edges_of_slices(const Image& image, const CannyOptions& options, const Mask* where) {
  require(!where || same_grid(image.grid, where->grid), "the image and the mask of its edges lie on different grids; resample the mask to the image");
  Mask edges(image.grid);
  Grid grid = image.grid;
  grid.size[2] = 1;
  const auto voxels = std::ptrdiff_t(grid.count());
  parallel_for(
      std::size_t(image.grid.size[2]),
      [&](std::size_t k) {
        const auto slice = [&](const auto& volume) {
          auto one = std::remove_cvref_t<decltype(volume)>(grid);
          one.grid.origin = image.grid.point(0, 0, int(k));
          std::copy_n(volume.data.begin() + std::ptrdiff_t(k) * voxels, voxels, one.data.begin());
          return one;
        };
        const Mask inside = where ? slice(*where) : Mask(), found = canny_edges(slice(image), options, where ? &inside : nullptr);
        std::copy(found.data.begin(), found.data.end(), edges.data.begin() + std::ptrdiff_t(k) * voxels);
      },
      1);
  return edges;
}

}  // namespace mtled
