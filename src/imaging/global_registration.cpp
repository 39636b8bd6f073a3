#include <algorithm>
#include <cmath>

#include "core/error.hpp"
#include "imaging/bone_motion.hpp"
#include "imaging/pose_search.hpp"
#include "imaging/rigid_registration.hpp"

namespace mtled {
namespace {

constexpr double degree = 0.017453292519943295;

std::vector<Vec3d> voxel_centers(const Grid& grid, const Mask* inside) {
  std::vector<Vec3d> points;
  for (int k = 0; k < grid.size[2]; ++k)
    for (int j = 0; j < grid.size[1]; ++j)
      for (int i = 0; i < grid.size[0]; ++i) {
        const Vec3d x = grid.point(i, j, k);
        if (!inside || nearest_value<std::uint8_t>(*inside, x, 0)) points.push_back(x);
      }
  return points;
}

}  // namespace

Vec3d center_of_intensity(const Image& image, const Mask* mask) {
  const Grid& grid = mask ? mask->grid : image.grid;
  const double lowest = *std::min_element(image.data.begin(), image.data.end());
  double mass = 0;
  Vec3d moment;
  for (int k = 0; k < grid.size[2]; ++k)
    for (int j = 0; j < grid.size[1]; ++j)
      for (int i = 0; i < grid.size[0]; ++i) {
        const std::size_t v = grid.offset(i, j, k);
        const double weight = mask ? double(mask->data[v] != 0) : image.data[v] - lowest;
        mass += weight;
        moment += weight * Vec3d{double(i), double(j), double(k)};
      }
  require(mass > 0, mask ? "the body mask is empty" : "the image is constant", "; a rigid registration needs contents");
  return grid.point((1 / mass) * moment);
}

RigidMotion register_rigidly(const Image& moving, const Image& fixed, const Mask* moving_mask, const Mask* fixed_mask) {
  for (const Image* image : {&moving, &fixed})
    for (const int n : image->grid.size)
      require(n >= 4, "an image has only ", n, " voxels along one axis; rigid registration needs at least 4");
  const Image moving_coarse = coarsen(moving, 3), fixed_coarse = coarsen(fixed, 3);
  const std::vector<Vec3d> points = voxel_centers(moving_coarse.grid, moving_mask);
  const Vec3d from = center_of_intensity(moving_coarse, moving_mask), to = center_of_intensity(fixed_coarse, fixed_mask);

  const Image fixed_smooth = smooth(fixed_coarse, 6);
  const Samples samples = sample(smooth(moving_coarse, 6), points, 4000);
  const auto starts = poses_around({from, Mat3d::identity(), to - from}, {50, 20 * degree}, {25, 10 * degree});
  const Pose coarse = best_pose(samples, fixed_smooth, starts, 6, {10, 5 * degree}, 4);
  return refine_motion(moving_coarse, fixed_coarse, points, coarse.motion, {{4, 4000, 2}, {2, 8000, 0.5}});
}

}  // namespace mtled
