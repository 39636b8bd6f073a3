#pragma once
#include <memory>
#include <optional>

#include "evaluation_report.hpp"
#include "imaging/figures.hpp"
#include "imaging/morphology.hpp"
#include "pipeline.hpp"
#include "report.hpp"

namespace mtled {

struct EvaluateOptions : CommonOptions {
  std::filesystem::path fixed, moving, warped, mask, fixed_labels, moving_labels, warped_labels, fixed_landmarks, moving_landmarks, transform, inverse_transform, result, output;
  std::filesystem::path reference_transform, reference_inverse_transform, reference_points;  ///< one at most
  std::vector<std::string> contours;  ///< see parse_contours()
  std::vector<std::string> beside;    ///< see parse_others()
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

/// The map `there` at the voxels of the fixed grid. A field that lies on it already is taken out of `there`, not copied.
std::shared_ptr<const DenseField> field_on(const Grid& fixed, DisplacementFunction& there);
/// Throws an input error for files that are no transforms.
Maps read_maps(EvaluateOptions& options, const Grid& fixed, const std::optional<Image>& moving);
/// Whether the transform taken as a map moving -> fixed fits much better, by landmarks and by the images. Of large images
/// every second, third, ... voxel along each axis is compared.
void check_direction(const EvaluateOptions& options, const Image& fixed, const std::optional<Image>& moving, const Mask& mask, const Maps& maps, const Landmarks& landmarks, Json& report);

/// Label maps: of the fixed image, of the moving one, and this on the fixed grid as it lies and warped.
struct LabelMaps {
  std::optional<LabelImage> fixed, moving, before, after;
};

/// Another registration of the same images, to be compared with.
struct Other {
  std::string name;
  std::filesystem::path file;
  Image warped;
  std::optional<LabelImage> labels;           ///< warped, if there are moving labels
  std::vector<std::optional<Vec3d>> mapped;   ///< the fixed landmarks; nothing where it is not known
};
/// Of texts NAME=FILE or NAME=FOLDER of a result; files are not read yet. Usage errors: no such text, a name that is taken.
std::vector<Other> parse_others(const std::vector<std::string>& texts);
/// Reads their transforms, warps images, labels and landmarks by them, and puts Jacobian and rigidity into
/// report["beside"]. Voxels of `where` that one of them does not know or sends out of the moving image are cleared. Input
/// error when none is left.
void read_others(std::vector<Other>& others, const Image& moving, const Mask& mask, const LabelMaps& labels, const Landmarks& landmarks, Mask& where, Json& report);

/// Empty without landmarks. Input error when none can be used.
Landmarks read_landmarks(const EvaluateOptions& options, const Grid& fixed, const std::optional<Image>& moving, const Maps& maps);
/// Leaves out those that one of the others does not know, so that all are judged by the same points. Input error when none
/// is left.
void leave_out_unknown(Landmarks& landmarks, std::vector<Other>& others);
/// Errors before, of the others and after.
void report_landmarks(const Landmarks& landmarks, const std::vector<Other>& others, const Maps& maps, Json& report);
/// `others` as they were read: a row for every pair that counts.
std::string landmark_table(const Landmarks& landmarks, const std::vector<Other>& others, const Maps& maps);

/// The difference from a displacement that is known otherwise, by finite elements for example.
struct ReferenceComparison {
  std::filesystem::path file;
  std::string where;  ///< what its points are
  FieldDifference difference;
  Picture picture;
};
/// Usage errors: what a reference is compared with is missing.
void check_reference(const CLI::App& verb, const EvaluateOptions& options);
/// Nothing without a reference. `mask`: only points that it leads into there. Input errors: a file that cannot be read; no
/// point that both know.
std::optional<ReferenceComparison> compare_with_reference(const EvaluateOptions& options, const Image& fixed, const std::optional<Image>& moving, const Maps& maps, const std::optional<Mask>& mask);
void report_reference(const ReferenceComparison& comparison, Json& report);
void print_reference(const Json& difference);
std::string reference_table(const FieldDifference& difference);

/// An organ whose outlines are compared: a label, or the lungs as they are seen in the image.
struct NamedContour {
  std::string name;
  int label = 0;  ///< 0: found in the image
};
/// Of texts NAME=LABEL or `lungs`. Usage errors: neither, label out of range, a name twice.
std::vector<NamedContour> parse_contours(const std::vector<std::string>& texts);
/// Usage errors: as above, and labels or images that they need are missing. `has_transform`: moving labels can be warped.
void check_contours(const CLI::App& verb, const EvaluateOptions& options, bool has_transform);
/// `where`: voxels of the fixed grid that count. Input error: no body in an image whose lungs are asked for.
void report_contours(const std::vector<NamedContour>& contours, const Image& fixed, const std::vector<NamedImage>& candidates, const LabelMaps& labels, const std::vector<Other>& others, const Mask& where, Json& report);
void print_contours(const Json& contours);
std::string contour_table(const Json& contours);

/// Where the Jacobian of the transform counts (the mask, where the transform is known), and its determinant there.
struct FieldRegion {
  Mask counted;
  Image ratio;
};

/// What the report shows of images and field, around `where`.
ReportView view_of(const Image& fixed, const std::optional<Image>& moving, const std::vector<Other>& others, const std::optional<Image>& warped, const Maps& maps, const FieldRegion& region, const Mask& where);
/// The facts of the report: evaluation.json, the files that were read, and the figure of the reference.
Json report_facts(const EvaluateOptions& options, const Image& fixed, const std::optional<Image>& moving, const std::vector<Other>& others, const std::optional<ReferenceComparison>& reference, const Json& evaluation);

Mask intersection(Mask a, const Mask& b);

}  // namespace mtled
