#include "image_io/stored_bytes.hpp"

#include <zlib.h>

#include <fstream>
#include <memory>
#include <vector>

#include "core/error.hpp"
#include "image_io/formats.hpp"
#include "io/input.hpp"

namespace mtled {
namespace {

constexpr std::size_t chunk = 1 << 18;

/// zlib's state for unpacking; recognises zlib and gzip headers by itself.
struct Inflater {
  z_stream state{};
  Inflater() {
    if (inflateInit2(&state, MAX_WBITS + 32) != Z_OK) fail(Failure::internal, "zlib cannot be used");
  }
  ~Inflater() { inflateEnd(&state); }
};

}  // namespace

std::uint64_t stored_bytes(const std::filesystem::path& file, std::uint64_t offset) {
  std::error_code error;
  const std::uint64_t size = std::filesystem::file_size(file, error);
  require(!error, "cannot read ", file, ": ", error.message());
  return size > offset ? size - offset : 0;
}

void visit_stored_bytes(const std::filesystem::path& file, const ByteVisitor& visit) {
  std::ifstream stream(file, std::ios::binary);
  std::vector<unsigned char> bytes(chunk);
  while (stream.read(reinterpret_cast<char*>(bytes.data()), chunk), stream.gcount() > 0) visit(bytes.data(), std::size_t(stream.gcount()));
}

std::uint64_t inflated_bytes(const std::filesystem::path& file, std::uint64_t offset, const ByteVisitor& visit) {
  std::ifstream stream(file, std::ios::binary);
  stream.seekg(std::streamoff(offset));
  std::vector<unsigned char> packed(chunk), unpacked(chunk);
  Inflater inflater;
  z_stream& z = inflater.state;
  std::uint64_t total = 0;
  while (stream.read(reinterpret_cast<char*>(packed.data()), chunk), stream.gcount() > 0) {
    z.next_in = packed.data();
    z.avail_in = unsigned(stream.gcount());
    do {
      z.next_out = unpacked.data();
      z.avail_out = chunk;
      const int status = inflate(&z, Z_NO_FLUSH);
      total += chunk - z.avail_out;
      if (visit) visit(unpacked.data(), chunk - z.avail_out);
      require(status == Z_OK || status == Z_STREAM_END || status == Z_BUF_ERROR,
              "its compressed data are damaged; copy or download it again");
      if (status == Z_STREAM_END && z.avail_in > 0) inflateReset(&z);  // gzip files may hold several parts
    } while (z.avail_in > 0 || z.avail_out == 0);
  }
  return total;
}

void require_complete(std::uint64_t found, std::uint64_t needed) {
  require(found >= needed, "the file is cut off: it holds ", found, " of ", needed,
          " bytes of voxels; copy or download it again");
}

void gzip(const std::filesystem::path& source, const std::filesystem::path& target) {
  std::ifstream stream(source, std::ios::binary);
  const auto close = [](gzFile file) { gzclose(file); };
  std::unique_ptr<gzFile_s, decltype(close)> packed(gzopen(target.c_str(), "wb1"), close);
  std::vector<char> buffer(chunk);
  bool good = stream.good() && packed != nullptr;
  while (good && (stream.read(buffer.data(), chunk), stream.gcount() > 0))
    good = gzwrite(packed.get(), buffer.data(), unsigned(stream.gcount())) == int(stream.gcount());
  if (!good || gzclose(packed.release()) != Z_OK) fail_to_write(system_reason());
}

}  // namespace mtled
