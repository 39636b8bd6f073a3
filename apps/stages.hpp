#pragma once
#include <chrono>
#include <string>

#include "io/json.hpp"

namespace mtled {

/// Books wall time and peak memory so far per stage: {name: {seconds, peak_memory_MB}}.
class Stages {
 public:
  /// Ends a stage that began with the one before, or with this object.
  void lap(const std::string& stage);
  const Json& report() const { return report_; }

 private:
  Json report_ = Json::object();
  std::chrono::steady_clock::time_point last_ = std::chrono::steady_clock::now();
};

}  // namespace mtled
