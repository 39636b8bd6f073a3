// The CUDA backend of a program that is built without it.
#include "core/error.hpp"
#include "core/mechanics.hpp"
#include "cuda/backend.hpp"
#include "cuda/field.hpp"

namespace mtled {

CudaStatus cuda_status() {
  CudaStatus status;
  status.problem = "no CUDA device: this program is built without CUDA";
  status.remedy = "build it where there is a CUDA Toolkit, with -DMTLED_CUDA=ON";
  return status;
}

namespace {

[[noreturn]] void refuse() {
  const CudaStatus status = cuda_status();
  fail(Failure::device, status.problem, "; ", status.remedy, ", or use --device cpu");
}

}  // namespace

MakeMechanics cuda_mechanics(int) {
  return [](const DiscreteModel&, const SolverOptions&) -> std::unique_ptr<Mechanics> { refuse(); };
}
double cuda_copy_bandwidth(int) { refuse(); }
std::unique_ptr<FieldBackend> cuda_field(int, const ShapeEvaluator&, const std::vector<Vec3d>&) { refuse(); }
SampleDisplaced cuda_sampler(int) { refuse(); }

}  // namespace mtled
