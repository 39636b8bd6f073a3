#pragma once
#include <vector>

#include "imaging/bone_motion.hpp"
#include "imaging/label_region.hpp"

namespace mtled {

constexpr double visible_enough = 0.5;  ///< fraction of a label that the fixed image must show for a registration

/// Where the registration of one label starts.
struct BoneStart {
  RigidMotion given;     ///< from the labels' positions, or from the global registration
  RigidMotion searched;  ///< the best pose that the search around it found
};

/// Starts from labels on both sides: equal centroids, with no turn or with the principal axes aligned (whichever
/// correlates better). `fixed_regions` has the same labels in the same order as `regions`.
std::vector<BoneStart> starts_from_labels(const Image& moving, const Image& fixed,
                                          const std::vector<LabelRegion>& regions,
                                          const std::vector<LabelRegion>& fixed_regions,
                                          const BoneMotionOptions& options);

/// Starts without labels in the fixed image. All labels together, as one rigid body, are searched around `global`: the
/// whole column is not mistaken for its neighbour one level off as easily as one vertebra. The label that then
/// correlates best becomes the anchor, and the chain is followed up and down from it: each label is searched near the
/// place where its neighbour's motion takes it, by less than half the distance between the two. Where that place is not
/// visible enough in the fixed image, the label follows its neighbour.
std::vector<BoneStart> starts_along_spine(const Image& moving, const Image& fixed,
                                          const std::vector<LabelRegion>& regions, const RigidMotion& global,
                                          const BoneMotionOptions& options);

}  // namespace mtled
