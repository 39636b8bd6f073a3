#include "io/solution_output.hpp"

#include <algorithm>
#include <cmath>

#include "core/stabilisation.hpp"

namespace mtled {
namespace {

/// JSON has no NaN: a value that is not known is null.
Json number(double v) { return std::isfinite(v) ? Json(v) : Json(nullptr); }

}  // namespace

Json summary_of(const Solution& s) {
  Json j;
  j["converged"] = s.converged;
  j["steps"] = s.steps;
  j["force_evaluations"] = s.force_evaluations;
  j["load_increments"] = s.load_increments;
  j["error_estimate_mm"] = number(s.error_estimate_mm);
  j["strain_energy_mN_mm"] = number(s.strain_energy);
  j["reactions_mN"] = Json::object();
  for (const auto& [name, r] : s.reactions) j["reactions_mN"][name] = {r.x, r.y, r.z};
  j["smallest_volume_ratio"] = number(s.smallest_volume_ratio);
  j["nodes"] = s.parameter.size();
  j["integration_points"] = s.points;
  j["stencils"] = s.stencils;
  j["enlarged_supports"] = s.enlarged_supports;
  j["dropped_points"] = s.dropped_points;
  if (!s.points_per_node.empty()) {
    const auto seen = [](double per_node) { return per_node > 0; };
    double fewest = 0;
    for (double per_node : s.points_per_node)
      if (seen(per_node) && (fewest == 0 || per_node < fewest)) fewest = per_node;
    j["fewest_points_per_node"] = fewest;
    j["nodes_with_few_points"] = std::count_if(s.points_per_node.begin(), s.points_per_node.end(), [&](double per_node) { return seen(per_node) && per_node < enough_points_per_node; });
  }
  j["coarse_unknowns"] = s.coarse_unknowns;
  double total = 0;
  for (const auto& [stage, t] : s.seconds) j["stage_seconds"][stage] = t, total += t;
  j["seconds"] = total;
  for (const auto& h : s.history)
    j["history"].push_back({{"step", h.step}, {"error_estimate_mm", number(h.error_estimate_mm)}, {"largest_increment_mm", number(h.largest_increment_mm)}, {"convergence_rate", h.convergence_rate}, {"strain_energy_mN_mm", number(h.strain_energy)}});
  return j;
}

void write_nodes(const std::filesystem::path& directory, const Cloud& cloud, const Constraints& constraints, const Solution& solution, std::vector<PointData> more) {
  write_displacements(directory / "nodes.csv", cloud.nodes, solution.displacement);
  PointData u{"displacement_mm", 3, {}};
  for (const Vec3d& d : solution.displacement)
    for (int c = 0; c < 3; ++c) u.values.push_back(float(d[c]));
  if (!constraints.node.empty()) {
    PointData prescribed{"prescribed", 1, std::vector<float>(cloud.size(), 0.0f)};
    for (int n : constraints.node) prescribed.values[std::size_t(n)] = 1;
    more.insert(more.begin(), std::move(prescribed));
  }
  if (!solution.points_per_node.empty()) more.push_back({"points_per_node", 1, {solution.points_per_node.begin(), solution.points_per_node.end()}});
  more.insert(more.begin(), std::move(u));
  write_vtu(directory / "nodes.vtu", cloud.nodes, more);
}

}  // namespace mtled
