#include "imaging/nearest_voxel.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

namespace mtled {
namespace {

constexpr double rounding = 1e-12;  ///< relative, of a sum of three squares

/// Marks every voxel with this probability.
Mask scattered(std::array<int, 3> size, double share, unsigned seed) {
  Grid grid;
  grid.size = size, grid.spacing = {0.8, 1.3, 2.1};
  Mask mask(grid);
  std::mt19937 random(seed);
  for (auto& v : mask.data) v = std::bernoulli_distribution(share)(random);
  return mask;
}

double squared_distance(const Grid& grid, const Index& a, const Index& b) {
  double sum = 0;
  for (int x = 0; x < 3; ++x) sum += std::pow(grid.spacing[x] * (a[std::size_t(x)] - b[std::size_t(x)]), 2);
  return sum;
}

template <class Work>
void for_each(const Grid& grid, const Work& work) {
  for (int k = 0; k < grid.size[2]; ++k)
    for (int j = 0; j < grid.size[1]; ++j)
      for (int i = 0; i < grid.size[0]; ++i) work(Index{i, j, k});
}

/// By looking at every marked voxel; in the slice of `from` only, or anywhere.
double smallest_squared_distance(const Mask& mask, const Index& from, bool in_slice) {
  double smallest = INFINITY;
  for_each(mask.grid, [&](const Index& v) {
    if (mask.at(v[0], v[1], v[2]) && (!in_slice || v[2] == from[2])) smallest = std::min(smallest, squared_distance(mask.grid, v, from));
  });
  return smallest;
}

TEST(NearestVoxel, IsTheOneThatASearchOfAllFinds) {
  const std::array<int, 3> sizes[] = {{19, 14, 11}, {1, 23, 9}, {30, 1, 1}, {12, 17, 1}};
  for (const auto& size : sizes)
    for (const double share : {0.002, 0.02, 0.3}) {
      const Mask mask = scattered(size, share, 7);
      const NearestVoxel nearest(mask);
      for_each(mask.grid, [&](const Index& from) {
        for (const bool in_slice : {false, true}) {
          const auto [voxel, squared] = in_slice ? nearest.in_slice(from) : nearest.anywhere(from);
          const double expected = smallest_squared_distance(mask, from, in_slice);
          if (std::isinf(expected)) {
            EXPECT_EQ(squared, expected);
            continue;
          }
          EXPECT_NEAR(squared, expected, rounding * expected);
          EXPECT_NEAR(squared_distance(mask.grid, voxel, from), expected, rounding * expected);
          EXPECT_TRUE(mask.at(voxel[0], voxel[1], voxel[2]));
        }
      });
    }
}

TEST(NearestVoxel, OfAMarkedVoxelIsItself) {
  const Mask mask = scattered({9, 8, 7}, 0.5, 1);
  const NearestVoxel nearest(mask);
  for_each(mask.grid, [&](const Index& v) {
    if (mask.at(v[0], v[1], v[2])) {
      EXPECT_EQ(nearest.anywhere(v).voxel, v);
    }
  });
}

}  // namespace
}  // namespace mtled
