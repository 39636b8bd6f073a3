#include "imaging/body.hpp"

#include <algorithm>
#include <cmath>

#include "core/error.hpp"
#include "imaging/morphology.hpp"

namespace mtled {
namespace {

/// The voxel axis that is closest to the patient's long axis (z of LPS): slices across it are axial.
int long_axis(const Grid& grid) {
  int axis = 0;
  for (int a = 1; a < 3; ++a)
    if (std::abs(grid.direction[2][a]) > std::abs(grid.direction[2][axis])) axis = a;
  return axis;
}

/// Offsets of the voxels on the rim of slice `s` across `axis`, in the order of a walk around it from a corner.
std::vector<std::size_t> rim(const Grid& grid, int axis, int s) {
  const int u = (axis + 1) % 3, v = (axis + 2) % 3, last_u = grid.size[u] - 1, last_v = grid.size[v] - 1;
  std::vector<std::size_t> walk;
  const auto step = [&](int a, int b) {
    int index[3];
    index[axis] = s, index[u] = a, index[v] = b;
    walk.push_back(grid.offset(index[0], index[1], index[2]));
  };
  for (int a = 0; a < last_u; ++a) step(a, 0);
  for (int b = 0; b < last_v; ++b) step(last_u, b);
  for (int a = last_u; a > 0; --a) step(a, last_v);
  for (int b = last_v; b > 0; --b) step(0, b);
  if (walk.empty()) step(0, 0);
  return walk;
}

/// Air around the patient that surely is not a cut lung: the stretches of air on each slice's rim that hold a corner.
/// A lung that the side of the image cuts meets the rim between two stretches of chest wall.
std::vector<std::size_t> corner_air(const Mask& air, int axis) {
  const Grid& grid = air.grid;
  const int u = (axis + 1) % 3, v = (axis + 2) % 3;
  const int corners[4] = {0, grid.size[u] - 1, grid.size[u] + grid.size[v] - 2, 2 * grid.size[u] + grid.size[v] - 3};
  std::vector<std::size_t> seeds;
  for (int s = 0; s < grid.size[axis]; ++s) {
    const std::vector<std::size_t> walk = rim(grid, axis, s);
    const int n = int(walk.size());
    for (const int corner : corners)
      for (const int direction : {1, n - 1})
        for (int steps = 0, at = corner % n; steps < n && air.data[walk[at]]; ++steps, at = (at + direction) % n)
          seeds.push_back(walk[at]);
  }
  return seeds;
}

/// `body` and everything that the air around it does not reach within an axial slice.
Mask fill(const Mask& body) {
  Mask air(body.grid);
  for (std::size_t v = 0; v < air.data.size(); ++v) air.data[v] = !body.data[v];
  const int axis = long_axis(body.grid);
  const Mask around = flood(air, corner_air(air, axis), -1);
  std::vector<std::size_t> seeds;
  for (int s = 0; s < body.grid.size[axis]; ++s)
    for (const std::size_t v : rim(body.grid, axis, s))
      if (around.data[v]) seeds.push_back(v);
  Mask filled = flood(air, seeds, axis);
  for (auto& voxel : filled.data) voxel = !voxel;
  return filled;
}

/// `solid` and the wide cavities that it encloses (lungs): next to them even a thin chest wall survives the opening.
/// The narrow gaps between back and couch stay open, so that the couch still comes off.
Mask fill_wide_cavities(const Mask& solid, double half_width_mm) {
  Mask enclosed = fill(solid);
  for (std::size_t v = 0; v < solid.data.size(); ++v) enclosed.data[v] = enclosed.data[v] && !solid.data[v];
  const Mask cores = erode(enclosed, half_width_mm);
  std::vector<std::size_t> seeds;
  for (std::size_t v = 0; v < cores.data.size(); ++v)
    if (cores.data[v]) seeds.push_back(v);
  Mask filled = flood(enclosed, seeds, -1);
  for (std::size_t v = 0; v < solid.data.size(); ++v) filled.data[v] = filled.data[v] || solid.data[v];
  return filled;
}

}  // namespace

Mask body_mask(const Image& ct, const BodyOptions& options) {
  require(!ct.data.empty(), "the image has no voxels; give a 3-D CT");
  require(options.opening_radius_mm >= 0, "the opening radius of the body mask is ", options.opening_radius_mm,
          " mm; it must not be negative");
  Mask solid(ct.grid);
  for (std::size_t v = 0; v < ct.data.size(); ++v) solid.data[v] = ct.data[v] > options.threshold;
  const double radius = options.opening_radius_mm;
  const Mask trunk = dilate(largest_component(erode(fill_wide_cavities(solid, 2 * radius), radius)), radius);
  if (std::find(trunk.data.begin(), trunk.data.end(), 1) == trunk.data.end()) {
    const auto [low, high] = std::minmax_element(ct.data.begin(), ct.data.end());
    fail(Failure::input, "no body was found: intensities run from ", *low, " to ", *high, " and no part above ",
         options.threshold, " HU is thicker than ", 2 * radius,
         " mm; is this a CT in HU? Set another body threshold or opening radius, or give a body mask");
  }
  return fill(trunk);
}

}  // namespace mtled
