#include "stages.hpp"

#include <sys/resource.h>

namespace mtled {

void Stages::lap(const std::string& stage) {
  const auto now = std::chrono::steady_clock::now();
  rusage usage;
  getrusage(RUSAGE_SELF, &usage);
  report_[stage] = {{"seconds", std::chrono::duration<double>(now - last_).count()}, {"peak_memory_MB", double(usage.ru_maxrss) / 1024}};
  last_ = now;
}

}  // namespace mtled
