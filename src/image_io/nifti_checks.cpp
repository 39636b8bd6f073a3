#include <zlib.h>

#include <algorithm>
#include <bit>
#include <cstdint>
#include <cstring>
#include <functional>
#include <memory>

#include "core/error.hpp"
#include "image_io/format_checks.hpp"
#include "image_io/formats.hpp"
#include "image_io/stored_bytes.hpp"

namespace mtled {
namespace {

constexpr int header_size = 348, second_version_size = 540;
constexpr int displacement_intent = 1006;
constexpr int type_float = 16, type_double = 64;
constexpr int spatial_unit_bits = 7, unit_unknown = 0, unit_mm = 2;
constexpr std::uint64_t most_packed = 1032;  ///< bytes that deflate can put into one

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
  /// 4 or 8 when the voxels are floating-point numbers of so many bytes, else 0.
  int float_bytes() const {
    const int type = field<std::int16_t>(70);
    return type == type_float ? 4 : type == type_double ? 8 : 0;
  }
  bool little_endian() const { return swapped_ != (std::endian::native == std::endian::little); }
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

/// Finds NaN and infinity (all bits of the exponent set) among the voxels: ITK's reader turns them into 0 in silence.
class NonFiniteVoxels {
 public:
  NonFiniteVoxels(const NiftiHeader& header, std::uint64_t offset, std::uint64_t bytes)
      : size_(std::size_t(header.float_bytes())), little_endian_(header.little_endian()), skip_(offset), left_(bytes) {}
  void operator()(const unsigned char* bytes, std::size_t count) {
    const std::size_t skipped = std::size_t(std::min<std::uint64_t>(skip_, count));
    skip_ -= skipped;
    const std::size_t end = std::size_t(std::min<std::uint64_t>(count, skipped + left_));
    left_ -= end - skipped;
    std::size_t i = skipped;
    while (i < end) {
      if (filled_ == 0)
        for (; i + size_ <= end; i += size_) look_at(bytes + i);
      if (i == end) return;
      value_[filled_++] = bytes[i++];
      if (filled_ < size_) continue;
      filled_ = 0;
      look_at(value_);
    }
  }
  std::uint64_t count() const { return count_; }
  std::uint64_t first() const { return first_; }

 private:
  void look_at(const unsigned char* value) {
    const unsigned high = value[little_endian_ ? size_ - 1 : 0], next = value[little_endian_ ? size_ - 2 : 1];
    const unsigned exponent_in_next = size_ == 4 ? 0x80 : 0xF0;
    if ((high & 0x7F) == 0x7F && (next & exponent_in_next) == exponent_in_next && count_++ == 0) first_ = voxel_;
    ++voxel_;
  }

  std::size_t size_;
  bool little_endian_;
  std::uint64_t skip_, left_, voxel_ = 0, count_ = 0, first_ = 0;
  unsigned char value_[8]{};
  std::size_t filled_ = 0;
};

/// Bytes of voxels that the header tells of.
std::uint64_t bytes_of_voxels(const NiftiHeader& header) {
  constexpr const char* damaged = "its header is damaged; copy or download it again";
  require(header.dimension(0) >= 1 && header.dimension(0) <= 7, damaged);
  std::uint64_t bytes = std::uint64_t(header.bits_per_voxel()) / 8;
  for (int i = 1; i <= header.dimension(0); ++i) require(!__builtin_mul_overflow(bytes, std::uint64_t(std::max(header.dimension(i), 1)), &bytes), damaged);
  return bytes;
}

/// What can be said of the file's size without unpacking it, before there is memory for `needed` bytes of voxels.
void check_size(const std::filesystem::path& file, std::uint64_t offset, std::uint64_t needed) {
  if (!has_extension(file, ".gz")) return require_complete(stored_bytes(file, offset), needed);
  const std::uint64_t stored = stored_bytes(file, 0);
  require(needed / most_packed <= stored, "the file is cut off, or its header damaged: ", needed, " bytes of voxels do not fit into ", stored, " packed bytes; copy or download it again");
}

/// Of what the header says: `needed` bytes of voxels from byte `offset`.
void check_voxels(const std::filesystem::path& file, const NiftiHeader& header, std::uint64_t offset, std::uint64_t needed, bool values_too) {
  const bool packed = has_extension(file, ".gz");
  NonFiniteVoxels bad(header, offset, needed);
  const bool may_be_bad = values_too && header.float_bytes() > 0;
  const ByteVisitor visit = may_be_bad ? ByteVisitor(std::ref(bad)) : ByteVisitor();
  if (packed) {
    const std::uint64_t all = inflated_bytes(file, 0, visit);
    require_complete(all - std::min(all, offset), needed);
  } else if (may_be_bad) {
    visit_stored_bytes(file, visit);
  }
  if (const std::uint64_t row = std::uint64_t(std::max(header.dimension(1), 1)), slice = row * std::uint64_t(std::max(header.dimension(2), 1)); bad.count() > 0)
    fail(Failure::input, bad.count(), bad.count() == 1 ? " voxel is" : " voxels are", " NaN or infinite, the first one at index (", bad.first() % row, ", ",
         bad.first() % slice / row, ", ", bad.first() / slice, "); replace such values first");
}

std::function<void()> check(const std::filesystem::path& file, bool values_too) {
  if (has_extension(file, ".gz")) {
    const std::filesystem::path beside = file.parent_path() / file.stem();
    require(!std::filesystem::exists(beside), beside,
            " lies beside it, and the ITK library would mix the two; move or rename one of them");
  }
  const NiftiHeader header(file);
  const std::uint64_t needed = bytes_of_voxels(header);
  require(header.intent() != displacement_intent,
          "it is a NIfTI displacement field (intent 1006), which the ITK library misreads; convert it to NRRD");
  require(header.spatial_unit() == unit_mm || header.spatial_unit() == unit_unknown,
          "its lengths are not in mm; convert it to mm");
  const auto offset = std::uint64_t(std::max(header.voxel_offset(), double(header_size)));
  check_size(file, offset, needed);
  return [=] { check_voxels(file, header, offset, needed, values_too); };
}

}  // namespace

std::function<void()> check_nifti(const std::filesystem::path& file) { return check(file, true); }

void check_written_nifti(const std::filesystem::path& file) { check(file, false)(); }

}  // namespace mtled
