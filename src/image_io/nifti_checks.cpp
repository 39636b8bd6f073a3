#include <zlib.h>

#include <algorithm>
#include <cstring>
#include <memory>

#include "core/error.hpp"
#include "image_io/format_checks.hpp"
#include "image_io/formats.hpp"
#include "image_io/stored_bytes.hpp"

namespace mtled {
namespace {

constexpr int header_size = 348, second_version_size = 540;
constexpr int displacement_intent = 1006;
constexpr int spatial_unit_bits = 7, unit_unknown = 0, unit_mm = 2;

/// The header of a NIfTI-1 file; fields at the byte offsets of nifti1.h.
class NiftiHeader {
 public:
  explicit NiftiHeader(const std::filesystem::path& file) {
    const auto close = [](gzFile f) { gzclose(f); };
    const std::unique_ptr<gzFile_s, decltype(close)> stream(gzopen(file.c_str(), "rb"),
                                                            close);  // reads plain files too
    require(stream != nullptr, "it cannot be opened; check its permissions");
    const int found = gzread(stream.get(), bytes_, header_size);
    require(found >= 4, "the file is empty or damaged; copy or download it again");
    swapped_ = field<std::int32_t>(0) != header_size && field<std::int32_t>(0) != second_version_size;
    require(field<std::int32_t>(0) != second_version_size, "it is a NIfTI-2 file; convert it to NIfTI-1 or NRRD");
    require(field<std::int32_t>(0) == header_size, "it is not a NIfTI file; give it the extension of its true format");
    require(found == header_size, "the file is cut off within its header; copy or download it again");
    require(std::memcmp(bytes_ + 344, "n+1", 4) == 0,
            "it is not a NIfTI-1 file of one part; convert it to .nii.gz or NRRD");
  }
  int dimension(int i) const { return field<std::int16_t>(40 + 2 * i); }
  int intent() const { return field<std::int16_t>(68); }
  int bits_per_voxel() const { return field<std::int16_t>(72); }
  double voxel_offset() const { return field<float>(108); }
  int spatial_unit() const { return bytes_[123] & spatial_unit_bits; }

 private:
  template <class T>
  T field(int offset) const {
    unsigned char bytes[sizeof(T)];
    std::copy_n(bytes_ + offset, sizeof(T), bytes);
    if (swapped_) std::reverse(bytes, bytes + sizeof(T));
    T value;
    std::memcpy(&value, bytes, sizeof(T));
    return value;
  }
  unsigned char bytes_[header_size]{};
  bool swapped_ = false;
};

}  // namespace

void check_nifti(const std::filesystem::path& file) {
  const bool packed = has_extension(file, ".gz");
  if (packed) {
    const std::filesystem::path beside = file.parent_path() / file.stem();
    require(!std::filesystem::exists(beside), beside,
            " lies beside it, and the ITK library would mix the two; move or rename one of them");
  }
  const NiftiHeader header(file);
  std::uint64_t needed = std::uint64_t(header.bits_per_voxel()) / 8;
  require(header.dimension(0) >= 1 && header.dimension(0) <= 7, "its header is damaged; copy or download it again");
  for (int i = 1; i <= header.dimension(0); ++i) needed *= std::uint64_t(std::max(header.dimension(i), 1));
  const auto offset = std::uint64_t(std::max(header.voxel_offset(), double(header_size)));
  const std::uint64_t all = packed ? inflated_bytes(file, 0) : stored_bytes(file, 0);
  require_complete(all - std::min(all, offset), needed);
  require(header.intent() != displacement_intent,
          "it is a NIfTI displacement field (intent 1006), which the ITK library misreads; convert it to NRRD");
  require(header.spatial_unit() == unit_mm || header.spatial_unit() == unit_unknown,
          "its lengths are not in mm; convert it to mm");
}

}  // namespace mtled
