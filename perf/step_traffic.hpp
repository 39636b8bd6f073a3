#pragma once
#include "core/discrete_model.hpp"

namespace mtled {

/// Bytes that one step of the relaxation must move at least between memory and processor, when everything that is used more
/// than once in a pass stays in caches and nothing is padded. R = bytes of a real number, indices have 4 bytes.
struct StepTraffic {
  double tables = 0;        ///< per pass: (3 R + 4) per term of a distinct stencil, 8 per point (stencil, first slot), (R + 4) per term of a spring; once 3 R per point (volume, two moduli) and 4 R per spring (stiffness, target)
  double displacement = 0;  ///< 3 R per node: read for the strains
  double stresses = 0;      ///< 2 * 9 R per point: written by the first pass, read by the second; none in a fused pass
  double state = 0;         ///< (7 * 3 R + 1) per node: u, increment and change read and written, diagonal and watched read; in a fused pass 2 * 3 R more, the force written and read
  double coarse = 0;        ///< two-level: 2 * 3 R per node (force written and read, unless counted above) and the dense inverse in single precision
  double total() const { return tables + displacement + stresses + state + coarse; }
};

/// `real`: 4 or 8 bytes. `fused`: forces are added up as soon as a point's stress is known (CPU), instead of a pass over the points and one over
/// the nodes (CUDA). `coarse_unknowns`: 0 where the preconditioner is the diagonal.
StepTraffic step_traffic(const DiscreteModel& model, int real, bool fused, int coarse_unknowns);

}  // namespace mtled
