#include "imaging/lungs.hpp"

#include "imaging/morphology.hpp"

namespace mtled {
namespace {

constexpr double smallest_piece = 0.02;  ///< of the largest one

/// The largest 6-connected components, as long as they have a fiftieth of the voxels of the first.
Mask large_components(Mask mask) {
  Mask kept(mask.grid);
  std::size_t largest = 0;
  for (;;) {
    const Mask piece = largest_component(mask);
    const std::size_t voxels = count(piece);
    if (largest == 0) largest = voxels;
    if (voxels == 0 || double(voxels) < smallest_piece * double(largest)) return kept;
    for (std::size_t v = 0; v < mask.data.size(); ++v)
      if (piece.data[v]) kept.data[v] = 1, mask.data[v] = 0;
  }
}

/// With the voxels that cannot be reached from the rim of their slice along k.
Mask fill_slices(const Mask& mask) {
  Mask rest(mask.grid);
  for (std::size_t v = 0; v < mask.data.size(); ++v) rest.data[v] = !mask.data[v];
  const auto& n = mask.grid.size;
  std::vector<std::size_t> rim;
  for (int k = 0; k < n[2]; ++k) {
    for (int j = 0; j < n[1]; ++j) rim.push_back(mask.grid.offset(0, j, k)), rim.push_back(mask.grid.offset(n[0] - 1, j, k));
    for (int i = 0; i < n[0]; ++i) rim.push_back(mask.grid.offset(i, 0, k)), rim.push_back(mask.grid.offset(i, n[1] - 1, k));
  }
  Mask filled = flood(rest, rim, 2);
  for (auto& voxel : filled.data) voxel = !voxel;
  return filled;
}

}  // namespace

Mask lung_mask(const Image& ct, const BodyOptions& options) {
  Mask air = body_mask(ct, options);
  for (std::size_t v = 0; v < air.data.size(); ++v) air.data[v] = air.data[v] && ct.data[v] <= options.threshold;
  return fill_slices(large_components(std::move(air)));
}

}  // namespace mtled
