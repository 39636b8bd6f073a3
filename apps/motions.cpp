#include <cstdio>

#include "io/output.hpp"
#include "io/tables.hpp"
#include "pipeline.hpp"

namespace mtled {
namespace {

struct MotionsOptions : CommonOptions {
  std::filesystem::path moving, fixed, output;
  MotionOptions motion;
};

void run(CLI::App& verb, const MotionsOptions& options) {
  apply_config(verb, options);
  for (const char* name : {"--moving", "--fixed", "--moving-labels", "--output"}) require_option(verb, name);
  const auto limit = start(options);
  const ImagePair pair = read_pair(options.moving, options.fixed, {});
  BoneLoads loads = read_loads(pair.moving, pair.fixed, options.motion);
  const OutputDirectory output(options.output, options.force);
  find_motions(pair.moving, pair.fixed, options.motion, options, loads);
  write_motions(output / "motions.json", loads.motions);
  const Json report{{"motions", loads.report}, {"warnings", loads.warnings}};
  write_text(output / "summary.json", report.dump(1) + "\n");
  std::printf("label  turn deg  centre moves mm  similarity before -> after\n");
  for (const auto& m : loads.report)
    std::printf("%5d  %8.2f  %15.2f  %s\n", m["label"].get<int>(), m["rotation_deg"].get<double>(), m["center_displacement_mm"].get<double>(),
                m.contains("similarity_after") ? (std::to_string(m["similarity_before"].get<double>()) + " -> " + std::to_string(m["similarity_after"].get<double>())).c_str() : "given");
}

}  // namespace

void add_motions(CLI::App& program) {
  auto options = std::make_shared<MotionsOptions>();
  CLI::App* verb = program.add_subcommand("motions", "Estimate the rigid motion of every label between two images");
  verb->add_option("--moving,-m", options->moving, "moving image")->type_name("IMAGE");
  verb->add_option("--fixed,-f", options->fixed, "fixed image")->type_name("IMAGE");
  verb->add_option("--output,-o", options->output, "folder for motions.json and summary.json")->type_name("DIR");
  add_motion_options(*verb, options->motion);
  add_common(*verb, *options, true);
  verb->callback([verb, options] { run(*verb, *options); });
}

}  // namespace mtled
