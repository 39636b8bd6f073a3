#pragma once
#include <vector>

namespace mtled {

/// The coarse functions as plain data, for backends that apply the correction themselves. Node n feels the 27 functions
/// first[n] + i + stride_y j + stride_z k with the weights weight[9n + i] weight[9n + 3 + j] weight[9n + 6 + k], i, j, k = 0..2.
struct CoarseLayout {
  int functions = 0, stride_y = 0, stride_z = 0;
  std::vector<int> used;             ///< functions that are unknowns, ascending; unknown 3 v + c is component c of used[v]
  std::vector<int> slot, first;      ///< [nodes]
  std::vector<double> weight;        ///< [9 * nodes]
  std::vector<double> active;        ///< [3 * nodes] 1 where a parameter follows the functions, else 0
};

}  // namespace mtled
