#pragma once
#include <vector>

#include "core/motion.hpp"
#include "core/volume.hpp"

namespace mtled {

/// One resolution of a registration.
struct RegistrationLevel {
  double sigma_mm = 0;         ///< Gaussian smoothing of both images; 0 = none
  std::size_t points = 0;      ///< how many of the points take part at most; 0 = all
  double largest_step_mm = 1;  ///< of the optimiser
};

/// Rigid motion moving -> fixed that maximises the squared normalised correlation over `points` of the moving image
/// [LPS mm], from `start`, level by level. ITK: CorrelationImageToImageMetricv4, Euler3DTransform about the centre of
/// the start, QuasiNewtonOptimizerv4 with steps in mm. Both images are interpolated by cubic splines, and the optimiser
/// gets that spline's own gradient: with ITK's usual central differences it stops up to 0.3 deg beside the optimum. One
/// thread, no random numbers. Throws a numerical error when the images do not overlap enough for ITK.
RigidMotion refine_motion(const Image& moving, const Image& fixed, const std::vector<Vec3d>& points,
                          const RigidMotion& start, const std::vector<RegistrationLevel>& levels);

/// Rigid motion moving -> fixed that minimises the differences of intensity, after a linear fit of one image's
/// intensities to the other's, robustly (Tukey's weights, scale from the median difference) and symmetrically: at
/// `moving_points` and their images, and at `fixed_points` and their origins [LPS mm]. Gauss-Newton from `start`, which
/// must lie near the solution; `start` comes back where the points do not determine a motion within 3 mm of it.
/// Interpolation by cubic splines of the images as they are: smooth them before.
RigidMotion refine_robustly(const Image& moving, const Image& fixed, const std::vector<Vec3d>& moving_points,
                            const std::vector<Vec3d>& fixed_points, const RigidMotion& start);

/// Gaussian smoothing (ITK's recursive filter); every axis needs at least 4 voxels.
Image smooth(const Image& image, double sigma_mm);
/// Averages of blocks of voxels, so that the spacing grows to about `spacing_mm` where it is finer.
Image coarsen(const Image& image, double spacing_mm);
/// The part of an image that holds the given points and `margin_mm` around them (at least 4 voxels along each axis
/// where the image has them; the nearest part of the image if no point lies inside).
Image crop(const Image& image, const std::vector<Vec3d>& points, double margin_mm);

}  // namespace mtled
