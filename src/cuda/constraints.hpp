#pragma once
#include <array>
#include <vector>

#include "core/constraint_tables.hpp"
#include "cuda/step_load.hpp"
#include "cuda/vec4.hpp"

/// Constraints as in core/constraint_operator.hpp. A prescribed or dependent parameter is named by its place in a field,
/// 4 slot + component. Where the shape functions interpolate (direct), u is set and f is zeroed. Otherwise, in this order:
///   impose: RightOfConstraints, MatrixRows with the inverse into u;
///   reduce: ForceAtPlaces, MatrixRows with the inverse's transpose, SubtractMultipliers, ZeroPlaces.
/// All three components are done by the same launch: their rows follow each other.
namespace mtled {

/// u = load * value at the prescribed places. Index functor over these.
template <class Real>
struct SetPlaces {
  const std::int32_t* place;
  const Real* value;  ///< [mm]
  Real* u;            ///< [4 * slots]
  StepLoad step;
  MTLED_HD void operator()(int b) const {
    if (step.over() || !step.imposes()) return;
    u[place[b]] = Real(step.load() * double(value[b]));
  }
};
/// f = 0 there.
template <class Real>
struct ZeroPlaces {
  const std::int32_t* place;
  Real* f;
  StepLoad step;
  MTLED_HD void operator()(int b) const {
    if (!step.over()) f[place[b]] = 0;
  }
};

/// right = load * value - Phi_BF u_F, in double. Index functor over the rows.
template <class Real>
struct RightOfConstraints {
  const Real* value;
  const std::int32_t* begin;       ///< [rows + 1]
  const std::int32_t* free_place;  ///< [entries]
  const Real* free_value;          ///< [entries]
  const Real* u;                   ///< [4 * slots]
  Real* right;
  StepLoad step;
  MTLED_HD void operator()(int b) const {
    if (step.over()) return;
    double sum = step.load() * double(value[b]);
    for (std::int32_t e = begin[b]; e < begin[b + 1]; ++e) sum -= double(free_value[e]) * double(u[free_place[e]]);
    right[b] = Real(sum);
  }
};
/// f_B in the order of the rows.
template <class Real>
struct ForceAtPlaces {
  const std::int32_t* place;
  const Real* f;
  Real* at;
  StepLoad step;
  MTLED_HD void operator()(int b) const {
    if (!step.over()) at[b] = f[place[b]];
  }
};
/// f_F -= Phi_BF^T lambda. Index functor over the places that Phi_BF has, each with its rows in ascending order.
template <class Real>
struct SubtractMultipliers {
  const std::int32_t* place;       ///< [places]
  const std::int32_t* begin;       ///< [places + 1]
  const std::int32_t* row;         ///< [entries]
  const Real* coefficient;         ///< [entries]
  const Real* multiplier;          ///< [rows] [mN]
  Real* f;
  StepLoad step;
  MTLED_HD void operator()(int i) const {
    if (step.over()) return;
    double sum = 0;
    for (std::int32_t e = begin[i]; e < begin[i + 1]; ++e) sum += double(coefficient[e]) * double(multiplier[row[e]]);
    f[place[i]] -= Real(sum);
  }
};

/// What they read, on the host.
template <class Real>
struct ConstraintArrays {
  bool direct = true;
  int block_begin[4] = {};                                          ///< rows of the components
  std::vector<std::int32_t> place, begin{0}, free_place, identity;  ///< identity: 0, 1, 2 ... by row
  std::vector<Real> value, free_value, inverse, transposed;
  std::vector<std::int32_t> used_place, used_begin{0}, used_row;    ///< Phi_BF by columns
  std::vector<Real> used_value;

  explicit ConstraintArrays(const std::array<ConstraintTable, 3>& tables);
};

template <class Real>
ConstraintArrays<Real>::ConstraintArrays(const std::array<ConstraintTable, 3>& tables) {
  for (const ConstraintTable& t : tables) direct = direct && t.inverse.empty();
  std::vector<std::vector<std::pair<std::int32_t, Real>>> column;  // by place
  for (int c = 0; c < 3; ++c) {
    const ConstraintTable& t = tables[std::size_t(c)];
    const std::size_t n = t.slot.size();
    for (std::size_t b = 0; b < n; ++b) {
      identity.push_back(std::int32_t(place.size()));
      place.push_back(4 * t.slot[b] + c), value.push_back(Real(t.value[b]));
      if (!t.inverse.empty())
        for (std::size_t e = std::size_t(t.begin[b]); e < std::size_t(t.begin[b + 1]); ++e) {
          const std::size_t to = std::size_t(4 * t.free_slot[e] + c);
          free_place.push_back(std::int32_t(to)), free_value.push_back(Real(t.free_value[e]));
          if (column.size() <= to) column.resize(to + 1);
          column[to].push_back({identity.back(), free_value.back()});
        }
      begin.push_back(std::int32_t(free_place.size()));
    }
    block_begin[c + 1] = int(place.size());
    if (direct) continue;
    for (std::size_t r = 0; r < n; ++r)
      for (std::size_t s = 0; s < n; ++s) {
        const auto entry = [&](std::size_t i, std::size_t j) { return t.inverse.empty() ? Real(i == j) : Real(t.inverse[i * n + j]); };
        inverse.push_back(entry(r, s)), transposed.push_back(entry(s, r));
      }
  }
  for (std::size_t to = 0; to < column.size(); ++to) {
    if (column[to].empty()) continue;
    used_place.push_back(std::int32_t(to));
    for (const auto& [row, coefficient] : column[to]) used_row.push_back(row), used_value.push_back(coefficient);
    used_begin.push_back(std::int32_t(used_row.size()));
  }
}

}  // namespace mtled
