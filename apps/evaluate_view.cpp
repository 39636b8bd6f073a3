#include "evaluate.hpp"
#include "report/encode.hpp"

namespace mtled {
namespace {

constexpr double report_margin_mm = 20;  ///< around what is compared

}  // namespace

ReportView view_of(const Image& fixed, const std::optional<Image>& moving, const std::vector<Other>& others, const std::optional<Image>& warped, const Maps& maps, const FieldRegion& region, const Mask& where) {
  ReportView view(grey_scale_of(fixed));
  view.add_space("fixed", view_grid(fixed.grid, report_voxels, &where, report_margin_mm));
  view.add_image("fixed", "Fixed image", "fixed", fixed);
  if (moving) view.add_image("before", "Moving image, as it was", "fixed", *moving);
  for (const Other& other : others) view.add_image(other.name, "Moving image, " + other.name, "fixed", other.warped);
  if (warped) view.add_image("after", "Moving image, registered", "fixed", *warped);
  if (maps.field) add_field(view, maps.field->displacement, region.counted, region.ratio);
  return view;
}

Json report_facts(const EvaluateOptions& options, const Image& fixed, const std::optional<Image>& moving, const std::vector<Other>& others, const std::optional<ReferenceComparison>& reference, const Json& evaluation) {
  Json facts = facts_of_evaluation(evaluation);
  facts["inputs"] = Json::array();
  const auto list = [&](const char* option, const std::filesystem::path& path, const Grid* grid = nullptr) {
    if (!path.empty()) list_input(facts["inputs"], role_of(option), path.string(), grid);
  };
  list("fixed", options.fixed, &fixed.grid);
  list("moving", options.moving, moving ? &moving->grid : nullptr);
  list("warped", options.warped, &fixed.grid);
  list("transform", options.transform);
  list("inverse-transform", options.inverse_transform);
  for (const Other& other : others) list_input(facts["inputs"], other.name, other.file.string());
  list("mask", options.mask);
  list("fixed-labels", options.fixed_labels);
  list("moving-labels", options.moving_labels);
  list("warped-labels", options.warped_labels);
  for (const auto* file : {&options.reference_transform, &options.reference_inverse_transform, &options.reference_points}) list("reference", *file);
  for (const auto* file : {&options.evaluation.landmarks, &options.fixed_landmarks, &options.moving_landmarks}) list("landmarks", *file);
  if (reference) facts["figures"] = {{{"title", "Difference from the reference"}, {"caption", reference->file.filename().string()}, {"picture", png_address(reference->picture)}}};
  return facts;
}

}  // namespace mtled
