#pragma once
#include <cuda_runtime_api.h>

#include "core/error.hpp"

/// Throws what went wrong, in which call and where, unless a call of the CUDA runtime succeeded.
#define MTLED_CUDA(call) ::mtled::check_cuda((call), #call, __FILE__, __LINE__)

namespace mtled {

inline void check_cuda(cudaError_t result, const char* call, const char* file, int line) {
  if (result == cudaSuccess) return;
  cudaGetLastError();  // forget it: later calls shall not report it again
  if (result == cudaErrorMemoryAllocation) fail(Failure::memory, "the memory of the GPU is full (", call, "); use a larger node spacing, or --device cpu");
  fail(Failure::device, "the GPU failed: ", cudaGetErrorString(result), " (", cudaGetErrorName(result), ") in ", call, ", ", file, ":", line,
       "; run `mtled info` to see the devices, or use --device cpu");
}

}  // namespace mtled
