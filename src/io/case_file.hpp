#pragma once
#include <filesystem>
#include <optional>
#include <vector>

#include "core/cloud.hpp"
#include "core/dynamics.hpp"
#include "core/solver.hpp"

namespace mtled {

/// A problem for `mtled solve`.
struct SolveCase {
  Cloud cloud;
  IntegrationPoints points;
  Constraints constraints;
  std::vector<Vec3d> probes;   ///< may be empty
  MlsOptions shapes;
  SolverOptions solver;
  Loads loads;
  std::optional<DynamicsOptions> dynamics;  ///< absent: static equilibrium
};

/// Reads case.toml and the tables that it names (format: docs/solve.md). Every fault is an input error with file, row or
/// key, reason and remedy: unknown key, node that does not exist, node constrained twice with different values, volume or
/// modulus that is not positive, Poisson ratio that is not below 0.5, ...
SolveCase read_case(const std::filesystem::path& path);

}  // namespace mtled
