#include "io/input.hpp"

#include <cerrno>
#include <fstream>
#include <iterator>
#include <system_error>

#include "core/error.hpp"

namespace mtled {

std::string system_reason() { return std::generic_category().message(errno); }

std::string read_file(const std::filesystem::path& path) {
  std::error_code ignored;
  const std::filesystem::file_status status = std::filesystem::status(path, ignored);
  require(std::filesystem::exists(status), "cannot read ", path, ": no such file; check the name and the folder");
  require(!std::filesystem::is_directory(status), "cannot read ", path, ": it is a folder; give the file itself");
  errno = 0;
  std::ifstream stream(path, std::ios::binary);
  require(stream.good(), "cannot read ", path, ": ", system_reason(), "; check its permissions");
  std::string content;
  if (std::filesystem::is_regular_file(status)) {
    content.resize(std::filesystem::file_size(path, ignored));
    stream.read(content.data(), std::streamsize(content.size()));
    content.resize(std::size_t(stream.gcount()));
  } else {  // a pipe has no size
    content.assign(std::istreambuf_iterator<char>(stream), {});
  }
  require(!stream.bad(), "cannot read ", path, ": ", system_reason());
  return content;
}

}  // namespace mtled
