#include <cstdio>

#include "core/error.hpp"
#include "evaluate.hpp"
#include "image_io/image_io.hpp"
#include "io/tables.hpp"

namespace mtled {
namespace {

constexpr const char* on_slices = "difference on the slices";

/// `u` of those points whose places after it lie in `mask`; of all without a mask.
DisplacementFunction leading_into(const std::optional<Mask>& mask, DisplacementFunction u) {
  if (!mask) return u;
  return [u = std::move(u), &mask](const Vec3d& x, Vec3d& value) { return u(x, value) && nearest_value<std::uint8_t>(*mask, x + value, 0) != 0; };
}

ReferenceComparison compare_in_fixed(const EvaluateOptions& options, const Image& fixed, const Maps& maps, const std::optional<Mask>& mask) {
  const DisplacementFunction read = read_transform(options.reference_transform, "reference transform");
  const DisplacementFunction reference = [&](const Vec3d& y, Vec3d& v) { return read(y, v) && (!mask || nearest_value<std::uint8_t>(*mask, y, 0) != 0); };
  ReferenceComparison result{options.reference_transform, "voxels of the fixed image", compare_displacements(maps.there, reference, fixed.grid), {}};
  result.picture = field_difference_figure(fixed, [&](const Grid& slice) { return difference_on_slice(maps.there, reference, slice); }, result.difference, on_slices);
  return result;
}

ReferenceComparison compare_in_moving(const EvaluateOptions& options, const Image& moving, const Maps& maps, const std::optional<Mask>& mask) {
  const DisplacementFunction reference = leading_into(mask, read_transform(options.reference_inverse_transform, "reference transform"));
  ReferenceComparison result{options.reference_inverse_transform, "voxels of the moving image", compare_displacements(maps.back, reference, moving.grid), {}};
  result.picture = field_difference_figure(moving, [&](const Grid& slice) { return difference_on_slice(maps.back, reference, slice); }, result.difference, on_slices);
  return result;
}

ReferenceComparison compare_at_points(const EvaluateOptions& options, const Image& moving, const Maps& maps, const std::optional<Mask>& mask) {
  std::vector<Vec3d> points = read_points(options.reference_points), reference = read_points(options.reference_points, {"ux", "uy", "uz"});
  std::size_t kept = 0;
  for (std::size_t p = 0; p < points.size(); ++p)
    if (!mask || nearest_value<std::uint8_t>(*mask, points[p] + reference[p], 0) != 0) points[kept] = points[p], reference[kept] = reference[p], ++kept;
  points.resize(kept), reference.resize(kept);
  ReferenceComparison result{options.reference_points, "points of the moving image", compare_displacements(maps.back, points, reference), {}};
  result.picture = field_difference_figure(moving, [&](const Grid& slice) { return differences_along_sight(maps.back, points, reference, slice); }, result.difference, "largest difference along the line of sight");
  return result;
}

}  // namespace

void check_reference(const CLI::App& verb, const EvaluateOptions& options) {
  const int given = int(!options.reference_transform.empty()) + int(!options.reference_inverse_transform.empty()) + int(!options.reference_points.empty());
  if (given > 1) fail(Failure::usage, "--reference-transform, --reference-inverse-transform and --reference-points exclude each other, and ", given, " of them are given; keep one, and look into the --config file, too");
  const bool in_fixed = !options.reference_transform.empty(), in_moving = !options.reference_inverse_transform.empty() || !options.reference_points.empty();
  if (in_fixed && options.result.empty()) require_option(verb, "--transform");
  if (in_moving) require_option(verb, "--moving");
  if (in_moving && options.result.empty()) require_option(verb, "--inverse-transform");
}

std::optional<ReferenceComparison> compare_with_reference(const EvaluateOptions& options, const Image& fixed, const std::optional<Image>& moving, const Maps& maps, const std::optional<Mask>& mask) {
  if (!options.reference_transform.empty()) return with_context("reference transform '" + options.reference_transform.string() + "'", [&] { return compare_in_fixed(options, fixed, maps, mask); });
  if (!options.reference_inverse_transform.empty()) return with_context("reference transform '" + options.reference_inverse_transform.string() + "'", [&] { return compare_in_moving(options, *moving, maps, mask); });
  if (!options.reference_points.empty()) return with_context("reference points '" + options.reference_points.string() + "'", [&] { return compare_at_points(options, *moving, maps, mask); });
  return std::nullopt;
}

void report_reference(const ReferenceComparison& comparison, Json& report) {
  const FieldDifference& d = comparison.difference;
  Json& j = report["field_difference"];
  j = {{"reference", comparison.file.string()}, {"where", comparison.where}, {"points", d.difference_mm.size()}, {"unknown_points", d.unknown}, {"mean_mm", d.mean}, {"root_mean_square_mm", d.root_mean_square},
       {"median_mm", d.median}, {"percentile_95_mm", d.percentile_95}, {"percentile_99_5_mm", d.percentile_99_5}, {"max_mm", d.maximum}, {"within_half_mm", d.within_half_mm}, {"difference_1_to_100_mm", d.curve_mm}};
  for (const DifferenceGroup& g : d.groups) j["by_displacement"].push_back({{"from_mm", g.from_mm}, {"to_mm", g.to_mm}, {"points", g.points}, {"median_mm", g.median_mm}, {"percentile_95_mm", g.percentile_95_mm}});
  if (d.unknown > 0) note(report, concatenate("the transform is not known at ", d.unknown, " of ", d.unknown + d.difference_mm.size(), " ", comparison.where, " that the reference knows; they are left out of the difference"));
}

void print_reference(const Json& j) {
  std::printf("difference from the reference: median %.3f, 95 %% %.3f, 99.5 %% %.3f, max %.3f mm; %.2f %% within 0.5 mm (%zu %s)\n", j["median_mm"].get<double>(), j["percentile_95_mm"].get<double>(), j["percentile_99_5_mm"].get<double>(),
              j["max_mm"].get<double>(), 100 * j["within_half_mm"].get<double>(), j["points"].get<std::size_t>(), j["where"].get<std::string>().c_str());
}

std::string reference_table(const FieldDifference& difference) {
  std::string table = "percent,difference_mm\n";
  for (std::size_t percent = 1; percent <= 100; ++percent) table += concatenate(percent, ",", difference.curve_mm[percent - 1], "\n");
  return table;
}

}  // namespace mtled
