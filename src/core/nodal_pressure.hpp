#pragma once
#include <array>
#include <vector>

#include "core/cloud.hpp"
#include "core/nodal_field.hpp"
#include "core/stencils.hpp"

namespace mtled {

/// Pressure averaged at the nodes of 4-node tetrahedra, which lock otherwise (Bonet & Burton 1998). With J_a and k_a the
/// means of J and k over the elements around node a, weighted with volume, and V_a a quarter of these elements' volume,
///   W = sum_e V_e W_isochoric(F_e) + sum_a V_a k_a / 2 (J_a - 1)^2,
/// so the pressure of an element is the mean over its nodes of k_a (J_a - 1). This class is the difference to the
/// standard elements, whose pressure is k_e (J_e - 1): it suits every material with that volumetric part. Scalar code in
/// double precision, multi-threaded, with the same bits for any number of threads.
template <class Real>
class NodalPressure {
 public:
  /// One integration point per tetrahedron.
  NodalPressure(const SupportTable& supports, const IntegrationPoints& points);
  /// f += force [mN] at displacement u [mm]
  void add_force(const NodalField<Real>& u, NodalField<Real>& f) const;
  /// f += K(u) v
  void add_tangent(const NodalField<Real>& u, const NodalField<Real>& v, NodalField<Real>& f) const;
  /// Energy [mN mm], negative where the standard elements have too much.
  double energy(const NodalField<Real>& u) const;

 private:
  struct Tetrahedron {
    std::array<int, 4> slot, node;  ///< node: index into slot_
    std::array<Vec3d, 4> gradient;  ///< [1/mm]
    double volume, bulk_modulus;    ///< [mm^3], [kPa]
  };
  /// sum_I u_I (x) grad N_I
  static Mat3d gradient(const NodalField<Real>& u, const Tetrahedron& t);
  /// [nodes] means of `of_element` over the elements around each node.
  std::vector<double> nodal_means(const std::vector<double>& of_element) const;
  /// [elements] mean over the nodes of k_a * (mean of change) minus k_e * change [kPa], for change = J - 1 or its derivative.
  std::vector<double> pressure_excess(const std::vector<double>& change) const;
  /// f_I += sum_e S_e grad N_I
  void gather(const std::vector<Mat3d>& S, NodalField<Real>& f) const;

  std::vector<Tetrahedron> tetrahedra_;
  std::vector<int> slot_;                   ///< [nodes] slots with tetrahedra, ascending
  std::vector<std::size_t> begin_;          ///< [nodes + 1] into the next two
  std::vector<std::uint32_t> element_of_;   ///< elements around each node, ascending
  std::vector<std::uint8_t> corner_of_;     ///< which of their corners the node is
  std::vector<double> volume_, bulk_modulus_;  ///< [nodes] V_a, k_a
};

}  // namespace mtled
