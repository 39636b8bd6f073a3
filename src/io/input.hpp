#pragma once
#include <filesystem>
#include <string>

namespace mtled {

/// Everything in a file, as bytes. Input errors: missing, a folder, cannot be read.
std::string read_file(const std::filesystem::path& path);
/// The reason of the last failed system call in words ("Permission denied"), for messages.
std::string system_reason();

}  // namespace mtled
