#include "io/case_file.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <unordered_map>

#include "core/material.hpp"
#include "io/tables.hpp"
#include "io/toml_reader.hpp"

namespace mtled {

toml::table parse_toml(const std::filesystem::path& path) {
  require(std::filesystem::is_regular_file(path), "'", path.string(), "' is not a file");
  try {
    return toml::parse_file(path.string());
  } catch (const toml::parse_error& error) {
    fail(Failure::input, path.string(), ", line ", error.source().begin.line, ": ", error.description());
  }
}

namespace {

double positive_number(TomlSection& section, const std::string& key, double otherwise) {
  const double v = section.value(key, otherwise);
  require(v > 0 && std::isfinite(v), section.place(key), " is ", v, "; it must be positive and finite");
  return v;
}

int whole_number(TomlSection& section, const std::string& key, int otherwise, int least) {
  const std::int64_t v = section.value<std::int64_t>(key, otherwise);
  require(v >= least && v <= std::numeric_limits<int>::max(), section.place(key), " is ", v, "; it must be a whole number from ", least, " to ",
          std::numeric_limits<int>::max());
  return int(v);
}

struct MaterialDefaults {
  double shear_modulus, bulk_modulus, density;
};

MaterialDefaults read_material(TomlSection& section) {
  const std::string model = section.value<std::string>("model", "neo-hookean");
  require(model == "neo-hookean", section.place("model"), " is '", model, "'; this version knows: neo-hookean");
  MaterialDefaults m{};
  m.shear_modulus = positive_number(section, "shear_modulus_kpa", 1.0);
  require(!(section.has("bulk_modulus_kpa") && section.has("poisson_ratio")), section.place("poisson_ratio"),
          " and bulk_modulus_kpa say the same thing; keep one");
  const double poisson = section.value("poisson_ratio", 0.49);
  require(poisson >= 0 && poisson < 0.5, section.place("poisson_ratio"), " is ", poisson,
          "; it must be at least 0 and below 0.5 (0.5, exactly incompressible, has no finite bulk modulus; 0.49 is usual)");
  m.bulk_modulus = positive_number(section, "bulk_modulus_kpa", bulk_modulus(m.shear_modulus, poisson));
  m.density = positive_number(section, "density_kg_mm3", 1e-6);
  return m;
}

IntegrationPoints read_integration_points(const std::filesystem::path& path, const MaterialDefaults& defaults) {
  const Table table = Table::read(path);
  IntegrationPoints points;
  const int x = table.column("x"), y = table.column("y"), z = table.column("z"), volume = table.column("volume");
  const auto optional_column = [&](const char* name) { return table.has(name) ? table.column(name) : -1; };
  const int shear = optional_column("shear_modulus_kpa"), bulk = optional_column("bulk_modulus_kpa"), density = optional_column("density_kg_mm3");
  const auto positive = [&](std::size_t row, int column, const char* name, double otherwise) {
    const double v = column < 0 ? otherwise : table.number(row, column);
    require(v > 0, table.place(row), ": ", name, " is ", v, "; it must be positive");
    return v;
  };
  for (std::size_t r = 0; r < table.rows(); ++r) {
    points.position.push_back({table.number(r, x), table.number(r, y), table.number(r, z)});
    points.volume.push_back(positive(r, volume, "volume", 0));
    points.shear_modulus.push_back(positive(r, shear, "shear_modulus_kpa", defaults.shear_modulus));
    points.bulk_modulus.push_back(positive(r, bulk, "bulk_modulus_kpa", defaults.bulk_modulus));
    points.density.push_back(positive(r, density, "density_kg_mm3", defaults.density));
  }
  require(points.size() > 0, path.string(), " has no integration points");
  return points;
}

Constraints read_constraints(const std::filesystem::path& path, std::size_t num_nodes) {
  const Table table = Table::read(path);
  Constraints constraints;
  const int node = table.column("node"), set = table.has("set") ? table.column("set") : -1;
  const int u[3] = {table.column("ux"), table.column("uy"), table.column("uz")};
  std::map<std::string, int> number;
  std::unordered_map<int, std::size_t> row_of;  // index into constraints
  for (std::size_t r = 0; r < table.rows(); ++r) {
    const double n = table.number(r, node);
    require(n >= 0 && n == std::floor(n) && n < double(num_nodes), table.place(r), ": node ", n, " does not exist; nodes are numbered 0 to ", num_nodes - 1);
    const std::string name = set < 0 ? "constraints" : std::string(table.text(r, set));
    const int s = number.emplace(name, int(number.size())).first->second;
    if (s == int(constraints.set_names.size())) constraints.set_names.push_back(name);
    const auto [it, is_new] = row_of.emplace(int(n), constraints.node.size());
    const std::size_t at = it->second;
    if (is_new) {
      constraints.node.push_back(int(n)), constraints.displacement.push_back({}), constraints.fixed.push_back({}), constraints.set.push_back(s);
    }
    for (int c = 0; c < 3; ++c) {
      const auto value = table.optional_number(r, u[c]);
      if (!value) continue;
      require(!constraints.fixed[at][std::size_t(c)] || constraints.displacement[at][c] == *value, table.place(r), ": node ", n,
              " is constrained twice with different values (", constraints.displacement[at][c], " and ", *value, " mm); keep one");
      constraints.fixed[at][std::size_t(c)] = true, constraints.displacement[at][c] = *value;
    }
    const auto& fixed = constraints.fixed[at];
    require(fixed[0] || fixed[1] || fixed[2], table.place(r), ": no displacement component is given; remove the row");
  }
  require(!constraints.node.empty(), path.string(), " has no constraints: nothing holds or moves the body");
  return constraints;
}

std::optional<Lattice> read_lattice(TomlSection& nodes, const std::string& file) {
  const toml::table* table = nodes.section("lattice");
  if (!table) return std::nullopt;
  TomlSection section(table, file, "nodes.lattice");
  Lattice lattice;
  const toml::array* origin = section.array("origin");
  require(origin && origin->size() == 3, section.place("origin"), " must be three numbers [mm]");
  for (int a = 0; a < 3; ++a) {
    const auto value = (*origin)[std::size_t(a)].value<double>();
    require(value.has_value(), section.place("origin"), " must be three numbers [mm]");
    lattice.origin[a] = *value;
  }
  lattice.spacing = positive_number(section, "spacing", 0.0);
  section.finish();
  return lattice;
}

}  // namespace

SolveCase read_case(const std::filesystem::path& path) {
  const toml::table root_table = parse_toml(path);
  const std::string file = path.filename().string();
  const auto beside = [&](const std::string& name) { return path.parent_path() / name; };
  TomlSection root(&root_table, file, "");
  SolveCase result;

  TomlSection nodes(root.section("nodes"), file, "nodes");
  const auto node_path = beside(nodes.required_text("file"));
  std::optional<Lattice> lattice = read_lattice(nodes, file);
  nodes.finish();
  result.cloud = with_context("reading " + node_path.string(), [&] { return make_cloud(read_points(node_path), std::move(lattice)); });

  TomlSection material(root.section("material"), file, "material");
  const MaterialDefaults defaults = read_material(material);
  material.finish();

  TomlSection points(root.section("points"), file, "points");
  result.points = read_integration_points(beside(points.required_text("file")), defaults);
  points.finish();

  TomlSection constraints(root.section("constraints"), file, "constraints");
  result.constraints = read_constraints(beside(constraints.required_text("file")), result.cloud.size());
  constraints.finish();

  TomlSection probes(root.section("probes"), file, "probes");
  if (root.has("probes")) result.probes = read_points(beside(probes.required_text("file")));
  probes.finish();

  TomlSection shapes(root.section("shape_functions"), file, "shape_functions");
  const std::string basis = shapes.value<std::string>("basis", "linear");
  const std::map<std::string, Basis> bases{{"linear", Basis::linear}, {"quadratic", Basis::quadratic}, {"modified-quadratic", Basis::modified_quadratic}};
  require(bases.count(basis), shapes.place("basis"), " is '", basis, "'; choose linear, quadratic or modified-quadratic");
  result.shapes.basis = bases.at(basis);
  result.shapes.dilatation = shapes.value("dilatation", result.shapes.basis == Basis::linear ? 1.75 : 2.25);
  require(result.shapes.dilatation > 1 && result.shapes.dilatation <= 4, shapes.place("dilatation"), " is ", result.shapes.dilatation,
          "; it must be above 1 and at most 4 node spacings (1.75 is usual for the linear basis, 2.25 for the quadratic ones)");
  const std::string support = shapes.value<std::string>("support", "radius");
  require(support == "radius" || support == "count", shapes.place("support"), " is '", support, "'; choose radius or count");
  require(support == "count" || !shapes.has("count"), shapes.place("count"), " has no effect unless support = \"count\"; add that or remove it");
  if (support == "count") {
    const int least = result.shapes.basis == Basis::linear ? 10 : 20;
    require(shapes.has("count") && !shapes.has("dilatation"), shapes.place("support"), " = \"count\" needs count and no dilatation");
    require(!result.cloud.lattice, shapes.place("support"), " = \"count\" is for clouds that are no lattice: on a lattice the radius gives the count; remove it, or nodes.lattice");
    result.shapes.count = whole_number(shapes, "count", 0, least);
    require(result.shapes.count <= 200, shapes.place("count"), " is ", result.shapes.count, "; it must be at most 200 (20 is usual for the linear basis, 45 for the quadratic ones)");
  }
  shapes.finish();

  TomlSection solver(root.section("solver"), file, "solver");
  result.solver.tolerance_mm = positive_number(solver, "tolerance_mm", result.solver.tolerance_mm);
  result.solver.max_steps = whole_number(solver, "max_steps", result.solver.max_steps, 1);
  const std::string relaxation = solver.value<std::string>("relaxation", "two-level");
  require(relaxation == "two-level" || relaxation == "plain", solver.place("relaxation"), " is '", relaxation, "'; choose two-level or plain");
  result.solver.relaxation = relaxation == "plain" ? Relaxation::plain : Relaxation::two_level;
  result.solver.load_steps = whole_number(solver, "load_steps", 0, 0);
  result.solver.coarse_unknowns = whole_number(solver, "coarse_unknowns", result.solver.coarse_unknowns, 6);
  result.solver.stabilisation = solver.value("stabilisation", 0.0);
  require(result.solver.stabilisation >= 0 && std::isfinite(result.solver.stabilisation), solver.place("stabilisation"), " is ", result.solver.stabilisation,
          "; it must be 0 (none) or positive and finite (2 is usual)");
  const std::string precision = solver.value<std::string>("precision", "single");
  require(precision == "single" || precision == "double", solver.place("precision"), " is '", precision, "'; choose single or double");
  result.solver.double_precision = precision == "double";
  solver.finish();
  root.finish();
  return result;
}

}  // namespace mtled
