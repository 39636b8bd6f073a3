#pragma once
#include <map>
#include <string>
#include <vector>

#include "core/approximation.hpp"
#include "core/cloud.hpp"

namespace mtled {

/// A factor in time from a table: constant before its first and after its last row.
struct History {
  std::vector<double> time;    ///< [rows] ascending [s]
  std::vector<double> factor;  ///< [rows] [1]
  bool smooth = false;         ///< 10 s^3 - 15 s^4 + 6 s^5 between rows (no velocity or acceleration at them), not linear
  double at(double t) const;
};

/// What pulls at the body besides prescribed motion. All dead loads: they keep the direction and the size of the rest
/// state, however the body deforms.
struct Loads {
  Vec3d gravity{};                     ///< [mm/s^2]
  std::vector<Vec3d> place, force;     ///< [n] rest positions in the body [mm], forces there [mN]
  std::vector<int> set;                ///< [n] index into set_names
  std::vector<std::string> set_names;
  bool any() const { return !place.empty() || gravity != Vec3d{}; }
};

/// Row sums of the consistent mass, m_I = sum over points of density * volume * phi_I [num_nodes] [kg]. Mass and centre of
/// mass are those of the points, and gravity accelerates all nodes alike. Points without shape functions are left out.
std::vector<double> lumped_mass(const Approximation& field, const IntegrationPoints& points);

/// Nodal forces [mN] of each set of loads, [num_nodes]; gravity, if any, is the set "gravity". Forces at places are
/// distributed by the shape functions there, so that forces and moments are kept. Input error: a place outside the body.
std::map<std::string, std::vector<Vec3d>> nodal_forces(const Approximation& field, const Loads& loads, const std::vector<double>& mass);

}  // namespace mtled
