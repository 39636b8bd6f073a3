#include <algorithm>

#include "core/error.hpp"
#include "imaging/voxel_loop.hpp"
#include "imaging/warp.hpp"

namespace mtled {
namespace {

/// Sweeps of Laplace's equation per level: they remove the blocks that the coarser level leaves (measured: 4 halve the
/// jump at the surface against none, more change little).
constexpr int relaxation_sweeps = 4;

/// 2 along the axes that the next level halves, else 1. Axes of much larger spacing wait, so that voxels become cubes.
std::array<int, 3> coarsening_factors(const Grid& grid) {
  double smallest = 0;
  for (int a = 0; a < 3; ++a)
    if (grid.size[a] > 1 && (smallest == 0 || grid.spacing[a] < smallest)) smallest = grid.spacing[a];
  std::array<int, 3> factors{1, 1, 1};
  for (int a = 0; a < 3; ++a)
    if (grid.size[a] > 1 && grid.spacing[a] < 1.5 * smallest) factors[a] = 2;
  return factors;
}

Grid coarsened(Grid grid, const std::array<int, 3>& factors) {
  for (int a = 0; a < 3; ++a) {
    grid.size[a] = (grid.size[a] + factors[a] - 1) / factors[a];
    grid.spacing[a] *= factors[a];
  }
  return grid;
}

/// Mean of the known children of every coarse voxel.
void push(const VectorImage& fine, const Mask& fine_known, const std::array<int, 3>& factors, VectorImage& coarse,
          Mask& coarse_known) {
  const auto& n = fine.grid.size;
  for_each_voxel(coarse.grid, [&](int i, int j, int k, std::size_t voxel) {
    Vec3d sum;
    int count = 0;
    for (int c = factors[2] * k; c < std::min(factors[2] * (k + 1), n[2]); ++c)
      for (int b = factors[1] * j; b < std::min(factors[1] * (j + 1), n[1]); ++b)
        for (int a = factors[0] * i; a < std::min(factors[0] * (i + 1), n[0]); ++a) {
          const std::size_t child = fine.grid.offset(a, b, c);
          if (!fine_known.data[child]) continue;
          const Vec3f& v = fine.data[child];
          sum += Vec3d{v.x, v.y, v.z};
          ++count;
        }
    if (count == 0) return;
    coarse.data[voxel] = {float(sum.x / count), float(sum.y / count), float(sum.z / count)};
    coarse_known.data[voxel] = 1;
  });
}

/// Trilinear value of the coarse field in the unknown fine voxels.
void pull(const VectorImage& coarse, const std::array<int, 3>& factors, VectorImage& fine, const Mask& fine_known) {
  for_each_voxel(fine.grid, [&](int i, int j, int k, std::size_t voxel) {
    if (fine_known.data[voxel]) return;
    const int index[3] = {i, j, k};
    int low[3], high[3];
    double t[3];
    for (int a = 0; a < 3; ++a) {
      const int last = coarse.grid.size[a] - 1;
      const double c = std::clamp((index[a] + 0.5) / factors[a] - 0.5, 0.0, double(last));
      low[a] = int(c);
      high[a] = std::min(low[a] + 1, last);
      t[a] = c - low[a];
    }
    Vec3d sum;
    for (int corner = 0; corner < 8; ++corner) {
      const bool x = corner & 1, y = corner & 2, z = corner & 4;
      const Vec3f& v = coarse.at(x ? high[0] : low[0], y ? high[1] : low[1], z ? high[2] : low[2]);
      const double weight = (x ? t[0] : 1 - t[0]) * (y ? t[1] : 1 - t[1]) * (z ? t[2] : 1 - t[2]);
      sum += weight * Vec3d{v.x, v.y, v.z};
    }
    fine.data[voxel] = {float(sum.x), float(sum.y), float(sum.z)};
  });
}

/// Gauss-Seidel on Laplace's equation in the unknown voxels, no flux through the border of the grid. Voxels of one
/// colour have neighbours of the other colour only: parallel and deterministic.
void relax(VectorImage& field, const Mask& known) {
  const Grid& grid = field.grid;
  const std::size_t stride[3] = {1, grid.offset(0, 1, 0), grid.offset(0, 0, 1)};
  double weight[3];
  for (int a = 0; a < 3; ++a) weight[a] = 1 / (grid.spacing[a] * grid.spacing[a]);
  for (int sweep = 0; sweep < 2 * relaxation_sweeps; ++sweep)
    for_each_voxel(grid, [&](int i, int j, int k, std::size_t voxel) {
      if (known.data[voxel] || ((i + j + k) & 1) != (sweep & 1)) return;
      const int index[3] = {i, j, k};
      Vec3d sum;
      double total = 0;
      const auto add = [&](std::size_t neighbour, double w) {
        const Vec3f& v = field.data[neighbour];
        sum += w * Vec3d{v.x, v.y, v.z};
        total += w;
      };
      for (int a = 0; a < 3; ++a) {
        if (index[a] > 0) add(voxel - stride[a], weight[a]);
        if (index[a] + 1 < grid.size[a]) add(voxel + stride[a], weight[a]);
      }
      field.data[voxel] = {float(sum.x / total), float(sum.y / total), float(sum.z / total)};
    });
}

/// Needs at least one known voxel.
void fill_unknown(VectorImage& field, const Mask& known) {
  if (std::find(known.data.begin(), known.data.end(), 0) == known.data.end()) return;
  const auto factors = coarsening_factors(field.grid);
  VectorImage coarse(coarsened(field.grid, factors));
  Mask coarse_known(coarse.grid);
  push(field, known, factors, coarse, coarse_known);
  fill_unknown(coarse, coarse_known);
  pull(coarse, factors, field, known);
  relax(field, known);
}

}  // namespace

void extend_smoothly(VectorImage& field, const Mask& covered) {
  require(field.grid == covered.grid,
          "the displacement and the mask of its covered voxels lie on different grids; "
          "compute both on the same grid");
  require(
      std::any_of(covered.data.begin(), covered.data.end(), [](auto c) { return c != 0; }),
      "no voxel of the image lies in the deformed body; body and image are probably in different places: check their "
      "origins and directions");
  fill_unknown(field, covered);
}

}  // namespace mtled
