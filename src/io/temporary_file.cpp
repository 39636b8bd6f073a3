#include "io/temporary_file.hpp"

#include <unistd.h>

#include <array>
#include <atomic>
#include <csignal>
#include <cstring>
#include <string>

#include "core/error.hpp"
#include "io/output.hpp"

namespace mtled {
namespace {

// A signal handler may neither lock nor allocate: names stand in fixed buffers, guarded by a lock-free state each.
enum SlotState : int { unused, filling, in_use };
struct Slot {
  std::atomic<int> state{unused};
  char name[4096];
};
static_assert(std::atomic<int>::is_always_lock_free);
std::array<Slot, 64> slots;

extern "C" void remove_temporaries_and_end(int signal) {
  for (const Slot& slot : slots)
    if (slot.state.load() == in_use) ::unlink(slot.name);  // fails for a folder
  for (auto slot = slots.rbegin(); slot != slots.rend(); ++slot)  // folders within others were added after those
    if (slot->state.load() == in_use) ::rmdir(slot->name);        // fails for a folder with something in it
  ::_exit(128 + signal);
}

/// Number of the slot that now holds `name`; -1 when there is no room for it.
int claim_slot(const std::string& name) {
  if (name.size() >= sizeof(Slot::name)) return -1;
  for (std::size_t i = 0; i < slots.size(); ++i) {
    int expected = unused;
    if (!slots[i].state.compare_exchange_strong(expected, filling)) continue;
    std::memcpy(slots[i].name, name.c_str(), name.size() + 1);
    slots[i].state = in_use;
    return int(i);
  }
  return -1;
}

}  // namespace

InterruptGuard::InterruptGuard(const std::filesystem::path& path) : slot_(claim_slot(std::filesystem::absolute(path).string())) {}

InterruptGuard::~InterruptGuard() {
  if (slot_ >= 0) slots[std::size_t(slot_)].state = unused;
}

namespace {

std::filesystem::path temporary_name(const std::filesystem::path& target) {
  static std::atomic<int> count{0};
  return target.parent_path() / concatenate(".partial-", ::getpid(), "-", count++, "-", target.filename().string());
}

}  // namespace

TemporaryFile::TemporaryFile(const std::filesystem::path& target) : path_(temporary_name(target)), guard_(path_) {}

TemporaryFile::~TemporaryFile() {
  std::error_code ignored;
  std::filesystem::remove(path_, ignored);
}

void install_interrupt_handler() {
  struct sigaction action {};
  action.sa_handler = remove_temporaries_and_end;
  sigfillset(&action.sa_mask);
  sigaction(SIGINT, &action, nullptr);
  sigaction(SIGTERM, &action, nullptr);
}

}  // namespace mtled
