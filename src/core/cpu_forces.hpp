#pragma once
#include <memory>
#include <vector>

#include "core/cpu_kernels.hpp"
#include "core/nodal_field.hpp"
#include "core/stencils.hpp"

namespace mtled {

/// Internal forces of the whole model on the CPU: multi-threaded, vectorised, and with the same bits for any number of
/// threads. Points are sorted along the slots and cut into ranges so long that every second one shares no node with the
/// others: the even ranges are done in parallel, then the odd ones, each adding to its own stretch of slots in order.
template <class Real>
class CpuForces {
 public:
  CpuForces(const SupportTable& supports, const SlotLayout& layout, const IntegrationPoints& points);
  ~CpuForces();

  /// f = internal force [mN] at displacement u [mm].
  VolumeRatioStatistics force(const NodalField<Real>& u, NodalField<Real>& f) const;
  /// f = K(u) v [mN].
  void tangent(const NodalField<Real>& u, const NodalField<Real>& v, NodalField<Real>& f) const;

  std::size_t bytes() const;              ///< of the tables
  std::size_t aligned_points() const;     ///< points in packs of one stencil
  std::size_t aligned_packs() const;

 private:
  struct Packs;
  std::unique_ptr<Packs> packs_;
};

}  // namespace mtled
