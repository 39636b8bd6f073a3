#include "core/constraint_operator.hpp"

#include <Eigen/Sparse>
#include <Eigen/SparseLU>
#include <cmath>

#include "core/error.hpp"

namespace mtled {
namespace {

constexpr double worst_magnification = 1e8;  ///< ordinary clouds have 5 to 60; with two nodes 1e-5 spacings apart (1e10) single precision no longer converges

}  // namespace

std::vector<ShapeFunctions> shapes_at_prescribed_nodes(const Approximation& field, const Constraints& constraints) {
  std::vector<ShapeFunctions> shapes(constraints.node.size());
  for (std::size_t b = 0; b < shapes.size(); ++b)
    require(field.at(field.cloud().nodes[std::size_t(constraints.node[b])], shapes[b]), "node ", constraints.node[b],
            " has a prescribed displacement but too few nodes around it for shape functions; add nodes or remove it");
  return shapes;
}

/// The prescribed values of one displacement component.
struct ConstraintOperator::Component {
  std::vector<int> row;                 ///< [n] index into Constraints
  std::vector<int> slot;                ///< [n]
  std::vector<double> value;            ///< [n] [mm]
  bool direct = true;
  std::vector<int> begin, free_slot;    ///< Phi_BF by rows
  std::vector<double> free_value;
  Eigen::SparseLU<Eigen::SparseMatrix<double>> factor, factor_transposed;

  /// `f`: force at a slot
  template <class Force>
  Eigen::VectorXd multipliers(const Force& f) const {
    Eigen::VectorXd fb(Eigen::Index(slot.size()));
    for (std::size_t b = 0; b < slot.size(); ++b) fb[Eigen::Index(b)] = f(slot[b]);
    return direct ? fb : Eigen::VectorXd(factor_transposed.solve(fb));
  }

