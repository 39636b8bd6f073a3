#pragma once
#include <filesystem>
#include <optional>
#include <vector>

#include "core/cloud.hpp"
#include "core/dynamics.hpp"
#include "core/finite_elements.hpp"
#include "core/shape_evaluator.hpp"
#include "core/solver.hpp"

namespace mtled {

/// A problem for `mtled solve`.
struct SolveCase {
  Cloud cloud;
  IntegrationPoints points;    ///< one per element where there are elements
  bool align_points = true;    ///< with the lattice cells that touch prescribed nodes (core/coupled_integration.hpp)
  bool merge_points_outside = false;  ///< points where there are no nodes give their volume to the nearest others; false: they are errors
  Constraints constraints;
  SpringPlaces springs;        ///< may be empty
  bool couple = true;          ///< on a lattice: prescribed nodes with finite elements; false: collocation, as on other clouds
  std::vector<Vec3d> probes;   ///< may be empty
  MlsOptions shapes;           ///< where there are no elements
  Elements elements;           ///< may be empty
  double hourglass = 0.02;     ///< of hexahedra
  bool nodal_pressure = false; ///< of tetrahedra
  SolverOptions solver;
  Loads loads;
  std::optional<DynamicsOptions> dynamics;  ///< absent: static equilibrium
};

/// What the case is discretised with: moving least squares or finite elements, the springs that stabilise them, and those
/// of the case (input error: one at a place without shape functions). Refers to the case.
struct Discretisation {
  std::unique_ptr<Approximation> field;
  Springs springs;
};
Discretisation discretise(const SolveCase& problem);

/// Reads case.toml and the tables that it names (format: docs/solve.md). Every fault is an input error with file, row or
/// key, reason and remedy: unknown key, node that does not exist, node constrained twice with different values, volume or
/// modulus that is not positive, Poisson ratio that is not below 0.5, ...
SolveCase read_case(const std::filesystem::path& path);

}  // namespace mtled
