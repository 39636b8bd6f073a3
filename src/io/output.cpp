#include "io/output.hpp"

#include <unistd.h>

#include <cerrno>
#include <fstream>

#include "core/error.hpp"
#include "io/input.hpp"
#include "io/temporary_file.hpp"

namespace mtled {
namespace fs = std::filesystem;
namespace {

void check_target(const fs::path& path) {
  std::error_code ignored;
  if (path.filename().empty() || fs::is_directory(path, ignored))
    fail(Failure::output, "cannot write ", path, ": it is a folder; give the name of a file");
  const fs::path folder = path.parent_path().empty() ? fs::path(".") : path.parent_path();
  if (!fs::is_directory(folder, ignored))
    fail(Failure::output, "cannot write ", path, ": there is no folder ", folder, "; create it first");
}

}  // namespace

void prepare_output_directory(const fs::path& directory, bool force) {
  std::error_code error;
  fs::create_directories(directory, error);
  if (!fs::is_directory(directory))
    fail(Failure::output, "cannot create the output folder ", directory, ": ",
         error ? error.message() : "a file of that name exists", "; choose another folder");
  if (::access(directory.c_str(), R_OK | W_OK | X_OK) != 0)
    fail(Failure::output, "cannot write into the output folder ", directory, ": ", system_reason(),
         "; change its permissions or choose another folder");
  if (!force && !fs::is_empty(directory))
    fail(Failure::output, "the output folder ", directory,
         " is not empty; choose another one, or give --force to overwrite results of the same name");
}

void write_atomically(const fs::path& path, const std::function<void(const fs::path&)>& write) {
  check_target(path);
  const TemporaryFile temporary(path);
  write(temporary.path());
  std::error_code error;
  fs::rename(temporary.path(), path, error);
  if (error)
    fail(Failure::output, "cannot write ", path, ": ", error.message(), "; check the permissions of file and folder");
}

void write_stream(const fs::path& path, const std::function<void(std::ostream&)>& fill) {
  write_atomically(path, [&](const fs::path& temporary) {
    const auto check = [&](const std::ios& stream) {
      if (stream.fail())
        fail(Failure::output, "cannot write ", path, ": ", system_reason(),
             "; check the free space and the permissions of the folder");
    };
    errno = 0;
    std::ofstream stream(temporary, std::ios::binary);
    check(stream);
    fill(stream);
    stream.close();
    check(stream);
  });
}

void write_text(const fs::path& path, const std::string& text) {
  write_stream(path, [&](std::ostream& stream) { stream.write(text.data(), std::streamsize(text.size())); });
}

}  // namespace mtled
