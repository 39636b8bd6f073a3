#include <algorithm>

#include "core/error.hpp"
#include "imaging/rest_position.hpp"
#include "imaging/voxel_loop.hpp"

namespace mtled {
namespace {

Vec3f to_float(const Vec3d& v) { return {float(v.x), float(v.y), float(v.z)}; }

}  // namespace

DenseField forward_field(const Grid& moving_grid, const DisplacementFunction& u) {
  DenseField field{VectorImage(moving_grid), Mask(moving_grid)};
  for_each_voxel(moving_grid, [&](int i, int j, int k, std::size_t voxel) {
    Vec3d value;
    if (!u(moving_grid.point(i, j, k), value)) return;
    field.displacement.data[voxel] = to_float(value);
    field.covered.data[voxel] = 1;
  });
  extend_smoothly(field.displacement, field.covered);
  return field;
}

DenseField inverse_field(const Grid& fixed_grid, const DenseField& forward, const DisplacementFunction& u,
                         double tolerance_mm, InverseStatistics& statistics) {
  require(tolerance_mm > 0, "tolerance of the inverse displacement is ", tolerance_mm,
          " mm, but no iteration reaches zero; "
          "give a positive value such as 0.01");
  const SolveForRestPosition solve(forward.displacement, u, tolerance_mm);
  DenseField inverse{VectorImage(fixed_grid), Mask(fixed_grid)};
  std::vector<InverseStatistics> of_slice(std::size_t(fixed_grid.size[2]));
  parallel_for(
      of_slice.size(),
      [&](std::size_t slice) {
        const int k = int(slice);
        for (int j = 0; j < fixed_grid.size[1]; ++j)
          for (int i = 0; i < fixed_grid.size[0]; ++i) {
            const Vec3d y = fixed_grid.point(i, j, k);
            Vec3d X;
            double residual = 0;
            const auto outcome = solve(y, X, residual);
            if (outcome == SolveForRestPosition::Outcome::unresolved) ++of_slice[slice].unresolved;
            if (outcome != SolveForRestPosition::Outcome::covered) continue;
            const std::size_t voxel = fixed_grid.offset(i, j, k);
            inverse.displacement.data[voxel] = to_float(X - y);
            inverse.covered.data[voxel] = 1;
            of_slice[slice].largest_residual_mm = std::max(of_slice[slice].largest_residual_mm, residual);
            ++of_slice[slice].covered;
          }
      },
      1);
  statistics = {};
  for (const InverseStatistics& slice : of_slice) {
    statistics.largest_residual_mm = std::max(statistics.largest_residual_mm, slice.largest_residual_mm);
    statistics.covered += slice.covered;
    statistics.unresolved += slice.unresolved;
  }
  with_context("inverting the displacement", [&] { extend_smoothly(inverse.displacement, inverse.covered); });
  return inverse;
}

}  // namespace mtled
