#pragma once
#include <cstdint>
#include <memory>
#include <vector>

#include "core/constraint_operator.hpp"
#include "core/solver.hpp"
#include "core/stencils.hpp"

namespace mtled {

/// The discrete problem in slots, for every backend: plain data on the host, in double. Refers to the caller's field, points
/// and constraints. Statics need all of it, dynamics only what comes before `constraints`.
struct DiscreteModel {
  const Approximation* field = nullptr;
  const IntegrationPoints* points = nullptr;
  SlotLayout layout;
  std::vector<Vec3d> position;        ///< [num_slots] rest positions [mm]
  SupportTable supports;
  std::unique_ptr<const ConstraintOperator> constraints;
  Springs springs;
  std::vector<Vec3d> external;        ///< [num_slots] dead loads [mN]; empty: none
  std::vector<std::uint8_t> active;   ///< [3 * num_slots] by component, then slot: 1 where a parameter is free, 0 where it is prescribed or no node
  std::vector<std::uint8_t> coarse_active;  ///< the same, also 0 for the parameters that prescribed ones depend on
  std::vector<double> diagonal;       ///< [3 * num_slots] of the stiffness at rest (two-level) or a fictitious mass (plain) [mN/mm]; positive where active
  std::vector<std::uint8_t> watched;  ///< [num_slots] nodes whose increments make the error estimate (inside the body)
  double spacing = 0;                 ///< mean node spacing [mm]
  double largest_increment = 0;       ///< of a step, beyond which the iteration has diverged [mm]
  double largest_distance = 0;        ///< of a node to the nearest place that is held, in node spacings
  std::size_t slots() const { return position.size(); }
};

/// Layout, positions and supports. Points without a usable support give their volume to others in `points`.
DiscreteModel make_discrete_model(const Approximation& field, IntegrationPoints& points);
/// The whole static problem. `points_of_nodes` [out]: see points_per_node(). Input errors: a part of the body that is not
/// held, or no free node.
DiscreteModel make_static_model(const Approximation& field, IntegrationPoints& points, const Constraints& constraints, Springs springs, const Loads& loads, const SolverOptions& options,
                                 std::vector<double>& points_of_nodes);

/// Of all points at displacement u.
struct StateOfPoints {
  double strain_energy = 0;           ///< [mN mm], without springs and nodal pressure
  double smallest_volume_ratio = 0;   ///< det F
  Vec3d worst_place{};                ///< where that is [mm]
  std::size_t inverted = 0;           ///< points with det F <= 0
};
/// `u`: [num_slots] [mm]. In double.
StateOfPoints measure_points(const DiscreteModel& model, const std::vector<Vec3d>& u);

/// The field at some places: row r is the sum of value * parameter over [begin[r], begin[r + 1]).
struct FieldRows {
  std::vector<std::size_t> begin{0};  ///< [rows + 1]
  std::vector<int> slot;
  std::vector<float> value;
  std::size_t size() const { return begin.size() - 1; }
};
FieldRows field_at_watched_nodes(const DiscreteModel& model);

}  // namespace mtled
