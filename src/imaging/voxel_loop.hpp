#pragma once
#include "core/parallel.hpp"
#include "core/volume.hpp"

namespace mtled {

/// Calls work(i, j, k, offset) once for every voxel of `grid`, in parallel. `work` may write to its own voxel only;
/// then the result does not depend on the number of threads.
template <class Work>
void for_each_voxel(const Grid& grid, const Work& work) {
  const std::size_t rows = std::size_t(grid.size[1]) * std::size_t(grid.size[2]);
  parallel_for(
      rows,
      [&](std::size_t row) {
        const int j = int(row % std::size_t(grid.size[1])), k = int(row / std::size_t(grid.size[1]));
        const std::size_t first = grid.offset(0, j, k);
        for (int i = 0; i < grid.size[0]; ++i) work(i, j, k, first + std::size_t(i));
      },
      16);
}

}  // namespace mtled
