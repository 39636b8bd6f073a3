#pragma once
#include <cstdint>
#include <filesystem>
#include <functional>

namespace mtled {

/// Looks at bytes of a file, piece after piece.
using ByteVisitor = std::function<void(const unsigned char* bytes, std::size_t count)>;

/// Bytes of `file` after `offset`; 0 when it ends before.
std::uint64_t stored_bytes(const std::filesystem::path& file, std::uint64_t offset);
/// Shows `visit` all bytes of `file`.
void visit_stored_bytes(const std::filesystem::path& file, const ByteVisitor& visit);
/// Bytes that the zlib or gzip data at `offset` unpack to, as far as they go: fewer than were packed when the file is
/// cut off. Input error: damaged (checksums are verified). `visit`, if given, is shown them.
std::uint64_t inflated_bytes(const std::filesystem::path& file, std::uint64_t offset, const ByteVisitor& visit = {});
/// Input error unless `found` bytes of voxels are at least `needed`.
void require_complete(std::uint64_t found, std::uint64_t needed);
/// Packs `source` into the gzip file `target`. Output error: cannot be written.
void gzip(const std::filesystem::path& source, const std::filesystem::path& target);

}  // namespace mtled
