#pragma once
#include <filesystem>

#include "core/shape_evaluator.hpp"
#include "core/solver.hpp"

namespace mtled {

/// Writes the equilibrium of a body that springs hold as a case that `mtled solve` reads (docs/solve.md): case.toml, written
/// last, nodes.csv, body_cells.csv on a lattice that knows them, points.csv and springs.csv. Numbers have as many digits as
/// a double needs, so that the case has the same solution, bit for bit. Springs at places without shape functions are left
/// out, as springs_on() does. The points are elastic and neo-Hookean, and
/// the names of sets have neither commas nor quotes.
/// Output errors: those of write_atomically().
void write_case(const std::filesystem::path& directory, const ShapeEvaluator& field, const IntegrationPoints& points, const SpringPlaces& springs, const SolverOptions& solver);

}  // namespace mtled
