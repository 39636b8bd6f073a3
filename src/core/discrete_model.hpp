#pragma once
#include <cstdint>
#include <vector>

#include "core/solver.hpp"
#include "core/stencils.hpp"

namespace mtled {

/// The discrete static problem in slots, for every backend: plain data on the host, in double. Refers to the caller's field,
/// points and constraints.
struct DiscreteModel {
  const Approximation* field = nullptr;
  const IntegrationPoints* points = nullptr;
  const Constraints* constraints = nullptr;
  SlotLayout layout;
  std::vector<Vec3d> position;        ///< [num_slots] rest positions [mm]
  SupportTable supports;
  Springs springs;
  std::vector<Vec3d> external;        ///< [num_slots] dead loads [mN]; empty: none
  std::vector<std::uint8_t> active;   ///< [3 * num_slots] by component, then slot: 1 where a parameter is free, 0 where it is prescribed or no node
  std::vector<double> diagonal;       ///< [3 * num_slots] of the stiffness at rest (two-level) or a fictitious mass (plain) [mN/mm]; positive where active
  std::vector<std::uint8_t> watched;  ///< [num_slots] nodes whose increments make the error estimate (inside the body)
  double spacing = 0;                 ///< mean node spacing [mm]
  double largest_increment = 0;       ///< of a step, beyond which the iteration has diverged [mm]
  double largest_distance = 0;        ///< of a node to the nearest place that is held, in node spacings
  std::size_t slots() const { return position.size(); }
};

}  // namespace mtled
