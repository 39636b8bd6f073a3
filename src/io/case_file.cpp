#include "io/case_file.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <unordered_map>

#include "core/material.hpp"
#include "io/dynamics_case.hpp"
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

/// A material law in files: its name and the keys of its parameters. A key without a default must be given, as a key of
/// [material] or as a column of the points.
struct LawInFiles {
  const char* name;
  MaterialModel model;
  struct Key {
    const char* name;
    std::optional<double> otherwise;
  };
  std::vector<Key> keys;
};
const std::vector<LawInFiles>& known_laws() {
  static const std::vector<LawInFiles> laws{
      {"neo-hookean", MaterialModel::neo_hookean, {{"shear_modulus_kpa", 1.0}}},
      {"mooney-rivlin", MaterialModel::mooney_rivlin, {{"c10_kpa", {}}, {"c01_kpa", {}}}},
      {"yeoh", MaterialModel::yeoh, {{"c1_kpa", {}}, {"c2_kpa", {}}, {"c3_kpa", 0.0}}},
      {"ogden", MaterialModel::ogden, {{"shear_modulus_kpa", 1.0}, {"ogden_exponent", {}}}},
      {"transversely-isotropic", MaterialModel::transversely_isotropic, {{"shear_modulus_kpa", 1.0}, {"fibre_modulus_kpa", {}}, {"fibre_x", {}}, {"fibre_y", {}}, {"fibre_z", {}}}}};
  return laws;
}

/// Of the fibre, which [material] gives as one array and the points as three columns.
bool is_fibre_component(const std::string& key) { return key == "fibre_x" || key == "fibre_y" || key == "fibre_z"; }

/// Shear modulus at rest and further parameters of IntegrationPoints; `place` says where the values come from.
struct Elasticity {
  double shear_modulus;
  std::vector<double> further;
};
Elasticity elasticity(MaterialModel model, const std::vector<double>& v, const std::string& place) {
  const auto shear = [&](double mu) {
    require(mu > 0 && std::isfinite(mu), place, ": shear_modulus_kpa is ", mu, "; it must be positive and finite");
    return mu;
  };
  switch (model) {
    case MaterialModel::neo_hookean: return {shear(v[0]), {}};
    case MaterialModel::mooney_rivlin:
      require(v[0] >= 0 && v[1] >= 0 && v[0] + v[1] > 0 && std::isfinite(v[0] + v[1]), place, ": c10_kpa is ", v[0], " and c01_kpa ", v[1],
              "; neither may be negative and one must be positive, else the material is not stable at every stretch");
      return {2 * (v[0] + v[1]), {v[1]}};
    case MaterialModel::yeoh:
      // dW/dI1 = c1 + 2 c2 y + 3 c3 y^2 > 0 for all y >= 0
      require(v[0] > 0 && v[2] >= 0 && (v[1] >= 0 || v[1] * v[1] < 3 * v[0] * v[2]) && std::isfinite(v[0] + v[1] + v[2]), place, ": c1_kpa, c2_kpa and c3_kpa are ", v[0], ", ", v[1], " and ", v[2],
              "; c1 must be positive, c3 not negative, and c2 above -sqrt(3 c1 c3), else the material softens until it has no stiffness");
      return {2 * v[0], {v[1], v[2]}};
    case MaterialModel::ogden:
      require(std::abs(v[1]) >= 0.1 && std::abs(v[1]) <= 30, place, ": ogden_exponent is ", v[1], "; its size must be from 0.1 to 30 (brain: -4.7; 2 is neo-Hookean)");
      return {shear(v[0]), {v[1]}};
    case MaterialModel::transversely_isotropic: {
      require(v[1] >= 0 && std::isfinite(v[1]), place, ": fibre_modulus_kpa is ", v[1], "; it must be finite and not negative");
      const double length = norm(Vec3d{v[2], v[3], v[4]});
      require(length > 1e-6 && std::isfinite(length), place, ": the fibre (", v[2], ", ", v[3], ", ", v[4], ") has no direction; give one that is longer than 1e-6 (its length does not matter)");
      return {shear(v[0]), {v[1], v[2] / length, v[3] / length, v[4] / length}};
    }
  }
  fail(Failure::internal, "unknown material model");
}

