#include "io/case_output.hpp"

#include <charconv>

#include "core/error.hpp"
#include "io/output.hpp"

namespace mtled {
namespace {

/// Shortest text that is read as the same number.
std::string exact(double value) {
  char buffer[32];
  return {buffer, std::to_chars(buffer, buffer + sizeof buffer, value).ptr};
}

/// Cells of a row, with commas between.
struct Row {
  std::string text;
  void add(const std::string& cell) {
    if (!text.empty()) text += ',';
    text += cell;
  }
  void add(double number) { add(exact(number)); }
  void add(const Vec3d& v) { add(v.x), add(v.y), add(v.z); }
};

/// A table; `fill(r, row)` adds the cells of row r, or none when it is to be left out.
template <class Fill>
void write_table(const std::filesystem::path& path, const char* header, std::size_t rows, const Fill& fill) {
  write_stream(path, [&](std::ostream& stream) {
    stream << header << '\n';
    Row row;
    for (std::size_t r = 0; r < rows; ++r) {
      row.text.clear();
      fill(r, row);
      if (!row.text.empty()) stream << (row.text += '\n');
    }
  });
}

void write_body_cells(const std::filesystem::path& path, const Lattice& lattice) {
  const std::size_t width = std::size_t(lattice.size[0]), plane = width * std::size_t(lattice.size[1]);
  write_table(path, "i,j,k", lattice.body_cell.size(), [&](std::size_t c, Row& row) {
    if (lattice.body_cell[c]) row.add(Vec3d{double(c % width), double(c % plane / width), double(c / plane)});
  });
}

const char* name_of(Basis basis) {
  switch (basis) {
    case Basis::linear: return "linear";
    case Basis::quadratic: return "quadratic";
    case Basis::modified_quadratic: return "modified-quadratic";
  }
  fail(Failure::internal, "unknown basis");
}

}  // namespace

void write_case(const std::filesystem::path& directory, const ShapeEvaluator& field, const IntegrationPoints& points, const SpringPlaces& springs, const SolverOptions& solver) {
  if (points.model != MaterialModel::neo_hookean || points.viscoelastic() || field.options().count > 0) fail(Failure::internal, "write_case() knows only elastic neo-Hookean bodies and supports by radius");
  const Cloud& cloud = field.cloud();
  std::filesystem::remove(directory / "case.toml");  // a folder without it is not complete
  write_table(directory / "nodes.csv", "x,y,z", cloud.size(), [&](std::size_t n, Row& row) { row.add(cloud.nodes[n]); });
  write_table(directory / "points.csv", "x,y,z,volume,shear_modulus_kpa,bulk_modulus_kpa,density_kg_mm3", points.size(), [&](std::size_t p, Row& row) {
    row.add(points.position[p]), row.add(points.volume[p]), row.add(points.shear_modulus[p]), row.add(points.bulk_modulus[p]), row.add(points.density[p]);
  });
  ShapeFunctions shapes;
  write_table(directory / "springs.csv", "x,y,z,stiffness,ux,uy,uz,set", springs.size(), [&](std::size_t p, Row& row) {
    if (!field.at(springs.position[p], shapes)) return;
    row.add(springs.position[p]), row.add(springs.stiffness[p]), row.add(springs.displacement[p]), row.add(springs.set_names[std::size_t(springs.set[p])]);
  });
  std::string lattice;
  if (cloud.lattice) {
    const Lattice& l = *cloud.lattice;
    lattice = concatenate("lattice = { origin = [", exact(l.origin.x), ", ", exact(l.origin.y), ", ", exact(l.origin.z), "], spacing = ", exact(l.spacing), ", size = [", l.size[0], ", ", l.size[1], ", ", l.size[2], "] }\n");
    if (!l.body_cell.empty()) {
      write_body_cells(directory / "body_cells.csv", l);
      lattice += "body_cells = \"body_cells.csv\"\n";
    }
  }
  write_text(directory / "case.toml",
             concatenate("[nodes]\nfile = \"nodes.csv\"\n", lattice, "\n[points]\nfile = \"points.csv\"\noutside = \"merge\"\n\n[springs]\nfile = \"springs.csv\"\n\n[shape_functions]\nbasis = \"",
                         name_of(field.options().basis), "\"\ndilatation = ", exact(field.options().dilatation), "\n\n[solver]\ntolerance_mm = ", exact(solver.tolerance_mm),
                         "\nmax_steps = ", solver.max_steps, "\nrelaxation = \"", solver.relaxation == Relaxation::plain ? "plain" : "two-level", "\"\nload_steps = ", solver.load_steps,
                         "\ncoarse_unknowns = ", solver.coarse_unknowns, "\nstabilisation = ", exact(solver.stabilisation), "\nprecision = \"", solver.double_precision ? "double" : "single", "\"\n"));
}

}  // namespace mtled
