#pragma once
#include "core/gather_table.hpp"
#include "cuda/step_load.hpp"
#include "cuda/vec4.hpp"

namespace mtled {

/// Pass two: f[slot] = sum of volume * P grad over the points around a node, less load * external. Index functor over the
/// threads of the table, one per node. Reads per term 16 bytes of the stencil (float) and 48 of stress; writes 16 bytes.
/// Terms are added in the order of the table. Slots without a row are left as they are.
template <class Real>
struct ForceOfNodes {
  GatherTableView<Real> of_nodes;
  const Vec4<Real>* stress[3];  ///< [places] rows of volume * P [mN mm]
  const Vec4<Real>* external;   ///< [slots] [mN]; null: none
  Vec4<Real>* f;                ///< [slots] [mN]
  StepLoad step;

  MTLED_HD void operator()(int thread) const {
    if (step.over()) return;
    const int slot = of_nodes.row[thread];
    if (slot < 0) return;
    const Real load = external ? Real(step.load()) : Real(0);  // here: its division is a call, across which the sums would spill
    Vec4<Real> sum{};
    of_nodes.each(thread, [&](int place, const GatherEntry<Real>& g) {
      const Vec4<Real> px = stress[0][place], py = stress[1][place], pz = stress[2][place];
      sum.x += px.x * g.x + px.y * g.y + px.z * g.z;
      sum.y += py.x * g.x + py.y * g.y + py.z * g.z;
      sum.z += pz.x * g.x + pz.y * g.y + pz.z * g.z;
    });
    f[slot] = external ? sum - load * external[slot] : sum;
  }
};

}  // namespace mtled
