#pragma once
#include <filesystem>
#include <functional>
#include <iosfwd>
#include <string>

namespace mtled {

/// Creates `directory` for results. Output errors: cannot be created or written; not empty and `force` is false.
void prepare_output_directory(const std::filesystem::path& directory, bool force);
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
