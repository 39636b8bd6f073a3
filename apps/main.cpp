#include <cstdio>
#include <new>

#include "command.hpp"
#include "core/error.hpp"
#include "io/output.hpp"

namespace {

/// CLI11 would only say that a subcommand is required.
void require_known_verb(const CLI::App& program, int argc, char** argv) {
  if (argc < 2 || argv[1][0] == '-') return;
  std::string verbs;
  for (const CLI::App* verb : program.get_subcommands([](const CLI::App*) { return true; })) {
    if (verb->check_name(argv[1])) return;
    verbs += (verbs.empty() ? "" : ", ") + verb->get_name();
  }
  mtled::fail(mtled::Failure::usage, "'", argv[1], "' is no verb of this program", MTLED_IMAGING ? "" : ", which was built without ITK", "; choose one of ", verbs);
}

}  // namespace

int main(int argc, char** argv) {
  using namespace mtled;
  install_interrupt_handler();
  CLI::App program("Predicts how the body deforms between two images of one patient, from the motions of the bones, by meshless\n"
                   "total Lagrangian explicit dynamics, and warps the moving image onto the fixed one.\n"
                   "Coordinates are LPS in mm. Exit codes: 0 done, 1 internal, 2 usage, 3 input, 4 numerical, 5 device, 6 memory, 7 output.",
                   "mtled");
  program.require_subcommand(1);
  program.set_version_flag("--version", MTLED_VERSION);
#if MTLED_IMAGING
  add_register(program);
  add_classify(program);
  add_motions(program);
  add_warp(program);
  add_evaluate(program);
  add_baseline(program);
#endif
  add_solve(program);
  add_info(program);
  try {
    require_known_verb(program, argc, argv);
    program.parse(argc, argv);
    return 0;
  } catch (const CLI::ParseError& error) {
    return program.exit(error) == 0 ? 0 : int(Failure::usage);
  } catch (const Error& error) {
    std::fprintf(stderr, "mtled: error: %s\n", error.what());
    return int(error.failure());
  } catch (const std::bad_alloc&) {
    std::fprintf(stderr, "mtled: error: out of memory; use a larger --node-spacing, or images resampled with --resample\n");
    return int(Failure::memory);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "mtled: internal error: %s\n", error.what());
    return int(Failure::internal);
  }
}
