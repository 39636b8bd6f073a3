// Instantiates every functor for every material, in float and double: for the compiler's report of registers and spills.
#include "cuda/advance.hpp"
#include "cuda/constraints.hpp"
#include "cuda/cuda_device.cuh"
#include "cuda/dense_rows.hpp"
#include "cuda/field_rows.hpp"
#include "cuda/nodal_force.hpp"
#include "cuda/springs.hpp"
#include "cuda/stress.hpp"
#include "cuda/vectors.hpp"

namespace mtled {

template <template <class> class Material, class Real>
void material(CudaDevice& d) {
  d.for_blocks(1, StressOfPoints<Material, Real>{});
  d.for_each(1, TangentOfPoints<Material, Real>{});
  d.for_blocks(1, EnergyOfPoints<Material, Real>{});
}
template <class Real>
void all(CudaDevice& d) {
  material<NeoHookean, Real>(d), material<MooneyRivlin, Real>(d), material<Yeoh, Real>(d), material<Ogden, Real>(d), material<TransverselyIsotropic, Real>(d);
  d.for_each(1, ForceOfNodes<Real>{}), d.for_each(1, PullOfSprings<Real>{}), d.for_each(1, ForceOfSprings<Real>{});
  d.for_blocks(1, RestrictToCells<Real>{}), d.for_each(1, RightSide<Real>{}), d.for_each(1, PreconditionedForce<Real>{});
  d.for_blocks(1, MatrixRows<float, float>{}), d.for_blocks(1, MatrixRows<Real, Real>{});
  d.for_blocks(1, AdvanceNodes<Real>{}), d.for_blocks(1, FinishStep<Real>{});
  d.for_each(1, Combine<Real>{}), d.for_each(1, MultiplyByDiagonal<Real>{}), d.for_blocks(1, DotProduct<Real>{});
  d.for_blocks(1, ReduceValues<double, Add>{}), d.for_blocks(1, ReduceValues<Real, Larger>{}), d.for_blocks(1, ReduceValues<VolumeRatios<Real>, Worse>{});
  d.for_each(1, SetPlaces<Real>{}), d.for_each(1, ZeroPlaces<Real>{}), d.for_each(1, RightOfConstraints<Real>{});
  d.for_each(1, ForceAtPlaces<Real>{}), d.for_each(1, SubtractMultipliers<Real>{}), d.for_blocks(1, LargestOfRows<Real>{});
}
void instantiate(CudaDevice& d) {
  all<float>(d), all<double>(d);
  CudaDevice::Buffer<float> b(d, 8);
  b.copy_from(b);
  d.repeat({&d}, 25, [&] { d.for_each(1, Combine<float>{}); });
}

}  // namespace mtled
