#include <chrono>
#include <cstdio>

#include "core/error.hpp"
#include "evaluation_report.hpp"
#include "image_io/image_io.hpp"
#include "imaging/figures.hpp"
#include "imaging/morphology.hpp"
#include "io/output.hpp"
#include "io/solution_output.hpp"
#include "io/tables.hpp"
#include "pipeline.hpp"

namespace mtled {
namespace {

struct RegisterOptions : CommonOptions {
  std::filesystem::path moving, fixed, output;
  std::vector<double> resample;
  TissueOptions tissue;
  MotionOptions motion;
  MechanicsOptions mechanics;
  EvaluationOptions evaluation;
  Interpolation interpolation = Interpolation::linear;
  double outside = -1000;
  bool evaluate = true;
};

constexpr double inverse_tolerance_mm = 0.01;
constexpr double evaluation_margin_mm = 10;  ///< around the body: the skin's edges and where a bad candidate puts them

/// Books wall time per stage.
class StageTimes {
 public:
  void lap(const std::string& stage) {
    const auto now = std::chrono::steady_clock::now();
    seconds_[stage] = std::chrono::duration<double>(now - last_).count();
    last_ = now;
  }
  const nlohmann::json& seconds() const { return seconds_; }

 private:
  nlohmann::json seconds_ = nlohmann::json::object();
  std::chrono::steady_clock::time_point last_ = std::chrono::steady_clock::now();
};

nlohmann::json describe(const JacobianStatistics& s) {
  return {{"min", s.minimum}, {"percentile_1", s.percentile_1}, {"median", s.median}, {"percentile_99", s.percentile_99}, {"max", s.maximum}, {"folded_voxels", s.folded}, {"voxels", s.voxels}};
}

/// Where edges are compared: around what the deformed moving body covers of the fixed image.
Mask evaluation_region(const Mask& covered) { return dilate(covered, evaluation_margin_mm); }

nlohmann::json evaluate(const RegisterOptions& options, const ImagePair& pair, const Tissue& tissue, const BoneLoads& loads, const Deformation& deformation,
                        const DenseField& forward, const DenseField& inverse, const Image& warped) {
  announce(options, "evaluating");
  nlohmann::json report;
  Mask fixed_region = evaluation_region(inverse.covered);
  const RigidMotion rigid = register_rigidly(pair.moving, pair.fixed, &tissue.body, nullptr);
  const RigidMotion identity;
  const Image before = warp_image_rigidly(pair.moving, pair.fixed.grid, identity, Interpolation::linear, float(options.outside));
  const Image rigidly = warp_image_rigidly(pair.moving, pair.fixed.grid, rigid, Interpolation::linear, float(options.outside));
  report["edges"] = compare_edges_of(pair.fixed, {{"before", &before}, {"rigid", &rigidly}, {"mtled", &warped}}, options.evaluation.canny, fixed_region);
  write_png(options.output / "overlay.png", overlay_figure(pair.fixed, {{"before", &before}, {"rigid registration", &rigidly}, {"mtled", &warped}}));
  if (!options.evaluation.landmarks.empty()) {
    const auto from = read_points(options.evaluation.landmarks, {"mx", "my", "mz"}), to = read_points(options.evaluation.landmarks, {"fx", "fy", "fz"});
    std::vector<Vec3d> rigid_points;
    for (const Vec3d& x : from) rigid_points.push_back(rigid.apply(x));
    report["landmarks"]["before"] = describe(point_errors(from, to));
    report["landmarks"]["rigid"] = describe(point_errors(rigid_points, to));
    std::vector<Vec3d> inside, target;
    const std::vector<Vec3d> warped_points = warp_points(from, deformation.function(), forward.displacement);
    for (std::size_t p = 0; p < from.size(); ++p)
      if (std::isfinite(warped_points[p].x)) inside.push_back(warped_points[p]), target.push_back(to[p]);
    if (inside.size() < from.size()) warn(concatenate(from.size() - inside.size(), " landmarks lie outside the moving image and are left out"));
    report["landmarks"]["mtled"] = describe(point_errors(inside, target));
  }
  if (loads.fixed_labels) {
    report["labels"]["before"] = describe(label_overlap(resample_labels(loads.labels, pair.fixed.grid), *loads.fixed_labels));
    report["labels"]["mtled"] = describe(label_overlap(warp_labels(loads.labels, inverse.displacement), *loads.fixed_labels));
  }
  return report;
}

void print_summary(const nlohmann::json& summary, const std::filesystem::path& output) {
  const auto& solver = summary["solver"];
  std::printf("converged after %d steps, estimated error %.3g mm; %zu nodes\n", solver["steps"].get<int>(), solver["error_estimate_mm"].get<double>(), solver["nodes"].get<std::size_t>());
  std::printf("smallest volume ratio %.3f, %zu folded voxels\n", summary["jacobian"]["min"].get<double>(), summary["jacobian"]["folded_voxels"].get<std::size_t>());
  if (summary.contains("evaluation")) {
    print_edges(summary["evaluation"]["edges"]);
    if (summary["evaluation"].contains("landmarks"))
      for (const auto& [name, e] : summary["evaluation"]["landmarks"].items())
        std::printf("landmarks %-8s mean %.2f, median %.2f, 95 %% %.2f, max %.2f mm (%d points)\n", name.c_str(), e["mean_mm"].get<double>(), e["median_mm"].get<double>(),
                    e["percentile_95_mm"].get<double>(), e["max_mm"].get<double>(), e["points"].get<int>());
  }
  std::printf("results in %s: warped.nii.gz, fixed_to_moving.h5 (for 3D Slicer and ITK), overlay.png, displacement.png, summary.json, ...\n", output.string().c_str());
}

void run(CLI::App& verb, RegisterOptions& options) {
  apply_config(verb, options);
  for (const char* name : {"--moving", "--fixed", "--moving-labels", "--output"}) require_option(verb, name);
  const auto limit = start(options);
  StageTimes times;
  announce(options, "reading images");
  const ImagePair pair = read_pair(options.moving, options.fixed, options.resample);
  prepare_output_directory(options.output, options.force);
  times.lap("reading");
  const Tissue tissue = find_tissue(pair.moving, options.tissue, options);
  times.lap("tissue");
  const BoneLoads loads = find_motions(pair.moving, pair.fixed, options.motion, options);
  times.lap("motions");
  const Deformation deformation(tissue, loads, options.mechanics, options);
  times.lap("mechanics");

  announce(options, "warping");
  const DenseField forward = forward_field(pair.moving.grid, deformation.function());
  times.lap("forward field");
  InverseStatistics inverse_statistics;
  const DenseField inverse = inverse_field(pair.fixed.grid, forward, deformation.function(), inverse_tolerance_mm, inverse_statistics);
  times.lap("inverse field");
  const Image warped = warp_image(pair.moving, inverse.displacement, options.interpolation, float(options.outside));
  times.lap("warp");

  nlohmann::json summary;
  summary["program"] = "mtled " MTLED_VERSION;
  for (const CLI::Option* option : verb.get_options())
    if (!option->get_lnames().empty() && option->count() > 0) summary["settings"][option->get_lnames()[0]] = option->results();
  summary["tissue"] = describe(tissue);
  summary["motions"] = loads.report;
  summary["warnings"] = loads.warnings;
  summary["solver"] = summary_of(deformation.solution());
  summary["solver"].erase("reactions_mN");
  summary["jacobian"] = describe(jacobian_statistics(forward.displacement, forward.covered));
  summary["inverse"] = {{"largest_residual_mm", inverse_statistics.largest_residual_mm}, {"covered_voxels", inverse_statistics.covered}, {"unresolved_voxels", inverse_statistics.unresolved}};
  if (summary["jacobian"]["folded_voxels"].get<std::size_t>() > 0) warn("the deformation folds at some voxels (see summary.json); results there are not to be trusted");

  announce(options, "writing");
  write_image(options.output / "warped.nii.gz", warped);
  write_labels(options.output / "warped_labels.nii.gz", warp_labels(loads.labels, inverse.displacement));
  write_mask(options.output / "body_mask.nii.gz", tissue.body);
  write_mask(options.output / "warped_body.nii.gz", inverse.covered);
  write_image(options.output / "shear_modulus.nii.gz", tissue.shear_modulus);
  write_motions(options.output / "motions.json", loads.motions);
  write_vector_image(options.output / "moving_to_fixed.nrrd", forward.displacement);
  write_vector_image(options.output / "fixed_to_moving.nrrd", inverse.displacement);
  write_displacement_transform(options.output / "fixed_to_moving.h5", inverse.displacement);
  write_nodes(options.output, deformation.body().cloud, deformation.solution());
  write_png(options.output / "displacement.png", displacement_figure(pair.moving, forward.displacement, forward.covered));
  times.lap("writing");
  if (options.evaluate) {
    summary["evaluation"] = evaluate(options, pair, tissue, loads, deformation, forward, inverse, warped);
    times.lap("evaluation");
  }
  summary["stage_seconds"] = times.seconds();
  write_text(options.output / "summary.json", summary.dump(1) + "\n");
  print_summary(summary, options.output);
}

}  // namespace

void add_register(CLI::App& program) {
  auto options = std::make_shared<RegisterOptions>();
  CLI::App* verb = program.add_subcommand("register", "Predict the deformation between two images and warp the moving one");
  verb->add_option("--moving,-m", options->moving, "moving image: NIfTI, NRRD, MetaImage or a folder with a DICOM series")->type_name("IMAGE");
  verb->add_option("--fixed,-f", options->fixed, "fixed image")->type_name("IMAGE");
  verb->add_option("--output,-o", options->output, "folder for the results")->type_name("DIR");
  verb->add_option("--resample", options->resample, "resample both images to this voxel spacing first [mm], three numbers")->expected(3)->check(CLI::PositiveNumber);
  add_motion_options(*verb, options->motion);
  add_tissue_options(*verb, options->tissue);
  add_mechanics_options(*verb, options->mechanics);
  const std::map<std::string, Interpolation> kinds{{"linear", Interpolation::linear}, {"cubic", Interpolation::cubic}};
  verb->add_option("--interpolation", options->interpolation, "of the warped image: linear or cubic (B-spline)")->transform(CLI::CheckedTransformer(kinds))->default_str("linear");
  verb->add_option("--outside", options->outside, "value of the warped image where the moving image does not reach")->capture_default_str();
  verb->add_flag("!--no-evaluation", options->evaluate, "skip the evaluation");
  add_evaluation_options(*verb, options->evaluation);
  add_common(*verb, *options, true);
  verb->footer("Example: mtled register -m supine.nii.gz -f prone.nii.gz --moving-labels spine.nii.gz -o result");
  verb->callback([verb, options] { run(*verb, *options); });
}

}  // namespace mtled
