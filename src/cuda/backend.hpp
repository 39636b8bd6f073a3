#pragma once
#include <string>
#include <vector>

#include "core/solver.hpp"

/// The CUDA backend for those who know nothing of CUDA. Without CUDA in the build the same functions say so.
namespace mtled {

struct DeviceDescription {
  int ordinal = 0;                 ///< in the order of the CUDA runtime, as in cuda:0
  std::string name;
  int capability_major = 0, capability_minor = 0;
  int multiprocessors = 0;
  double memory_bytes = 0, free_bytes = 0;
  std::string unusable;            ///< why it cannot be used, and what helps; empty: it ran a kernel
};

/// What there is to compute on.
struct CudaStatus {
  bool built = false;              ///< the CUDA backend is in this program
  std::string runtime, driver;     ///< versions of CUDA, such as "13.0": of this program, and that the driver supports; empty: none
  std::string architectures;       ///< compute capabilities that this program is compiled for, such as "7.5, 9.0"
  std::string problem, remedy;     ///< why there are no devices at all; empty: there are
  std::vector<DeviceDescription> devices;
};

/// Looks for devices and runs a small kernel on each, which takes about a second with a device; later calls repeat what the first
/// one found. Never throws.
CudaStatus cuda_status();

/// The solver's mechanics on a device. Making them is a memory error where the model does not fit, with what it needs; an input
/// error where it has what only the CPU computes (pressure averaged at nodes); a device error where the device fails.
MakeMechanics cuda_mechanics(int ordinal);
/// Bytes read and written per second by a copy of 1 GB within the device's memory [GB/s], the median of several.
double cuda_copy_bandwidth(int ordinal);

}  // namespace mtled
