#pragma once
#include <fcntl.h>
#include <gtest/gtest.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <csignal>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>
#include <vector>

/// The program as a user calls it.
namespace mtled::program {

namespace fs = std::filesystem;

struct Outcome {
  int code = -1;  ///< exit code; 128 + signal when it was killed
  std::string out, err;
};

inline std::string content(const fs::path& path) {
  std::ifstream stream(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), {}};
}

/// A run that goes on until finish().
class Run {
 public:
  /// Standard output and error go to files named after `log`, which lie outside the folders under test.
  Run(const std::vector<std::string>& arguments, const fs::path& log) : out_(log.string() + ".out"), err_(log.string() + ".err") {
    std::vector<char*> argv{const_cast<char*>(MTLED_PROGRAM)};
    for (const std::string& a : arguments) argv.push_back(const_cast<char*>(a.c_str()));
    argv.push_back(nullptr);
    posix_spawn_file_actions_t actions;
    posix_spawn_file_actions_init(&actions);
    posix_spawn_file_actions_addopen(&actions, 1, out_.c_str(), O_WRONLY | O_CREAT | O_TRUNC, 0600);
    posix_spawn_file_actions_addopen(&actions, 2, err_.c_str(), O_WRONLY | O_CREAT | O_TRUNC, 0600);
    if (posix_spawn(&process_, MTLED_PROGRAM, &actions, nullptr, argv.data(), environ) != 0) ADD_FAILURE() << "cannot start " << MTLED_PROGRAM;
    posix_spawn_file_actions_destroy(&actions);
  }
  /// Waits until standard error holds `text`; false when the run ends before or after 20 s.
  bool wait_for(const std::string& text) const {
    for (int i = 0; i < 2000; ++i, ::usleep(10000)) {
      if (content(err_).find(text) != std::string::npos) return true;
      siginfo_t info{};
      if (::waitid(P_PID, id_t(process_), &info, WEXITED | WNOHANG | WNOWAIT) == 0 && info.si_pid == process_) return false;
    }
    return false;
  }
  void interrupt(int signal = SIGINT) const { ::kill(process_, signal); }
  Outcome finish() {
    int status = 0;
    ::waitpid(process_, &status, 0);
    return {WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status), content(out_), content(err_)};
  }

 private:
  fs::path out_, err_;
  pid_t process_ = -1;
};

inline Outcome run(const std::vector<std::string>& arguments, const fs::path& log) { return Run(arguments, log).finish(); }

/// Relative names of everything in a folder and below, sorted.
inline std::vector<std::string> listing(const fs::path& folder) {
  std::vector<std::string> names;
  if (fs::exists(folder))
    for (const auto& entry : fs::recursive_directory_iterator(folder)) names.push_back(fs::relative(entry.path(), folder).string());
  std::sort(names.begin(), names.end());
  return names;
}

/// The exit code is `code` and the message is one line that holds all `parts`.
inline void expect_refusal(const Outcome& outcome, int code, const std::vector<std::string>& parts) {
  EXPECT_EQ(outcome.code, code) << outcome.err << outcome.out;
  for (const std::string& part : parts) EXPECT_NE(outcome.err.find(part), std::string::npos) << "'" << part << "' is not in: " << outcome.err;
  EXPECT_EQ(outcome.err.find("internal error"), std::string::npos) << outcome.err;
}

}  // namespace mtled::program
