#pragma once
#include <cstddef>
#include <vector>

#include "core/motion.hpp"
#include "core/volume.hpp"
#include "imaging/warp.hpp"

namespace mtled {

/// The displacement function at the voxels of `grid`; 0 where it is unknown (as ITK continues displacement fields).
DenseField sample_displacement(const DisplacementFunction& u, const Grid& grid);
/// The inverse of the map x -> x + u(x), whose displacement is known best around `from`, at the voxels of `to`; found to
/// 0.1 mm, covered where it was found. Input error when it is found nowhere.
DenseField inverted(const DisplacementFunction& u, const Grid& from, const Grid& to);

/// Rotation and shift that bring the points x closest to y in the mean square (Kabsch 1976), about the centroid of x.
/// Input error: no points, or lists of different length.
RigidMotion best_rigid_motion(const std::vector<Vec3d>& x, const std::vector<Vec3d>& y);

/// How far a field is from moving a label rigidly: distances [mm] of its voxels from their best rigid motion.
struct LabelRigidity {
  int label = 0;
  std::size_t voxels = 0;
  double rms_mm = 0, largest_mm = 0;
};
/// Per label, ascending, over the voxels where the field is covered. Input error: different grids.
std::vector<LabelRigidity> label_rigidity(const LabelImage& labels, const DenseField& field);

/// Distances |y - S(T(y))| [mm] of voxels y of `where`, T given by `there`, S by `back`; voxels that either does not
/// know are left out. All 0 without voxels.
struct InverseConsistency {
  std::size_t voxels = 0;
  double mean = 0, percentile_95 = 0, percentile_99 = 0, maximum = 0;
};
InverseConsistency inverse_consistency(const DenseField& there, const DisplacementFunction& back, const Mask& where);

/// Normalised correlation [-1, 1] of two images over `where`, all on one grid; 0 where one is constant.
double correlation(const Image& a, const Image& b, const Mask& where);

}  // namespace mtled
