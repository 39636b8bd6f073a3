#pragma once
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <string>
#include <vector>

#include "core/tensor.hpp"
#include "report/encode.hpp"

namespace mtled {

/// Vectors in three little-endian 16-bit numbers each, in units of 0.02 mm (up to 655 mm, longer ones are cut).
class PackedVectors {
 public:
  static constexpr double scale_mm = 0.02;
  void add(const Vec3d& v) {
    for (int a = 0; a < 3; ++a) put(int(std::lround(std::clamp(v[a] / scale_mm, -32767.0, 32767.0))));
  }
  void add_unknown() {
    for (int a = 0; a < 3; ++a) put(-32768);
  }
  std::string text() const { return base64(bytes_); }

 private:
  void put(int number) {
    bytes_.push_back(std::uint8_t(number & 255));
    bytes_.push_back(std::uint8_t(number >> 8 & 255));
  }
  std::vector<std::uint8_t> bytes_;
};

}  // namespace mtled
