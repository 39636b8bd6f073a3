#pragma once
#include <string>
#include <vector>

#include "core/motion.hpp"
#include "core/volume.hpp"

namespace mtled {

struct BoneMotionOptions {
  double margin_mm = 5;              ///< tissue around a label that takes part in its registration
  double largest_shift_mm = 60;      ///< of neighbourhood search when there are no fixed labels
  double largest_turn_deg = 35;
  bool check_inverse = true;         ///< also register backwards and report the disagreement
};

/// What the registration of one label found.
struct BoneMotion {
  LabelMotion motion;                ///< moving -> fixed
  double similarity_before = 0;      ///< normalised correlation in the label's region, with the start pose [-1, 1]
  double similarity_after = 0;       ///< the same after registration
  double inverse_consistency_mm = 0; ///< largest |x - backward(forward(x))| over the label's voxels; 0 if not checked
  int voxels = 0;                    ///< of the label in the moving image
};

struct BoneMotionResult {
  std::vector<BoneMotion> bones;     ///< ascending label
  std::vector<std::string> warnings; ///< labels missing on one side, implausible neighbours, label at the image border, ...
};

/// Rigid motion of every label between two images by intensity-based registration (ITK).
/// Start: label centroids (and principal axes) where `fixed_labels` is given, else a global rigid registration of the
/// images followed by a neighbourhood search. Deterministic. `fixed_labels` may be null.
BoneMotionResult estimate_bone_motions(const Image& moving, const Image& fixed, const LabelImage& moving_labels,
                                       const LabelImage* fixed_labels, const BoneMotionOptions& options);

/// Warnings about motions that no spine makes: neighbours (consecutive labels) whose relative turn or shift is much
/// larger than that of the others, or that fits a mix-up by one level.
std::vector<std::string> implausible_neighbours(const std::vector<LabelMotion>& motions);

/// Global rigid registration (multi-resolution, mutual information or correlation), moving -> fixed. The start is the
/// alignment of the body masks' (or images') centres. Also the baseline of the evaluation.
RigidMotion register_rigidly(const Image& moving, const Image& fixed, const Mask* moving_mask, const Mask* fixed_mask);

}  // namespace mtled
