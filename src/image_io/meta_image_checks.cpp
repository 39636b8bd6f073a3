#include <fstream>
#include <map>
#include <sstream>

#include "core/error.hpp"
#include "image_io/format_checks.hpp"
#include "image_io/stored_bytes.hpp"

namespace mtled {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t longest_header = 1 << 16;

/// "Key = value" lines up to ElementDataFile, and where the bytes after them begin.
struct MetaHeader {
  std::map<std::string, std::string> values;
  std::uint64_t end = 0;
};

std::string trimmed(const std::string& text) {
  const std::size_t first = text.find_first_not_of(" \t\r"), last = text.find_last_not_of(" \t\r");
  return first == std::string::npos ? "" : text.substr(first, last - first + 1);
}

MetaHeader read_header(const fs::path& file) {
  std::ifstream stream(file, std::ios::binary);
  std::string text(longest_header, '\0');
  stream.read(text.data(), std::streamsize(text.size()));
  text.resize(std::size_t(stream.gcount()));
  MetaHeader header;
  for (std::size_t begin = 0; begin < text.size() && !header.values.contains("ElementDataFile");) {
    const std::size_t end = std::min(text.find('\n', begin), text.size());
    const std::string line = text.substr(begin, end - begin);
    begin = end + 1;
    if (const std::size_t equals = line.find('='); equals != std::string::npos)
      header.values[trimmed(line.substr(0, equals))] = trimmed(line.substr(equals + 1));
    header.end = begin;
  }
  require(header.values.contains("ElementDataFile") && header.values.contains("DimSize"),
          "it is not a MetaImage file, or its header is cut off; copy or download it again");
  return header;
}

std::uint64_t bytes_of_type(const std::string& type) {
  static const std::map<std::string, int> sizes{{"MET_CHAR", 1},   {"MET_UCHAR", 1},     {"MET_SHORT", 2},
                                                {"MET_USHORT", 2}, {"MET_INT", 4},       {"MET_UINT", 4},
                                                {"MET_LONG", 4},   {"MET_ULONG", 4},     {"MET_FLOAT", 4},
                                                {"MET_DOUBLE", 8}, {"MET_LONG_LONG", 8}, {"MET_ULONG_LONG", 8}};
  const auto found = sizes.find(type);
  require(found != sizes.end(), "its voxel type ", type, " is not supported; convert it to a single number per voxel");
  return std::uint64_t(found->second);
}

std::uint64_t needed_bytes(std::map<std::string, std::string> values) {
  std::uint64_t needed = bytes_of_type(values["ElementType"]);
  std::istringstream sizes(values["DimSize"]);
  for (std::uint64_t size = 0; sizes >> size;) needed *= size;
  if (values.contains("ElementNumberOfChannels"))
    needed *= std::strtoull(values["ElementNumberOfChannels"].c_str(), nullptr, 10);
  return needed;
}

}  // namespace

void check_meta_image(const fs::path& file) {
  MetaHeader header = read_header(file);
  const std::string name = header.values["ElementDataFile"];
  const bool local = name == "LOCAL" || name == "Local" || name == "local";
  require(!name.starts_with("LIST") && name.find('%') == name.npos,
          "its voxels are spread over several files; convert it to one file (.mha, .nrrd or .nii.gz)");
  const fs::path data_file = local ? file : file.parent_path() / name;
  require(fs::exists(data_file), "its voxels should be in ", data_file, ", which is missing; copy that file too");
  const long skipped = local ? 0 : std::max(0l, std::strtol(header.values["HeaderSize"].c_str(), nullptr, 10));
  const std::uint64_t begin = local ? header.end : std::uint64_t(skipped);
  const std::string packed = header.values["CompressedData"];
  require_complete(packed.starts_with('T') || packed.starts_with('t') ? inflated_bytes(data_file, begin)
                                                                      : stored_bytes(data_file, begin),
                   needed_bytes(header.values));
}

}  // namespace mtled