/// What [material] says: values of the keys that it has, for points without a column of that name.
struct MaterialDefaults {
  const LawInFiles* law;
  std::vector<std::optional<double>> value;  ///< [keys]
  std::optional<double> bulk_modulus;
  double poisson_ratio, density;
  std::vector<PronyTerm> prony;
};

double checked_poisson_ratio(double ratio, const std::string& place) {
  require(ratio >= 0 && ratio < 0.5, place, " is ", ratio,
          "; it must be at least 0 and below 0.5 (0.5, exactly incompressible, has no finite bulk modulus; 0.49 is usual)");
  return ratio;
}

std::vector<PronyTerm> read_prony(TomlSection& material, const std::string& file) {
  std::vector<PronyTerm> prony;
  const toml::array* terms = material.array("prony");
  if (!terms) return prony;
  require(terms->size() >= 1 && terms->size() <= 3, material.place("prony"), " has ", terms->size(), " terms; one to three are possible");
  for (std::size_t t = 0; t < terms->size(); ++t) {
    require((*terms)[t].is_table(), material.place("prony"), " must be a list of { alpha = ..., tau_s = ... }");
    TomlSection section((*terms)[t].as_table(), file, "material.prony[" + std::to_string(t) + "]");
    PronyTerm term;
    term.alpha = section.value("alpha", 0.0);
    term.alpha_volumetric = section.value("alpha_volumetric", 0.0);
    for (const auto& [key, alpha] : {std::pair("alpha", term.alpha), std::pair("alpha_volumetric", term.alpha_volumetric)})
      require(alpha >= 0 && alpha < 1, section.place(key), " is ", alpha, "; it must be at least 0 and below 1");
    require(term.alpha + term.alpha_volumetric > 0, section.place("alpha"), " is 0: the term does nothing; remove it");
    term.tau = positive_number(section, "tau_s", 0.0);
    section.finish();
    prony.push_back(term);
  }
  const PronyTerm sum = total(prony);
  require(sum.alpha < 1 && sum.alpha_volumetric < 1, material.place("prony"), ": the alphas sum to ", std::max(sum.alpha, sum.alpha_volumetric),
          "; they must stay below 1, else no stiffness is left in the long term");
  return prony;
}

MaterialDefaults read_material(TomlSection& section, const std::string& file) {
  const std::string model = section.value<std::string>("model", "neo-hookean");
  MaterialDefaults m{};
  std::string names;
  for (const LawInFiles& law : known_laws()) {
    names += (names.empty() ? "" : ", ") + std::string(law.name);
    if (law.name == model) m.law = &law;
  }
  require(m.law, section.place("model"), " is '", model, "'; this version knows: ", names);
  std::optional<Vec3d> fibre;
  if (m.law->model == MaterialModel::transversely_isotropic)
    if (const toml::array* components = section.array("fibre")) {
      require(components->size() == 3, section.place("fibre"), " must be three numbers");
      fibre.emplace();
      for (int a = 0; a < 3; ++a) {
        const auto value = (*components)[std::size_t(a)].value<double>();
        require(value.has_value(), section.place("fibre"), " must be three numbers");
        (*fibre)[a] = *value;
      }
    }
  for (std::size_t i = 0; i < m.law->keys.size(); ++i) {
    const auto& key = m.law->keys[i];
    const std::string name = key.name;
    if (is_fibre_component(name)) m.value.push_back(fibre ? std::optional((*fibre)[int(i) - 2]) : std::nullopt);
    else if (name == "shear_modulus_kpa") m.value.push_back(positive_number(section, name, *key.otherwise));
    else m.value.push_back(section.has(name) ? std::optional(section.value(name, 0.0)) : key.otherwise);
  }
  require(!(section.has("bulk_modulus_kpa") && section.has("poisson_ratio")), section.place("poisson_ratio"),
          " and bulk_modulus_kpa say the same thing; keep one");
  m.poisson_ratio = checked_poisson_ratio(section.value("poisson_ratio", 0.49), section.place("poisson_ratio"));
  if (section.has("bulk_modulus_kpa")) m.bulk_modulus = positive_number(section, "bulk_modulus_kpa", 0.0);
  m.density = positive_number(section, "density_kg_mm3", 1e-6);
  m.prony = read_prony(section, file);
  const bool complete = std::all_of(m.value.begin(), m.value.end(), [](const auto& v) { return v.has_value(); });
  if (complete) {
    std::vector<double> values;
    for (const auto& v : m.value) values.push_back(*v);
    const double mu = elasticity(m.law->model, values, file + ": [material]").shear_modulus;
    if (!m.bulk_modulus) m.bulk_modulus = bulk_modulus(mu, m.poisson_ratio);
  }
  return m;
}

