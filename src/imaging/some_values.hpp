#pragma once
#include <cmath>
#include <numeric>
#include <vector>

#include "core/volume.hpp"

namespace mtled {

/// The values of every n-th voxel, for percentiles of an image: at most 200 000, NaN left out. n has no divisor in common
/// with the voxels along i, so that all columns are met.
inline std::vector<float> some_values(const Image& image) {
  constexpr std::size_t most_values = 200000;
  std::size_t step = 1 + image.data.size() / most_values;
  while (std::gcd(step, std::size_t(image.grid.size[0])) > 1) ++step;
  std::vector<float> values;
  for (std::size_t v = 0; v < image.data.size(); v += step)
    if (!std::isnan(image.data[v])) values.push_back(image.data[v]);
  return values;
}

}  // namespace mtled
