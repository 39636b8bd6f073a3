#include "image_io/checksum.hpp"

#include <itksys/MD5.h>

#include <algorithm>
#include <fstream>
#include <memory>
#include <vector>

#include "core/error.hpp"

namespace mtled {

std::string md5_of(const std::filesystem::path& path) {
  std::vector<std::filesystem::path> files{path};
  if (std::filesystem::is_directory(path)) {
    files.clear();
    for (const auto& entry : std::filesystem::directory_iterator(path))
      if (entry.is_regular_file()) files.push_back(entry.path());
    std::sort(files.begin(), files.end());
  }
  const std::unique_ptr<itksysMD5, decltype(&itksysMD5_Delete)> md5(itksysMD5_New(), &itksysMD5_Delete);
  itksysMD5_Initialize(md5.get());
  std::vector<char> buffer(1 << 20);
  for (const auto& file : files) {
    std::ifstream stream(file, std::ios::binary);
    require(stream.good(), "'", file.string(), "' cannot be read");
    while (stream.read(buffer.data(), std::streamsize(buffer.size())) || stream.gcount() > 0)
      itksysMD5_Append(md5.get(), reinterpret_cast<const unsigned char*>(buffer.data()), int(stream.gcount()));
  }
  char digits[32];
  itksysMD5_FinalizeHex(md5.get(), digits);
  return std::string(digits, sizeof digits);
}

}  // namespace mtled
