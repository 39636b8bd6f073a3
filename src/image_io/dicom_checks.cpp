#include <cstdint>
#include <cstring>
#include <string_view>
#include <vector>

#include "core/error.hpp"
#include "image_io/format_checks.hpp"
#include "io/input.hpp"

namespace mtled {
namespace {

constexpr std::size_t preamble = 128;
constexpr std::uint32_t undefined_length = 0xFFFFFFFF;
constexpr std::uint32_t transfer_syntax_tag = 0x00020010, rows_tag = 0x00280010, pixel_tag = 0x7FE00010;
constexpr std::uint32_t item_tag = 0xFFFEE000, item_end_tag = 0xFFFEE00D, sequence_end_tag = 0xFFFEE0DD;

/// Walks through the data elements of a little-endian DICOM file without looking into them.
class DicomWalk {
 public:
  explicit DicomWalk(std::string_view bytes) : bytes_(bytes), at_(preamble + 4) {}
  /// Whether there are voxels. Input error when the file ends within an element, or before what was announced.
  bool finds_voxels() {
    while (at_ < bytes_.size() && !done_) next_element();
    require_up_to(at_);
    require(done_ || (open_.empty() && !has_rows_), "the file is cut off; copy or download it again");
    return done_;
  }

 private:
  struct Sequence {
    bool implicit, pixels;
  };
  void require_up_to(std::size_t end) const {
    require(end <= bytes_.size(), "the file is cut off: it has ", bytes_.size(), " bytes, and needs ", end,
            " at least; copy or download it again");
  }
  template <class T>
  T take() {
    require_up_to(at_ + sizeof(T));
    T value;
    std::memcpy(&value, bytes_.data() + at_, sizeof(T));
    at_ += sizeof(T);
    return value;
  }
  std::uint32_t take_tag() {
    const std::uint32_t group = take<std::uint16_t>();
    in_header_ = in_header_ && group == 2;
    return group << 16 | take<std::uint16_t>();
  }
  bool implicit() const { return open_.empty() ? !in_header_ && implicit_file_ : open_.back().implicit; }

  void next_element() {
    const std::uint32_t tag = take_tag();
    if (tag == item_tag || tag == item_end_tag || tag == sequence_end_tag) return delimiter(tag);
    std::uint32_t length = 0;
    bool unknown_kind = false;
    if (implicit()) {
      length = take<std::uint32_t>();
    } else {
      require_up_to(at_ + 2);
      const std::string_view kind = bytes_.substr(at_, 2);
      at_ += 2;
      static constexpr std::string_view long_kinds = "OB OW OF OD OL OV SQ UC UR UT UN SV UV";
      unknown_kind = kind == "UN";
      const bool is_long = long_kinds.find(kind) != kind.npos;
      if (is_long) take<std::uint16_t>();
      length = is_long ? take<std::uint32_t>() : take<std::uint16_t>();
    }
    if (length == undefined_length) return open_.push_back({implicit() || unknown_kind, tag == pixel_tag});
    if (tag == transfer_syntax_tag) set_syntax(length);
    has_rows_ = has_rows_ || (tag == rows_tag && open_.empty());
    at_ += length;
    done_ = done_ || (tag == pixel_tag && open_.empty());
  }
  void delimiter(std::uint32_t tag) {
    const std::uint32_t length = take<std::uint32_t>();
    if (tag == sequence_end_tag && !open_.empty()) {
      done_ = open_.back().pixels && open_.size() == 1;
      open_.pop_back();
    } else if (tag == item_tag && !open_.empty() && open_.back().pixels) {
      at_ += length;  // a piece of compressed pixels; items of other sequences are walked through
    }
  }
  void set_syntax(std::uint32_t length) {
    require_up_to(at_ + length);
    std::string_view syntax = bytes_.substr(at_, length);
    while (!syntax.empty() && (syntax.back() == '\0' || syntax.back() == ' ')) syntax.remove_suffix(1);
    implicit_file_ = syntax == "1.2.840.10008.1.2";
    done_ = syntax == "1.2.840.10008.1.2.2" || syntax == "1.2.840.10008.1.2.1.99";  // big endian, deflated: not walked
  }

  std::string_view bytes_;
  std::size_t at_;
  bool in_header_ = true, implicit_file_ = false, has_rows_ = false, done_ = false;
  std::vector<Sequence> open_;  ///< sequences of undefined length that have begun
};

}  // namespace

bool check_dicom(const std::filesystem::path& file) {
  const std::string bytes = read_file(file);
  const bool dicom = bytes.size() >= preamble + 4 && bytes.compare(preamble, 4, "DICM") == 0;
  return dicom && DicomWalk(bytes).finds_voxels();
}

}  // namespace mtled
