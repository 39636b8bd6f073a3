#pragma once
#include <deque>
#include <filesystem>
#include <functional>
#include <iosfwd>
#include <string>
#include <vector>

#include "io/temporary_file.hpp"

namespace mtled {

/// A folder for results. It is created at once with its parents, so that one that cannot be written is known before the
/// work; what was created and is still empty at the end is removed, also when the run is interrupted.
class OutputDirectory {
 public:
  /// Output errors: cannot be created or written; not empty and `force` is false.
  OutputDirectory(const std::filesystem::path& directory, bool force);
  ~OutputDirectory();
  OutputDirectory(const OutputDirectory&) = delete;
  OutputDirectory& operator=(const OutputDirectory&) = delete;
  std::filesystem::path operator/(const std::string& name) const { return path_ / name; }
  const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
  std::vector<std::filesystem::path> created_;  ///< outermost first
  std::deque<InterruptGuard> guards_;           ///< of these
};
/// Calls `write(temporary)` with a temporary name in the same folder (same extension) and renames it to `path` when
/// that returns; removes the temporary when it throws. So no half-written file is ever seen under its real name. An
/// interrupted run (SIGINT, SIGTERM) leaves none either: temporaries in use are removed by install_interrupt_handler.
/// Output errors: no such folder, `path` is a folder, cannot be renamed.
void write_atomically(const std::filesystem::path& path,
                      const std::function<void(const std::filesystem::path&)>& write);
/// write_atomically of what `fill` puts into a binary stream. Output errors also: cannot be opened, disk full.
void write_stream(const std::filesystem::path& path, const std::function<void(std::ostream&)>& fill);
/// write_atomically of a text.
void write_text(const std::filesystem::path& path, const std::string& text);
/// SIGINT and SIGTERM: remove the temporaries in use, then end with exit code 130 or 143.
void install_interrupt_handler();

}  // namespace mtled
