#pragma once
#include <filesystem>

#include "core/shape_evaluator.hpp"
#include "core/solver.hpp"
#include "io/json.hpp"
#include "io/tables.hpp"

namespace mtled {

/// The solver's part of summary.json: converged, steps, error_estimate_mm, strain_energy_mN_mm, reactions_mN, ...
Json summary_of(const Solution& solution);
/// nodes.csv (x,y,z,ux,uy,uz: the field at the nodes) and nodes.vtu (displacement [mm], prescribed: 1 where it was given
/// at nodes, `more`, and points_per_node unless it is empty).
void write_nodes(const std::filesystem::path& directory, const Cloud& cloud, const Constraints& constraints, const Solution& solution, std::vector<PointData> more = {});

}  // namespace mtled
