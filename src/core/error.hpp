#pragma once
#include <sstream>
#include <stdexcept>
#include <string>

namespace mtled {

/// What went wrong, as the exit code of the program.
enum class Failure : int {
  internal = 1,    ///< a defect of this program
  usage = 2,       ///< command line
  input = 3,       ///< a file, image, table or setting that cannot be used
  numerical = 4,   ///< the solver diverged or did not converge
  device = 5,      ///< the requested GPU is missing or failed
  memory = 6,      ///< more memory needed than there is
  output = 7,      ///< a result cannot be written
};

/// Every error that a user can meet. The message says the problem, the reason and the remedy.
class Error : public std::runtime_error {
 public:
  Error(Failure failure, const std::string& message) : std::runtime_error(message), failure_(failure) {}
  Failure failure() const { return failure_; }

 private:
  Failure failure_;
};

template <class... Parts>
std::string concatenate(const Parts&... parts) {
  std::ostringstream text;
  text.precision(6);
  (text << ... << parts);
  return text.str();
}

template <class... Parts>
[[noreturn]] void fail(Failure failure, const Parts&... parts) {
  throw Error(failure, concatenate(parts...));
}

/// Throws an input error made of `parts` unless `condition` holds.
template <class... Parts>
void require(bool condition, const Parts&... parts) {
  if (!condition) fail(Failure::input, parts...);
}

/// Runs `work`; an Error that leaves it gets "`context`: " in front.
template <class Work>
decltype(auto) with_context(const std::string& context, Work&& work) {
  try {
    return work();
  } catch (const Error& error) {
    throw Error(error.failure(), context + ": " + error.what());
  }
}

}  // namespace mtled
