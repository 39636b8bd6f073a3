// The CUDA backend of the solver.
#include <algorithm>
#include <chrono>

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

double cuda_copy_bandwidth(int ordinal) {
  MTLED_CUDA(cudaSetDevice(ordinal));
  CudaDevice device;
  constexpr std::size_t size = std::size_t(1) << 30;
  CudaDevice::Buffer<char> from(device, size), to(device, size);
  std::vector<double> seconds;
  for (int r = 0; r < 12; ++r) {
    device.synchronize();
    const auto started = std::chrono::steady_clock::now();
    to.copy_from(from);
    device.synchronize();
    seconds.push_back(std::chrono::duration<double>(std::chrono::steady_clock::now() - started).count());
  }
  std::nth_element(seconds.begin(), seconds.begin() + 6, seconds.end());
  return 2e-9 * double(size) / seconds[6];
}

}  // namespace mtled
