#pragma once
#include <filesystem>

namespace mtled {

/// While it lives, an interrupted run removes `path`: a file, or a folder that is empty then (see
/// install_interrupt_handler); for up to 64 at once and names of at most 4095 bytes.
class InterruptGuard {
 public:
  explicit InterruptGuard(const std::filesystem::path& path);
  ~InterruptGuard();
  InterruptGuard(const InterruptGuard&) = delete;
  InterruptGuard& operator=(const InterruptGuard&) = delete;

 private:
  int slot_;  ///< in the table of the interrupt handler; -1 = none was free
};

/// A hidden name in the folder of `target` with the same extension, for a file on its way to that target. Whatever has
/// this name at the end of its life is removed; also when the run is interrupted.
class TemporaryFile {
 public:
  explicit TemporaryFile(const std::filesystem::path& target);
  ~TemporaryFile();
  TemporaryFile(const TemporaryFile&) = delete;
  TemporaryFile& operator=(const TemporaryFile&) = delete;
  const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
  InterruptGuard guard_;
};

}  // namespace mtled
