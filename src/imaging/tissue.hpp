#pragma once
#include <optional>
#include <string>
#include <vector>

#include "core/volume.hpp"

namespace mtled {

/// Settings of Fuzzy C-Means on intensity (Bezdek 1981; used on CT by Li et al.).
struct FuzzyCMeansOptions {
  int classes = 8;                      ///< >= 2
  double fuzziness = 2.0;               ///< q > 1
  std::vector<double> fixed_centers{};  ///< if not empty: use these centres (sorted) and do not iterate
  std::vector<double>
      initial_centers{};    ///< if empty: CT anchors for 8 classes of a CT (-300 ... 100 present), else quantiles
  double tolerance = 1e-4;  ///< stop when no centre moves more [intensity]
  int max_iterations = 5000;
};

struct FuzzyClasses {
  std::vector<double> centers;  ///< [classes] ascending [intensity]
  double fuzziness = 2.0;
  double objective = 0;  ///< J = sum u^q d^2
  int iterations = 0;
  bool converged = false;
};

/// Weighted samples: a scalar image's histogram, on which FCM is exact.
struct Histogram {
  std::vector<double> values;  ///< ascending
  std::vector<double> counts;
};
/// Histogram of the voxels inside `mask`, one bin per distinct value after rounding to `bin_width` (1 HU for CT).
Histogram histogram(const Image& image, const Mask& mask, double bin_width);
FuzzyClasses fuzzy_c_means(const Histogram& samples, const FuzzyCMeansOptions& options);
/// Memberships [classes] of one intensity; the intensity is clamped to [centers.front(), centers.back()] first.
void memberships(const FuzzyClasses& classes, double intensity, double* membership);

struct TissueProperties {
  std::string name;              ///< e.g. "muscle"
  double shear_modulus_kpa = 0;  ///< > 0
  bool bone = false;             ///< for information: free bone is 10 x muscle
  std::optional<double> poisson_ratio{};  ///< [0, 0.5); none: that of all tissue
};
/// Table of Li et al. for 8 CT classes: lung 0.53 (x3), fat 1.07, ligament 3.57, muscle 4.05, bone 40.5 (x2) kPa.
std::vector<TissueProperties> default_tissue_table();

/// Membership-weighted shear modulus [kPa] of every voxel inside the mask, 0 outside (a table lookup per voxel).
Image shear_modulus_map(const Image& image, const Mask& mask, const FuzzyClasses& classes,
                        const std::vector<TissueProperties>& table);
/// Membership-weighted bulk modulus [kPa], that of each class from its own Poisson ratio, which all must have.
Image bulk_modulus_map(const Image& image, const Mask& mask, const FuzzyClasses& classes,
                       const std::vector<TissueProperties>& table);
/// Number (1..classes) of the class of largest membership inside the mask, 0 outside.
LabelImage hard_classes(const Image& image, const Mask& mask, const FuzzyClasses& classes);

}  // namespace mtled
