#include "core/springs.hpp"

#include <algorithm>
#include <numeric>

namespace mtled {

void Springs::add(const std::vector<int>& nodes, const std::vector<double>& coefficients, double k, const Vec3d& to, int in_set) {
  node.insert(node.end(), nodes.begin(), nodes.end());
  coefficient.insert(coefficient.end(), coefficients.begin(), coefficients.end());
  begin.push_back(node.size());
  stiffness.push_back(k), target.push_back(to), set.push_back(in_set);
}

Springs springs_on(const SpringPlaces& places, const Approximation& field, Springs springs) {
  std::vector<ShapeFunctions> shapes(places.size());
  parallel_for(shapes.size(), [&](std::size_t p) {
    if (!field.at(places.position[p], shapes[p])) shapes[p].clear();
  }, 256);
  const int first_set = int(springs.set_names.size());
  springs.set_names.insert(springs.set_names.end(), places.set_names.begin(), places.set_names.end());
  for (std::size_t p = 0; p < shapes.size(); ++p)
    if (!shapes[p].node.empty()) springs.add(shapes[p].node, shapes[p].value, places.stiffness[p], places.displacement[p], first_set + places.set[p]);
  return springs;
}

template <class Real>
SpringForces<Real>::SpringForces(const Springs& springs, const SlotLayout& layout)
    : begin_(springs.begin), coefficient_(springs.coefficient.begin(), springs.coefficient.end()),
      stiffness_(springs.stiffness.begin(), springs.stiffness.end()), target_(springs.target), set_(springs.set), set_names_(springs.set_names) {
  for (int n : springs.node) slot_.push_back(layout.slot_of_node[std::size_t(n)]);
  // The same entries by slot, in the order of the springs.
  std::vector<std::uint32_t> spring(slot_.size());
  for (std::size_t r = 0; r < springs.size(); ++r)
    for (std::size_t e = begin_[r]; e < begin_[r + 1]; ++e) spring[e] = std::uint32_t(r);
  std::vector<std::size_t> order(slot_.size());
  std::iota(order.begin(), order.end(), std::size_t(0));
  std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) { return slot_[a] < slot_[b]; });
  for (std::size_t e : order) {
    if (used_slot_.empty() || used_slot_.back() != slot_[e]) used_slot_.push_back(slot_[e]), of_slot_.push_back(spring_of_.size());
    spring_of_.push_back(spring[e]), coefficient_of_.push_back(coefficient_[e]);
  }
  of_slot_.push_back(spring_of_.size());
}

template <class Real>
Vec3d SpringForces<Real>::stretch(const NodalField<Real>& u, double load, std::size_t r) const {
  Vec3d q = (-load) * target_[r];
  for (std::size_t e = begin_[r]; e < begin_[r + 1]; ++e)
    for (int c = 0; c < 3; ++c) q[c] += double(coefficient_[e]) * double(u.at(std::size_t(slot_[e]), c));
  return q;
}

template <class Real>
void SpringForces<Real>::add_force(const NodalField<Real>& u, double load, NodalField<Real>& f) const {
  std::vector<std::array<Real, 3>> pull(stiffness_.size());
  parallel_for(pull.size(), [&](std::size_t r) {
    const Vec3d q = stretch(u, load, r);
    for (int c = 0; c < 3; ++c) pull[r][std::size_t(c)] = Real(double(stiffness_[r]) * q[c]);
  }, 4096);
  parallel_for(used_slot_.size(), [&](std::size_t s) {
    Real sum[3] = {};
    for (std::size_t e = of_slot_[s]; e < of_slot_[s + 1]; ++e)
      for (int c = 0; c < 3; ++c) sum[c] += coefficient_of_[e] * pull[spring_of_[e]][std::size_t(c)];
    for (int c = 0; c < 3; ++c) f.at(std::size_t(used_slot_[s]), c) += sum[c];
  }, 4096);
}

template <class Real>
double SpringForces<Real>::energy(const NodalField<Real>& u, double load) const {
  return parallel_sum(stiffness_.size(), [&](std::size_t begin, std::size_t end) {
    double sum = 0;
    for (std::size_t r = begin; r < end; ++r) sum += double(stiffness_[r]) / 2 * squared_norm(stretch(u, load, r));
    return sum;
  });
}

template <class Real>
std::map<std::string, Vec3d> SpringForces<Real>::reactions(const NodalField<Real>& u, double load) const {
  std::map<std::string, Vec3d> sum;
  for (const std::string& name : set_names_) sum[name] = {};
  for (std::size_t r = 0; r < stiffness_.size(); ++r) {
    if (set_[r] < 0) continue;
    double total = 0;  // of the coefficients: the resultant of the nodal forces
    for (std::size_t e = begin_[r]; e < begin_[r + 1]; ++e) total += double(coefficient_[e]);
    sum[set_names_[std::size_t(set_[r])]] += (-double(stiffness_[r]) * total) * stretch(u, load, r);
  }
  return sum;
}

template class SpringForces<float>;
template class SpringForces<double>;

}  // namespace mtled
