// The CUDA backend of a program that is built without it.
#include "core/error.hpp"
#include "core/mechanics.hpp"
#include "cuda/backend.hpp"

namespace mtled {

CudaStatus cuda_status() {
  CudaStatus status;
  status.problem = "no CUDA device: this program is built without CUDA";
  status.remedy = "build it where there is a CUDA Toolkit, with -DMTLED_CUDA=ON";
  return status;
}

MakeMechanics cuda_mechanics(int) {
  return [](const DiscreteModel&, const SolverOptions&) -> std::unique_ptr<Mechanics> {
    const CudaStatus status = cuda_status();
    fail(Failure::device, status.problem, "; ", status.remedy, ", or use --device cpu");
  };
}

}  // namespace mtled
