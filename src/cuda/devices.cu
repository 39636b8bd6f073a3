// What devices there are, and whether this program runs on them.
#include <cuda_runtime.h>

#include "core/error.hpp"
#include "cuda/backend.hpp"

namespace mtled {
namespace {

constexpr int architectures[] = {__CUDA_ARCH_LIST__};  // 750 is compute capability 7.5
constexpr int answer = 42;

__global__ void write_answer(int* to) { *to = answer; }

std::string version_text(int version) { return concatenate(version / 1000, ".", version % 1000 / 10); }

std::string architectures_text() {
  std::string text;
  for (const int a : architectures) text += concatenate(text.empty() ? "" : ", ", a / 100, ".", a % 100 / 10);
  return text;
}

/// Runs a kernel on the current device and reads what it wrote.
cudaError_t try_kernel(int& written) {
  int* memory = nullptr;
  cudaError_t error = cudaMalloc(&memory, sizeof *memory);
  if (error != cudaSuccess) return error;
  write_answer<<<1, 1>>>(memory);
  error = cudaGetLastError();
  if (error == cudaSuccess) error = cudaMemcpy(&written, memory, sizeof written, cudaMemcpyDeviceToHost);
  cudaFree(memory);
  return error;
}

std::string why(cudaError_t error) { return concatenate(cudaGetErrorString(error), " (", cudaGetErrorName(error), ")"); }

std::string why_unusable(cudaError_t error, const DeviceDescription& device) {
  switch (error) {
    case cudaErrorNoKernelImageForDevice:
    case cudaErrorInvalidDeviceFunction:
    case cudaErrorUnsupportedPtxVersion:
    case cudaErrorInvalidPtx:
      return concatenate("this program has no code for its compute capability ", device.capability_major, ".", device.capability_minor, " (it has ", architectures_text(),
                         "); build with -DCMAKE_CUDA_ARCHITECTURES=", device.capability_major, device.capability_minor);
    case cudaErrorDevicesUnavailable:
      return "another program has it for itself, or its compute mode is `prohibited`; wait, or ask who administers the machine";
    case cudaErrorMemoryAllocation:
      return "its memory is all in use; end other programs on it (`nvidia-smi` lists them)";
    default:
      return concatenate("it fails with: ", why(error), "; look at `nvidia-smi`, and restart the machine if it shows an error");
  }
}

DeviceDescription describe(int ordinal) {
  DeviceDescription device;
  device.ordinal = ordinal;
  cudaDeviceProp properties{};
  cudaError_t error = cudaGetDeviceProperties(&properties, ordinal);
  if (error == cudaSuccess) {
    device.name = properties.name;
    device.capability_major = properties.major, device.capability_minor = properties.minor;
    device.multiprocessors = properties.multiProcessorCount;
    device.memory_bytes = double(properties.totalGlobalMem);
    error = cudaSetDevice(ordinal);
  }
  std::size_t free = 0, total = 0;
  if (error == cudaSuccess) error = cudaMemGetInfo(&free, &total);
  device.free_bytes = double(free);
  int written = 0, pools = 0;
  if (error == cudaSuccess) error = cudaDeviceGetAttribute(&pools, cudaDevAttrMemoryPoolsSupported, ordinal);
  if (error == cudaSuccess) error = try_kernel(written);
  if (error != cudaSuccess) {
    device.unusable = why_unusable(error, device);
    (void)cudaGetLastError();  // the next device begins without it
  } else if (written != answer) {
    device.unusable = concatenate("a kernel wrote ", written, " instead of ", answer, "; its memory or its driver is defective");
  } else if (!pools) {
    device.unusable = "its driver has no memory pools; install a newer one, or give the virtual machine the whole GPU";
  }
  cudaDeviceReset();  // leaves nothing of this program on devices that it will not use
  return device;
}

CudaStatus look_for_devices() {
  CudaStatus status;
  status.built = true;
  status.architectures = architectures_text();
  int runtime = 0, driver = 0, count = 0, before = 0;
  cudaRuntimeGetVersion(&runtime);
  status.runtime = version_text(runtime);
  if (cudaDriverGetVersion(&driver) == cudaSuccess && driver > 0) status.driver = version_text(driver);
  const cudaError_t error = cudaGetDeviceCount(&count);
  if (error != cudaSuccess) (void)cudaGetLastError();
  if (status.driver.empty()) {
    status.problem = "no CUDA device: the driver is not installed";
    status.remedy = concatenate("install an NVIDIA driver that supports CUDA ", status.runtime, " (in a container: start it with the GPU, as `docker run --gpus all` does)");
  } else if (error == cudaErrorInsufficientDriver) {
    status.problem = concatenate("no CUDA device: the driver supports CUDA ", status.driver, ", this program needs ", status.runtime);
    status.remedy = "install a newer NVIDIA driver, or build with an older CUDA Toolkit";
  } else if (error == cudaErrorNoDevice || (error == cudaSuccess && count == 0)) {
    status.problem = "no CUDA device: the driver knows of none";
    status.remedy = "look at `nvidia-smi`, and whether CUDA_VISIBLE_DEVICES hides them";
  } else if (error != cudaSuccess) {
    status.problem = concatenate("no CUDA device: the driver fails with: ", why(error));
    status.remedy = "look at `nvidia-smi`; after an update of the driver, restart the machine";
  }
  if (!status.problem.empty()) return status;
  cudaGetDevice(&before);
  for (int ordinal = 0; ordinal < count; ++ordinal) status.devices.push_back(describe(ordinal));
  cudaSetDevice(before);
  (void)cudaGetLastError();
  return status;
}

}  // namespace

CudaStatus cuda_status() {
  static const CudaStatus status = look_for_devices();
  return status;
}

}  // namespace mtled
