#include "io/output.hpp"

#include <unistd.h>

#include <cerrno>
#include <fstream>

#include "core/error.hpp"
#include "io/input.hpp"

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

/// Removes those of the folders, innermost first, that hold nothing.
void remove_empty(const std::vector<fs::path>& folders) {
  std::error_code ignored;
  for (auto folder = folders.rbegin(); folder != folders.rend(); ++folder)
    if (fs::is_directory(*folder, ignored) && fs::is_empty(*folder, ignored)) fs::remove(*folder, ignored);
}

}  // namespace

OutputDirectory::OutputDirectory(const fs::path& directory, bool force) : path_(directory) {
  if (path_.empty()) fail(Failure::output, "the name of the output folder is empty; give one");
  std::error_code error;
  for (fs::path p = fs::absolute(path_).lexically_normal(); !p.empty() && !fs::exists(p, error) && p != p.parent_path(); p = p.parent_path())
    if (!p.filename().empty()) created_.insert(created_.begin(), p);
  fs::create_directories(path_, error);
  for (const fs::path& p : created_) guards_.emplace_back(p);
  if (!fs::is_directory(path_)) {
    remove_empty(created_);
    fail(Failure::output, "cannot create the output folder ", path_, ": ",
         error ? error.message() : "a file of that name exists", "; choose another folder");
  }
  if (::access(path_.c_str(), R_OK | W_OK | X_OK) != 0)
    fail(Failure::output, "cannot write into the output folder ", path_, ": ", system_reason(),
         "; change its permissions or choose another folder");
  if (!force && !fs::is_empty(path_))
    fail(Failure::output, "the output folder ", path_,
         " is not empty; choose another one, or give --force to overwrite results of the same name");
}

OutputDirectory::~OutputDirectory() { remove_empty(created_); }

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
