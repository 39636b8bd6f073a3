#include "evaluate.hpp"

#include <algorithm>
#include <cstdio>

#include "core/error.hpp"
#include "image_io/image_io.hpp"
#include "imaging/same_grid.hpp"
#include "io/output.hpp"
#include "stages.hpp"

namespace mtled {
namespace {

std::size_t axes_of_one_voxel(const Grid& grid) { return std::size_t(std::count(grid.size.begin(), grid.size.end(), 1)); }

LabelMaps read_label_maps(const EvaluateOptions& options, const Grid& fixed, const Maps& maps) {
  LabelMaps labels;
  if (!options.fixed_labels.empty()) labels.fixed = labels_on(fixed, options.fixed_labels, "fixed labels");
  if (!options.moving_labels.empty()) labels.moving = read_labels(options.moving_labels, "moving labels");
  if (labels.moving && labels.fixed) labels.before = labels_at(*labels.moving, fixed);
  if (!options.warped_labels.empty()) labels.after = labels_on(fixed, options.warped_labels, "warped labels");
  else if (labels.moving && maps.field) labels.after = warp_labels(*labels.moving, maps.field->displacement);
  return labels;
}

void report_labels(const LabelMaps& labels, const std::vector<Other>& others, const Maps& maps, Json& report) {
  if (labels.before) report["labels"]["before"] = describe(label_overlap(*labels.before, *labels.fixed));
  for (const Other& other : others)
    if (labels.fixed && other.labels) report["labels"][other.name] = describe(label_overlap(*other.labels, *labels.fixed));
  if (labels.fixed && labels.after) {
    report["labels"]["after"] = describe(label_overlap(*labels.after, *labels.fixed));
    for (const Json& l : report["labels"]["after"])
      for (const int side : {0, 1})
        if (l["voxels"][std::size_t(side)] == 0) note(report, concatenate("label ", l["label"].get<int>(), " is missing in the ", side == 0 ? "warped" : "fixed", " labels: Dice 0 and no distances; check the two label maps if it should be there"));
  }
  if (maps.field && (labels.fixed || labels.after)) report["rigidity"] = describe(label_rigidity(labels.fixed ? *labels.fixed : *labels.after, *maps.field));
}

FieldRegion region_of(const Maps& maps, const Mask& mask) {
  if (!maps.field) return {};
  FieldRegion region{intersection(mask, maps.field->covered), {}};
  region.ratio = volume_ratio(maps.field->displacement, region.counted);
  return region;
}

void report_field(const FieldRegion& region, const Maps& maps, Json& report) {
  report["field"]["jacobian"] = describe(jacobian_statistics(maps.field->displacement, region.counted, region.ratio));
  if (const std::size_t folded = report["field"]["jacobian"]["folded_voxels"]; folded > 0) note(report, concatenate("the transform folds at ", folded, " voxels (determinant at most 0); it has no inverse there"));
  if (maps.back && !maps.computed_inverse) report["field"]["inverse_consistency"] = describe(inverse_consistency(*maps.field, maps.back, region.counted));
}

void print_report(const Json& report) {
  if (report.contains("edges")) print_edges(report["edges"]);
  if (report.contains("labels")) print_labels(report["labels"]);
  if (report.contains("contours")) print_contours(report["contours"]);
  if (report.contains("rigidity"))
    for (const Json& r : report["rigidity"]) std::printf("label %4d is off its best rigid motion by %.3f mm (rms), %.3f mm at most\n", r["label"].get<int>(), r["rms_mm"].get<double>(), r["largest_mm"].get<double>());
  if (report.contains("landmarks"))
    for (const auto& [name, l] : report["landmarks"].items())
      if (l.is_object())
        std::printf("landmarks %-6s mean %.2f, median %.2f, 95 %% %.2f, max %.2f mm (%d points)\n", name.c_str(), l["mean_mm"].get<double>(), l["median_mm"].get<double>(), l["percentile_95_mm"].get<double>(),
                    l["max_mm"].get<double>(), l["points"].get<int>());
  if (report.contains("field_difference")) print_reference(report["field_difference"]);
  if (!report.contains("field")) return;
  const Json& j = report["field"]["jacobian"];
  const auto number = [&](const char* key) { return j[key].get<double>(); };
  const auto deviation = [&](const char* key) { return j[key].is_null() ? std::string("-") : concatenate(j[key].get<double>()); };
  std::printf("det J: min %.3f, 1 %% %.3f, 99 %% %.3f, max %.3f, %d of %d voxels folded, SDlogJ %s (Learn2Reg's %s)\n", number("min"), number("percentile_1"), number("percentile_99"), number("max"),
              j["folded_voxels"].get<int>(), j["voxels"].get<int>(), deviation("sd_log").c_str(), deviation("sd_log_learn2reg").c_str());
  if (report["field"].contains("inverse_consistency")) {
    const Json& c = report["field"]["inverse_consistency"];
    std::printf("inverse consistency: mean %.3f, 95 %% %.3f, max %.3f mm\n", c["mean_mm"].get<double>(), c["percentile_95_mm"].get<double>(), c["max_mm"].get<double>());
  }
}

void check_usage(const CLI::App& verb, const EvaluateOptions& options) {
  for (const char* name : {"--fixed", "--output"}) require_option(verb, name);
  const bool has_transform = !options.transform.empty() || !options.inverse_transform.empty() || !options.result.empty();
  if (options.moving.empty() && !has_transform) require_option(verb, "--warped");
  if (options.fixed_landmarks.empty() != options.moving_landmarks.empty()) require_option(verb, "--fixed-landmarks"), require_option(verb, "--moving-landmarks");
  if (!options.fixed_landmarks.empty() && !options.evaluation.landmarks.empty()) fail(Failure::usage, "--landmarks holds the points of both images; give either that or --fixed-landmarks and --moving-landmarks");
  if (!options.fixed_labels.empty() && options.moving_labels.empty() && !has_transform) require_option(verb, "--warped-labels");
  if (!parse_others(options.beside).empty()) {
    require_option(verb, "--moving");
    if (!has_transform && options.warped.empty()) require_option(verb, "--transform");
  }
  check_contours(verb, options, has_transform);
  check_reference(verb, options);
  if (options.fixed_labels.empty() && (!options.warped_labels.empty() || (!options.moving_labels.empty() && !has_transform))) require_option(verb, "--fixed-labels");
}

void run(CLI::App& verb, EvaluateOptions& options) {
  apply_config(verb, options);
  check_usage(verb, options);
  const auto limit = start(options);
  Stages times;
  const Image fixed = read_image(options.fixed, "fixed image");
  std::optional<Image> moving, warped;
  if (!options.moving.empty()) moving = read_image(options.moving, "moving image");
  if (moving)
    require(axes_of_one_voxel(moving->grid) == axes_of_one_voxel(fixed.grid), "one of the fixed and the moving image has a single slice where the other has more; compare two volumes, or two single slices");
  if (!options.warped.empty()) {
    warped = read_image(options.warped, "warped image");
    require(same_grid(fixed.grid, warped->grid), "warped image '", options.warped.string(), "' is on another grid than the fixed image; resample it to the fixed image, or give the moving image and the transform instead");
  }
  const Mask mask = options.mask.empty() ? Mask(fixed.grid, 1) : mask_on(fixed.grid, options.mask, "mask");
  times.lap("images");
  announce(options, "reading transforms");
  const Maps maps = read_maps(options, fixed.grid, moving);
  Landmarks landmarks = read_landmarks(options, fixed.grid, moving, maps);
  for (const auto* file : {&options.reference_transform, &options.reference_inverse_transform, &options.reference_points})
    require(file->empty() || std::filesystem::exists(*file), "reference '", file->string(), "' does not exist; check its name");
  const OutputDirectory output(options.output, options.force);
  times.lap("transforms");
  announce(options, "evaluating");
  const CannyOptions& canny = options.evaluation.canny;
  Json report;
  const EdgeSpace space = options.slices ? EdgeSpace::slices : EdgeSpace::volume;
  report["settings"] = describe(canny, space);
  report["warnings"] = Json::array();

  Mask where = mask;
  std::optional<Image> before;
  if (maps.field) {
    where = intersection(std::move(where), maps.field->covered);
    if (count(where) < count(mask)) note(report, concatenate("the transform is known at ", 100.0 * double(count(where)) / double(count(mask)), " % of the voxels only; the others are left out of edges and Jacobian"));
  }
  if (moving) {
    Mask inside;
    if (maps.field) {
      Image by_transform = warp_continued(*moving, fixed.grid, &maps.field->displacement, inside);
      where = intersection(std::move(where), inside);
      if (!warped) warped = std::move(by_transform);
    }
    before = warp_continued(*moving, fixed.grid, nullptr, inside);
    if (!maps.field) where = intersection(std::move(where), inside);
  }
  require(count(where) > 0, maps.field ? "the transform leads no voxel of the fixed image (within the mask) into the moving image; check that it belongs to these images and maps points of the fixed to the moving image"
                                       : "the moving image does not overlap the fixed image (within the mask) in space; give the transform between them");
  times.lap("warping");
  const LabelMaps labels = read_label_maps(options, fixed.grid, maps);
  std::vector<Other> others = parse_others(options.beside);
  if (moving) read_others(others, *moving, mask, labels, landmarks, where, report);
  leave_out_unknown(landmarks, others);
  times.lap("label maps and others");
  std::vector<NamedImage> candidates;
  if (before) candidates.push_back({"before", &*before});
  for (const Other& other : others) candidates.push_back({other.name, &other.warped});
  if (warped) candidates.push_back({"after", &*warped});
  for (const NamedImage& c : candidates) report["correlation"][c.name] = correlation(fixed, *c.image, where);
  times.lap("correlation");
  const FieldRegion region = region_of(maps, mask);
  std::optional<ReportView> view;
  if (options.report) view = view_of(fixed, moving, others, warped, maps, region, where), times.lap("report");
  if (!candidates.empty())
    report["edges"] = compare_edges_of(fixed, candidates, canny, where, moving ? &moving->grid : nullptr, space, report,
                                       [&](const std::string& name, const Mask& edges) { if (view) view->add_edges(name, edges); });
  times.lap("edges");
  report_labels(labels, others, maps, report);
  report_contours(parse_contours(options.contours), fixed, candidates, labels, others, where, report);
  before.reset(), warped.reset(), candidates.clear();
  times.lap("labels and contours");
  report_landmarks(landmarks, others, maps, report);
  if (maps.field) report_field(region, maps, report);
  times.lap("field");
  check_direction(options, fixed, moving, mask, maps, landmarks, report);
  const auto reference = compare_with_reference(options, fixed, moving, maps, options.mask.empty() ? std::nullopt : std::optional(mask));
  if (reference) report_reference(*reference, report);
  times.lap("direction and reference");

  if (report.contains("edges")) write_text(output / "edges.csv", edge_table(report["edges"]));
  if (report.contains("labels")) write_text(output / "labels.csv", label_table(report["labels"]));
  if (report.contains("landmarks")) write_text(output / "landmarks.csv", landmark_table(landmarks, others, maps));
  if (report.contains("contours")) write_text(output / "contours.csv", contour_table(report["contours"]));
  if (reference) {
    write_text(output / "field_difference.csv", reference_table(reference->difference));
    write_png(output / "field_difference.png", reference->picture);
  }
  times.lap("writing");
  report["stages"] = times.report();
  write_text(output / "evaluation.json", report.dump(1) + "\n");
  if (view) {
    Json facts = report_facts(options, fixed, moving, others, reference, report);
    facts["settings"] = settings_of(verb);
    write_report(output / "report.html", std::move(facts), *view);
  }
  print_report(report);
}

}  // namespace

void add_evaluate(CLI::App& program) {
  auto options = std::make_shared<EvaluateOptions>();
  CLI::App* verb = program.add_subcommand("evaluate", "Judge a registration by any program: edges, labels, landmarks, field");
  verb->add_option("--fixed,-f", options->fixed, "fixed image")->type_name("IMAGE");
  verb->add_option("--moving,-m", options->moving, "moving image: shows what it was before, and is warped by the transform")->type_name("IMAGE");
  verb->add_option("--warped,-w", options->warped, "moving image warped onto the fixed grid, by any program")->type_name("IMAGE");
  verb->add_option("--transform,-t", options->transform, "map of points of the fixed to the moving image: .h5, .tfm, .txt, .mat as ITK writes them, or a displacement field (.nrrd, .mha, .nii.gz) [mm, LPS]")->type_name("FILE");
  verb->add_option("--inverse-transform", options->inverse_transform, "map of points of the moving to the fixed image; alone, its inverse is computed")->type_name("FILE");
  verb->add_option("--result,-r", options->result, "output folder of `mtled register`: both transforms")->type_name("DIR");
  verb->add_option("--mask", options->mask, "compare edges and look at the field only here (fixed image)")->type_name("IMAGE");
  verb->add_option("--fixed-labels", options->fixed_labels, "label map in the fixed image")->type_name("IMAGE");
  verb->add_option("--moving-labels", options->moving_labels, "label map in the moving image; warped by the transform")->type_name("IMAGE");
  verb->add_option("--warped-labels", options->warped_labels, "warped label map, by any program")->type_name("IMAGE");
  verb->add_option("--fixed-landmarks", options->fixed_landmarks, "CSV with x,y,z: points in the fixed image [mm, LPS]")->type_name("FILE");
  verb->add_option("--moving-landmarks", options->moving_landmarks, "CSV with x,y,z: the same points in the moving image, in the same order")->type_name("FILE");
  verb->add_option("--beside", options->beside, "another registration of these images to compare with: a map of points of the fixed to the moving image, or a folder of results; may be repeated")->type_name("NAME=FILE");
  verb->add_option("--contour", options->contours, "compare the outlines of an organ in the slices along k: NAME=LABEL of the label maps, or `lungs`, found in a CT; may be repeated")->type_name("NAME=LABEL");
  CLI::Option* reference[] = {verb->add_option("--reference-transform", options->reference_transform, "map of points of the fixed to the moving image that --transform is compared with")->type_name("FILE"),
                              verb->add_option("--reference-inverse-transform", options->reference_inverse_transform, "map of points of the moving to the fixed image, such as one by finite elements, that --inverse-transform is compared with")->type_name("FILE"),
                              verb->add_option("--reference-points", options->reference_points, "CSV with x,y,z,ux,uy,uz: points of the moving image and their displacements [mm, LPS], that --inverse-transform is compared with")->type_name("FILE")};
  for (CLI::Option* one : reference)
    for (CLI::Option* other : reference)
      if (one != other) one->excludes(other);
  verb->add_flag("--slices", options->slices, "2-D edges, compared slice by slice (along k), instead of 3-D ones");
  verb->add_flag("!--no-report", options->report, "do not write report.html");
  verb->add_option("--output,-o", options->output, "folder for evaluation.json, report.html and tables")->type_name("DIR");
  add_evaluation_options(*verb, options->evaluation);
  add_common(*verb, *options, true);
  verb->callback([verb, options] { run(*verb, *options); });
}

}  // namespace mtled
