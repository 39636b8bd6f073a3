#pragma once
#include "core/volume.hpp"

namespace mtled {

struct BodyOptions {
  double threshold = -500;       ///< [HU] voxels above it may be body; air, couch foam and sheets lie below or are removed
  double opening_radius_mm = 5;  ///< cuts bridges between body and couch or sheets; 0 = off
};
/// Mask of the patient in a CT without couch and clothing; lungs, bowel gas and other holes are filled.
/// Throws an input error when nothing is found (with the intensity range and the threshold in the message).
Mask body_mask(const Image& ct, const BodyOptions& options);

}  // namespace mtled
