#include <cstdio>

#include "core/error.hpp"
#include "evaluation_report.hpp"
#include "image_io/image_io.hpp"
#include "io/output.hpp"
#include "io/tables.hpp"
#include "pipeline.hpp"

namespace mtled {
namespace {

struct EvaluateOptions : CommonOptions {
  std::filesystem::path fixed, warped, mask, fixed_labels, warped_labels, points, output;
  EvaluationOptions evaluation;
};

void run(CLI::App& verb, const EvaluateOptions& options) {
  apply_config(verb, options);
  for (const char* name : {"--fixed", "--warped", "--output"}) require_option(verb, name);
  const auto limit = start(options);
  const Image fixed = read_image(options.fixed, "fixed image"), warped = read_image(options.warped, "warped image");
  require(fixed.grid.size == warped.grid.size, "the warped image is on another grid than the fixed image; evaluate what `mtled register` or `mtled warp` wrote");
  prepare_output_directory(options.output, options.force);
  const Mask where = options.mask.empty() ? Mask(fixed.grid, 1) : read_mask(options.mask, "mask");
  nlohmann::json report;
  report["edges"] = compare_edges_of(fixed, {{"warped", &warped}}, options.evaluation.canny, where);
  print_edges(report["edges"]);
  if (!options.fixed_labels.empty() || !options.warped_labels.empty()) {
    require_option(verb, "--fixed-labels"), require_option(verb, "--warped-labels");
    report["labels"] = describe(label_overlap(read_labels(options.warped_labels, "warped labels"), read_labels(options.fixed_labels, "fixed labels")));
    for (const auto& l : report["labels"]) std::printf("label %4d  Dice %.3f\n", l["label"].get<int>(), l["dice"].get<double>());
  }
  if (!options.evaluation.landmarks.empty()) {
    report["landmarks"] = describe(point_errors(read_points(options.evaluation.landmarks, {"mx", "my", "mz"}), read_points(options.evaluation.landmarks, {"fx", "fy", "fz"})));
    std::printf("landmarks: mean %.2f mm\n", report["landmarks"]["mean_mm"].get<double>());
  }
  write_text(options.output / "evaluation.json", report.dump(1) + "\n");
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
  verb->add_option("--output,-o", options->output, "folder for evaluation.json")->type_name("DIR");
  add_evaluation_options(*verb, options->evaluation);
  add_common(*verb, *options, true);
  verb->callback([verb, options] { run(*verb, *options); });
}

}  // namespace mtled
