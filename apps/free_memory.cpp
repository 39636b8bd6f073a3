#include "free_memory.hpp"

#include <algorithm>
#include <fstream>
#include <limits>
#include <string>

namespace mtled {
namespace {

constexpr double unknown = std::numeric_limits<double>::infinity();

/// The number that follows `key` in a file of "key number ..." lines.
double value_of(const char* file, const std::string& key) {
  std::ifstream stream(file);
  std::string word;
  while (stream >> word) {
    double value = 0;
    if (word == key && stream >> value) return value;
    std::getline(stream, word);
  }
  return unknown;
}

double number_in(const char* file) {
  double value = 0;
  return std::ifstream(file) >> value ? value : unknown;
}

/// What a control group (version 2) leaves; its cache of files gives way when memory is short.
double left_in_container() {
  const double limit = number_in("/sys/fs/cgroup/memory.max"), used = number_in("/sys/fs/cgroup/memory.current");
  if (limit == unknown || used == unknown) return unknown;  // "max" is no number: no limit
  const double cache = value_of("/sys/fs/cgroup/memory.stat", "inactive_file");
  return std::max(1.0, limit - used + (cache == unknown ? 0 : cache));
}

}  // namespace

double free_memory() {
  const double bytes = std::min(1024 * value_of("/proc/meminfo", "MemAvailable:"), left_in_container());
  return bytes == unknown ? 0 : bytes;
}

}  // namespace mtled
