#include <cstdio>

#include "core/error.hpp"
#include "cuda/field.hpp"
#include "image_io/image_io.hpp"
#include "io/tables.hpp"
#include "pipeline.hpp"

namespace mtled {
namespace {

struct WarpOptions : CommonOptions {
  std::filesystem::path result, image, labels, points, output;
  std::string direction = "moving-to-fixed";
  Interpolation interpolation = Interpolation::linear;
  double outside = -1000;
};

/// True when any voxel of the field takes its value from `grid`.
bool reaches(const VectorImage& field, const Grid& grid) {
  const Mask there(grid, 1);
  const auto& n = field.grid.size;
  for (int k = 0; k < n[2]; ++k)
    for (int j = 0; j < n[1]; ++j)
      for (int i = 0; i < n[0]; ++i) {
        const Vec3f& v = field.data[field.grid.offset(i, j, k)];
        if (nearest_value<std::uint8_t>(there, field.grid.point(i, j, k) + Vec3d{v.x, v.y, v.z}, 0)) return true;
      }
  return false;
}

/// Images need the field that leads back from their new grid; points the one that leads on.
void run(CLI::App& verb, const WarpOptions& options) {
  apply_config(verb, options);
  for (const char* name : {"--result", "--output"}) require_option(verb, name);
  const auto limit = start(options);
  const int inputs = int(!options.image.empty()) + int(!options.labels.empty()) + int(!options.points.empty());
  if (inputs != 1) fail(Failure::usage, "give exactly one of --image, --labels and --points");
  if (std::filesystem::exists(options.output) && !options.force) fail(Failure::output, "'", options.output.string(), "' exists; give --force to replace it");
  const bool onwards = options.direction == "moving-to-fixed";
  const auto field = [&](bool forward) { return read_vector_image(options.result / (forward ? "moving_to_fixed.nrrd" : "fixed_to_moving.nrrd"), "displacement field"); };
  if (!options.points.empty()) {
    const VectorImage u = field(onwards);
    std::vector<Vec3d> points = read_points(options.points);
    std::size_t outside = 0;
    for (Vec3d& x : points) {
      Vec3d d;
      if (linear_value(u, x, d)) x += d;
      else ++outside;
    }
    require(outside == 0, outside, " of ", points.size(), " points lie outside the ", onwards ? "moving" : "fixed", " image; remove them");
    require(!points.empty(), "'", options.points.string(), "' holds no points; give at least one row");
    write_points(options.output, points);
  } else {
    const VectorImage v = field(!onwards);
    const auto require_reached = [&](const Grid& grid, const std::filesystem::path& file) {
      require(reaches(v, grid), "'", file.string(), "' and the ", onwards ? "moving" : "fixed", " image of this result do not overlap in space; check --direction and the file");
    };
    if (!options.image.empty()) {
      const Image image = read_image(options.image, "image");
      require_reached(image.grid, options.image);
      // One image is warped on the CPU sooner than a GPU starts: only when it is asked for.
      const DeviceRequest request = parse_device(options.device);
      const SampleDisplaced sampler = request.kind == DeviceRequest::cuda ? cuda_sampler(choose_device(request, cuda_status()).ordinal) : SampleDisplaced();
      write_image(options.output, warp_image(image, v, options.interpolation, float(options.outside), sampler));
    } else {
      const LabelImage labels = read_labels(options.labels, "labels");
      require_reached(labels.grid, options.labels);
      write_labels(options.output, warp_labels(labels, v));
    }
  }
  std::printf("wrote %s\n", options.output.string().c_str());
}

}  // namespace

void add_warp(CLI::App& program) {
  auto options = std::make_shared<WarpOptions>();
  CLI::App* verb = program.add_subcommand("warp", "Warp an image, labels or points with the result of `register`");
  verb->add_option("--result,-r", options->result, "output folder of `mtled register`")->type_name("DIR");
  verb->add_option("--image,-i", options->image, "image to warp")->type_name("IMAGE");
  verb->add_option("--labels", options->labels, "label map to warp (nearest neighbour)")->type_name("IMAGE");
  verb->add_option("--points", options->points, "CSV with x,y,z [mm, LPS]")->type_name("FILE");
  verb->add_option("--output,-o", options->output, "file to write")->type_name("FILE");
  verb->add_option("--direction", options->direction, "moving-to-fixed or fixed-to-moving")->check(CLI::IsMember({"moving-to-fixed", "fixed-to-moving"}))->capture_default_str();
  const std::map<std::string, Interpolation> kinds{{"linear", Interpolation::linear}, {"cubic", Interpolation::cubic}};
  verb->add_option("--interpolation", options->interpolation, "linear or cubic (B-spline)")->transform(CLI::CheckedTransformer(kinds))->default_str("linear");
  verb->add_option("--outside", options->outside, "value where the image does not reach")->capture_default_str();
  add_common(*verb, *options, true);
  verb->callback([verb, options] { run(*verb, *options); });
}

}  // namespace mtled
