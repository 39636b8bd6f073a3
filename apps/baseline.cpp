#include <chrono>
#include <cmath>
#include <cstdio>

#include "core/error.hpp"
#include "image_io/checksum.hpp"
#include "image_io/image_io.hpp"
#include "imaging/baseline_registration.hpp"
#include "imaging/figures.hpp"
#include "imaging/morphology.hpp"
#include "imaging/same_grid.hpp"
#include "imaging/voxel_loop.hpp"
#include "io/output.hpp"
#include "pipeline.hpp"

namespace mtled {
namespace {

struct BaselineCommand : CommonOptions {
  std::string method;
  std::filesystem::path moving, fixed, fixed_mask, start, output;
  std::vector<double> resample;
  RigidStart initial = RigidStart::best;
  std::vector<int> mesh{10, 10, 10};
  BaselineOptions registration;
  Interpolation interpolation = Interpolation::linear;
  double outside = -1000;
};

constexpr double inverse_tolerance_mm = 0.01;
constexpr double body_margin_mm = 10;     ///< around the body: the skin's edge needs both sides
constexpr double fading_mm = 10;          ///< around rigid bodies and folds, where a refinement fades out

/// A displacement field from what it is at a point of its grid.
template <class F>
VectorImage field_on(const Grid& grid, const F& displacement) {
  VectorImage field(grid);
  for_each_voxel(grid, [&](int i, int j, int k, std::size_t voxel) {
    const Vec3d u = displacement(grid.point(i, j, k));
    field.data[voxel] = {float(u.x), float(u.y), float(u.z)};
  });
  return field;
}

Json describe(const std::vector<BaselineLevel>& levels) {
  Json j = Json::array();
  for (const BaselineLevel& l : levels)
    j.push_back({{"spacing_mm", l.spacing_mm}, {"mutual_information_before", l.before}, {"mutual_information_after", l.after}, {"overlap", l.overlap}, {"evaluations", l.evaluations}, {"seconds", l.seconds}});
  return j;
}

Json describe(const RigidMotion& m) {
  Json rotation = Json::array();
  for (int i = 0; i < 3; ++i) rotation.push_back({m.rotation[i][0], m.rotation[i][1], m.rotation[i][2]});
  return {{"convention", "LPS mm; fixed -> moving: x = R (y - center) + center + t"}, {"center", {m.center.x, m.center.y, m.center.z}}, {"R", rotation},
          {"t", {m.translation.x, m.translation.y, m.translation.z}}, {"turn_deg", norm(rotation_vector(m.rotation)) * 180 / M_PI}, {"shift_mm", norm(m.translation)}};
}

Json describe(const JacobianStatistics& s) {
  return {{"min", s.minimum}, {"percentile_1", s.percentile_1}, {"median", s.median}, {"percentile_99", s.percentile_99}, {"max", s.maximum}, {"folded_voxels", s.folded}, {"voxels", s.voxels}};
}

void print_levels(const char* name, const std::vector<BaselineLevel>& levels) {
  for (const BaselineLevel& l : levels)
    std::printf("%-8s %4.1f mm: mutual information %.4f -> %.4f, %d evaluations, %.1f s\n", name, l.spacing_mm, l.before, l.after, l.evaluations, l.seconds);
}

/// What a registration with mechanics left behind.
struct Mechanics {
  VectorImage field;   ///< fixed -> moving
  Image warped;
  Mask body, around_body;
  Image freedom;       ///< of a refinement: none in the rigid bodies
};
Mechanics read_result(const std::filesystem::path& result, const Image& fixed) {
  Mechanics m{read_vector_image(result / "fixed_to_moving.nrrd", "displacement field of the start"), read_image(result / "warped.nii.gz", "warped image of the start"), {}, {}, {}};
  require(same_grid(m.field.grid, fixed.grid) && same_grid(m.warped.grid, fixed.grid), "the result in '", result.string(),
          "' is on another grid than the fixed image; give the fixed image of that registration, and its --resample if it had one");
  m.body = mask_on(fixed.grid, result / "warped_body.nii.gz", "warped body of the start");
  m.around_body = dilate(m.body, body_margin_mm);
  m.freedom = freedom_outside(mask_on(fixed.grid, result / "warped_labels.nii.gz", "warped labels of the start"), fading_mm);
  return m;
}

void run(CLI::App& verb, const BaselineCommand& options) {
  apply_config(verb, options);
  for (const char* name : {"--moving", "--fixed", "--output"}) require_option(verb, name);
  const bool free_form = options.method == "bspline", after_mechanics = !options.start.empty();
  if (after_mechanics && !free_form) fail(Failure::usage, "--start refines the result of `mtled register` with B-splines; use it with `mtled baseline bspline`");
  const auto limit = start(options);
  Json seconds = Json::object();
  auto lap = [&seconds, last = std::chrono::steady_clock::now()](const char* stage) mutable {
    const auto now = std::chrono::steady_clock::now();
    seconds[stage] = std::chrono::duration<double>(now - last).count();
    last = now;
  };
  announce(options, "reading images");
  const ImagePair pair = read_pair(options.moving, options.fixed, options.resample);
  std::optional<Mask> mask;
  if (!options.fixed_mask.empty()) mask = mask_on(pair.fixed.grid, options.fixed_mask, "fixed mask");
  std::optional<Mechanics> mechanics;
  if (after_mechanics) mechanics = read_result(options.start, pair.fixed);
  const OutputDirectory output(options.output, options.force);
  lap("reading");

  Json summary;
  summary["program"] = "mtled " MTLED_VERSION;
  summary["method"] = options.method;
  for (const CLI::Option* option : verb.get_options())
    if (!option->get_lnames().empty() && option->count() > 0) summary["settings"][option->get_lnames()[0]] = option->results();
  for (const auto& [name, path] : {std::pair{"moving", options.moving}, std::pair{"fixed", options.fixed}, std::pair{"fixed-mask", options.fixed_mask}})
    if (!path.empty()) summary["inputs"][name] = {{"path", path.string()}, {"md5", md5_of(path)}};

  RigidBaseline rigid;
  if (!mechanics) {
    announce(options, "rigid registration");
    rigid = register_rigid_baseline(pair.moving, pair.fixed, mask ? &*mask : nullptr, options.initial, options.registration);
    summary["rigid"] = describe(rigid.fixed_to_moving);
    summary["rigid"]["start"] = name_of(rigid.start);
    summary["rigid"]["levels"] = describe(rigid.levels);
    print_levels("rigid", rigid.levels);
    lap("rigid");
  }
  FreeFormBaseline spline;
  if (free_form) {
    announce(options, "B-spline registration");
    const Mask* where = mask ? &*mask : mechanics ? &mechanics->around_body : nullptr;
    spline = register_free_form_baseline(mechanics ? mechanics->warped : pair.moving, pair.fixed, where, rigid.fixed_to_moving, {options.mesh[0], options.mesh[1], options.mesh[2]},
                                         mechanics ? &mechanics->freedom : nullptr, options.registration);
    const Vec3d& cell = spline.deformation.control.spacing;
    summary["bspline"] = {{"mesh", options.mesh}, {"control_spacing_mm", {cell.x, cell.y, cell.z}}, {"levels", describe(spline.levels)}};
    print_levels("bspline", spline.levels);
    lap("bspline");
  }

  announce(options, "warping");
  VectorImage fixed_to_moving;
  if (mechanics) {
    VectorImage b = field_on(pair.fixed.grid, [&](const Vec3d& y) { return spline.deformation.displacement(y); });
    for (std::size_t v = 0; v < b.data.size(); ++v) b.data[v] = mechanics->freedom.data[v] * b.data[v];
    int reductions;
    fixed_to_moving = compose_without_folds(mechanics->field, b, mechanics->body, fading_mm, reductions);
    summary["bspline"]["reductions"] = reductions;
    if (reductions > 0) announce(options, concatenate("the B-spline refinement folded; it was halved there ", reductions, " times"));
  } else {
    fixed_to_moving = field_on(pair.fixed.grid, [&](const Vec3d& y) { return rigid.fixed_to_moving.apply(free_form ? y + spline.deformation.displacement(y) : y) - y; });
  }
  const Mask counted = mechanics ? mechanics->body : Mask(pair.fixed.grid, 1);  // around a body that was deformed its field is made up
  const JacobianStatistics jacobian = jacobian_statistics(fixed_to_moving, counted);
  summary["jacobian"] = describe(jacobian);
  if (mechanics) summary["jacobian_of_start"] = describe(jacobian_statistics(mechanics->field, counted));
  if (jacobian.folded > 0) warn(concatenate("the deformation folds at ", jacobian.folded, " of ", jacobian.voxels, " voxels; results there are not to be trusted (fewer --mesh cells fold less)"));
  VectorImage moving_to_fixed;
  if (free_form) {
    InverseStatistics statistics;
    const DisplacementFunction there = [&](const Vec3d& y, Vec3d& v) { return linear_value(fixed_to_moving, y, v); };
    moving_to_fixed = inverse_field(pair.moving.grid, {fixed_to_moving, Mask(pair.fixed.grid, 1)}, there, inverse_tolerance_mm, statistics).displacement;
    summary["inverse"] = {{"largest_residual_mm", statistics.largest_residual_mm}, {"covered_voxels", statistics.covered}, {"unresolved_voxels", statistics.unresolved}};
  } else {
    const RigidMotion back = inverse(rigid.fixed_to_moving);
    moving_to_fixed = field_on(pair.moving.grid, [&](const Vec3d& x) { return back.displacement(x); });
  }
  const Image warped = warp_image(pair.moving, fixed_to_moving, options.interpolation, float(options.outside));
  lap("warp");

  announce(options, "writing");
  std::filesystem::remove(output / "summary.json");  // written last: a folder without it is not complete
  write_image(output / "warped.nii.gz", warped);
  write_vector_image(output / "fixed_to_moving.nrrd", fixed_to_moving);
  write_vector_image(output / "moving_to_fixed.nrrd", moving_to_fixed);
  write_displacement_transform(output / "fixed_to_moving.h5", fixed_to_moving);
  if (!mechanics) write_transform(output / "fixed_to_moving.tfm", rigid.fixed_to_moving, free_form ? &spline.deformation : nullptr);
  const Image before = warp_image_rigidly(pair.moving, pair.fixed.grid, RigidMotion(), Interpolation::linear, float(options.outside));
  write_png(output / "overlay.png", overlay_figure(pair.fixed, {{"before", &before}, {mechanics ? "mtled, then B-spline" : free_form ? "B-spline" : "rigid", &warped}}));
  lap("writing");
  summary["seconds"] = seconds;
  write_text(output / "summary.json", summary.dump(1) + "\n");
  std::printf("results in %s: warped.nii.gz, fixed_to_moving%s (for 3D Slicer and ITK), summary.json, ...\n", options.output.string().c_str(), mechanics ? ".h5" : ".tfm");
}

}  // namespace

void add_baseline(CLI::App& program) {
  auto options = std::make_shared<BaselineCommand>();
  CLI::App* verb = program.add_subcommand("baseline", "Register by intensities alone, without mechanics, for comparison: rigidly or with B-splines");
  verb->add_option("method", options->method, "rigid, or bspline (rigid, then B-spline)")->required()->check(CLI::IsMember({"rigid", "bspline"}));
  verb->add_option("--moving,-m", options->moving, "moving image: NIfTI, NRRD, MetaImage or a folder with a DICOM series")->type_name("IMAGE");
  verb->add_option("--fixed,-f", options->fixed, "fixed image")->type_name("IMAGE");
  verb->add_option("--output,-o", options->output, "folder for the results")->type_name("DIR");
  verb->add_option("--resample", options->resample, "resample both images to this voxel spacing first [mm], three numbers")->expected(3)->check(positive());
  verb->add_option("--fixed-mask", options->fixed_mask, "compare intensities only here")->type_name("IMAGE");
  verb->add_option("--start", options->start, "bspline: output folder of `mtled register` to refine, instead of a rigid registration; rigid labels stay rigid")->type_name("DIR");
  const std::map<std::string, RigidStart> starts{{"best", RigidStart::best}, {"moments", RigidStart::moments}, {"geometry", RigidStart::geometry}, {"identity", RigidStart::identity}};
  verb->add_option("--initial", options->initial, "start of the rigid registration: centres of intensity (moments) or of the images (geometry) on each other, as the headers say (identity), or the best of these")
      ->transform(CLI::CheckedTransformer(starts))->default_str("best");
  verb->add_option("--mesh", options->mesh, "cells of the B-spline grid along the axes of the fixed image, three numbers")->expected(3)->check(CLI::Range(1, 100))->capture_default_str();
  verb->add_option("--bins", options->registration.bins, "of the histogram, per image")->check(CLI::Range(6, 256))->capture_default_str();
  verb->add_option("--samples", options->registration.samples, "places at which intensities are compared on each resolution")->check(CLI::Range(1000, 100000000))->capture_default_str();
  verb->add_option("--seed", options->registration.seed, "of the draw of these places")->capture_default_str();
  verb->add_option("--levels", options->registration.levels, "resolutions")->check(CLI::Range(1, 6))->capture_default_str();
  verb->add_option("--finest-spacing", options->registration.finest_spacing_mm, "voxel spacing of the finest resolution [mm]; doubled for each before it")->check(positive())->capture_default_str();
  verb->add_option("--evaluations", options->registration.evaluations, "of the mutual information on each resolution, at most")->check(CLI::Range(1, 100000))->capture_default_str();
  const std::map<std::string, Interpolation> kinds{{"linear", Interpolation::linear}, {"cubic", Interpolation::cubic}};
  verb->add_option("--interpolation", options->interpolation, "of the warped image: linear or cubic (B-spline)")->transform(CLI::CheckedTransformer(kinds))->default_str("linear");
  verb->add_option("--outside", options->outside, "value of the warped image where the moving image does not reach")->capture_default_str();
  add_common(*verb, *options, true);
  verb->footer("Example: mtled baseline bspline -m supine.nii.gz -f prone.nii.gz -o bspline");
  verb->callback([verb, options] { run(*verb, *options); });
}

}  // namespace mtled
