#pragma once
#include "core/volume.hpp"

namespace mtled {

/// Anatomical planes as radiologists look at them: axial (from below; the patient's left on the right, front up),
/// coronal (from the front; left on the right, head up), sagittal (from the left; front on the left, head up).
enum class Plane { axial, coronal, sagittal };

/// Pixels of the slice through `through` [LPS mm]: a grid with one voxel along k, i to the right and j down on the
/// picture. It covers the image's bounding box in LPS; the image's own direction may be anything.
Grid slice_grid(const Grid& image, const Vec3d& through, Plane plane, double pixel_mm);
/// The same slice with `factor` times as many pixels along i and j over the same rectangle.
Grid refined(Grid slice, int factor);
/// Extent [mm] of the image's bounding box along L-R, A-P and I-S, voxel corners included.
Vec3d extent_mm(const Grid& image);
/// Middle of the image [LPS mm].
Vec3d middle(const Grid& image);

/// Intensities that are shown black and white.
struct Window {
  double low = 0, high = 1;
};
/// Soft tissue (-160 to 240 HU) where the image has CT's range (air below -500 and something above 100); otherwise the
/// 1st and 98th percentile of the voxels above the smallest value (which is background in skull-stripped images),
/// of large images of some voxels (see some_values()).
Window display_window(const Image& image);

}  // namespace mtled
