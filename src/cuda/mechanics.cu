// The CUDA backend of the solver.
#include "cuda/backend.hpp"
#include "cuda/cuda_device.cuh"
#include "cuda/device_mechanics.hpp"

namespace mtled {

MakeMechanics cuda_mechanics(int ordinal) {
  return [ordinal](const DiscreteModel& model, const SolverOptions& options) -> std::unique_ptr<Mechanics> {
    MTLED_CUDA(cudaSetDevice(ordinal));
    if (options.double_precision) return std::make_unique<DeviceMechanics<double, CudaDevice>>(model, options);
    return std::make_unique<DeviceMechanics<float, CudaDevice>>(model, options);
  };
}

}  // namespace mtled
