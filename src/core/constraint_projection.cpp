#include "core/constraint_projection.hpp"

#include <Eigen/Sparse>
#include <Eigen/SparseCholesky>
#include <cmath>

#include "core/constraint_operator.hpp"
#include "core/error.hpp"

namespace mtled {
/// The prescribed values of one displacement component.
struct ConstraintProjection::Component {
  std::vector<int> row;                 ///< [n] index into Constraints
  std::vector<int> slot;                ///< [n]
  bool direct = true;                   ///< Phi is the identity: it and the factor are not used
  std::vector<int> begin{0}, entry_slot;  ///< Phi by rows
  std::vector<double> entry_value;
  Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>> factor;  ///< of Phi M^-1 Phi^T
};

ConstraintProjection::ConstraintProjection(const Approximation& field, const SlotLayout& layout, const Constraints& constraints, const std::vector<double>& inverse_mass)
    : inverse_mass_(&inverse_mass), rows_(constraints.node.size()) {
  const std::vector<ShapeFunctions> shapes = shapes_at_prescribed_nodes(field, constraints);
  for (int c = 0; c < 3; ++c) {
    auto k = std::make_unique<Component>();
    std::vector<Eigen::Triplet<double>> scaled;  // Phi M^-1/2
    for (std::size_t b = 0; b < rows_; ++b) {
      if (!constraints.fixed[b][std::size_t(c)]) continue;
      const int own = layout.slot_of_node[std::size_t(constraints.node[b])];
      for (std::size_t i = 0; i < shapes[b].node.size(); ++i) {
        const int slot = layout.slot_of_node[std::size_t(shapes[b].node[i])];
        const double value = shapes[b].value[i];
        k->direct = k->direct && std::abs(value - (slot == own ? 1 : 0)) < interpolation_tolerance;
        k->entry_slot.push_back(slot), k->entry_value.push_back(value);
        scaled.emplace_back(int(k->row.size()), slot, value * std::sqrt(inverse_mass[std::size_t(slot)]));
      }
      k->begin.push_back(int(k->entry_slot.size()));
      k->row.push_back(int(b)), k->slot.push_back(own);
    }
    if (!k->direct) {
      Eigen::SparseMatrix<double> phi(Eigen::Index(k->row.size()), layout.num_slots);
      phi.setFromTriplets(scaled.begin(), scaled.end());
      k->factor.compute(Eigen::SparseMatrix<double>(phi * phi.transpose()));
      const auto pivots = k->factor.vectorD();
      require(k->factor.info() == Eigen::Success && pivots.minCoeff() > 1e-12 * pivots.maxCoeff(),
              "the displacements of the prescribed nodes are not independent: some of these nodes are too close together, or have no integration points around "
              "them; thin them out");
    }
    component_.push_back(std::move(k));
  }
}

ConstraintProjection::~ConstraintProjection() = default;

std::vector<Vec3d> ConstraintProjection::project(const NodalField<double>& u, const std::vector<Vec3d>& value, NodalField<double>& d) const {
  const std::vector<double>& inverse_mass = *inverse_mass_;
  std::vector<Vec3d> multiplier(rows_);
  for (int c = 0; c < 3; ++c) {
    const Component& k = *component_[std::size_t(c)];
    const double* from = u.component(c);
    double* to = d.component(c);
    if (k.direct) {
      for (std::size_t b = 0; b < k.slot.size(); ++b) {
        const int s = k.slot[b];
        const std::size_t row = std::size_t(k.row[b]);
        const double wanted = value[row][c] - from[s], weight = inverse_mass[std::size_t(s)];
        multiplier[row][c] = weight > 0 ? (wanted - to[s]) / weight : 0;
        to[s] = wanted;
      }
      continue;
    }
    Eigen::VectorXd gap(Eigen::Index(k.row.size()));
    for (std::size_t b = 0; b < k.row.size(); ++b) {
      double g = value[std::size_t(k.row[b])][c];
      for (int e = k.begin[b]; e < k.begin[b + 1]; ++e) {
        const int s = k.entry_slot[std::size_t(e)];
        g -= k.entry_value[std::size_t(e)] * (from[s] + to[s]);
      }
      gap[Eigen::Index(b)] = g;
    }
    const Eigen::VectorXd mu = k.factor.solve(gap);
    for (std::size_t b = 0; b < k.row.size(); ++b) {
      multiplier[std::size_t(k.row[b])][c] = mu[Eigen::Index(b)];
      for (int e = k.begin[b]; e < k.begin[b + 1]; ++e) {
        const int s = k.entry_slot[std::size_t(e)];
        to[s] += inverse_mass[std::size_t(s)] * k.entry_value[std::size_t(e)] * mu[Eigen::Index(b)];
      }
    }
  }
  return multiplier;
}

}  // namespace mtled