/// `elements`: the points are their centres, a row of the table each; null: the table has columns for place and volume.
IntegrationPoints read_integration_points(const std::filesystem::path& path, const MaterialDefaults& defaults, const FiniteElements* elements) {
  const Table table = Table::read(path);
  IntegrationPoints points;
  points.model = defaults.law->model;
  points.prony = defaults.prony;
  const auto place_column = [&](const char* name) { return elements ? -1 : table.column(name); };
  const int x = place_column("x"), y = place_column("y"), z = place_column("z"), volume = place_column("volume");
  const auto optional_column = [&](const char* name) { return table.has(name) ? table.column(name) : -1; };
  const int bulk = optional_column("bulk_modulus_kpa"), poisson = optional_column("poisson_ratio"), density = optional_column("density_kg_mm3");
  require(bulk < 0 || poisson < 0, path.string(), ": the columns poisson_ratio and bulk_modulus_kpa say the same thing; keep one");
  std::vector<int> column;
  for (std::size_t i = 0; i < defaults.value.size(); ++i) {
    const char* name = defaults.law->keys[i].name;
    column.push_back(optional_column(name));
    require(column[i] >= 0 || defaults.value[i], "model '", defaults.law->name, "' needs ", name, "; give it in [material]", is_fibre_component(name) ? " as fibre = [x, y, z]" : "", " or as a column of ", path.string());
  }
  const auto positive = [&](std::size_t row, int at, const char* name, double otherwise) {
    const double v = at < 0 ? otherwise : table.number(row, at);
    require(v > 0, table.place(row), ": ", name, " is ", v, "; it must be positive");
    return v;
  };
  std::vector<double> value(column.size());
  for (std::size_t r = 0; r < table.rows(); ++r) {
    points.position.push_back(elements ? elements->centres()[r] : Vec3d{table.number(r, x), table.number(r, y), table.number(r, z)});
    points.volume.push_back(elements ? elements->volumes()[r] : positive(r, volume, "volume", 0));
    for (std::size_t i = 0; i < value.size(); ++i) value[i] = column[i] < 0 ? *defaults.value[i] : table.number(r, column[i]);
    const Elasticity e = elasticity(points.model, value, table.place(r));
    points.shear_modulus.push_back(e.shear_modulus);
    points.further.insert(points.further.end(), e.further.begin(), e.further.end());
    if (poisson >= 0) points.bulk_modulus.push_back(bulk_modulus(e.shear_modulus, checked_poisson_ratio(table.number(r, poisson), table.place(r) + ": poisson_ratio")));
    else points.bulk_modulus.push_back(positive(r, bulk, "bulk_modulus_kpa", defaults.bulk_modulus.value_or(bulk_modulus(e.shear_modulus, defaults.poisson_ratio))));
    points.density.push_back(positive(r, density, "density_kg_mm3", defaults.density));
  }
  require(points.size() > 0, path.string(), " has no integration points");
  return points;
}

