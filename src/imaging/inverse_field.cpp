#include <algorithm>

#include "core/error.hpp"
#include "core/rest_position.hpp"
#include "imaging/voxel_loop.hpp"
#include "imaging/warp.hpp"

namespace mtled {
namespace {

Vec3f to_float(const Vec3d& v) { return {float(v.x), float(v.y), float(v.z)}; }

Mask covered(const Volume<Coverage>& coverage) {
  Mask mask(coverage.grid);
  for_each_voxel(mask.grid, [&](int, int, int, std::size_t voxel) { mask.data[voxel] = coverage.data[voxel] == Coverage::covered; });
  return mask;
}

std::size_t count(const Volume<Coverage>& coverage, Coverage kind) { return std::size_t(std::count(coverage.data.begin(), coverage.data.end(), kind)); }

/// A displacement function of the CPU, which always decides.
struct Displacement {
  const DisplacementFunction* u;
  Coverage operator()(const Vec3d& X, Vec3d& value) const { return (*u)(X, value) ? Coverage::covered : Coverage::outside; }
};

}  // namespace

DenseField forward_field(const Grid& moving_grid, const DisplacementFunction& u, FieldBackend* device) {
  DenseField field{VectorImage(moving_grid), {}};
  Volume<Coverage> coverage(moving_grid, Coverage::undecided);
  if (device) {
    device->forward(field.displacement, coverage);
    field.undecided = count(coverage, Coverage::undecided);
  }
  for_each_voxel(moving_grid, [&](int i, int j, int k, std::size_t voxel) {
    if (coverage.data[voxel] != Coverage::undecided) return;
    Vec3d value;
    coverage.data[voxel] = Displacement{&u}(moving_grid.point(i, j, k), value);
    if (coverage.data[voxel] == Coverage::covered) field.displacement.data[voxel] = to_float(value);
  });
  field.covered = covered(coverage);
  extend_smoothly(field.displacement, field.covered);
  return field;
}

DenseField inverse_field(const Grid& fixed_grid, const DenseField& forward, const DisplacementFunction& u,
                         double tolerance_mm, InverseStatistics& statistics, FieldBackend* device) {
  require(tolerance_mm > 0, "tolerance of the inverse displacement is ", tolerance_mm,
          " mm, but no iteration reaches zero; "
          "give a positive value such as 0.01");
  DenseField inverse{VectorImage(fixed_grid), {}};
  Volume<Coverage> coverage(fixed_grid, Coverage::undecided);
  statistics = {};
  if (device) {
    statistics.largest_residual_mm = device->inverse(forward.displacement, tolerance_mm, inverse.displacement, coverage);
    inverse.undecided = count(coverage, Coverage::undecided);
  }
  const SolveForRestPosition solve(view_of(forward.displacement), Displacement{&u}, tolerance_mm);
  std::vector<double> largest_of_slice(std::size_t(fixed_grid.size[2]));
  parallel_for(
      largest_of_slice.size(),
      [&](std::size_t slice) {
        const int k = int(slice);
        for (int j = 0; j < fixed_grid.size[1]; ++j)
          for (int i = 0; i < fixed_grid.size[0]; ++i) {
            const std::size_t voxel = fixed_grid.offset(i, j, k);
            if (coverage.data[voxel] != Coverage::undecided) continue;
            const Vec3d y = fixed_grid.point(i, j, k);
            Vec3d X;
            double residual = 0;
            coverage.data[voxel] = solve(y, X, residual);
            if (coverage.data[voxel] != Coverage::covered) continue;
            inverse.displacement.data[voxel] = to_float(X - y);
            largest_of_slice[slice] = std::max(largest_of_slice[slice], residual);
          }
      },
      1);
  for (const double largest : largest_of_slice) statistics.largest_residual_mm = std::max(statistics.largest_residual_mm, largest);
  statistics.covered = count(coverage, Coverage::covered);
  statistics.unresolved = count(coverage, Coverage::unresolved);
  inverse.covered = covered(coverage);
  with_context("inverting the displacement", [&] { extend_smoothly(inverse.displacement, inverse.covered); });
  return inverse;
}

}  // namespace mtled
