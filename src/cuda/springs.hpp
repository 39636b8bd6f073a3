#pragma once
#include <vector>

#include "core/springs.hpp"
#include "cuda/step_load.hpp"
#include "cuda/vec4.hpp"

namespace mtled {

/// Pull of each spring, stiffness * (sum coefficient u - load target) [mN]. Index functor, one thread per spring; reads 8
/// bytes per entry (float) and 16 of displacement. The sum is in double, as on the CPU: a stretch is a small difference.
template <class Real>
struct PullOfSprings {
  const std::uint32_t* begin;   ///< [springs + 1]
  const std::int32_t* slot;     ///< [entries]
  const Real* coefficient;      ///< [entries]
  const Real* stiffness;        ///< [springs] [mN/mm]
  const Vec4<Real>* target;     ///< [springs] [mm]
  const Vec4<Real>* u;          ///< [slots] [mm]
  Vec4<Real>* pull;             ///< [springs]
  StepLoad step;

  MTLED_HD void operator()(int spring) const {
    if (step.over()) return;
    const double load = step.load();
    const Vec4<Real> to = target[spring];
    double x = -load * double(to.x), y = -load * double(to.y), z = -load * double(to.z);
    for (std::uint32_t e = begin[spring]; e < begin[spring + 1]; ++e) {
      const Vec4<Real> a = u[slot[e]];
      const double c = double(coefficient[e]);
      x += c * double(a.x), y += c * double(a.y), z += c * double(a.z);
    }
    const double k = double(stiffness[spring]);
    pull[spring] = {Real(k * x), Real(k * y), Real(k * z), Real(0)};
  }
};

/// Adds the pulls to the force of every slot that has springs, in the order of the springs. Index functor over these slots.
/// A slot that no integration point acts on gets its force from here alone.
template <class Real>
struct ForceOfSprings {
  const std::int32_t* slot;           ///< [used slots] the slot, or -1 - slot where there is no force of points to add to
  const std::uint32_t* begin;         ///< [used slots + 1]
  const std::uint32_t* spring;        ///< [entries]
  const Real* coefficient;            ///< [entries]
  const Vec4<Real>* pull;             ///< [springs]
  const Vec4<Real>* external;         ///< [slots] [mN], of slots without points; null: none
  Vec4<Real>* f;                      ///< [slots]
  StepLoad step;

  MTLED_HD void operator()(int i) const {
    if (step.over()) return;
    Vec4<Real> sum{};
    for (std::uint32_t e = begin[i]; e < begin[i + 1]; ++e) sum = sum + coefficient[e] * pull[spring[e]];
    if (slot[i] >= 0) {
      f[slot[i]] = f[slot[i]] + sum;
    } else {
      const int own = -1 - slot[i];
      f[own] = external ? sum - Real(step.load()) * external[own] : sum;
    }
  }
};

/// The tables of both functors on the host.
template <class Real>
struct SpringTables {
  std::vector<std::uint32_t> begin, of_slot, spring;
  std::vector<std::int32_t> slot, used_slot;
  std::vector<Real> coefficient, stiffness, coefficient_of;
  std::vector<Vec4<Real>> target;

  /// `seen`: [num_slots] whether integration points act on a slot.
  SpringTables(const Springs& springs, const SlotLayout& layout, const std::vector<std::uint8_t>& seen);
};

template <class Real>
SpringTables<Real>::SpringTables(const Springs& springs, const SlotLayout& layout, const std::vector<std::uint8_t>& seen)
    : begin(springs.begin.begin(), springs.begin.end()), coefficient(springs.coefficient.begin(), springs.coefficient.end()),
      stiffness(springs.stiffness.begin(), springs.stiffness.end()) {
  for (int n : springs.node) slot.push_back(layout.slot_of_node[std::size_t(n)]);
  for (const Vec3d& t : springs.target) target.push_back({Real(t.x), Real(t.y), Real(t.z), Real(0)});
  // Counting sort of the entries by slot, which keeps the order of the springs.
  std::vector<std::uint32_t> end(std::size_t(layout.num_slots) + 1, 0);
  for (std::int32_t s : slot) ++end[std::size_t(s) + 1];
  for (std::size_t s = 1; s < end.size(); ++s) {
    if (end[s] > 0) {
      const std::int32_t own = std::int32_t(s - 1);
      used_slot.push_back(seen[s - 1] ? own : -1 - own), of_slot.push_back(end[s - 1]);
    }
    end[s] += end[s - 1];
  }
  of_slot.push_back(std::uint32_t(slot.size()));
  spring.resize(slot.size()), coefficient_of.resize(slot.size());
  for (std::uint32_t r = 0; r < springs.size(); ++r)
    for (std::uint32_t e = begin[r]; e < begin[r + 1]; ++e) {
      const std::uint32_t to = end[std::size_t(slot[e])]++;
      spring[to] = r, coefficient_of[to] = coefficient[e];
    }
}

}  // namespace mtled