Elements read_elements(const std::filesystem::path& path) {
  const Table table = Table::read(path);
  Elements elements;
  elements.corners = table.has("n4") ? 8 : 4;
  std::vector<int> column;
  for (const char* name : {"n0", "n1", "n2", "n3", "n4", "n5", "n6", "n7"})
    if (int(column.size()) < elements.corners) column.push_back(table.column(name));
  for (std::size_t r = 0; r < table.rows(); ++r)
    for (int c : column) {
      const double n = table.number(r, c);
      require(n == std::floor(n) && std::abs(n) < std::numeric_limits<int>::max(), table.place(r), ": ", n, " is no node number; nodes are numbered 0, 1, 2, ... in the order of their table");
      elements.node.push_back(int(n));
    }
  return elements;
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

SpringPlaces read_springs(const std::filesystem::path& path) {
  const Table table = Table::read(path);
  SpringPlaces springs;
  const int x = table.column("x"), y = table.column("y"), z = table.column("z"), stiffness = table.column("stiffness");
  const bool moves = table.has("ux") || table.has("uy") || table.has("uz");
  const int ux = moves ? table.column("ux") : -1, uy = moves ? table.column("uy") : -1, uz = moves ? table.column("uz") : -1, set = table.has("set") ? table.column("set") : -1;
  std::map<std::string, int> number;
  for (std::size_t r = 0; r < table.rows(); ++r) {
    springs.position.push_back({table.number(r, x), table.number(r, y), table.number(r, z)});
    springs.displacement.push_back(moves ? Vec3d{table.number(r, ux), table.number(r, uy), table.number(r, uz)} : Vec3d{});
    const double k = table.number(r, stiffness);
    if (!(k > 0)) fail(Failure::input, table.place(r), ": stiffness is ", k, " mN/mm; it must be positive; remove the row if nothing holds this place");
    springs.stiffness.push_back(k);
    const std::string name = set < 0 ? "springs" : std::string(table.text(r, set));
    springs.set.push_back(number.emplace(name, int(number.size())).first->second);
    if (springs.set.back() == int(springs.set_names.size())) springs.set_names.push_back(name);
  }
  require(springs.size() > 0, path.string(), " has no rows; add some or leave it out");
  return springs;
}

/// Marks the cells of the table in the lattice.
void read_body_cells(const std::filesystem::path& path, Lattice& lattice) {
  const Table table = Table::read(path);
  const int column[3] = {table.column("i"), table.column("j"), table.column("k")};
  lattice.body_cell.assign(lattice.node_at.size(), 0);
  for (std::size_t r = 0; r < table.rows(); ++r) {
    int cell[3];
    for (int a = 0; a < 3; ++a) {
      const double c = table.number(r, column[a]);
      const int last = lattice.size[std::size_t(a)] - 2;
      if (!(c == std::floor(c) && c >= 0 && c <= last))
        fail(Failure::input, table.place(r), ": ", c, " is no cell of the lattice; along axis ", a, " they are numbered 0 to ", last, ", by their lowest corners");
      cell[a] = int(c);
    }
    lattice.body_cell[lattice.offset(cell[0], cell[1], cell[2])] = 1;
  }
  require(table.rows() > 0, path.string(), " has no rows; add the cells that hold body or leave it out");
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
  if (const toml::array* size = section.array("size")) {
    constexpr std::int64_t most = 1000000;
    for (std::size_t a = 0; a < 3; ++a) {
      const std::int64_t positions = size->size() == 3 && (*size)[a].is_integer() ? (*size)[a].value_or(std::int64_t(0)) : 0;
      require(positions >= 2 && positions <= most, section.place("size"), " must be three whole numbers from 2 to ", most, ": the positions along each axis");
      lattice.size[a] = int(positions);
    }
  }
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
  const bool size_given = lattice && lattice->size[0] > 0;
  result.cloud = with_context("reading " + node_path.string(), [&] { return make_cloud(read_points(node_path), std::move(lattice)); });
  if (nodes.has("body_cells")) {
    require(size_given, nodes.place("body_cells"), " are numbered from the origin of a lattice with `size`; add size = [..., ..., ...] to nodes.lattice");
    read_body_cells(beside(nodes.required_text("body_cells")), *result.cloud.lattice);
  }
  nodes.finish();

  TomlSection material(root.section("material"), file, "material");
  const MaterialDefaults defaults = read_material(material, file);
  material.finish();

  TomlSection elements(root.section("elements"), file, "elements");
  if (root.has("elements")) {
    for (const char* other : {"points", "shape_functions"})
      require(!root.has(other), file, ": [elements] and [", other, "] exclude each other: finite elements bring their own integration points and shape functions; keep one");
    const auto element_path = beside(elements.required_text("file"));
    result.elements = read_elements(element_path);
    for (const auto& [key, corners] : {std::pair("hourglass", 8), std::pair("nodal_pressure", 4)})
      require(!elements.has(key) || result.elements.corners == corners, elements.place(key), " is for elements of ", corners, " nodes; remove it");
    result.hourglass = positive_number(elements, "hourglass", result.hourglass);
    result.nodal_pressure = elements.value("nodal_pressure", false);
    elements.finish();
    const auto mesh = with_context("reading " + element_path.string(), [&] { return std::make_unique<FiniteElements>(result.cloud, result.elements); });
    result.points = read_integration_points(element_path, defaults, mesh.get());
  } else {
    TomlSection points(root.section("points"), file, "points");
    result.points = read_integration_points(beside(points.required_text("file")), defaults, nullptr);
    result.align_points = points.value("align", true);
    const std::string outside = points.value<std::string>("outside", "error");
    require(outside == "error" || outside == "merge", points.place("outside"), " is '", outside, "'; choose error or merge");
    result.merge_points_outside = outside == "merge";
    points.finish();
  }

  TomlSection constraints(root.section("constraints"), file, "constraints");
  if (root.has("constraints") || !(root.has("springs") || root.has("dynamics")))  // springs can hold it, and a body in motion need not be held
    result.constraints = read_constraints(beside(constraints.required_text("file")), result.cloud.size());
  if (constraints.has("scheme")) {
    const std::string scheme = constraints.value<std::string>("scheme", "");
    require(scheme == "coupling" || scheme == "collocation", constraints.place("scheme"), " is '", scheme, "'; choose coupling or collocation");
    require(result.elements.size() == 0, constraints.place("scheme"), " is for moving least squares: finite elements interpolate prescribed nodes as they are; remove it");
    require(scheme == "collocation" || result.cloud.lattice, constraints.place("scheme"),
            " = \"coupling\" needs the cells of a lattice, and there is none; add nodes.lattice if the nodes are on one, or choose collocation");
    result.couple = scheme == "coupling";
  }
  constraints.finish();

  TomlSection springs(root.section("springs"), file, "springs");
  if (root.has("springs")) result.springs = read_springs(beside(springs.required_text("file")));
  springs.finish();

  TomlSection probes(root.section("probes"), file, "probes");
  if (root.has("probes")) result.probes = read_points(beside(probes.required_text("file")));
  probes.finish();

  TomlSection loads(root.section("loads"), file, "loads");
  result.loads = read_loads(loads, path.parent_path());
  loads.finish();

  TomlSection dynamics(root.section("dynamics"), file, "dynamics");
  if (root.has("dynamics")) {
    result.dynamics = read_dynamics(dynamics, path.parent_path());
    require(!root.has("solver"), file, ": the settings of [solver] belong to the search for equilibrium, and [dynamics] computes the motion in time; remove one of them");
  }
  dynamics.finish();

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

namespace {

Discretisation discretise_body(const SolveCase& problem) {
  if (problem.elements.size() == 0) {
    std::vector<std::uint8_t> prescribed;
    if (problem.couple && !problem.constraints.node.empty()) {
      prescribed.resize(problem.cloud.size());
      for (int n : problem.constraints.node) prescribed[std::size_t(n)] = 1;
    }
    return {std::make_unique<ShapeEvaluator>(problem.cloud, std::move(prescribed), problem.shapes), {}};
  }
  auto elements = std::make_unique<FiniteElements>(problem.cloud, problem.elements, problem.nodal_pressure);
  Springs springs;
  if (problem.elements.corners == 8) springs = elements->hourglass_springs(problem.hourglass, problem.points);
  return {std::move(elements), std::move(springs)};
}

}  // namespace

Discretisation discretise(const SolveCase& problem) {
  Discretisation result = discretise_body(problem);
  const std::size_t wanted = result.springs.size() + problem.springs.size();
  result.springs = springs_on(problem.springs, *result.field, std::move(result.springs));
  ShapeFunctions shapes;
  for (std::size_t p = 0; result.springs.size() < wanted && p < problem.springs.size(); ++p) {
    const Vec3d& x = problem.springs.position[p];
    require(result.field->at(x, shapes), "the spring of row ", p, " at (", x.x, ", ", x.y, ", ", x.z, ") mm lies where there are no nodes; remove it or move it into the body");
  }
  return result;
}

}  // namespace mtled
