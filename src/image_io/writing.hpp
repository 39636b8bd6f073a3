#pragma once
#include <filesystem>
#include <string>
#include <vector>

#include "image_io/formats.hpp"
#include "io/output.hpp"

namespace mtled {

/// write_atomically of `work(temporary)`, so that every error is an output error (or memory) that says what was being
/// written. Output error: `path` has none of these extensions.
template <class Work>
void writing(const std::filesystem::path& path, const std::vector<std::string>& extensions, Work&& work) {
  with_context(concatenate("writing '", path.string(), "'"), [&] {
    std::string supported;
    for (const std::string& extension : extensions) {
      if (has_extension(path, extension))
        return write_atomically(path, [&](const std::filesystem::path& temporary) {
          translating_errors(Failure::output, "check the free space and the permissions of the folder",
                             [&] { work(temporary); });
        });
      supported += (supported.empty() ? "" : ", ") + extension;
    }
    fail(Failure::output, "its format is not supported here; use ", supported);
  });
}

}  // namespace mtled
