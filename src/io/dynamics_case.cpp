#include "io/dynamics_case.hpp"

#include <algorithm>
#include <cmath>

#include "io/tables.hpp"
#include "io/toml_reader.hpp"

namespace mtled {
namespace {

double number_from(TomlSection& section, const std::string& key, double otherwise, bool zero_allowed) {
  const double v = section.value(key, otherwise);
  require((v > 0 || (zero_allowed && v == 0)) && std::isfinite(v), section.place(key), " is ", v, "; it must be ", zero_allowed ? "at least 0" : "positive", " and finite");
  return v;
}

/// Number of the set in that row, which is added to the loads if it is new.
int load_set(Loads& loads, const Table& table, std::size_t row, const std::string& otherwise) {
  const std::string name = table.has("set") ? std::string(table.text(row, table.column("set"))) : otherwise;
  require(name != "gravity", table.place(row), ": no set of loads may be named 'gravity', which is the name of the weight; choose another name");
  const auto number = std::find(loads.set_names.begin(), loads.set_names.end(), name) - loads.set_names.begin();
  if (number == std::ptrdiff_t(loads.set_names.size())) loads.set_names.push_back(name);
  return int(number);
}

/// Adds the rows of a table as forces: `vector` columns, times `-pressure_kpa` when they are areas.
void read_forces(const std::filesystem::path& path, const char* const (&vector)[3], bool areas, const std::string& set, Loads& loads) {
  const Table table = Table::read(path);
  const int x[3] = {table.column("x"), table.column("y"), table.column("z")}, v[3] = {table.column(vector[0]), table.column(vector[1]), table.column(vector[2])};
  const int pressure = areas ? table.column("pressure_kpa") : -1;
  for (std::size_t r = 0; r < table.rows(); ++r) {
    Vec3d place, force;
    for (int c = 0; c < 3; ++c) place[c] = table.number(r, x[c]), force[c] = table.number(r, v[c]) * (areas ? -table.number(r, pressure) : 1);
    loads.place.push_back(place), loads.force.push_back(force), loads.set.push_back(load_set(loads, table, r, set));
  }
  require(table.rows() > 0, path.string(), " has no rows; add some or leave it out");
}

}  // namespace

Loads read_loads(TomlSection& section, const std::filesystem::path& folder) {
  Loads loads;
  if (const toml::array* gravity = section.array("gravity_mm_s2")) {
    const std::string problem = section.place("gravity_mm_s2") + " must be three numbers [mm/s^2], such as [0.0, 0.0, -9810.0]";
    require(gravity->size() == 3, problem);
    for (int c = 0; c < 3; ++c) {
      const auto value = (*gravity)[std::size_t(c)].value<double>();
      require(value && std::isfinite(*value), problem);
      loads.gravity[c] = *value;
    }
  }
  if (section.has("forces")) read_forces(folder / section.required_text("forces"), {"fx", "fy", "fz"}, false, "forces", loads);
  if (section.has("pressure")) read_forces(folder / section.required_text("pressure"), {"ax", "ay", "az"}, true, "pressure", loads);
  return loads;
}

DynamicsOptions read_dynamics(TomlSection& section, const std::filesystem::path& folder) {
  DynamicsOptions options;
  require(section.has("duration_s"), section.place("duration_s"), " is missing: how long the motion lasts");
  options.duration = number_from(section, "duration_s", 0, false);
  require(!(section.has("time_step_s") && section.has("safety")), section.place("time_step_s"), " and safety both set the time step; keep one");
  if (section.has("time_step_s")) options.time_step = number_from(section, "time_step_s", 0, false);
  options.safety = section.value("safety", options.safety);
  require(options.safety > 0 && options.safety <= 1, section.place("safety"), " is ", options.safety, "; it is the share of the stable time step, above 0 and at most 1 (0.8 is usual)");
  options.damping = number_from(section, "damping_per_s", 0, true);
  if (section.has("output_every_s")) options.output_every = number_from(section, "output_every_s", 0, false);
  const std::string interpolation = section.value<std::string>("interpolation", "linear");
  require(interpolation == "linear" || interpolation == "smooth", section.place("interpolation"), " is '", interpolation, "'; choose linear or smooth");
  if (section.has("histories")) {
    const Table table = Table::read(folder / section.required_text("histories"));
    const int set = table.column("set"), time = table.column("time_s"), factor = table.column("factor");
    for (std::size_t r = 0; r < table.rows(); ++r) {
      History& history = options.histories[std::string(table.text(r, set))];
      history.smooth = interpolation == "smooth";
      const double t = table.number(r, time);
      require(history.time.empty() || t > history.time.back(), table.place(r), ": time ", t, " s of '", table.text(r, set), "' does not come after ",
              history.time.empty() ? 0 : history.time.back(), " s; sort the rows of each set by time, without repetition");
      history.time.push_back(t), history.factor.push_back(table.number(r, factor));
    }
  }
  return options;
}

}  // namespace mtled
