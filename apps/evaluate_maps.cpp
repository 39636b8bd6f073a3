#include <algorithm>
#include <cmath>
#include <utility>

#include "core/error.hpp"
#include "evaluate.hpp"
#include "image_io/image_io.hpp"
#include "imaging/same_grid.hpp"

namespace mtled {
namespace {

constexpr double much_better = 0.5;      ///< the inverse is suspected when it leaves less than this part of the misfit
constexpr double enough_overlap = 0.05;  ///< of the voxels, for a comparison of the two directions
constexpr double enough_voxels = 3e5;    ///< for that comparison: correlations are then certain to some 0.002

DisplacementFunction value_in(std::shared_ptr<const DenseField> field) {
  return [field](const Vec3d& y, Vec3d& v) { return linear_value(field->displacement, y, v); };
}

/// Every n-th voxel along each axis.
Grid thinned(Grid grid, int n) {
  for (int a = 0; a < 3; ++a) {
    grid.size[std::size_t(a)] = (grid.size[std::size_t(a)] + n - 1) / n;
    grid.spacing[a] *= n;
  }
  return grid;
}
int thinning(const Grid& grid) { return int(std::ceil(std::cbrt(std::max(1.0, double(grid.count()) / enough_voxels)))); }

template <class T>
Volume<T> thinned(const Volume<T>& volume, int n) {
  Volume<T> few(thinned(volume.grid, n));
  for (int k = 0; k < few.grid.size[2]; ++k)
    for (int j = 0; j < few.grid.size[1]; ++j)
      for (int i = 0; i < few.grid.size[0]; ++i) few.at(i, j, k) = volume.at(n * i, n * j, n * k);
  return few;
}

/// The part of check_direction() that compares images; true when the inverse fits much better.
bool inverse_fits_images(const Image& all_fixed, const Image& moving, const Mask& all_of_mask, const Maps& maps, Json& j) {
  const int n = thinning(all_fixed.grid);
  const Image fixed = thinned(all_fixed, n);
  const Mask mask = thinned(all_of_mask, n);
  const DenseField other = inverted(maps.there, thinned(moving.grid, thinning(moving.grid)), fixed.grid);
  const VectorImage given = thinned(maps.field->displacement, n);
  Mask common = intersection(intersection(mask, thinned(maps.field->covered, n)), other.covered), inside;
  const Image as_given = warp_continued(moving, fixed.grid, &given, inside);
  common = intersection(std::move(common), inside);
  const Image reversed = warp_continued(moving, fixed.grid, &other.displacement, inside);
  common = intersection(std::move(common), inside);
  const std::size_t voxels = count(common);
  if (voxels == 0 || double(voxels) < enough_overlap * double(count(mask))) return false;
  const double r = correlation(fixed, as_given, common), r_other = correlation(fixed, reversed, common);
  j["correlation_as_given"] = r, j["correlation_reversed"] = r_other, j["voxels"] = voxels;
  return 1 - r_other * r_other < much_better * (1 - r * r);
}

}  // namespace


Mask intersection(Mask a, const Mask& b) {
  for (std::size_t v = 0; v < a.data.size(); ++v) a.data[v] = a.data[v] && b.data[v];
  return a;
}

std::shared_ptr<const DenseField> field_on(const Grid& fixed, DisplacementFunction& there) {
  DenseDisplacement* dense = there.target<DenseDisplacement>();
  if (!dense || !same_grid(dense->field->grid, fixed)) return std::make_shared<DenseField>(sample_displacement(there, fixed));
  const auto field = std::make_shared<DenseField>(std::move(*dense->field), Mask(fixed, 1));
  there = value_in(field);
  return field;
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
    maps.field = field_on(fixed, maps.there);
  } else if (maps.back) {
    maps.computed_inverse = true;
    maps.field = std::make_shared<DenseField>(with_context("inverse transform '" + options.inverse_transform.string() + "'", [&] { return inverted(maps.back, moving ? moving->grid : fixed, fixed); }));
    maps.there = value_in(maps.field);
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
      reversed = inverse_fits_images(fixed, *moving, mask, maps, j) || reversed;
    } catch (const Error&) {  // what has no inverse here is not the inverse
    }
  }
  j["reversed_fits_better"] = reversed;
  if (reversed)
    note(report, "the transform seems to have the wrong direction: its inverse fits much better (see `direction` in evaluation.json). A transform must map points of the fixed to the moving image; give this one as --inverse-transform instead of --transform");
}

}  // namespace mtled
