#pragma once
#include <functional>
#include <memory>
#include <vector>

#include "core/field_backend.hpp"
#include "core/motion.hpp"
#include "core/volume.hpp"

namespace mtled {

/// u(X) [mm] of the deforming body at a rest position X [LPS mm] of the moving image: true and u where the body's shape
/// functions cover X, false elsewhere. Safe to call from many threads.
using DisplacementFunction = std::function<bool(const Vec3d& X, Vec3d& u)>;

/// A displacement function that is the trilinear value of a dense field, known within the field's grid.
struct DenseDisplacement {
  std::shared_ptr<VectorImage> field;
  bool operator()(const Vec3d& X, Vec3d& u) const { return linear_value(*field, X, u); }
};

/// A dense displacement and where it comes from.
struct DenseField {
  VectorImage displacement;  ///< [mm] defined on every voxel
  Mask covered;              ///< 1 = from the mechanics, 0 = smooth extension into the surroundings
  std::size_t undecided = 0; ///< voxels that a device left to the CPU
};

/// Forward field on the moving grid: voxel X -> X + u(X). Outside the body: smooth extension (see extend_smoothly).
/// With a `device`, u is asked only where that does not decide. Throws an input error when u covers no voxel.
DenseField forward_field(const Grid& moving_grid, const DisplacementFunction& u, FieldBackend* device = nullptr);

struct InverseStatistics {
  double largest_residual_mm = 0;  ///< of |X + u(X) - y| over covered voxels; at most the tolerance
  std::size_t covered = 0;         ///< voxels y that have an X in the body
  std::size_t unresolved = 0;      ///< voxels y where the iteration stayed above the tolerance (folds); not covered
};
/// Inverse field on the fixed grid: voxel y -> X = y + v(y), found by iteration on the true u (start: `forward`, which
/// may be coarser than the fixed grid), |X + u(X) - y| <= tolerance_mm. Newton and Broyden steps: also where plain
/// iteration X <- y - u(X) diverges. Outside the deformed body and where unresolved: smooth extension. Costs about one
/// call of u per covered voxel when `forward` is as fine as the moving image. With a `device`, as forward_field(). Throws an input error when the deformed
/// body covers no voxel.
DenseField inverse_field(const Grid& fixed_grid, const DenseField& forward, const DisplacementFunction& u,
                         double tolerance_mm, InverseStatistics& statistics, FieldBackend* device = nullptr);

/// Fills the voxels where `covered` is 0 from the covered ones: averages from coarse to fine (push-pull, Gortler et al.
/// 1996), relaxed towards Laplace's equation on every level. Stays within the range of the covered values, is
/// continuous at the body's surface and tends to a constant far away. Same bits for any number of threads. Throws an
/// input error when nothing is covered or the grids differ.
void extend_smoothly(VectorImage& field, const Mask& covered);

/// moving(y + v(y)) on the grid of `inverse`; `outside` where that position is beyond the moving image's border voxels.
/// By `device` when there is one; cubic coefficients are found on the CPU.
Image warp_image(const Image& moving, const VectorImage& inverse, Interpolation interpolation, float outside, const SampleDisplaced& device = {});
/// The linear value of `moving` at y + v(y), or at y without a `field`, for the voxels y of `grid`, which is the field's.
/// Beyond its border the image continues with the border's values, so that the result has no edge where it ends.
/// `inside`: 1 where the position is in the image.
Image warp_continued(const Image& moving, const Grid& grid, const VectorImage* field, Mask& inside);
/// Label of the voxel nearest to y + v(y), 0 outside.
LabelImage warp_labels(const LabelImage& labels, const VectorImage& inverse);
/// Label of the voxel nearest to every voxel of `grid`, 0 outside.
LabelImage labels_at(const LabelImage& labels, const Grid& grid);
/// The same for one rigid motion moving -> fixed (baseline).
Image warp_image_rigidly(const Image& moving, const Grid& fixed_grid, const RigidMotion& motion,
                         Interpolation interpolation, float outside);
/// X + u(X); where u does not cover X, the trilinear value of the dense field; NaN outside it.
std::vector<Vec3d> warp_points(const std::vector<Vec3d>& points, const DisplacementFunction& u,
                               const VectorImage& dense);

struct JacobianStatistics {
  double minimum = 0, percentile_1 = 0, median = 0, percentile_99 = 0, maximum = 0;  ///< of det(I + grad u)
  std::size_t folded = 0;                                                            ///< voxels with det <= 0
  std::size_t voxels = 0;  ///< counted voxels (inside `where`)
  double sd_log = 0;       ///< SDlogJ: standard deviation of log det where det > 0; NaN where none is
  double sd_log_learn2reg = 0;  ///< as the Learn2Reg challenge computes it: of log(det + 3), det + 3 clipped to
                                ///< [1e-9, 1e9], by central differences whatever the mask, two voxels inside the grid; NaN
                                ///< where no voxel of the mask lies there
};
/// det(I + du/dX) by central differences between voxels of `where` (one-sided at its border), physical spacing and
/// direction. A voxel without a neighbour in `where` along some axis is not counted. Throws an input error when none
/// counts or the grids differ.
JacobianStatistics jacobian_statistics(const VectorImage& displacement, const Mask& where);
/// The same where volume_ratio() is known already.
JacobianStatistics jacobian_statistics(const VectorImage& displacement, const Mask& where, const Image& ratio);
/// The determinant itself; NaN where it is not counted.
Image volume_ratio(const VectorImage& displacement, const Mask& where);
/// 1 at the voxels that count as folded there; both on the same grid.
Mask folded_voxels(const VectorImage& displacement, const Mask& where);
/// The same where volume_ratio() is known already.
Mask folded_voxels(const Image& ratio);

/// Linear resampling over exactly the same extent, with the voxel spacing nearest to `spacing_mm` that divides it.
Image resample(const Image& image, const Vec3d& spacing_mm);
/// `labels` on `grid` by nearest neighbour; throws an input error when the two do not overlap in space.
LabelImage resample_labels(const LabelImage& labels, const Grid& grid);

}  // namespace mtled
