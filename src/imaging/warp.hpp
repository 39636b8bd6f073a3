#pragma once
#include <functional>
#include <vector>

#include "core/motion.hpp"
#include "core/volume.hpp"

namespace mtled {

/// u(X) [mm] of the deforming body at a rest position X [LPS mm] of the moving image: true and u where the body's shape
/// functions cover X, false elsewhere. Safe to call from many threads.
using DisplacementFunction = std::function<bool(const Vec3d& X, Vec3d& u)>;

/// A dense displacement and where it comes from.
struct DenseField {
  VectorImage displacement;  ///< [mm] defined on every voxel
  Mask covered;              ///< 1 = from the mechanics, 0 = smooth extension into the surroundings
};

/// Forward field on the moving grid: voxel X -> X + u(X). Outside the body: smooth extension (see extend_smoothly).
DenseField forward_field(const Grid& moving_grid, const DisplacementFunction& u);

struct InverseStatistics {
  double largest_residual_mm = 0;  ///< of |X + u(X) - y| over covered voxels
  std::size_t covered = 0;         ///< voxels y that have an X in the body
  std::size_t unresolved = 0;      ///< voxels y where the iteration stayed above the tolerance
};
/// Inverse field on the fixed grid: voxel y -> X = y + v(y), found by iteration on the true u (start: `forward`, which
/// may be coarser than the fixed grid), |X + u(X) - y| <= tolerance. Outside the deformed body: smooth extension.
DenseField inverse_field(const Grid& fixed_grid, const DenseField& forward, const DisplacementFunction& u,
                         double tolerance_mm, InverseStatistics& statistics);

/// Fills the voxels where `covered` is 0 from the covered ones: coarse-to-fine averages (push-pull), which is continuous
/// at the body's surface and constant far away. Throws when nothing is covered.
void extend_smoothly(VectorImage& field, const Mask& covered);

enum class Interpolation { linear, cubic, nearest };
/// moving(y + v(y)) on the grid of `inverse`; `outside` where that position is not in the moving image.
Image warp_image(const Image& moving, const VectorImage& inverse, Interpolation interpolation, float outside);
LabelImage warp_labels(const LabelImage& labels, const VectorImage& inverse);
/// The same for one rigid motion moving -> fixed (baseline).
Image warp_image_rigidly(const Image& moving, const Grid& fixed_grid, const RigidMotion& motion,
                         Interpolation interpolation, float outside);
/// X + u(X); where u does not cover X, the trilinear value of the dense field; NaN outside it.
std::vector<Vec3d> warp_points(const std::vector<Vec3d>& points, const DisplacementFunction& u, const VectorImage& dense);

struct JacobianStatistics {
  double minimum = 0, percentile_1 = 0, median = 0, percentile_99 = 0, maximum = 0;  ///< of det(I + grad u)
  std::size_t folded = 0;  ///< voxels with det <= 0
  std::size_t voxels = 0;  ///< counted voxels (inside `where`)
};
/// det(I + du/dX) by central differences on the voxel grid (one-sided at the border), physical spacing and direction.
JacobianStatistics jacobian_statistics(const VectorImage& displacement, const Mask& where);

/// Linear resampling to another voxel spacing over the same extent (labels: nearest).
Image resample(const Image& image, const Vec3d& spacing_mm);
/// `labels` on `grid` by nearest neighbour; throws an input error when the two do not overlap in space.
LabelImage resample_labels(const LabelImage& labels, const Grid& grid);

}  // namespace mtled
