#include <cstdio>
#include <thread>

#include "command.hpp"
#include "core/cpu_kernels.hpp"

namespace mtled {

void add_info(CLI::App& program) {
  CLI::App* verb = program.add_subcommand("info", "Say what this build can do and what devices there are");
  verb->callback([] {
    std::printf("mtled %s\ncompiler: %s\nimage verbs: %s\nprocessors: %u, kernels: %s\nCUDA: not in this build\n", MTLED_VERSION, __VERSION__,
                MTLED_IMAGING ? "yes (ITK " MTLED_ITK_VERSION ")" : "no (built without ITK)", std::thread::hardware_concurrency(), best_kernels_name());
  });
}

}  // namespace mtled
