#pragma once
#include <vector>

#include "core/approximation.hpp"
#include "core/springs.hpp"
#include "core/stencils.hpp"

namespace mtled {

/// Where a cloud has fewer integration points per node than this, some deformations of the nodes cost (almost) no energy and
/// the solution may be arbitrarily rough. Every point gives six strains and every node has three displacements: below 0.5
/// there are more unknowns than strains; at 1 the softest mode has 0.04 to 0.45 of its true energy; at 2 there is no defect. At corners of a
/// body the count falls short by up to a third, so that two points per node are counted as 1.2 to 1.4 there.
constexpr double enough_points_per_node = 1.1;

/// Integration points per node around every node [num_nodes]: the points that see it, per their volume, times the
/// volume of one node: the largest mean over a support there, weighted by volume (at a
/// surface less belongs to a node). 0 where no point sees
/// the node.
std::vector<double> points_per_node(const SupportTable& supports, const SlotLayout& layout, const IntegrationPoints& points);

/// Appends springs that tie the parameter of every node with fewer than `enough_points_per_node` to the field there,
///   energy = strength (2 / n - 1)^2 mu v / h^2 / 2 |u_I - sum_J phi_J(x_I) u_J|^2,
/// with the points per node n there, the mean shear modulus mu, the volume v of the node and h^3 the largest such mean
/// around. The factor of n is how the best strength was found to depend on it. Fields that the basis
/// reproduces, rigid motions among them, are free, and smooth ones cost O(h^2) of their strain energy; what oscillates from
/// node to node does not pass. `per_node`: points_per_node().
void add_stabilisation(const Approximation& field, const SupportTable& supports, const SlotLayout& layout, const IntegrationPoints& points,
                       const std::vector<double>& per_node, double strength, Springs& springs);

}  // namespace mtled
