#pragma once
#include <string>

#include "cuda/backend.hpp"

namespace mtled {

/// What a user asks for with --device.
struct DeviceRequest {
  enum Kind { automatic, cpu, cuda };
  Kind kind = automatic;
  int ordinal = -1;                ///< of cuda:N; -1: any
};
/// Reads auto, cpu, cuda or cuda:N. Usage error: anything else.
DeviceRequest parse_device(const std::string& text);

/// Where to solve.
struct DeviceChoice {
  int ordinal = -1;                ///< of a CUDA device; -1: CPU
  std::string reason;              ///< why not CUDA, when that was not asked for; else empty
  std::string description;         ///< "cpu", "cuda:0 NVIDIA H100 (80 GB)"
  bool on_cpu() const { return ordinal < 0; }
  /// "device: cuda:0 NVIDIA H100 (80 GB)", "device: cpu (no CUDA device: the driver is not installed)"
  std::string sentence() const;
};

/// The first device that works and has `bytes_needed` free (0: unknown). `automatic` falls back to the CPU; with `cuda` it is
/// a device error when there is none that works or none of that number, and a memory error when the memory is too small.
DeviceChoice choose_device(const DeviceRequest& request, const CudaStatus& status, double bytes_needed = 0);

}  // namespace mtled
