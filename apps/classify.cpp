#include <cstdio>

#include "image_io/image_io.hpp"
#include "io/output.hpp"
#include "pipeline.hpp"

namespace mtled {
namespace {

struct ClassifyOptions : CommonOptions {
  std::filesystem::path image, output;
  TissueOptions tissue;
};

void run(CLI::App& verb, const ClassifyOptions& options) {
  apply_config(verb, options);
  for (const char* name : {"--image", "--output"}) require_option(verb, name);
  const auto limit = start(options);
  const Image image = read_image(options.image, "image");
  const OutputDirectory output(options.output, options.force);
  const Tissue tissue = find_tissue(image, options.tissue, options);
  write_mask(output / "body_mask.nii.gz", tissue.body);
  write_image(output / "shear_modulus.nii.gz", tissue.shear_modulus);
  if (tissue.classes) write_labels(output / "classes.nii.gz", hard_classes(image, tissue.body, *tissue.classes));
  const Json report = describe(tissue);
  write_text(output / "summary.json", report.dump(1) + "\n");
  std::printf("body %.2f litres\n", report["body_litres"].get<double>());
  if (tissue.classes)
    for (const auto& c : report["classes"]) std::printf("class centre %8.1f  %-10s %6.2f kPa\n", c["center"].get<double>(), c["tissue"].get<std::string>().c_str(), c["shear_modulus_kpa"].get<double>());
}

}  // namespace

void add_classify(CLI::App& program) {
  auto options = std::make_shared<ClassifyOptions>();
  CLI::App* verb = program.add_subcommand("classify", "Body mask, fuzzy tissue classes and shear modulus of one image");
  verb->add_option("--image,-i", options->image, "the image")->type_name("IMAGE");
  verb->add_option("--output,-o", options->output, "folder for body_mask, classes, shear_modulus and summary.json")->type_name("DIR");
  add_tissue_options(*verb, options->tissue);
  add_common(*verb, *options, true);
  verb->callback([verb, options] { run(*verb, *options); });
}

}  // namespace mtled
