#include "io/dynamics_output.hpp"

#include <cstdio>
#include <sstream>

#include "core/error.hpp"
#include "core/parallel.hpp"
#include "io/output.hpp"
#include "io/tables.hpp"

namespace mtled {
namespace {

constexpr int digits = 9;  ///< significant, in the tables

/// A cell of a CSV table with a text of the user's: quoted where it must be.
std::string quoted(const std::string& text) {
  if (text.find_first_of(",\"\n") == text.npos) return text;
  std::string cell = "\"";
  for (const char c : text) cell += c == '"' ? "\"\"" : std::string(1, c);
  return cell + '"';
}

PointData field_at_nodes(const std::string& name, const Approximation& field, const std::vector<Vec3d>& parameter) {
  const std::vector<Vec3d>& nodes = field.cloud().nodes;
  PointData data{name, 3, std::vector<float>(3 * nodes.size())};
  parallel_for(nodes.size(), [&](std::size_t n) {
    Vec3d value;
    if (!displacement_at(field, parameter, nodes[n], value)) value = parameter[n];
    for (int c = 0; c < 3; ++c) data.values[3 * n + std::size_t(c)] = float(value[c]);
  }, 256);
  return data;
}

}  // namespace

void DynamicsWriter::write(const DynamicsFrame& frame) {
  const DynamicsEntry& e = frame.entry;
  const std::vector<Vec3d>& nodes = field_->cloud().nodes;
  PointData prescribed{"prescribed", 1, std::vector<float>(nodes.size(), 0.0f)};
  for (int n : constraints_->node) prescribed.values[std::size_t(n)] = 1;
  char name[32];
  std::snprintf(name, sizeof name, "motion_%06d.vtu", count_);
  write_vtu(directory_ / name, nodes,
            {field_at_nodes("displacement_mm", *field_, frame.parameter), field_at_nodes("velocity_mm_s", *field_, frame.velocity_parameter), prescribed});
  std::ostringstream collection, history, rows;
  for (std::ostringstream* stream : {&collection, &history, &rows}) stream->precision(digits);
  collection << "    <DataSet timestep=\"" << e.time << "\" file=\"" << name << "\"/>\n";
  collection_ += collection.str();
  write_text(directory_ / "motion.pvd", "<?xml version=\"1.0\"?>\n<VTKFile type=\"Collection\" version=\"1.0\">\n  <Collection>\n" + collection_ + "  </Collection>\n</VTKFile>\n");

  if (count_ == 0) {
    history << "step,time_s,kinetic_mN_mm,strain_mN_mm,springs_mN_mm,dissipated_mN_mm,work_of_loads_mN_mm,work_of_motions_mN_mm,balance_error_mN_mm,smallest_volume_ratio";
    for (const auto& [set, force] : e.reactions)
      for (const char* c : {" fx", " fy", " fz"}) history << ',' << quoted(set + c);
    history << '\n';
    rows << "time_s,probe,x,y,z,ux,uy,uz\n";
  }
  history << e.step << ',' << e.time << ',' << e.kinetic << ',' << e.strain << ',' << e.springs << ',' << e.dissipated << ',' << e.work_of_loads << ',' << e.work_of_motions << ','
          << e.balance_error() << ',' << e.smallest_volume_ratio;
  for (const auto& [set, force] : e.reactions) history << ',' << force.x << ',' << force.y << ',' << force.z;
  history << '\n';
  history_ += history.str();
  write_text(directory_ / "history.csv", history_);

  for (std::size_t p = 0; p < probes_->size(); ++p) {
    const Vec3d& x = (*probes_)[p];
    Vec3d u;
    require(displacement_at(*field_, frame.parameter, x, u), "probe ", p, " at (", x.x, ", ", x.y, ", ", x.z, ") mm lies outside the body; remove it");
    rows << e.time << ',' << p << ',' << x.x << ',' << x.y << ',' << x.z << ',' << u.x << ',' << u.y << ',' << u.z << '\n';
  }
  probe_rows_ += rows.str();
  if (!probes_->empty()) write_text(directory_ / "probe_history.csv", probe_rows_);
  ++count_;
}

Json summary_of(const DynamicsResult& r) {
  Json j;
  j["steps"] = r.steps;
  j["time_step_s"] = r.time_step;
  j["stable_time_step_s"] = r.stable_time_step;
  j["mass_kg"] = r.mass;
  j["smallest_nodal_mass_kg"] = r.smallest_nodal_mass;
  j["massless_nodes"] = r.massless_nodes;
  j["largest_balance_error"] = r.largest_balance_error;
  const DynamicsEntry& e = r.history.back();
  j["time_s"] = e.time;
  j["kinetic_energy_mN_mm"] = e.kinetic;
  j["strain_energy_mN_mm"] = e.strain;
  j["spring_energy_mN_mm"] = e.springs;
  j["dissipated_mN_mm"] = e.dissipated;
  j["work_of_loads_mN_mm"] = e.work_of_loads;
  j["work_of_motions_mN_mm"] = e.work_of_motions;
  j["reactions_mN"] = Json::object();
  for (const auto& [name, force] : e.reactions) j["reactions_mN"][name] = {force.x, force.y, force.z};
  j["smallest_volume_ratio"] = e.smallest_volume_ratio;
  j["integration_points"] = r.points;
  j["stencils"] = r.stencils;
  j["enlarged_supports"] = r.enlarged_supports;
  j["dropped_points"] = r.dropped_points;
  double total = 0;
  for (const auto& [stage, t] : r.seconds) j["stage_seconds"][stage] = t, total += t;
  j["seconds"] = total;
  return j;
}

}  // namespace mtled
