#include "imaging/bone_motion.hpp"

#include <algorithm>
#include <cmath>

#include "core/error.hpp"
#include "core/parallel.hpp"
#include "imaging/bone_starts.hpp"
#include "imaging/label_region.hpp"
#include "imaging/pose_search.hpp"
#include "imaging/rigid_registration.hpp"

namespace mtled {
namespace {

constexpr std::size_t fewest_voxels = 30;  ///< of a label that can be registered
constexpr double crop_margin_mm = 15;      ///< room for the rest of the motion and for smoothing
constexpr double noticeable_mm = 0.5;      ///< a rejected registration that differs less needs no warning
constexpr double poor_similarity = 0.5;    ///< a label that correlates less deserves a look
// First the label with its margin, which guides from afar; then the bone alone, because the soft tissue around it
// deforms (it costs up to 1 deg for a vertebral body). Points off the voxel grid, so that both images are interpolated
// alike. Last the voxels of the bone in either image, robustly: at its surface the tissue outside shines through.
const RegistrationLevel with_margin{1.5, 4000, 1}, bone_alone{1, 20000, 0.5};

/// Largest distance [mm] between the images of the points under two motions.
double largest_distance(const std::vector<Vec3d>& points, const RigidMotion& a, const RigidMotion& b) {
  double largest = 0;
  for (const Vec3d& point : points) largest = std::max(largest, norm(a.apply(point) - b.apply(point)));
  return largest;
}

/// `points` and `bone` are the label with and without its margin, in `from`.
RigidMotion refine_label(const Image& from, const Image& to, const std::vector<Vec3d>& points,
                         const std::vector<Vec3d>& bone, const RigidMotion& start) {
  return refine_motion(from, to, bone, refine_motion(from, to, points, start, {with_margin}), {bone_alone});
}

/// The voxels of `fixed` that come from a voxel of the label.
std::vector<Vec3d> voxels_in_fixed(const Image& fixed, const LabelImage& labels, int label, const RigidMotion& motion) {
  const RigidMotion back = inverse(motion);
  std::vector<Vec3d> found;
  for (int k = 0; k < fixed.grid.size[2]; ++k)
    for (int j = 0; j < fixed.grid.size[1]; ++j)
      for (int i = 0; i < fixed.grid.size[0]; ++i)
        if (const Vec3d y = fixed.grid.point(i, j, k); nearest_value(labels, back.apply(y), std::uint16_t{0}) == label)
          found.push_back(y);
  return found;
}

/// What the registration of one label found, and what the user should know about it.
struct Outcome {
  BoneMotion bone;
  std::vector<std::string> warnings;
};

Outcome register_label(const Image& moving, const Image& fixed, const LabelImage& labels, const LabelRegion& region,
                       const BoneStart& start, const BoneMotionOptions& options) {
  Outcome outcome;
  BoneMotion& bone = outcome.bone;
  const auto warn = [&](const auto&... parts) {
    outcome.warnings.push_back(concatenate("label ", region.label, " ", parts...));
  };
  bone.voxels = int(region.voxels.size());
  bone.motion = {region.label, start.searched};
  if (region.touches_border || fraction_inside(region.voxels, moving) < 1)
    warn("touches the border of the moving image: a cut bone is registered less well");

  const Image moving_part = crop(moving, region.points, crop_margin_mm);
  const std::vector<Vec3d> there = moved(region.points, start.searched);
  const Image fixed_part = crop(fixed, there, crop_margin_mm);
  const Samples samples = sample(moving_part, region.voxels, 0);
  bone.similarity_before = similarity(samples, fixed, start.given);
  if (fraction_inside(there, fixed) < visible_enough) {
    bone.similarity_after = similarity(samples, fixed, start.searched);
    warn(
        "leaves the fixed image and was not registered: it follows its neighbour; leave it out, or use a fixed image "
        "that "
        "shows it");
    return outcome;
  }

  const RigidMotion near = refine_label(moving_part, fixed_part, region.points, region.octants, start.searched);
  const RigidMotion forward =
      refine_robustly(smooth(moving_part, bone_alone.sigma_mm), smooth(fixed_part, bone_alone.sigma_mm), region.voxels,
                      voxels_in_fixed(fixed_part, labels, region.label, near), near);
  bone.similarity_after = similarity(samples, fixed, forward);
  if (bone.similarity_after >= bone.similarity_before) {
    bone.motion.motion = forward;
  } else {
    if (largest_distance(region.voxels, start.given, forward) > noticeable_mm)
      warn("was not improved by registration (correlation ", bone.similarity_before, " -> ", bone.similarity_after,
           "): it keeps its start position");
    bone.motion.motion = start.given;
    bone.similarity_after = bone.similarity_before;
  }
  if (const double inside = fraction_inside(moved(region.voxels, bone.motion.motion), fixed); inside < 0.95)
    warn("lies partly outside the fixed image (", std::round(100 * (1 - inside)), " % of it)");
  if (bone.similarity_after < poor_similarity)
    warn("matches the fixed image poorly (correlation ", bone.similarity_after, "): check its motion");

  if (options.check_inverse) {
    const RigidMotion backward =
        refine_label(fixed_part, moving_part, there, moved(region.octants, start.searched), inverse(start.searched));
    bone.inverse_consistency_mm = largest_distance(region.voxels, compose(backward, bone.motion.motion), {});
  }
  return outcome;
}

/// Leaves out labels that cannot be registered; says so. With fixed labels, only common labels stay on both sides.
void keep_usable(std::vector<LabelRegion>& regions, std::vector<LabelRegion>* fixed_regions,
                 std::vector<std::string>& warnings) {
  const auto has = [](const std::vector<LabelRegion>& list, int label) {
    return std::any_of(list.begin(), list.end(), [&](const LabelRegion& r) { return r.label == label; });
  };
  const auto drop = [&](std::vector<LabelRegion>& list, const char* side, const std::vector<LabelRegion>* other,
                        const char* other_side) {
    std::erase_if(list, [&](const LabelRegion& region) {
      const bool tiny = region.voxels.size() < fewest_voxels, missing = other && !has(*other, region.label);
      if (tiny)
        warnings.push_back(concatenate("label ", region.label, " has only ", region.voxels.size(), " voxels in the ",
                                       side, " image: left out"));
      else if (missing)
        warnings.push_back(concatenate("label ", region.label, " is in the ", side, " but not in the ", other_side,
                                       " labels: left out"));
      return tiny || missing;
    });
  };
  drop(regions, "moving", fixed_regions, "fixed");
  if (!fixed_regions) return;
  drop(*fixed_regions, "fixed", &regions, "moving");
  std::erase_if(regions, [&](const LabelRegion& region) { return !has(*fixed_regions, region.label); });
}

}  // namespace

BoneMotionResult estimate_bone_motions(const Image& moving, const Image& fixed, const LabelImage& moving_labels,
                                       const LabelImage* fixed_labels, const BoneMotionOptions& options) {
  require(options.margin_mm >= 0, "the margin around labels is ", options.margin_mm, " mm; it must not be negative");
  for (const Image* image : {&moving, &fixed})
    for (const int n : image->grid.size)
      require(n >= 4, "an image has only ", n, " voxels along one axis; bone registration needs at least 4");
  BoneMotionResult result;
  std::vector<LabelRegion> regions = label_regions(moving_labels, options.margin_mm), fixed_regions;
  require(!regions.empty(), "the moving labels are empty; mark every vertebra with a number from 1 on");
  if (fixed_labels) {
    fixed_regions = label_regions(*fixed_labels, 0);
    require(!fixed_regions.empty(), "the fixed labels are empty; mark the vertebrae, or run without fixed labels");
  }
  keep_usable(regions, fixed_labels ? &fixed_regions : nullptr, result.warnings);
  require(!regions.empty(), "no label can be used: ",
          fixed_labels
              ? "moving and fixed labels have no number in common; number the same vertebra alike on both sides"
              : "all labels are smaller than 30 voxels; check the label map");
  for (const LabelRegion& region : regions)
    require(fraction_inside(region.voxels, moving) > 0.5, "label ", region.label,
            " lies outside the moving image; are the labels drawn on that image?");

  const std::vector<BoneStart> starts =
      fixed_labels
          ? starts_from_labels(moving, fixed, regions, fixed_regions, options)
          : starts_along_spine(moving, fixed, regions, register_rigidly(moving, fixed, nullptr, nullptr), options);

  std::vector<Outcome> outcomes(regions.size());
  parallel_for(
      regions.size(),
      [&](std::size_t r) { outcomes[r] = register_label(moving, fixed, moving_labels, regions[r], starts[r], options); }, 1);

  std::vector<LabelMotion> motions;
  for (Outcome& outcome : outcomes) {
    motions.push_back(outcome.bone.motion);
    result.bones.push_back(outcome.bone);
    std::move(outcome.warnings.begin(), outcome.warnings.end(), std::back_inserter(result.warnings));
  }
  const auto odd = implausible_neighbours(motions);
  result.warnings.insert(result.warnings.end(), odd.begin(), odd.end());
  return result;
}

}  // namespace mtled
