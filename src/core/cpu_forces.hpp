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

  /// f = internal force [mN] at displacement u [mm]; of a viscoelastic body that of the long-term moduli.
  VolumeRatioStatistics force(const NodalField<Real>& u, NodalField<Real>& f) const;
  /// f = internal force [mN] after `time_step` [s] >= 0, at whose end the displacement is u: the memory of a viscoelastic body
  /// goes on by that step (backward Euler, as in NiftySim). It starts at rest, so that the first step of length 0 gives
  /// the response at once. Without viscoelasticity the same as force().
  VolumeRatioStatistics force_in_time(const NodalField<Real>& u, double time_step, NodalField<Real>& f);
  bool viscoelastic() const;
  /// f = K(u) v [mN].
  void tangent(const NodalField<Real>& u, const NodalField<Real>& v, NodalField<Real>& f) const;

  std::size_t bytes() const;              ///< of the tables
  std::size_t aligned_points() const;     ///< points in packs of one stencil
  std::size_t aligned_packs() const;

 private:
  /// kernel(range number) over all ranges, and their statistics together.
  template <class Kernel>
  VolumeRatioStatistics over_ranges(Kernel&& kernel) const;
  struct Packs;
  std::unique_ptr<Packs> packs_;
};

}  // namespace mtled
