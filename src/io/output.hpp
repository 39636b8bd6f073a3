#pragma once
#include <filesystem>
#include <functional>
#include <string>

namespace mtled {

/// Creates `directory` for results. Output errors: cannot be created or written; not empty and `force` is false.
void prepare_output_directory(const std::filesystem::path& directory, bool force);
/// Calls `write(temporary)` with a temporary name in the same folder (same extension) and renames it to `path` when that
/// returns; removes the temporary when it throws. So no half-written file is ever seen under its real name.
/// An interrupted run (SIGINT, SIGTERM) leaves none either: temporaries in use are removed by install_interrupt_handler.
void write_atomically(const std::filesystem::path& path, const std::function<void(const std::filesystem::path&)>& write);
/// write_atomically of a text.
void write_text(const std::filesystem::path& path, const std::string& text);
/// SIGINT and SIGTERM: remove the temporaries in use, then end with exit code 130 or 143.
void install_interrupt_handler();

}  // namespace mtled
