#include "evaluation_report.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>

namespace mtled {

void add_evaluation_options(CLI::App& verb, EvaluationOptions& o) {
  verb.add_option("--landmarks", o.landmarks, "CSV with mx,my,mz,fx,fy,fz: corresponding points in the moving and the fixed image [mm, LPS]")->type_name("FILE");
  verb.add_option("--canny-sigma", o.canny.sigma_mm, "smoothing before edges are found [mm]")->capture_default_str();
  verb.add_option("--canny-lower", o.canny.lower_threshold, "lower edge threshold [intensity/mm]")->capture_default_str();
  verb.add_option("--canny-upper", o.canny.upper_threshold, "upper edge threshold [intensity/mm]")->capture_default_str();
}

nlohmann::json describe(const EdgeDistance& d) {
  return {{"edge_voxels", {d.edges_a, d.edges_b}}, {"consistent_fraction", {d.kept_a, d.kept_b}}, {"percent", d.percents},
          {"hausdorff_mm", d.hausdorff_mm}, {"hausdorff_all_edges_mm", d.hausdorff_all_mm}, {"mean_mm", d.mean_mm},
          {"modified_hausdorff_mm", d.modified_hausdorff_mm}, {"within_two_voxels", d.within_two_voxels},
          {"within_two_voxels_all_edges", d.within_two_voxels_all}};
}

nlohmann::json describe(const PointErrors& e) {
  return {{"points", e.distance_mm.size()}, {"mean_mm", e.mean}, {"median_mm", e.median}, {"percentile_95_mm", e.percentile_95}, {"max_mm", e.maximum}};
}

nlohmann::json describe(const std::vector<LabelOverlap>& overlap) {
  nlohmann::json j = nlohmann::json::array();
  for (const LabelOverlap& o : overlap)
    j.push_back({{"label", o.label}, {"dice", o.dice}, {"hausdorff_95_mm", std::isfinite(o.hausdorff95_mm) ? nlohmann::json(o.hausdorff95_mm) : nlohmann::json(nullptr)}});
  return j;
}

nlohmann::json compare_edges_of(const Image& fixed, const std::vector<NamedImage>& candidates, const CannyOptions& canny, const Mask& where) {
  const Mask edges = canny_edges(fixed, canny, &where);
  const double largest_voxel = std::max({fixed.grid.spacing.x, fixed.grid.spacing.y, fixed.grid.spacing.z});
  nlohmann::json j = nlohmann::json::object();
  for (const NamedImage& c : candidates) j[c.name] = describe(compare_edges(edges, canny_edges(*c.image, canny, &where), largest_voxel));
  return j;
}

void print_edges(const nlohmann::json& edges) {
  std::printf("%-16s %9s %9s %9s %9s %12s %12s\n", "edges", "H60 mm", "H75 mm", "H85 mm", "H95 mm", "<2 voxels", "consistent");
  for (const auto& [name, e] : edges.items()) {
    std::printf("%-16s", name.c_str());
    for (const auto& h : e["hausdorff_mm"]) std::printf(" %9.2f", h.get<double>());
    std::printf(" %10.1f %% %10.1f %%\n", 100 * e["within_two_voxels"].get<double>(), 100 * std::min(e["consistent_fraction"][0].get<double>(), e["consistent_fraction"][1].get<double>()));
  }
}

}  // namespace mtled
