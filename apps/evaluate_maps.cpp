#include <algorithm>

#include "core/error.hpp"
#include "evaluate.hpp"
#include "image_io/image_io.hpp"

namespace mtled {
namespace {

constexpr double much_better = 0.5;      ///< the inverse is suspected when it leaves less than this part of the misfit
constexpr double enough_overlap = 0.05;  ///< of the voxels, for a comparison of the two directions

}  // namespace

void note(Json& report, const std::string& text) {
  warn(text);
  report["warnings"].push_back(text);
}

std::size_t count(const Mask& mask) { return std::size_t(std::count_if(mask.data.begin(), mask.data.end(), [](auto v) { return v != 0; })); }

Mask intersection(Mask a, const Mask& b) {
  for (std::size_t v = 0; v < a.data.size(); ++v) a.data[v] = a.data[v] && b.data[v];
  return a;
}

Maps read_maps(EvaluateOptions& options, const Grid& fixed, const std::optional<Image>& moving) {
  if (!options.result.empty()) {
    if (options.transform.empty()) options.transform = options.result / "fixed_to_moving.nrrd";
    if (options.inverse_transform.empty()) options.inverse_transform = options.result / "moving_to_fixed.nrrd";
  }
  Maps maps;
  if (!options.transform.empty()) maps.there = read_transform(options.transform, "transform");
  if (!options.inverse_transform.empty()) maps.back = read_transform(options.inverse_transform, "inverse transform");
  if (maps.there) {
    maps.field = sample_displacement(maps.there, fixed);
  } else if (maps.back) {
    maps.computed_inverse = true;
    maps.field = with_context("inverse transform '" + options.inverse_transform.string() + "'", [&] { return inverted(maps.back, moving ? moving->grid : fixed, fixed); });
    maps.there = [field = std::make_shared<VectorImage>(maps.field->displacement)](const Vec3d& y, Vec3d& v) { return linear_value(*field, y, v); };
  }
  return maps;
}

void check_direction(const EvaluateOptions& options, const Image& fixed, const std::optional<Image>& moving, const Mask& mask, const Maps& maps, const Landmarks& landmarks, Json& report) {
  if (options.transform.empty()) return;
  Json& j = report["direction"];
  bool reversed = false;
  std::vector<Vec3d> f, m, from_fixed, from_moving;
  for (std::size_t p = 0; p < landmarks.rows.size(); ++p) {
    Vec3d u;
    if (!maps.there(landmarks.moving[p], u)) continue;
    f.push_back(landmarks.fixed[p]), m.push_back(landmarks.moving[p]), from_fixed.push_back(landmarks.mapped[p]), from_moving.push_back(m.back() + u);
  }
  if (!f.empty()) {
    const double given = point_errors(from_fixed, m).mean, other = point_errors(from_moving, f).mean;
    j["landmarks_as_given_mm"] = given, j["landmarks_reversed_mm"] = other;
    const Vec3d& s = fixed.grid.spacing;
    reversed = given > std::max({s.x, s.y, s.z}) && other < much_better * given;
  }
  if (moving) {
    try {
      DenseField as_given = *maps.field, other = inverted(maps.there, moving->grid, fixed.grid);
      Mask common = intersection(intersection(mask, as_given.covered), other.covered);
      for (DenseField* field : {&as_given, &other}) common = intersection(common, keep_inside(field->displacement, moving->grid));
      if (double(count(common)) >= enough_overlap * double(count(mask))) {
        const auto correlation_by = [&](const DenseField& field) { return correlation(fixed, warp_image(*moving, field.displacement, Interpolation::linear, 0), common); };
        const double r = correlation_by(as_given), r_other = correlation_by(other);
        j["correlation_as_given"] = r, j["correlation_reversed"] = r_other, j["voxels"] = count(common);
        reversed = reversed || 1 - r_other * r_other < much_better * (1 - r * r);
      }
    } catch (const Error&) {  // what has no inverse here is not the inverse
    }
  }
  j["reversed_fits_better"] = reversed;
  if (reversed)
    note(report, "the transform seems to have the wrong direction: its inverse fits much better (see `direction` in evaluation.json). A transform must map points of the fixed to the moving image; give this one as --inverse-transform instead of --transform");
}

}  // namespace mtled
