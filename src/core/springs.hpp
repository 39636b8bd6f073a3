#pragma once
#include <map>
#include <string>
#include <vector>

#include "core/nodal_field.hpp"
#include "core/stencils.hpp"

namespace mtled {

/// Linear springs between nodal parameters and given places: the energy
///   sum_r stiffness_r / 2 |sum_I coefficient_rI u_I - load * target_r|^2.
/// With shape functions as coefficients and a target they prescribe the motion of a place by penalty; with target 0 they
/// stabilise what the integration points do not see (hourglass modes of elements, zero-energy modes of clouds).
struct Springs {
  std::vector<std::size_t> begin{0};     ///< [num_springs + 1]
  std::vector<int> node;                 ///< [entries]
  std::vector<double> coefficient;       ///< [entries] [1]
  std::vector<double> stiffness;         ///< [num_springs] > 0 [mN/mm]
  std::vector<Vec3d> target;             ///< [num_springs] [mm]
  std::vector<int> set;                  ///< [num_springs] index into set_names; -1: internal, holds nothing
  std::vector<std::string> set_names;
  std::size_t size() const { return stiffness.size(); }
  /// Appends a spring between `nodes` with `coefficients`.
  void add(const std::vector<int>& nodes, const std::vector<double>& coefficients, double k, const Vec3d& to, int in_set);
};

/// Places of the body, each held or pulled by a spring.
struct SpringPlaces {
  std::vector<Vec3d> position;        ///< [n] at rest [mm]
  std::vector<Vec3d> displacement;    ///< [n] at which the spring is slack [mm]
  std::vector<double> stiffness;      ///< [n] > 0 [mN/mm]
  std::vector<int> set;               ///< [n] index into set_names
  std::vector<std::string> set_names;
  std::size_t size() const { return position.size(); }
};
/// `springs`, followed by those of the places on the field's parameters, with the shape functions there as coefficients;
/// places where there are none are left out.
Springs springs_on(const SpringPlaces& places, const Approximation& field, Springs springs = {});

/// Their forces in slots; multi-threaded, with the same bits for any number of threads.
template <class Real>
class SpringForces {
 public:
  SpringForces(const Springs& springs, const SlotLayout& layout);
  /// f += force [mN] at displacement u [mm] and `load` (0..1) of the targets.
  void add_force(const NodalField<Real>& u, double load, NodalField<Real>& f) const;
  /// f += K v
  void add_tangent(const NodalField<Real>& v, NodalField<Real>& f) const { add_force(v, 0, f); }
  /// Energy [mN mm].
  double energy(const NodalField<Real>& u, double load) const;
  /// Per set: force of the springs on the body [mN].
  std::map<std::string, Vec3d> reactions(const NodalField<Real>& u, double load) const;
  /// Calls body(slot, stiffness * coefficient^2) for every entry.
  template <class Body>
  void each_diagonal_term(Body&& body) const {
    for (std::size_t r = 0; r < stiffness_.size(); ++r)
      for (std::size_t e = begin_[r]; e < begin_[r + 1]; ++e) body(std::size_t(slot_[e]), double(stiffness_[r]) * double(coefficient_[e]) * double(coefficient_[e]));
  }

 private:
  /// sum coefficient * u - load * target of spring r
  Vec3d stretch(const NodalField<Real>& u, double load, std::size_t r) const;

  std::vector<std::size_t> begin_;
  std::vector<int> slot_;
  std::vector<Real> coefficient_, stiffness_;
  std::vector<Vec3d> target_;
  std::vector<int> set_;
  std::vector<std::string> set_names_;
  std::vector<int> used_slot_;                ///< slots with springs, ascending
  std::vector<std::size_t> of_slot_;          ///< [used slots + 1] into the next two
  std::vector<std::uint32_t> spring_of_;
  std::vector<Real> coefficient_of_;
};

}  // namespace mtled
