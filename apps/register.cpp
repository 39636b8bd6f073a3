#include <algorithm>
#include <cmath>
#include <cstdio>
#include <optional>

#include "core/error.hpp"
#include "cuda/field.hpp"
#include "evaluation_report.hpp"
#include "image_io/checksum.hpp"
#include "image_io/image_io.hpp"
#include "imaging/figures.hpp"
#include "imaging/morphology.hpp"
#include "io/output.hpp"
#include "io/solution_output.hpp"
#include "io/tables.hpp"
#include "pipeline.hpp"
#include "report.hpp"
#include "report/node_cloud.hpp"
#include "stages.hpp"

namespace mtled {
namespace {

struct RegisterOptions : CommonOptions {
  std::filesystem::path moving, fixed, output, export_case;
  std::vector<double> resample;
  TissueOptions tissue;
  MotionOptions motion;
  MechanicsOptions mechanics;
  EvaluationOptions evaluation;
  std::filesystem::path points;
  Interpolation interpolation = Interpolation::linear;
  double outside = -1000;
  bool evaluate = true, report = true;
};

constexpr double inverse_tolerance_mm = 0.01;
constexpr double report_margin_mm = 20;      ///< around the body: what the report shows
constexpr double evaluation_margin_mm = 10;  ///< around the body: the skin's edges and where a bad candidate puts them

/// Name and checksum of every file that was read.
Json inputs_of(const RegisterOptions& o) {
  Json inputs = Json::object();
  for (const auto& [name, path] : std::initializer_list<std::pair<const char*, std::filesystem::path>>{
           {"moving", o.moving}, {"fixed", o.fixed}, {"moving-labels", o.motion.moving_labels}, {"fixed-labels", o.motion.fixed_labels}, {"motions", o.motion.motions},
           {"moving-mask", o.tissue.mask}, {"shear-modulus", o.tissue.shear_modulus}, {"tissue-table", o.tissue.tissue_table}, {"landmarks", o.evaluation.landmarks},
           {"points", o.points}, {"config", o.config}})
    if (!path.empty()) inputs[name] = {{"path", path.string()}, {"md5", md5_of(path)}};
  return inputs;
}

/// Value of an image at the nodes, 0 outside it.
template <class T>
PointData at_nodes(const std::string& name, const Cloud& cloud, const Volume<T>& image) {
  PointData data{name, 1, {}};
  for (const Vec3d& x : cloud.nodes) data.values.push_back(float(nearest_value<T>(image, x, 0)));
  return data;
}

/// Where edges are compared: around what the deformed moving body covers of the fixed image.
Mask evaluation_region(const Mask& covered) { return dilate(covered, evaluation_margin_mm); }

/// Corresponding points; empty without --landmarks.
struct Landmarks {
  std::vector<Vec3d> moving, fixed;
};
Landmarks read_landmarks(const std::filesystem::path& file) {
  if (file.empty()) return {};
  Landmarks landmarks{read_points(file, {"mx", "my", "mz"}), read_points(file, {"fx", "fy", "fz"})};
  require(!landmarks.moving.empty(), "'", file.string(), "' holds no landmarks; give at least one pair, or leave --landmarks out");
  return landmarks;
}

/// Of the landmarks inside the moving image; the others are noted. `warped`: where they go, NaN outside it.
void report_landmarks(const Landmarks& landmarks, const RigidMotion& rigid, const std::vector<Vec3d>& warped, Json& report) {
  std::vector<Vec3d> before, rigidly, after, fixed;
  for (std::size_t p = 0; p < warped.size(); ++p)
    if (std::isfinite(warped[p].x)) before.push_back(landmarks.moving[p]), rigidly.push_back(rigid.apply(landmarks.moving[p])), after.push_back(warped[p]), fixed.push_back(landmarks.fixed[p]);
  if (fixed.size() < warped.size()) note(report, concatenate(warped.size() - fixed.size(), " of ", warped.size(), " landmarks lie outside the moving image and are left out"));
  if (fixed.empty()) return;
  report["landmarks"] = {{"before", describe(point_errors(before, fixed))}, {"rigid", describe(point_errors(rigidly, fixed))}, {"mtled", describe(point_errors(after, fixed))}};
}

/// Adds edges, landmarks and labels to the metrics.
void evaluate(const RegisterOptions& options, const ImagePair& pair, const Tissue& tissue, const BoneLoads& loads, const Landmarks& landmarks,
              const Deformation& deformation, const DenseField& forward, const DenseField& inverse, const Image& warped, ReportView* view, Json& report) {
  announce(options, "evaluating");
  Mask fixed_region = evaluation_region(inverse.covered);
  const RigidMotion rigid = register_rigidly(pair.moving, pair.fixed, &tissue.body, nullptr);
  const RigidMotion identity;
  const Image before = warp_image_rigidly(pair.moving, pair.fixed.grid, identity, Interpolation::linear, float(options.outside));
  const Image rigidly = warp_image_rigidly(pair.moving, pair.fixed.grid, rigid, Interpolation::linear, float(options.outside));
  write_png(options.output / "overlay.png", overlay_figure(pair.fixed, {{"before", &before}, {"rigid registration", &rigidly}, {"mtled", &warped}}));
  report["edges"] = compare_edges_of(pair.fixed, {{"before", &before}, {"rigid", &rigidly}, {"mtled", &warped}}, options.evaluation.canny, fixed_region, &pair.moving.grid, EdgeSpace::volume, report,
                                     [&](const std::string& name, const Mask& edges) { if (view) view->add_edges(name, edges); });
  if (view) view->add_image("rigid", "Moving image, rigidly registered", "fixed", rigidly);
  if (!landmarks.moving.empty()) report_landmarks(landmarks, rigid, warp_points(landmarks.moving, deformation.function(), forward.displacement), report);
  if (loads.fixed_labels) {
    report["labels"]["before"] = describe(label_overlap(resample_labels(loads.labels, pair.fixed.grid), *loads.fixed_labels));
    report["labels"]["mtled"] = describe(label_overlap(warp_labels(loads.labels, inverse.displacement), *loads.fixed_labels));
  }
}

/// points.csv: where the given points of the moving image go; empty cells outside it.
void write_point_displacements(const std::filesystem::path& file, const std::vector<Vec3d>& points, const Deformation& deformation, const DenseField& forward) {
  std::vector<Vec3d> u = warp_points(points, deformation.function(), forward.displacement);
  for (std::size_t p = 0; p < points.size(); ++p) u[p] = u[p] - points[p];
  const auto outside = std::count_if(u.begin(), u.end(), [](const Vec3d& d) { return std::isnan(d.x); });
  if (outside > 0) warn(concatenate(outside, " of ", points.size(), " points lie outside the moving image; their displacement is left empty"));
  write_displacements(file, points, u);
}

void print_summary(const Json& metrics, const std::filesystem::path& output) {
  std::printf("converged after %d steps, estimated error %.3g mm\n", metrics["solver"]["steps"].get<int>(), metrics["solver"]["error_estimate_mm"].get<double>());
  std::printf("smallest volume ratio %.3f, %zu folded voxels\n", metrics["jacobian"]["min"].get<double>(), metrics["jacobian"]["folded_voxels"].get<std::size_t>());
  if (metrics.contains("edges")) print_edges(metrics["edges"]);
  if (metrics.contains("landmarks"))
    for (const auto& [name, e] : metrics["landmarks"].items())
      std::printf("landmarks %-8s mean %.2f, median %.2f, 95 %% %.2f, max %.2f mm (%d points)\n", name.c_str(), e["mean_mm"].get<double>(), e["median_mm"].get<double>(),
                  e["percentile_95_mm"].get<double>(), e["max_mm"].get<double>(), e["points"].get<int>());
  std::printf("results in %s: report.html (open it in a browser), warped.nii.gz, fixed_to_moving.h5 (for 3D Slicer and ITK), metrics.json, ...\n", output.string().c_str());
}

struct Fields {
  DenseField forward, inverse;
  InverseStatistics inverse_statistics;
  Image warped;
};
/// `device`: null: the CPU.
Fields fields_of(const RegisterOptions& options, const ImagePair& pair, const Deformation& deformation, FieldBackend* device, const SampleDisplaced& sampler, Stages& times) {
  Fields fields;
  fields.forward = forward_field(pair.moving.grid, deformation.function(), device);
  times.lap("forward field");
  fields.inverse = inverse_field(pair.fixed.grid, fields.forward, deformation.function(), inverse_tolerance_mm, fields.inverse_statistics, device);
  times.lap("inverse field");
  fields.warped = warp_image(pair.moving, fields.inverse.displacement, options.interpolation, float(options.outside), sampler);
  times.lap("warp");
  return fields;
}

/// What the report shows of images, tissue and field; `ratio`: volume_ratio() of the inverse one.
ReportView view_of(const ImagePair& pair, const Tissue& tissue, const Fields& fields, const Image& ratio) {
  ReportView view(grey_scale_of(pair.fixed));
  view.add_space("fixed", view_grid(pair.fixed.grid, report_voxels, &fields.inverse.covered, report_margin_mm));
  view.add_space("moving", view_grid(pair.moving.grid, report_voxels, &tissue.body, report_margin_mm));
  view.add_image("fixed", "Fixed image", "fixed", pair.fixed);
  view.add_image("before", "Moving image, as it was", "fixed", pair.moving);
  view.add_image("mtled", "Moving image, registered", "fixed", fields.warped);
  view.add_image("moving", "Moving image", "moving", pair.moving);
  Image modulus = tissue.shear_modulus;
  for (float& value : modulus.data)
    if (!(value > 0)) value = std::nanf("");
  view.add_numbers({"shear_modulus", "Shear modulus", "kPa", {0, 5}, false, 0, true}, "moving", modulus);
  add_field(view, fields.inverse.displacement, fields.inverse.covered, ratio);
  return view;
}

Json report_facts(const CLI::App& verb, const ImagePair& pair, const RegisterOptions& options, const Json& metrics, const Json& manifest) {
  Json facts = facts_of_registration(metrics, manifest);
  facts["settings"] = settings_of(verb);
  facts["inputs"] = Json::array();
  for (const auto& [role, input] : manifest["inputs"].items())
    list_input(facts["inputs"], role_of(role), input["path"], role == "moving" ? &pair.moving.grid : role == "fixed" ? &pair.fixed.grid : nullptr, input["md5"]);
  facts["edge_settings"] = describe(options.evaluation.canny, EdgeSpace::volume);
  return facts;
}

void run(CLI::App& verb, RegisterOptions& options) {
  apply_config(verb, options);
  for (const char* name : {"--moving", "--fixed", "--moving-labels", "--output"}) require_option(verb, name);
  const auto limit = start(options);
  Stages times;
  announce(options, "reading images");
  const ImagePair pair = read_pair(options.moving, options.fixed, options.resample);
  BoneLoads loads = read_loads(pair.moving, pair.fixed, options.motion);
  const Landmarks landmarks = read_landmarks(options.evaluation.landmarks);
  const std::vector<Vec3d> points = options.points.empty() ? std::vector<Vec3d>() : read_points(options.points);
  if (!options.export_case.empty() && std::filesystem::weakly_canonical(options.export_case) == std::filesystem::weakly_canonical(options.output))
    fail(Failure::usage, "--export-case and --output are the same folder, and both write a nodes.csv; choose another one for the case");
  const OutputDirectory output(options.output, options.force);
  std::optional<OutputDirectory> exported;
  if (!options.export_case.empty()) exported.emplace(options.export_case, options.force);
  times.lap("reading");
  const Tissue tissue = find_tissue(pair.moving, options.tissue, options);
  require_memory(tissue.body, options.mechanics.sampling.node_spacing_mm);
  compare_with_body(tissue.body, loads);
  times.lap("tissue");
  find_motions(pair.moving, pair.fixed, options.motion, options, loads);
  times.lap("motions");
  const Deformation deformation(tissue, loads, options.mechanics, options, options.export_case);
  times.lap("mechanics");

  announce(options, "warping");
  std::optional<Fields> fields;
  if (const DeviceChoice& solved = deformation.device(); !solved.on_cpu()) {
    try {
      const std::unique_ptr<FieldBackend> device = cuda_field(solved.ordinal, deformation.evaluator(), deformation.solution().parameter);
      fields = fields_of(options, pair, deformation, device.get(), cuda_sampler(solved.ordinal), times);
    } catch (const Error& error) {
      if (options.device != "auto") throw;
      warn(concatenate("the GPU failed after the solution, the fields are computed on the CPU: ", error.what()));
    }
  }
  if (!fields) fields = fields_of(options, pair, deformation, nullptr, {}, times);
  const auto& [forward, inverse, inverse_statistics, warped] = *fields;
  report_deviations(tissue.body, forward.displacement, forward.covered, loads);

  Json metrics, manifest;
  manifest["program"] = "mtled " MTLED_VERSION;
  for (const CLI::Option* option : verb.get_options())
    if (!option->get_lnames().empty() && option->count() > 0) manifest["settings"][option->get_lnames()[0]] = option->results();
  manifest["inputs"] = inputs_of(options);
  manifest["tissue"] = describe(tissue);
  manifest["solver"] = summary_of(deformation.solution());
  manifest["solver"].erase("reactions_mN");
  manifest["solver"]["tolerance_mm"] = options.mechanics.solver.tolerance_mm;
  manifest["solver"]["device"] = deformation.device().description;
  metrics["motions"] = loads.report;
  metrics["warnings"] = loads.warnings;
  for (const char* key : {"converged", "steps", "error_estimate_mm", "smallest_volume_ratio"}) metrics["solver"][key] = manifest["solver"][key];
  metrics["jacobian"] = describe(jacobian_statistics(forward.displacement, forward.covered));
  const Image ratio = volume_ratio(inverse.displacement, inverse.covered);
  metrics["inverse"] = {{"jacobian", describe(jacobian_statistics(inverse.displacement, inverse.covered, ratio))}, {"largest_residual_mm", inverse_statistics.largest_residual_mm}, {"covered_voxels", inverse_statistics.covered}, {"unresolved_voxels", inverse_statistics.unresolved}};
  if (!deformation.device().on_cpu()) manifest["voxels_left_to_cpu"] = {{"forward", forward.undecided}, {"inverse", inverse.undecided}};
  if (metrics["jacobian"]["folded_voxels"].get<std::size_t>() > 0) note(metrics, concatenate("the deformation folds at ", metrics["jacobian"]["folded_voxels"].get<std::size_t>(), " voxels; results there are not to be trusted"));

  announce(options, "writing");
  std::filesystem::remove(output / "manifest.json");  // written last: a folder without it is not complete
  write_image(output / "warped.nii.gz", warped);
  write_labels(output / "warped_labels.nii.gz", warp_labels(loads.labels, inverse.displacement));
  write_mask(output / "body_mask.nii.gz", tissue.body);
  write_mask(output / "warped_body.nii.gz", inverse.covered);
  write_image(output / "shear_modulus.nii.gz", tissue.shear_modulus);
  write_motions(output / "motions.json", loads.motions);
  write_vector_image(output / "moving_to_fixed.nrrd", forward.displacement);
  write_vector_image(output / "fixed_to_moving.nrrd", inverse.displacement);
  write_displacement_transform(output / "fixed_to_moving.h5", inverse.displacement);
  const Cloud& cloud = deformation.body().cloud;
  const PointData modulus = at_nodes("shear_modulus_kPa", cloud, tissue.shear_modulus), label = at_nodes("label", cloud, loads.labels);
  write_nodes(output.path(), cloud, {}, deformation.solution(), {modulus, label});
  if (!options.points.empty()) write_point_displacements(output / "points.csv", points, deformation, forward);
  write_png(output / "displacement.png", displacement_figure(pair.moving, forward.displacement, forward.covered));
  write_png(output / "shear_modulus.png", shear_modulus_figure(pair.moving, tissue.shear_modulus));
  write_png(output / "convergence.png", convergence_figure(deformation.solution().history, options.mechanics.solver.tolerance_mm));
  times.lap("writing");
  std::optional<ReportView> view;
  if (options.report) view = view_of(pair, tissue, *fields, ratio), times.lap("report");
  if (options.evaluate) {
    try {
      evaluate(options, pair, tissue, loads, landmarks, deformation, forward, inverse, warped, view ? &*view : nullptr, metrics);
    } catch (const Error& error) {
      note(metrics, std::string("the evaluation failed: ") + error.what());  // the registration is done all the same
    }
    times.lap("evaluation");
  }
  write_text(output / "metrics.json", metrics.dump(1) + "\n");
  manifest["stages"] = times.report();
  if (view) write_report(output / "report.html", report_facts(verb, pair, options, metrics, manifest), *view, node_cloud(cloud.nodes, deformation.solution().displacement, modulus.values, label.values));
  write_text(output / "manifest.json", manifest.dump(1) + "\n");
  print_summary(metrics, options.output);
}

}  // namespace

void add_register(CLI::App& program) {
  auto options = std::make_shared<RegisterOptions>();
  CLI::App* verb = program.add_subcommand("register", "Predict the deformation between two images and warp the moving one");
  verb->add_option("--moving,-m", options->moving, "moving image: NIfTI, NRRD, MetaImage or a folder with a DICOM series")->type_name("IMAGE");
  verb->add_option("--fixed,-f", options->fixed, "fixed image")->type_name("IMAGE");
  verb->add_option("--output,-o", options->output, "folder for the results")->type_name("DIR");
  verb->add_option("--export-case", options->export_case, "also write what is solved as a case for mtled solve into this folder, before solving it")->type_name("DIR");
  verb->add_option("--resample", options->resample, "resample both images to this voxel spacing first [mm], three numbers")->expected(3)->check(positive());
  add_motion_options(*verb, options->motion);
  add_tissue_options(*verb, options->tissue);
  add_mechanics_options(*verb, options->mechanics);
  verb->add_option("--points", options->points, "CSV with x,y,z [mm, LPS] on the moving image: points.csv gets their displacements")->type_name("FILE");
  const std::map<std::string, Interpolation> kinds{{"linear", Interpolation::linear}, {"cubic", Interpolation::cubic}};
  verb->add_option("--interpolation", options->interpolation, "of the warped image: linear or cubic (B-spline)")->transform(CLI::CheckedTransformer(kinds))->default_str("linear");
  verb->add_option("--outside", options->outside, "value of the warped image where the moving image does not reach")->capture_default_str();
  verb->add_flag("!--no-evaluation", options->evaluate, "skip the evaluation");
  verb->add_flag("!--no-report", options->report, "do not write report.html");
  add_evaluation_options(*verb, options->evaluation);
  add_common(*verb, *options, true);
  verb->footer("Example: mtled register -m supine.nii.gz -f prone.nii.gz --moving-labels spine.nii.gz -o result");
  verb->callback([verb, options] { run(*verb, *options); });
}

}  // namespace mtled
