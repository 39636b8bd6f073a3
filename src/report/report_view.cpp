#include "report/report_view.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/error.hpp"
#include "core/parallel.hpp"
#include "imaging/morphology.hpp"
#include "imaging/percentile.hpp"
#include "imaging/slices.hpp"
#include "imaging/some_values.hpp"
#include "imaging/warp.hpp"

namespace mtled {
namespace {

constexpr std::size_t most_arrows = 40000;
constexpr double smallest_ratio = 0.01;  ///< that is stored where nothing folds: 0 and less are for folds
constexpr float unknown = std::numeric_limits<float>::quiet_NaN();

/// 1, 2 or 5 times a power of ten, at least `value`.
double round_number_above(double value) {
  const double decade = std::pow(10, std::floor(std::log10(value)));
  for (const double factor : {1.0, 2.0, 5.0})
    if (factor * decade >= value * (1 - 1e-9)) return factor * decade;
  return 10 * decade;
}

/// Around 1, as far as the middle 99.8 % of the voxels are, but at most to 0 and 2; from below 0 to 2 where something folds.
ColorScale scale_of_ratio(const Image& ratio, bool folded) {
  std::vector<float> values = some_values(ratio);
  const double reach = values.empty() ? 0.1 : std::max({percentile(values, 99.9) - 1, 1 - percentile(values, 0.1), 0.05});
  const double half = folded ? 1 : std::min(round_number_above(reach), 1.0);
  return {"jacobian", "Volume ratio det J", "moving / fixed", {folded ? -0.05 : std::max(1 - half, smallest_ratio), 1 + half}, true, 1, true, !folded};
}

}  // namespace

GreyScale grey_scale_of(const Image& image) {
  const Window window = display_window(image);
  if (window.low == -160 && window.high == 240)
    return {{-1000, 600}, "HU", {{"Soft tissue", -160, 240}, {"Lung", -1000, 150}, {"Bone", -100, 600}, {"All", -1000, 600}}};
  std::vector<float> values = some_values(image);
  const double low = percentile(values, 0.2), high = std::max(percentile(values, 99.8), window.high);
  return {{low, high > low ? high : low + 1}, "", {{"Standard", window.low, window.high}, {"All", low, high}}};
}

void ReportView::add_image(const std::string& id, const std::string& name, const std::string& space, const Image& image) {
  Json windows = Json::array();
  for (const auto& w : scale_.windows) windows.push_back({{"name", w.name}, {"low", w.low}, {"high", w.high}});
  volumes_.push_back({{{"id", id}, {"name", name}, {"space", space}, {"kind", "grey"}, {"low", scale_.range.low}, {"high", scale_.range.high}, {"unit", scale_.unit}, {"windows", windows}}, grey_bytes(image, view(space), scale_.range), false});
}

void ReportView::add_numbers(const ColorScale& scale, const std::string& space, const Image& values, const Mask* lowest) {
  ByteVolume bytes = scalar_bytes(values, view(space), scale.range);
  if (lowest) set_lowest(bytes, *lowest);
  Json j{{"id", scale.id}, {"name", scale.name}, {"space", space}, {"kind", "scalar"}, {"low", scale.range.low}, {"high", scale.range.high}, {"unit", scale.unit},
         {"map", scale.diverging ? "diverging" : "sequential"}, {"open_start", scale.open_start}, {"open_end", scale.open_end}};
  if (scale.diverging) j["middle"] = scale.middle;
  volumes_.push_back({std::move(j), std::move(bytes), true});
}

void ReportView::add_edges(const std::string& id, const Mask& edges) {
  if (edges_.data.empty()) edges_ = ByteVolume(view("fixed"));
  require(edge_bits_.size() < 8, "the report shows the edges of eight images at most");
  const auto bit = std::uint8_t(1u << edge_bits_.size());
  edge_bits_[std::to_string(bit)] = id;
  set_bits(edges_, edges, bit);
}

void ReportView::set_arrows(const VectorImage& displacement, const Mask& known) {
  arrows_ = coarse_vectors(displacement, known, view("fixed"), most_arrows);
  arrows_["space"] = "fixed";
}

Json ReportView::json() const {
  Json j;
  for (const auto& [name, grid] : views_) j["spaces"][name] = describe_view(grid);
  std::vector<Json> descriptions;
  std::vector<const Volume*> volumes;
  const Volume edges{{{"id", "edges"}, {"space", "fixed"}, {"kind", "bits"}, {"bits", edge_bits_}}, edges_, true};
  for (const Volume& volume : volumes_) volumes.push_back(&volume);
  if (!edges_.data.empty()) volumes.push_back(&edges);
  for (const Volume* volume : volumes) descriptions.push_back(volume->description);
  parallel_for(volumes.size(), [&](std::size_t v) { descriptions[v]["mosaic"] = volumes[v]->exact ? mosaic_as_png(volumes[v]->bytes) : mosaic_as_jpeg(volumes[v]->bytes); }, 1);
  j["volumes"] = descriptions;
  if (!arrows_.is_null()) j["arrows"] = arrows_;
  return j;
}

Image magnitude(const VectorImage& field, const Mask& known) {
  Image size(field.grid, unknown);
  parallel_for(size.data.size(), [&](std::size_t v) {
    const Vec3f& d = field.data[v];
    if (known.data[v]) size.data[v] = std::sqrt(d.x * d.x + d.y * d.y + d.z * d.z);
  });
  return size;
}

void add_field(ReportView& view, const VectorImage& displacement, const Mask& known, const Image& ratio) {
  {
    const Image size = magnitude(displacement, known);
    float largest = 0;
    for (const float v : size.data)
      if (v > largest) largest = v;
    view.add_numbers({"displacement", "Displacement", "mm", {0, largest > 0 ? double(largest) : 1}}, "fixed", size);
  }
  view.set_arrows(displacement, known);
  const Mask folded = folded_voxels(ratio);
  const bool any = count(folded) > 0;
  view.add_numbers(scale_of_ratio(ratio, any), "fixed", ratio, any ? &folded : nullptr);
}

}  // namespace mtled
