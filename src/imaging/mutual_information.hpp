#pragma once
#include <cstdint>
#include <vector>

#include "core/volume.hpp"

namespace mtled {

/// A place of the fixed image and the intensity there.
struct IntensitySample {
  Vec3d place{};  ///< [LPS mm]
  double value = 0;
};
/// `count` places drawn evenly, with repetition, from the voxels of `image` (where `inside` is not 0, if it is given; on
/// any grid), each anywhere in its voxel; intensities by cubic spline. The same for the same seed on any machine. Input
/// error when no voxel is inside.
std::vector<IntensitySample> draw_samples(const Image& image, const Mask* inside, std::size_t count, std::uint64_t seed);

/// Mutual information [nat] of two images after Mattes, Haynor, Vesselle, Lewellen, Eubank 2003, with the histogram of
/// ITK's MattesMutualInformationImageToImageMetricv4: box windows on fixed intensities, cubic B-spline windows on moving
/// ones, two empty bins at either end. Unlike there, which samples count does not change with every evaluation: pushing what is
/// alike out of the moving image would raise the information of the rest. The same bits for any number of threads.
class MattesMutualInformation {
 public:
  /// `bins` per image, at least 6. Bins span the intensities of the samples and of `moving`. Input errors: constant
  /// intensities, too few bins, no samples.
  MattesMutualInformation(const Image& moving, const std::vector<IntensitySample>& samples, int bins);

  /// From now on those samples count that lie inside the moving image at `position` [samples] [LPS mm]; at first all do.
  /// Returns their fraction.
  double count_inside(const std::vector<Vec3d>& position);
  /// With the samples at `position` [samples] in the moving image; beyond its border they see the intensity at the border.
  /// `derivative` [samples]: of the information by each position [1/mm]. 0 when no sample counts.
  double evaluate(const std::vector<Vec3d>& position, std::vector<Vec3d>& derivative);

 private:
  Image coefficients_;
  std::vector<int> fixed_bin_;
  int bins_;
  double lowest_, bin_width_;               ///< of the moving image
  std::vector<std::uint8_t> counts_;        ///< [samples]
  std::vector<double> window_;              ///< [samples] moving intensity in bins
  std::vector<Vec3d> gradient_;             ///< [samples] of that [1/mm]
};

}  // namespace mtled