  /// Largest factor by which solving for the parameters magnifies errors of the values, 1 / smallest singular value of
  /// Phi_BB, by inverse iteration; `worst` [out]: the row that it concerns most.
  double magnification(std::size_t& worst) const {
    Eigen::VectorXd v(Eigen::Index(slot.size()));
    for (Eigen::Index b = 0; b < v.size(); ++b) v[b] = std::cos(double(b));  // no pattern that a mode could be orthogonal to
    double squared = 1;
    constexpr int iterations = 10;
    for (int i = 0; i < iterations; ++i) {
      v.normalize();
      v = factor.solve(factor_transposed.solve(v));
      squared = v.norm();
    }
    Eigen::Index at;
    v.cwiseAbs().maxCoeff(&at);
    worst = std::size_t(row[std::size_t(at)]);
    return std::sqrt(squared);
  }
};

ConstraintOperator::ConstraintOperator(const Approximation& field, const SlotLayout& layout, const Constraints& constraints)
    : constraints_(&constraints) {
  const std::size_t n = constraints.node.size();
  const std::vector<ShapeFunctions> shapes = shapes_at_prescribed_nodes(field, constraints);
  for (int c = 0; c < 3; ++c) {
    auto component = std::make_unique<Component>();
    std::vector<int> number(std::size_t(layout.num_slots), -1);
    for (std::size_t b = 0; b < n; ++b) {
      if (!constraints.fixed[b][std::size_t(c)]) continue;
      const int slot = layout.slot_of_node[std::size_t(constraints.node[b])];
      number[std::size_t(slot)] = int(component->slot.size());
      component->row.push_back(int(b)), component->slot.push_back(slot), component->value.push_back(constraints.displacement[b][c]);
    }
    std::vector<Eigen::Triplet<double>> bb;
    component->begin.push_back(0);
    for (std::size_t k = 0; k < component->row.size(); ++k) {
      const ShapeFunctions& s = shapes[std::size_t(component->row[k])];
      for (std::size_t i = 0; i < s.node.size(); ++i) {
        const int slot = layout.slot_of_node[std::size_t(s.node[i])];
        const double delta = slot == component->slot[k] ? 1 : 0;
        component->direct = component->direct && std::abs(s.value[i] - delta) < interpolation_tolerance;
        if (number[std::size_t(slot)] >= 0) {
          bb.emplace_back(int(k), number[std::size_t(slot)], s.value[i]);
        } else {
          component->free_slot.push_back(slot), component->free_value.push_back(s.value[i]);
        }
      }
      component->begin.push_back(int(component->free_slot.size()));
    }
    if (!component->direct) {
      Eigen::SparseMatrix<double> phi(Eigen::Index(component->row.size()), Eigen::Index(component->row.size()));
      phi.setFromTriplets(bb.begin(), bb.end());
      component->factor.compute(phi);
      const Eigen::SparseMatrix<double> transposed = phi.transpose();
      component->factor_transposed.compute(transposed);
      require(component->factor.info() == Eigen::Success && component->factor_transposed.info() == Eigen::Success,
              "the prescribed nodes' shape functions cannot be inverted: some of these nodes are too close together; thin them out");
      std::size_t worst;
      if (component->magnification(worst) > worst_magnification) {
        const int node = constraints.node[worst];
        const Vec3d& x = field.cloud().nodes[std::size_t(node)];
        fail(Failure::input, "node ", node, " at (", x.x, ", ", x.y, ", ", x.z,
             ") mm has a prescribed displacement and all but the same support as another such node: rounding would be magnified until nothing converges; they are too close together, remove one of them");
      }
    }
    component_.push_back(std::move(component));
  }
}

ConstraintOperator::~ConstraintOperator() = default;

template <class Real>
void ConstraintOperator::impose(NodalField<Real>& u, double load) const {
  for (int c = 0; c < 3; ++c) {
    const Component& k = *component_[std::size_t(c)];
    Real* to = u.component(c);
    if (k.direct) {
      for (std::size_t b = 0; b < k.slot.size(); ++b) to[k.slot[b]] = Real(load * k.value[b]);
      continue;
    }
    Eigen::VectorXd right(Eigen::Index(k.slot.size()));
    for (std::size_t b = 0; b < k.slot.size(); ++b) {
      double r = load * k.value[b];
      for (int s = k.begin[b]; s < k.begin[b + 1]; ++s) r -= k.free_value[std::size_t(s)] * double(to[k.free_slot[std::size_t(s)]]);
      right[Eigen::Index(b)] = r;
    }
    const Eigen::VectorXd ub = k.factor.solve(right);
    for (std::size_t b = 0; b < k.slot.size(); ++b) to[k.slot[b]] = Real(ub[Eigen::Index(b)]);
  }
}

template <class Real>
void ConstraintOperator::reduce(NodalField<Real>& f) const {
  for (int c = 0; c < 3; ++c) {
    const Component& k = *component_[std::size_t(c)];
    Real* to = f.component(c);
    if (!k.direct) {
      const Eigen::VectorXd lambda = k.multipliers([&](int slot) { return double(to[slot]); });
      for (std::size_t b = 0; b < k.slot.size(); ++b)
        for (int s = k.begin[b]; s < k.begin[b + 1]; ++s)
          to[k.free_slot[std::size_t(s)]] -= Real(k.free_value[std::size_t(s)] * lambda[Eigen::Index(b)]);
    }
    for (int slot : k.slot) to[slot] = 0;
  }
}

std::vector<Vec3d> ConstraintOperator::reactions(const std::vector<Vec3d>& internal) const {
  std::vector<Vec3d> reaction(constraints_->node.size());
  for (int c = 0; c < 3; ++c) {
    const Component& k = *component_[std::size_t(c)];
    if (k.slot.empty()) continue;
    const Eigen::VectorXd lambda = k.multipliers([&](int slot) { return internal[std::size_t(slot)][c]; });
    for (std::size_t b = 0; b < k.slot.size(); ++b) reaction[std::size_t(k.row[b])][c] = lambda[Eigen::Index(b)];
  }
  return reaction;
}

bool ConstraintOperator::direct() const {
  return component_[0]->direct && component_[1]->direct && component_[2]->direct;
}

void ConstraintOperator::each_dependent(bool neighbours, const std::function<void(int, int)>& body) const {
  for (int c = 0; c < 3; ++c) {
    const Component& k = *component_[std::size_t(c)];
    for (int slot : k.slot) body(slot, c);
    if (neighbours && !k.direct)
      for (int slot : k.free_slot) body(slot, c);
  }
}

double ConstraintOperator::inverse_entries() const {
  double entries = 0;
  for (const auto& k : component_)
    if (!k->direct) entries += double(k->slot.size()) * double(k->slot.size());
  return entries;
}

ConstraintTable ConstraintOperator::table(int component) const {
  const Component& k = *component_[std::size_t(component)];
  ConstraintTable table{k.slot, k.value, k.begin, k.free_slot, k.free_value, {}};
  if (k.direct) return table;
  const std::size_t n = k.slot.size();
  table.inverse.resize(n * n);
  parallel_for(n, [&](std::size_t s) {
    const Eigen::VectorXd column = k.factor.solve(Eigen::VectorXd::Unit(Eigen::Index(n), Eigen::Index(s)));
    for (std::size_t r = 0; r < n; ++r) table.inverse[r * n + s] = column[Eigen::Index(r)];
  }, 16);
  return table;
}

template void ConstraintOperator::impose(NodalField<float>&, double) const;
template void ConstraintOperator::impose(NodalField<double>&, double) const;
template void ConstraintOperator::reduce(NodalField<float>&) const;
template void ConstraintOperator::reduce(NodalField<double>&) const;

}  // namespace mtled
