#pragma once
#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "core/material_model.hpp"
#include "core/moving_least_squares.hpp"
#include "core/tensor.hpp"

namespace mtled {

/// A regular grid of possible node positions: origin + spacing * (i, j, k), axes along LPS.
struct Lattice {
  Vec3d origin{};                    ///< [mm]
  double spacing = 0;                ///< [mm]
  std::array<int, 3> size{};         ///< positions along i, j, k
  std::vector<int> node_at;          ///< [size] node number at each position (i fastest), -1 where there is none
  std::vector<std::uint8_t> body_cell;  ///< [size] nonzero where the cell from (i, j, k) to (i + 1, j + 1, k + 1) holds body; empty: all cells do

  std::size_t offset(int i, int j, int k) const {
    return std::size_t(i) + std::size_t(size[0]) * (std::size_t(j) + std::size_t(size[1]) * std::size_t(k));
  }
  bool contains(int i, int j, int k) const {
    return i >= 0 && j >= 0 && k >= 0 && i < size[0] && j < size[1] && k < size[2];
  }
  int node(int i, int j, int k) const { return contains(i, j, k) ? node_at[offset(i, j, k)] : -1; }
  bool holds_body(int i, int j, int k) const { return body_cell.empty() || (contains(i, j, k) && body_cell[offset(i, j, k)]); }
};

/// The nodes that carry the displacement.
struct Cloud {
  std::vector<Vec3d> nodes;                    ///< [num_nodes] rest positions [mm]
  std::optional<Lattice> lattice;              ///< present when every node is on it
  std::vector<std::array<int, 3>> lattice_ijk; ///< [num_nodes] when on a lattice
  std::size_t size() const { return nodes.size(); }
};

/// Where the stress is evaluated; each stands for a piece of the body.
struct IntegrationPoints {
  std::vector<Vec3d> position;        ///< [num_points] rest positions [mm]
  std::vector<double> volume;         ///< [num_points] > 0 [mm^3]
  std::vector<double> shear_modulus;  ///< [num_points] >= 0 [kPa] at rest; of the matrix between fibres; instantaneous
  std::vector<double> bulk_modulus;   ///< [num_points] > 0 [kPa] at rest; instantaneous
  std::vector<double> density;        ///< [num_points] >= 0 [kg/mm^3]
  MaterialModel model = MaterialModel::neo_hookean;
  std::vector<double> further;        ///< [num_points * further_parameters(model)] in the order of the struct in core/material.hpp
  std::vector<PronyTerm> prony;       ///< of the whole body; empty: elastic
  std::size_t size() const { return position.size(); }
  bool viscoelastic() const { return !prony.empty(); }
};

/// Sums of alpha and alpha_volumetric.
PronyTerm total(const std::vector<PronyTerm>& prony);
/// The same points with the elastic moduli that are left when all memory has faded: isochoric ones times 1 - sum alpha, the
/// bulk modulus times 1 - sum alpha_volumetric.
IntegrationPoints long_term(IntegrationPoints points);

/// Prescribed displacement of nodes.
struct Constraints {
  std::vector<int> node;                      ///< [n] each node once
  std::vector<Vec3d> displacement;            ///< [n] [mm]; components that are not prescribed hold 0
  std::vector<std::array<bool, 3>> fixed;     ///< [n] which components are prescribed
  std::vector<int> set;                       ///< [n] index into set_names
  std::vector<std::string> set_names;
};

/// Cloud of given nodes; `promise`: every node is on that lattice of origin and spacing (input error with the first row
/// that breaks it, or when two nodes share a place). Where its size is 0 the lattice becomes as large as the nodes need.
Cloud make_cloud(std::vector<Vec3d> nodes, std::optional<Lattice> promise);

/// On a lattice: marks the cells that hold body, so that no support reaches across a gap. These are the cells with a point, and those of which points fill a tenth, each point standing for a cube. No effect on other clouds.
void mark_body_cells(Cloud& cloud, const IntegrationPoints& points);

}  // namespace mtled
