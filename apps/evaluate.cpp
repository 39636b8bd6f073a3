#include <algorithm>
#include <cmath>
#include <cstdio>

#include "core/error.hpp"
#include "evaluation_report.hpp"
#include "image_io/image_io.hpp"
#include "imaging/same_grid.hpp"
#include "io/output.hpp"
#include "io/tables.hpp"
#include "pipeline.hpp"

namespace mtled {
namespace {

struct EvaluateOptions : CommonOptions {
  std::filesystem::path fixed, warped, mask, fixed_labels, warped_labels, result, output;
  EvaluationOptions evaluation;
};

/// The landmarks' moving points, where the result of a registration puts them if there is one.
PointErrors landmark_errors(const EvaluateOptions& options) {
  std::vector<Vec3d> points = read_points(options.evaluation.landmarks, {"mx", "my", "mz"});
  if (!options.result.empty()) {
    const VectorImage field = read_vector_image(options.result / "moving_to_fixed.nrrd", "displacement field");
    points = warp_points(points, [](const Vec3d&, Vec3d&) { return false; }, field);
    const auto outside = std::count_if(points.begin(), points.end(), [](const Vec3d& x) { return std::isnan(x.x); });
    require(outside == 0, outside, " of ", points.size(), " landmarks in '", options.evaluation.landmarks.string(), "' lie outside the moving image; remove them");
  }
  return with_context(options.evaluation.landmarks.string(), [&] { return point_errors(points, read_points(options.evaluation.landmarks, {"fx", "fy", "fz"})); });
}

void run(CLI::App& verb, const EvaluateOptions& options) {
  apply_config(verb, options);
  for (const char* name : {"--fixed", "--warped", "--output"}) require_option(verb, name);
  if (options.fixed_labels.empty() != options.warped_labels.empty()) require_option(verb, "--fixed-labels"), require_option(verb, "--warped-labels");
  const auto limit = start(options);
  const Image fixed = read_image(options.fixed, "fixed image"), warped = read_image(options.warped, "warped image");
  require(same_grid(fixed.grid, warped.grid), "warped image '", options.warped.string(), "' is on another grid than the fixed image; evaluate what `mtled register` or `mtled warp` wrote");
  const Mask where = options.mask.empty() ? Mask(fixed.grid, 1) : mask_on(fixed.grid, options.mask, "mask");
  const OutputDirectory output(options.output, options.force);
  Json report;
  report["edges"] = compare_edges_of(fixed, {{"warped", &warped}}, options.evaluation.canny, where);
  if (!options.fixed_labels.empty())
    report["labels"] = describe(label_overlap(labels_on(fixed.grid, options.warped_labels, "warped labels"), labels_on(fixed.grid, options.fixed_labels, "fixed labels")));
  if (!options.evaluation.landmarks.empty()) report["landmarks"] = describe(landmark_errors(options));
  write_text(output / "evaluation.json", report.dump(1) + "\n");
  print_edges(report["edges"]);
  if (report.contains("labels"))
    for (const auto& l : report["labels"]) std::printf("label %4d  Dice %.3f\n", l["label"].get<int>(), l["dice"].get<double>());
  if (report.contains("landmarks")) std::printf("landmarks: mean %.2f mm\n", report["landmarks"]["mean_mm"].get<double>());
}

}  // namespace

void add_evaluate(CLI::App& program) {
  auto options = std::make_shared<EvaluateOptions>();
  CLI::App* verb = program.add_subcommand("evaluate", "Compare a warped image with the fixed one: edges, labels, landmarks");
  verb->add_option("--fixed,-f", options->fixed, "fixed image")->type_name("IMAGE");
  verb->add_option("--warped,-w", options->warped, "moving image warped onto the fixed grid, by any program")->type_name("IMAGE");
  verb->add_option("--mask", options->mask, "compare edges only here")->type_name("IMAGE");
  verb->add_option("--fixed-labels", options->fixed_labels, "label map in the fixed image")->type_name("IMAGE");
  verb->add_option("--warped-labels", options->warped_labels, "warped label map")->type_name("IMAGE");
  verb->add_option("--result,-r", options->result, "output folder of `mtled register`: carries the landmarks of the moving image along (without it they are compared as they are)")->type_name("DIR");
  verb->add_option("--output,-o", options->output, "folder for evaluation.json")->type_name("DIR");
  add_evaluation_options(*verb, options->evaluation);
  add_common(*verb, *options, true);
  verb->callback([verb, options] { run(*verb, *options); });
}

}  // namespace mtled
