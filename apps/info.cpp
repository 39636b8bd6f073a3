#include <cstdio>
#include <thread>

#include "command.hpp"
#include "core/cpu_kernels.hpp"
#include "cuda/backend.hpp"

namespace mtled {
namespace {

void print_cuda() {
  const CudaStatus cuda = cuda_status();
  if (cuda.built) std::printf("CUDA: runtime %s, compiled for compute capability %s\nCUDA driver: %s\n", cuda.runtime.c_str(), cuda.architectures.c_str(), cuda.driver.empty() ? "none" : ("for CUDA " + cuda.driver).c_str());
  else std::printf("CUDA: not in this build\n");
  if (!cuda.problem.empty()) std::printf("CUDA cannot be used: %s; %s\n", cuda.problem.c_str(), cuda.remedy.c_str());
  for (const DeviceDescription& d : cuda.devices) {
    std::printf("cuda:%d: %s, compute capability %d.%d, %d multiprocessors, %.1f GB, %.1f GB free\n", d.ordinal, d.name.c_str(), d.capability_major, d.capability_minor,
                d.multiprocessors, d.memory_bytes / 1e9, d.free_bytes / 1e9);
    if (!d.unusable.empty()) std::printf("cuda:%d cannot be used: %s\n", d.ordinal, d.unusable.c_str());
  }
}

}  // namespace

void add_info(CLI::App& program) {
  CLI::App* verb = program.add_subcommand("info", "Say what this build can do and what devices there are");
  verb->callback([] {
    std::printf("mtled %s\ncompiler: %s\nimage verbs: %s\nprocessors: %u, kernels: %s\n", MTLED_VERSION, __VERSION__,
                MTLED_IMAGING ? "yes (ITK " MTLED_ITK_VERSION ")" : "no (built without ITK)", std::thread::hardware_concurrency(), best_kernels_name());
    print_cuda();
  });
}

}  // namespace mtled
