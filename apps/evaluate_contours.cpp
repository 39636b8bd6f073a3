#include <algorithm>
#include <charconv>
#include <cstdio>

#include "core/error.hpp"
#include "evaluate.hpp"
#include "imaging/contour.hpp"
#include "imaging/lungs.hpp"

namespace mtled {
namespace {

constexpr const char* lungs = "lungs";

Mask voxels_of(const std::optional<LabelImage>& labels, int label) {
  Mask organ(labels->grid);
  for (std::size_t v = 0; v < organ.data.size(); ++v) organ.data[v] = labels->data[v] == label;
  return organ;
}

Mask lungs_of(const Image& image, const std::string& name) {
  return with_context("contour of the lungs in the " + name + " (for images that are no CT of a whole trunk, give them as a label: --contour NAME=LABEL)", [&] { return lung_mask(image, {}); });
}

Json describe(const ContourDistance& d) {
  return {{"voxels", d.voxels}, {"unmatched_voxels", d.unmatched}, {"mean_mm", number_or_null(d.mean)}, {"median_mm", number_or_null(d.median)}, {"percentile_95_mm", number_or_null(d.percentile_95)}, {"max_mm", number_or_null(d.maximum)}};
}

std::string image_of(const std::string& candidate) { return candidate == "before" ? "moving" : candidate == "after" ? "warped" : candidate; }

constexpr const char* directions[] = {"from_fixed", "to_fixed"};
constexpr const char* distances[] = {"mean_mm", "median_mm", "percentile_95_mm", "max_mm"};

}  // namespace

std::vector<NamedContour> parse_contours(const std::vector<std::string>& texts) {
  std::vector<NamedContour> contours;
  for (const std::string& text : texts) {
    NamedContour contour{text, 0};
    if (text != lungs) {
      const std::size_t equals = text.rfind('=');
      const char* end = text.data() + text.size();
      const bool numbered = equals != std::string::npos && equals > 0 && std::from_chars(text.data() + equals + 1, end, contour.label).ptr == end && equals + 1 < text.size();
      if (!numbered || contour.label < 1 || contour.label > 65535) fail(Failure::usage, "--contour ", text, ": this is neither 'lungs' nor a name with a label from 1 to 65535; write for example --contour liver=5");
      contour.name = text.substr(0, equals);
      if (contour.name.find_first_of(",\"\n") != std::string::npos) fail(Failure::usage, "--contour ", text, ": a name must not hold commas or quotation marks; leave them out");
    }
    if (std::any_of(contours.begin(), contours.end(), [&](const NamedContour& c) { return c.name == contour.name; })) fail(Failure::usage, "--contour ", text, ": the name '", contour.name, "' is there twice; give every contour its own");
    contours.push_back(contour);
  }
  return contours;
}

void check_contours(const CLI::App& verb, const EvaluateOptions& options, bool has_transform) {
  for (const NamedContour& contour : parse_contours(options.contours)) {
    if (contour.label == 0 && options.warped.empty()) require_option(verb, "--moving");
    if (contour.label == 0) continue;
    require_option(verb, "--fixed-labels");
    if (options.warped_labels.empty() && options.moving_labels.empty()) require_option(verb, has_transform ? "--moving-labels" : "--warped-labels");
  }
}

void report_contours(const std::vector<NamedContour>& contours, const Image& fixed, const std::vector<NamedImage>& candidates, const LabelMaps& labels, const std::vector<Other>& others, const Mask& where, Json& report) {
  for (const NamedContour& contour : contours) {
    const bool labelled = contour.label > 0;
    const Mask of_fixed = contours_of_slices(labelled ? voxels_of(labels.fixed, contour.label) : lungs_of(fixed, "fixed image"), where);
    const auto say_if_missing = [&](const Mask& outline, const std::string& image) {
      if (count(outline) > 0) return;
      note(report, labelled ? concatenate("contour '", contour.name, "': label ", contour.label, " has no contour in the ", image, " labels (within the mask), so there are no distances; check its number")
                            : concatenate("contour '", contour.name, "': no air was found inside the body of the ", image, " image (within the mask), so there are no distances"));
    };
    say_if_missing(of_fixed, "fixed");
    const auto compare = [&](const std::string& name, const Mask& organ) {
      const Mask outline = contours_of_slices(organ, where);
      say_if_missing(outline, image_of(name));
      const ContourComparison c = compare_contours(of_fixed, outline);
      report["contours"][contour.name][name] = {{directions[0], describe(c.from_a)}, {directions[1], describe(c.from_b)}};
    };
    if (!labelled)
      for (const NamedImage& c : candidates) compare(c.name, lungs_of(*c.image, image_of(c.name) + " image"));
    if (labelled && labels.before) compare("before", voxels_of(labels.before, contour.label));
    for (const Other& other : others)
      if (labelled && other.labels) compare(other.name, voxels_of(other.labels, contour.label));
    if (labelled && labels.after) compare("after", voxels_of(labels.after, contour.label));
  }
}

void print_contours(const Json& contours) {
  std::printf("%-16s %-8s %9s %9s %9s %9s (larger of both directions)\n", "contours", "", "mean mm", "median mm", "95 % mm", "max mm");
  for (const auto& [name, candidates] : contours.items())
    for (const auto& [candidate, c] : candidates.items()) {
      std::printf("%-16s %-8s", name.c_str(), candidate.c_str());
      for (const char* key : distances) {
        const Json &from = c[directions[0]][key], &to = c[directions[1]][key];
        if (from.is_null() || to.is_null()) std::printf(" %9s", "-");
        else std::printf(" %9.2f", std::max(from.get<double>(), to.get<double>()));
      }
      std::printf("\n");
    }
}

std::string contour_table(const Json& contours) {
  std::string table = "contour,candidate,direction,voxels,unmatched_voxels,mean_mm,median_mm,percentile_95_mm,max_mm\n";
  for (const auto& [name, candidates] : contours.items())
    for (const auto& [candidate, c] : candidates.items())
      for (const char* direction : directions) {
        const Json& d = c[direction];
        table += concatenate(name, ",", candidate, ",", direction, ",", d["voxels"].get<std::size_t>(), ",", d["unmatched_voxels"].get<std::size_t>());
        for (const char* key : distances) table += next_cell(d[key]);
        table += "\n";
      }
  return table;
}

}  // namespace mtled
