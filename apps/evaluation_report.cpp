#include "evaluation_report.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>

namespace mtled {

void add_evaluation_options(CLI::App& verb, EvaluationOptions& o) {
  verb.add_option("--landmarks", o.landmarks, "CSV with mx,my,mz,fx,fy,fz: corresponding points in the moving and the fixed image [mm, LPS]")->type_name("FILE");
  verb.add_option("--canny-sigma", o.canny.sigma_mm, "smoothing before edges are found [mm]")->check(positive())->capture_default_str();
  verb.add_option("--canny-lower", o.canny.lower_threshold, "lower edge threshold [intensity/mm]")->check(not_negative())->capture_default_str();
  verb.add_option("--canny-upper", o.canny.upper_threshold, "upper edge threshold [intensity/mm]")->check(not_negative())->capture_default_str();
}

Json describe(const EdgeDistance& d) {
  return {{"edge_voxels", {d.edges_a, d.edges_b}}, {"consistent_fraction", {d.kept_a, d.kept_b}}, {"percent", d.percents},
          {"hausdorff_mm", d.hausdorff_mm}, {"hausdorff_all_edges_mm", d.hausdorff_all_mm}, {"mean_mm", d.mean_mm},
          {"modified_hausdorff_mm", d.modified_hausdorff_mm}, {"within_two_voxels", d.within_two_voxels},
          {"within_two_voxels_all_edges", d.within_two_voxels_all}};
}

Json describe(const PointErrors& e) {
  return {{"points", e.distance_mm.size()}, {"mean_mm", e.mean}, {"median_mm", e.median}, {"percentile_95_mm", e.percentile_95}, {"max_mm", e.maximum}};
}

Json describe(const std::vector<LabelOverlap>& overlap) {
  Json j = Json::array();
  for (const LabelOverlap& o : overlap)
    j.push_back({{"label", o.label}, {"dice", o.dice}, {"hausdorff_95_mm", std::isfinite(o.hausdorff95_mm) ? Json(o.hausdorff95_mm) : Json(nullptr)}});
  return j;
}

Json compare_edges_of(const Image& fixed, const std::vector<NamedImage>& candidates, const CannyOptions& canny, const Mask& where) {
  const Mask edges = canny_edges(fixed, canny, &where);
  const double largest_voxel = std::max({fixed.grid.spacing.x, fixed.grid.spacing.y, fixed.grid.spacing.z});
  Json j = Json::object();
  for (const NamedImage& c : candidates) j[c.name] = describe(compare_edges(edges, canny_edges(*c.image, canny, &where), largest_voxel));
  return j;
}

void print_edges(const Json& edges) {
  std::printf("%-16s %9s %9s %9s %9s %12s %12s %12s\n", "edges", "H60 mm", "H75 mm", "H85 mm", "H95 mm", "consistent", "<2 voxels", "<2 vox. all");
  for (const auto& [name, e] : edges.items()) {
    std::printf("%-16s", name.c_str());
    for (const auto& h : e["hausdorff_mm"]) std::printf(" %9.2f", h.get<double>());
    const double consistent = std::min(e["consistent_fraction"][0].get<double>(), e["consistent_fraction"][1].get<double>());
    for (const double share : {consistent, e["within_two_voxels"].get<double>(), e["within_two_voxels_all_edges"].get<double>()}) std::printf(" %10.1f %%", 100 * share);
    std::printf("\n");
  }
}

}  // namespace mtled
