#pragma once
#include <string>
#include <vector>

#include "core/motion.hpp"
#include "core/volume.hpp"

namespace mtled {

struct BoneMotionOptions {
  double margin_mm = 5;  ///< tissue around a label that guides its search; the last refinement uses the bone alone
  double largest_shift_mm = 60;  ///< of neighbourhood search when there are no fixed labels
  double largest_turn_deg = 35;
  bool check_inverse = true;  ///< also register backwards and report the disagreement
};

/// What the registration of one label found.
struct BoneMotion {
  LabelMotion motion;            ///< moving -> fixed
  double similarity_before = 0;  ///< normalised correlation of the label's voxels [-1, 1] with the start: label
                                 ///< positions, or the global registration
  double similarity_after = 0;        ///< the same after registration
  double inverse_consistency_mm = 0;  ///< largest |x - backward(forward(x))| over the label's voxels; 0 if not checked
  int voxels = 0;                     ///< of the label in the moving image
};

struct BoneMotionResult {
  std::vector<BoneMotion> bones;  ///< ascending label
  std::vector<std::string>
      warnings;  ///< labels missing on one side, implausible neighbours, label at the image border, ...
};

/// Rigid motion of every label between two images by intensity-based registration (ITK).
/// Start: label centroids (and principal axes) where `fixed_labels` is given, else a global rigid registration of the
/// images, then of all labels as one body, then along the chain of labels from the best one (see bone_starts.hpp).
/// The result does not depend on the number of threads. `fixed_labels` may be null. The grids may all differ.
/// Input errors: no labels, no label in common, labels outside the moving image. A label of fewer than 30 voxels is
/// left out with a warning; one that leaves the fixed image follows its neighbour, one that correlates worse than at
/// its start keeps its start, both with a warning. Accuracy on a simulated thorax (voxels of 2 x 2 x 2.5 mm): centres
/// 0.1 mm; turns 0.1 deg for a vertebra with ribs, 0.3 deg for a vertebral body, 0.9 deg for one of 500 voxels.
BoneMotionResult estimate_bone_motions(const Image& moving, const Image& fixed, const LabelImage& moving_labels,
                                       const LabelImage* fixed_labels, const BoneMotionOptions& options);

/// Warnings about motions that no spine makes: neighbours (consecutive labels) whose relative turn or shift is much
/// larger than that of the others, or that fits a mix-up by one level.
std::vector<std::string> implausible_neighbours(const std::vector<LabelMotion>& motions);

/// Centre [LPS mm] of a mask, or of the intensities above the image's minimum. Input errors: empty mask, constant image.
Vec3d center_of_intensity(const Image& image, const Mask* mask);

/// Global rigid registration, moving -> fixed: alignment of the centres of the masks (or of the intensities), search
/// within 50 mm and 20 deg of that, then ITK on two resolutions, by normalised correlation. With a moving mask, only
/// its inside is compared; the fixed mask only gives its centre. Also the baseline of the evaluation. Input errors:
/// empty mask, constant image, fewer than 4 voxels along an axis.
RigidMotion register_rigidly(const Image& moving, const Image& fixed, const Mask* moving_mask, const Mask* fixed_mask);

}  // namespace mtled
