#pragma once
#include <filesystem>

namespace mtled {

/// A hidden name in the folder of `target` with the same extension, for a file on its way to that target. Whatever has
/// this name at the end of its life is removed; also when the run is interrupted (see install_interrupt_handler), for
/// up to 64 at once and names of at most 4095 bytes.
class TemporaryFile {
 public:
  explicit TemporaryFile(const std::filesystem::path& target);
  ~TemporaryFile();
  TemporaryFile(const TemporaryFile&) = delete;
  TemporaryFile& operator=(const TemporaryFile&) = delete;
  const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
  int slot_ = -1;  ///< in the table of the interrupt handler; -1 = none was free
};

}  // namespace mtled
