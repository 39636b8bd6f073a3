#pragma once
#include <algorithm>
#include <cstdint>
#include <cstring>
#include <string>
#include <vector>

#include "core/motion.hpp"
#include "core/volume.hpp"

/// Image files made byte by byte, so that readers are tested against the formats and not against their own writers.
namespace mtled::testing_files {

/// What a NIfTI-1 file with int16 voxels says; the defaults are sound.
struct NiftiContent {
  std::vector<int> size{3, 4, 5};
  int q_code = 0, s_code = 1;
  float quaternion[3] = {0, 0, 0}, q_offset[3] = {0, 0, 0}, q_factor = 1;
  float spacing[3] = {2, 3, 4};
  float sform[3][4] = {{2, 0, 0, 10}, {0, 3, 0, 20}, {0, 0, 4, 30}};  ///< RAS
  float slope = 1, intercept = 0;
  int intent = 0, units = 2;
  bool big_endian = false;
  std::size_t bright = 0;  ///< the voxel that holds 100; all others hold 0
};

inline std::string nifti_bytes(const NiftiContent& content) {
  std::string bytes(352, '\0');
  const auto put = [&](std::size_t offset, auto value) {
    std::memcpy(&bytes[offset], &value, sizeof value);
    if (content.big_endian) std::reverse(&bytes[offset], &bytes[offset] + sizeof value);
  };
  put(0, std::int32_t(348));
  put(40, std::int16_t(content.size.size()));
  std::size_t count = 1;
  for (std::size_t i = 0; i < 7; ++i) {
    const int size = i < content.size.size() ? content.size[i] : 1;
    put(42 + 2 * i, std::int16_t(size));
    count *= std::size_t(size);
  }
  put(68, std::int16_t(content.intent));
  put(70, std::int16_t(4));   // int16
  put(72, std::int16_t(16));  // bits
  put(76, content.q_factor);
  for (std::size_t i = 0; i < 7; ++i) put(80 + 4 * i, i < 3 ? content.spacing[i] : 1.f);
  put(108, 352.f);
  put(112, content.slope);
  put(116, content.intercept);
  put(123, char(content.units));
  put(252, std::int16_t(content.q_code));
  put(254, std::int16_t(content.s_code));
  for (std::size_t i = 0; i < 3; ++i) {
    put(256 + 4 * i, content.quaternion[i]);
    put(268 + 4 * i, content.q_offset[i]);
    for (std::size_t j = 0; j < 4; ++j) put(280 + 16 * i + 4 * j, content.sform[i][j]);
  }
  std::memcpy(&bytes[344], "n+1", 4);
  bytes.resize(352 + 2 * count);
  put(352 + 2 * content.bright, std::int16_t(100));
  return bytes;
}

/// What a DICOM slice of 8 x 6 int16 voxels (value 10 i + z at voxel i) says.
struct DicomContent {
  int z = 0;  ///< [mm] of position (10, 20, z)
  bool implicit = false, nested = false;
  std::string slope = "1", intercept = "0";
};

class DicomElements {
 public:
  explicit DicomElements(bool implicit) : implicit_(implicit) {}
  template <class T>
  DicomElements& number(T value) {
    return text({reinterpret_cast<const char*>(&value), sizeof value});
  }
  DicomElements& text(const std::string& value) {
    bytes += value;
    return *this;
  }
  DicomElements& add(int group, int element, const std::string& kind, std::string value) {
    if (value.size() % 2) value += kind == "UI" ? '\0' : ' ';
    return head(group, element, kind, std::uint32_t(value.size())).text(value);
  }
  DicomElements& head(int group, int element, const std::string& kind, std::uint32_t length) {
    number(std::uint16_t(group)).number(std::uint16_t(element));
    if (implicit_ || group == 0xFFFE) return number(length);
    text(kind);
    if (kind == "OB" || kind == "OW" || kind == "SQ" || kind == "UN") return number(std::uint16_t(0)).number(length);
    return number(std::uint16_t(length));
  }
  std::string bytes;

 private:
  bool implicit_;
};

inline std::string dicom_bytes(const DicomContent& content) {
  const auto us = [](int value) { return std::string{char(value), char(value >> 8)}; };
  DicomElements header(false), data(content.implicit);
  header.add(2, 2, "UI", "1.2.840.10008.5.1.4.1.1.2").add(2, 3, "UI", "1.2.3.4");
  header.add(2, 0x10, "UI", content.implicit ? "1.2.840.10008.1.2" : "1.2.840.10008.1.2.1");
  data.add(8, 0x16, "UI", "1.2.840.10008.5.1.4.1.1.2").add(8, 0x18, "UI", "1.2.3.4." + std::to_string(content.z + 1));
  data.add(8, 0x60, "CS", "CT");
  if (content.nested) {  // a sequence of unknown length with one item, which holds a small picture of its own
    data.head(8, 0x2111, "SQ", 0xFFFFFFFF).head(0xFFFE, 0xE000, "", 0xFFFFFFFF).add(0x7FE0, 0x10, "OW", "ab");
    data.head(0xFFFE, 0xE00D, "", 0).head(0xFFFE, 0xE0DD, "", 0);
  }
  data.add(0x20, 0xD, "UI", "1.2.3").add(0x20, 0xE, "UI", "1.2.3.5");
  data.add(0x20, 0x32, "DS", "10\\20\\" + std::to_string(content.z)).add(0x20, 0x37, "DS", "1\\0\\0\\0\\1\\0");
  data.add(0x28, 2, "US", us(1))
      .add(0x28, 4, "CS", "MONOCHROME2")
      .add(0x28, 0x10, "US", us(6))
      .add(0x28, 0x11, "US", us(8));
  data.add(0x28, 0x30, "DS", "0.5\\0.7").add(0x28, 0x100, "US", us(16)).add(0x28, 0x101, "US", us(16));
  data.add(0x28, 0x102, "US", us(15)).add(0x28, 0x103, "US", us(1));
  data.add(0x28, 0x1052, "DS", content.intercept).add(0x28, 0x1053, "DS", content.slope);
  std::string voxels;
  for (int i = 0; i < 48; ++i) voxels += us(10 * i + content.z);
  data.add(0x7FE0, 0x10, "OW", voxels);
  DicomElements length(false);
  length.head(2, 0, "UL", 4).number(std::uint32_t(header.bytes.size()));
  return std::string(128, '\0') + "DICM" + length.bytes + header.bytes + data.bytes;
}

template <class T>
std::string raw_bytes(const std::vector<T>& values) {
  return {reinterpret_cast<const char*>(values.data()), values.size() * sizeof(T)};
}

/// A grid with nothing simple about it: oblique, anisotropic, left-handed, off the origin.
inline Grid oblique_grid() {
  Grid grid;
  grid.size = {7, 5, 4};
  grid.origin = {-120.5, 33.25, 801.125};
  grid.spacing = {0.75, 1.5, 2.5};
  Mat3d flip = Mat3d::identity();
  flip[1][1] = -1;
  grid.direction = rotation_matrix({0.3, -0.2, 0.5}) * flip;
  return grid;
}

}  // namespace mtled::testing_files
