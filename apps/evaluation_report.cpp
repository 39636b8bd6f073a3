#include "evaluation_report.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>

#include "core/error.hpp"

namespace mtled {

void add_evaluation_options(CLI::App& verb, EvaluationOptions& o) {
  verb.add_option("--landmarks", o.landmarks, "CSV with mx,my,mz,fx,fy,fz: corresponding points in the moving and the fixed image [mm, LPS]")->type_name("FILE");
  verb.add_option("--canny-sigma", o.canny.sigma_mm, "smoothing before edges are found [mm]")->check(positive())->capture_default_str();
  verb.add_option("--canny-lower", o.canny.lower_threshold, "lower edge threshold [intensity/mm]")->check(not_negative())->capture_default_str();
  verb.add_option("--canny-upper", o.canny.upper_threshold, "upper edge threshold [intensity/mm]")->check(not_negative())->capture_default_str();
}

void note(Json& report, const std::string& text) {
  warn(text);
  report["warnings"].push_back(text);
}

Json number_or_null(double value) { return std::isfinite(value) ? Json(value) : Json(nullptr); }

std::string next_cell(const Json& value) { return value.is_null() ? "," : concatenate(",", value.get<double>()); }

namespace {

/// A number, or a dash for null, right-aligned.
void print_cell(const Json& value, double factor, int width, int digits, const char* unit = "") {
  if (value.is_null()) std::printf(" %*s%s", width, "-", unit);
  else std::printf(" %*.*f%s", width, digits, factor * value.get<double>(), unit);
}

}  // namespace

Json describe(const CannyOptions& canny, EdgeSpace space) {
  return {{"canny_sigma_mm", canny.sigma_mm}, {"canny_lower_per_mm", canny.lower_threshold}, {"canny_upper_per_mm", canny.upper_threshold}, {"edges", space == EdgeSpace::slices ? "2-D, slice by slice along k" : "3-D"}};
}

Json describe(const EdgeDistance& d) {
  Json j{{"edge_voxels", {d.edges_a, d.edges_b}}, {"unmatched_voxels", {d.unmatched_a, d.unmatched_b}}, {"two_voxels_mm", d.two_voxels_mm}};
  if (!d.comparable()) {
    for (const char* key : {"consistent_fraction", "percent", "hausdorff_mm", "hausdorff_all_edges_mm", "mean_mm", "modified_hausdorff_mm", "within_two_voxels", "within_two_voxels_all_edges",
                            "hausdorff_1_to_100_mm", "hausdorff_1_to_100_all_edges_mm"})
      j[key] = nullptr;
    return j;
  }
  j.update({{"consistent_fraction", {d.kept_a, d.kept_b}}, {"percent", d.percents},
          {"hausdorff_mm", d.hausdorff_mm}, {"hausdorff_all_edges_mm", d.hausdorff_all_mm}, {"mean_mm", d.mean_mm},
          {"modified_hausdorff_mm", d.modified_hausdorff_mm}, {"within_two_voxels", d.within_two_voxels},
          {"within_two_voxels_all_edges", d.within_two_voxels_all}, {"hausdorff_1_to_100_mm", d.curve_mm}, {"hausdorff_1_to_100_all_edges_mm", d.curve_all_mm}});
  return j;
}

Json describe(const JacobianStatistics& s) {
  return {{"min", s.minimum}, {"percentile_1", s.percentile_1}, {"median", s.median}, {"percentile_99", s.percentile_99}, {"max", s.maximum}, {"folded_voxels", s.folded}, {"voxels", s.voxels},
          {"sd_log", number_or_null(s.sd_log)}, {"sd_log_learn2reg", number_or_null(s.sd_log_learn2reg)}};
}

Json describe(const std::vector<LabelRigidity>& rigidity) {
  Json j = Json::array();
  for (const LabelRigidity& r : rigidity) j.push_back({{"label", r.label}, {"voxels", r.voxels}, {"rms_mm", r.rms_mm}, {"largest_mm", r.largest_mm}});
  return j;
}

Json describe(const InverseConsistency& c) {
  return {{"voxels", c.voxels}, {"mean_mm", c.mean}, {"percentile_95_mm", c.percentile_95}, {"percentile_99_mm", c.percentile_99}, {"max_mm", c.maximum}};
}

Json describe(const PointErrors& e) {
  return {{"points", e.distance_mm.size()}, {"mean_mm", e.mean}, {"median_mm", e.median}, {"percentile_95_mm", e.percentile_95}, {"max_mm", e.maximum}, {"distances_mm", e.distance_mm}};
}

Json describe(const std::vector<LabelOverlap>& overlap) {
  Json j = Json::array();
  for (const LabelOverlap& o : overlap)
    j.push_back({{"label", o.label}, {"voxels", {o.voxels_a, o.voxels_b}}, {"dice", o.dice}, {"hausdorff_95_mm", number_or_null(o.hausdorff95_mm)}, {"hausdorff_95_pooled_mm", number_or_null(o.hausdorff95_pooled_mm)},
                 {"hausdorff_95_learn2reg_mm", number_or_null(o.hausdorff95_learn2reg_mm)}, {"average_surface_distance_mm", number_or_null(o.average_surface_distance_mm)},
                 {"surface_area_mm2", {number_or_null(o.surface_area_a_mm2), number_or_null(o.surface_area_b_mm2)}}});
  return j;
}

Json compare_edges_of(const Image& fixed, const std::vector<NamedImage>& candidates, const CannyOptions& canny, const Mask& where, const Grid* source, EdgeSpace space, Json& report,
                      const std::function<void(const std::string& name, const Mask& edges)>& seen) {
  const auto find_edges = space == EdgeSpace::slices ? canny_edges_of_slices : canny_edges;
  const Mask edges = find_edges(fixed, canny, &where);
  if (seen) seen("fixed", edges);
  const double largest_voxel = largest_spacing(fixed.grid, space), source_voxel = source ? largest_spacing(*source, space) : 0;
  Json j = Json::object();
  for (const NamedImage& c : candidates) {
    const Mask of_candidate = find_edges(*c.image, canny, &where);
    if (seen) seen(c.name, of_candidate);
    const EdgeDistance d = compare_edges(edges, of_candidate, largest_voxel, space, source_voxel);
    if (!d.comparable())
      note(report, concatenate(c.name, ": no edges to compare (", d.edges_a, " edge voxels in the fixed image, ", d.edges_b, " in the other); lower --canny-lower and --canny-upper, which are meant for CT (HU per mm), or check the images and their mask"));
    j[c.name] = describe(d);
  }
  return j;
}

void print_edges(const Json& edges) {
  std::printf("%-16s %9s %9s %9s %9s %9s %12s %12s %12s\n", "edges", "H60 mm", "H75 mm", "H85 mm", "H95 mm", "M-HD mm", "consistent", "<2 voxels", "<2 vox. all");
  for (const auto& [name, e] : edges.items()) {
    std::printf("%-16s", name.c_str());
    for (int p = 0; p < 4; ++p) print_cell(e["hausdorff_mm"].is_null() ? Json() : e["hausdorff_mm"][std::size_t(p)], 1, 9, 2);
    print_cell(e["modified_hausdorff_mm"], 1, 9, 2);
    const Json& kept = e["consistent_fraction"];
    print_cell(kept.is_null() ? Json() : Json(std::min(kept[0].get<double>(), kept[1].get<double>())), 100, 10, 1, " %");
    for (const char* share : {"within_two_voxels", "within_two_voxels_all_edges"}) print_cell(e[share], 100, 10, 1, " %");
    std::printf("\n");
  }
}

void print_labels(const Json& labels) {
  std::printf("%-16s %6s %9s %9s %12s %14s %9s\n", "labels", "label", "Dice", "HD95 mm", "HD95 pooled", "HD95 Learn2Reg", "ASD mm");
  for (const auto& [name, list] : labels.items())
    for (const Json& l : list) {
      std::printf("%-16s %6d", name.c_str(), l["label"].get<int>());
      print_cell(l["dice"], 1, 9, 3);
      print_cell(l["hausdorff_95_mm"], 1, 9, 2);
      print_cell(l["hausdorff_95_pooled_mm"], 1, 12, 2);
      print_cell(l["hausdorff_95_learn2reg_mm"], 1, 14, 2);
      print_cell(l["average_surface_distance_mm"], 1, 9, 2);
      std::printf("\n");
    }
}

std::string edge_table(const Json& edges) {
  std::string table = "percent";
  for (const auto& [name, e] : edges.items()) table += concatenate(",", name, "_mm,", name, "_all_edges_mm");
  table += "\n";
  for (std::size_t percent = 1; percent <= 100; ++percent) {
    table += std::to_string(percent);
    for (const auto& [name, e] : edges.items())
      for (const char* curve : {"hausdorff_1_to_100_mm", "hausdorff_1_to_100_all_edges_mm"}) table += next_cell(e[curve].is_null() ? Json() : e[curve][percent - 1]);
    table += "\n";
  }
  return table;
}

std::string label_table(const Json& labels) {
  std::string table = "label,candidate,dice,hausdorff_95_mm,hausdorff_95_pooled_mm,hausdorff_95_learn2reg_mm,average_surface_distance_mm\n";
  for (const auto& [name, list] : labels.items())
    for (const Json& l : list) {
      table += concatenate(l["label"].get<int>(), ",", name);
      for (const char* key : {"dice", "hausdorff_95_mm", "hausdorff_95_pooled_mm", "hausdorff_95_learn2reg_mm", "average_surface_distance_mm"}) table += next_cell(l[key]);
      table += "\n";
    }
  return table;
}

}  // namespace mtled
