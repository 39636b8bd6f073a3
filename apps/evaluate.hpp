#pragma once
#include <memory>
#include <optional>

#include "evaluation_report.hpp"
#include "pipeline.hpp"

namespace mtled {

struct EvaluateOptions : CommonOptions {
  std::filesystem::path fixed, moving, warped, mask, fixed_labels, moving_labels, warped_labels, fixed_landmarks, moving_landmarks, transform, inverse_transform, result, output;
  bool slices = false, report = true;
  EvaluationOptions evaluation;
};

/// The map fixed -> moving and, if it is known, moving -> fixed.
struct Maps {
  DisplacementFunction there, back;
  std::shared_ptr<const DenseField> field;  ///< `there` on the fixed grid
  bool computed_inverse = false;            ///< `there` was computed from `back`
};

/// Corresponding points inside both images, and those left out.
struct Landmarks {
  std::vector<Vec3d> moving, fixed, mapped;  ///< mapped: fixed by the transform, if there is one
  std::vector<std::size_t> rows, left_out;   ///< from 1
};

/// Throws an input error for files that are no transforms.
Maps read_maps(EvaluateOptions& options, const Grid& fixed, const std::optional<Image>& moving);
/// Whether the transform taken as a map moving -> fixed fits much better, by landmarks and by the images. Of large images
/// every second, third, ... voxel along each axis is compared.
void check_direction(const EvaluateOptions& options, const Image& fixed, const std::optional<Image>& moving, const Mask& mask, const Maps& maps, const Landmarks& landmarks, Json& report);

/// Empty without landmarks. Input error when none can be used.
Landmarks read_landmarks(const EvaluateOptions& options, const Grid& fixed, const std::optional<Image>& moving, const Maps& maps);
void report_landmarks(const Landmarks& landmarks, const Maps& maps, Json& report);
std::string landmark_table(const Landmarks& landmarks, const Maps& maps);

/// Prints a warning and keeps it in the report.
void note(Json& report, const std::string& text);
/// Voxels that are not 0.
std::size_t count(const Mask& mask);
Mask intersection(Mask a, const Mask& b);

}  // namespace mtled
