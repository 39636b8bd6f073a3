#pragma once
#include <filesystem>
#include <string>

namespace mtled {

/// MD5 of a file's bytes, or of those of all files of a folder in the order of their names, as 32 hexadecimal digits: to
/// recognise an input again, not for security. Input error when a file cannot be read.
std::string md5_of(const std::filesystem::path& path);

}  // namespace mtled
