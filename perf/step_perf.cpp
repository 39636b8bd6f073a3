// Time of one step of the relaxation per number of nodes and device, on a torso that the program makes itself.
#include <sys/resource.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <limits>
#include <memory>
#include <new>
#include <thread>

#include "core/cpu_kernels.hpp"
#include "core/error.hpp"
#include "core/mechanics.hpp"
#include "core/parallel.hpp"
#include "core/relaxation.hpp"
#include "core/shape_evaluator.hpp"
#include "cuda/device_choice.hpp"
#include "io/json.hpp"
#include "io/output.hpp"
#include "step_traffic.hpp"
#include "torso_model.hpp"

namespace mtled {
namespace {

struct Options {
  std::string device = "cpu", cloud = "lattice", commit;
  std::vector<std::size_t> sizes{10000, 30000, 100000, 300000, 1000000, 3000000, 10000000};
  std::size_t two_level_up_to = 1000000;
  int repetitions = 7, threads = int(std::thread::hardware_concurrency());
  bool double_precision = false;
  std::filesystem::path output = "step_perf";
};

double seconds_since(std::chrono::steady_clock::time_point start) { return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count(); }

/// Seconds that `work` takes.
template <class Work>
double seconds_of(Work&& work) {
  const auto start = std::chrono::steady_clock::now();
  work();
  return seconds_since(start);
}

double median(std::vector<double> values) {
  std::sort(values.begin(), values.end());
  const std::size_t n = values.size();
  return (values[n / 2] + values[(n - 1) / 2]) / 2;
}

/// What the benchmark must know of a device.
struct Backend {
  std::string device, driver;
  MakeMechanics make;
  std::function<double()> copy_bandwidth;  ///< [GB/s] read and written by a plain copy of an array that is much larger than any cache
  bool fused = false;                      ///< see step_traffic()
};

double cpu_copy_bandwidth() {
  constexpr std::size_t count = std::size_t(1) << 28, piece = std::size_t(1) << 20;
  const std::unique_ptr<char[]> from(new char[count]), to(new char[count]);
  parallel_pieces(count, piece, [&](std::size_t begin, std::size_t end) { std::fill(from.get() + begin, from.get() + end, 1), std::fill(to.get() + begin, to.get() + end, 0); });
  std::vector<double> seconds;
  for (int r = 0; r < 9; ++r)
    seconds.push_back(seconds_of([&] { parallel_pieces(count, piece, [&](std::size_t begin, std::size_t end) { std::copy(from.get() + begin, from.get() + end, to.get() + begin); }); }));
  return 2e-9 * double(count) / median(seconds);
}

/// The value after `name` and a colon in a file such as /proc/cpuinfo; "" where there is none.
std::string value_in(const char* file, const std::string& name) {
  std::ifstream stream(file);
  for (std::string line; std::getline(stream, line);)
    if (line.starts_with(name)) return line.substr(std::min(line.size(), line.find(':') + 2));
  return {};
}

Backend backend(const std::string& device) {
  if (device == "cpu") return {value_in("/proc/cpuinfo", "model name") + ", " + best_kernels_name(), "", make_cpu_mechanics, cpu_copy_bandwidth, true};
  const CudaStatus status = cuda_status();
  const DeviceChoice choice = choose_device(parse_device(device), status);
  if (choice.on_cpu()) return backend("cpu");
  return {choice.description, status.driver, cuda_mechanics(choice.ordinal), [choice] { return cuda_copy_bandwidth(choice.ordinal); }, false};
}

/// A control that lets the iteration go on whatever it does, unless it is no longer finite.
StepControl without_end() {
  StepControl control;
  control.tolerance = 0;
  control.largest_increment = std::numeric_limits<double>::max();
  control.impatient_from = control.longest_inversion = std::numeric_limits<int>::max();
  return control;
}

/// Steps from the bent torso towards equilibrium, in repetitions of a quarter of a second or more.
Json time_steps(Mechanics& mechanics, const DiscreteModel& model, int repetitions) {
  std::vector<Vec3d> bent(model.slots());
  for (int slot : model.layout.slot_of_node) bent[std::size_t(slot)] = torso_bending(model.position[std::size_t(slot)]);
  const VectorPointer u = mechanics.vector(), increment = mechanics.vector(), change = mechanics.vector();
  mechanics.upload(bent, *u);
  constexpr double margin = 1.4;  // of the power iteration, which comes from below
  const VectorPointer v = mechanics.vector();
  mechanics.upload(rough_vector(model.active), *v);
  const StepSizes sizes{0.9, margin * largest_eigenvalue(mechanics, *u, 20, *v)};
  StepControl control = without_end();
  const auto run = [&](int count) { return seconds_of([&] { mechanics.steps(count, sizes, control, *u, *increment, *change); }); };
  constexpr int fewest = 5, most = 10000;
  run(fewest);
  const int count = std::clamp(int(0.25 * fewest / run(fewest)), fewest, most);
  run(count);
  std::vector<double> us;
  for (int r = 0; r < repetitions; ++r) us.push_back(1e6 * run(count) / count);
  if (control.verdict != StepControl::going || !std::isfinite(mechanics.dot(*u, *u)))
    fail(Failure::numerical, "the iteration ended by itself after ", control.step, " steps (verdict ", control.verdict, "): its times mean nothing");
  return {{"median", median(us)}, {"min", *std::min_element(us.begin(), us.end())}, {"max", *std::max_element(us.begin(), us.end())}, {"repetitions", repetitions}, {"steps_per_repetition", count}};
}

/// Share of the points whose support no other point has.
double share_of_single_supports(const SupportTable& supports) {
  std::vector<int> users(std::size_t(supports.num_stencils()), 0);
  for (int s : supports.stencil)
    if (s >= 0) ++users[std::size_t(s)];
  return double(std::count(users.begin(), users.end(), 1)) / double(supports.stencil.size());
}

double peak_memory_bytes() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return 1024.0 * double(usage.ru_maxrss);
}

/// Memory of the whole run on the host [bytes]: above the 1.3 GB measured at a million lattice nodes; a guess for general clouds, whose supports weigh more.
double expected_memory(std::size_t nodes, CloudKind kind) { return (kind == CloudKind::lattice ? 2000.0 : 5000.0) * double(nodes) + 1e9; }

Json measure(const SampledBody& torso, double sampling_seconds, Relaxation relaxation, const Options& options, const Backend& device, double copy_bandwidth) {
  SolverOptions solver;
  solver.relaxation = relaxation;
  solver.double_precision = options.double_precision;
  Json setup{{"sampling", sampling_seconds}};
  const ShapeEvaluator field(torso.cloud, {}, {});
  IntegrationPoints points = torso.points;
  const Constraints none;
  DiscreteModel model;
  setup["model"] = seconds_of([&] {
    std::vector<double> points_of_nodes;
    model = make_static_model(field, points, none, springs_on(torso.rigid, field), {}, solver, points_of_nodes);
  });
  std::unique_ptr<Mechanics> mechanics;
  setup["backend"] = seconds_of([&] { mechanics = device.make(model, solver); });
  if (relaxation == Relaxation::two_level) {
    const VectorPointer rest = mechanics->vector();
    setup["coarse matrix"] = seconds_of([&] { mechanics->assemble_coarse(*rest); });
  }
  const Json us = time_steps(*mechanics, model, options.repetitions);
  const StepTraffic bytes = step_traffic(model, options.double_precision ? 8 : 4, device.fused, mechanics->coarse_unknowns());
  const double seconds = 1e-6 * us["median"].get<double>(), bandwidth = 1e-9 * bytes.total() / seconds;
  const double nodes = double(torso.cloud.size()), used_points = double(points.size() - model.supports.dropped.size());
  return {{"relaxation", relaxation == Relaxation::two_level ? "two-level" : "plain"},
          {"nodes", torso.cloud.size()},
          {"points", used_points},
          {"slots", model.slots()},
          {"springs", model.springs.size()},
          {"stencils", model.supports.num_stencils()},
          {"stencil_terms", model.supports.gradient.size()},
          {"enlarged_supports", model.supports.enlarged},
          {"dropped_points", model.supports.dropped.size()},
          {"share_of_single_supports", share_of_single_supports(model.supports)},
          {"coarse_unknowns", mechanics->coarse_unknowns()},
          {"mean_spacing_mm", model.spacing},
          {"microseconds_per_step", us},
          {"node_steps_per_s", nodes / seconds},
          {"point_steps_per_s", used_points / seconds},
          {"bytes_per_step", {{"tables", bytes.tables}, {"displacement", bytes.displacement}, {"stresses", bytes.stresses}, {"state", bytes.state}, {"coarse", bytes.coarse}, {"total", bytes.total()}}},
          {"GB_per_s", bandwidth},
          {"share_of_copy_bandwidth", bandwidth / copy_bandwidth},
          {"setup_seconds", setup},
          {"backend_bytes", mechanics->bytes()},
          {"peak_host_bytes", peak_memory_bytes()}};
}

std::string number(double value, int decimals) {
  char text[64];
  std::snprintf(text, sizeof text, "%.*f", decimals, value);
  return text;
}

std::string table(const Json& result) {
  const Json& c = result["conditions"];
  std::string text = "# Time per step\n\n";
  for (const auto& [name, value] : c.items()) text += "- " + name + ": " + (value.is_string() ? value.get<std::string>() : value.is_number_float() ? number(value.get<double>(), 1) : value.dump()) + "\n";
  text += "\nWritten by `step_perf`, which see in `perf/README.md`. Times are medians (smallest to largest). *Single*: points whose support no other point has. "
          "*GB/s* is what a step must move at least over its time, and *of copy* its share of a plain copy's. *Setup*: sampling + model + tables of the backend (+ coarse matrix).\n\n"
          "| nodes | points | relaxation | single % | us per step | million node steps/s | million point steps/s | MB per step | GB/s | of copy % | setup s | backend MB | peak host MB |\n"
          "|---|---|---|---|---|---|---|---|---|---|---|---|---|\n";
  for (const Json& r : result["runs"]) {
    if (r.contains("skipped")) {
      text += "| " + r["nodes"].dump() + " | | " + r["relaxation"].get<std::string>() + " | skipped: " + r["skipped"].get<std::string>() + " | | | | | | | | | |\n";
      continue;
    }
    const Json& us = r["microseconds_per_step"];
    const auto of = [&](const char* key, double scale, int decimals) { return number(scale * r[key].get<double>(), decimals); };
    std::string setup;
    for (const Json& s : r["setup_seconds"]) setup += (setup.empty() ? "" : " + ") + number(s.get<double>(), 1);
    text += "| " + r["nodes"].dump() + " | " + of("points", 1, 0) + " | " + r["relaxation"].get<std::string>() + " | " + of("share_of_single_supports", 100, 1) + " | " + number(us["median"].get<double>(), 0) + " (" +
            number(us["min"].get<double>(), 0) + " to " + number(us["max"].get<double>(), 0) + ") | " + of("node_steps_per_s", 1e-6, 1) + " | " + of("point_steps_per_s", 1e-6, 1) + " | " +
            number(1e-6 * r["bytes_per_step"]["total"].get<double>(), 1) + " | " + of("GB_per_s", 1, 1) + " | " + of("share_of_copy_bandwidth", 100, 0) + " | " + setup + " | " + of("backend_bytes", 1e-6, 0) + " | " +
            of("peak_host_bytes", 1e-6, 0) + " |\n";
  }
  return text;
}

/// Of the source that this program was built from, as far as git can tell.
std::string commit_of_source() {
  std::string text;
  if (FILE* pipe = popen("git -C '" MTLED_SOURCE_DIR "' describe --always --dirty 2>/dev/null", "r")) {
    char buffer[128];
    while (std::fgets(buffer, sizeof buffer, pipe)) text += buffer;
    pclose(pipe);
  }
  while (!text.empty() && text.back() == '\n') text.pop_back();
  return text.empty() ? "unknown" : text;
}

void run(const Options& options, const std::string& command) {
  const ThreadLimit limit(options.threads);
  const Backend device = backend(options.device);
  const CloudKind kind = options.cloud == "general" ? CloudKind::general : CloudKind::lattice;
  const OutputDirectory folder(options.output, true);
  const double copy_bandwidth = device.copy_bandwidth();
  Json result{{"conditions",
               {{"device", device.device},
                {"driver", device.driver.empty() ? "none" : device.driver},
                {"host threads", options.threads},
                {"precision", options.double_precision ? "double" : "single"},
                {"cloud", options.cloud},
                {"commit", options.commit.empty() ? commit_of_source() : options.commit},
                {"compiler", __VERSION__},
                {"command", command},
                {"copy GB/s", copy_bandwidth}}},
              {"runs", Json::array()}};
  const auto write = [&] {
    write_text(folder / "step_perf.json", result.dump(2) + "\n");
    write_text(folder / "step_perf.md", table(result));
  };
  for (const std::size_t nodes : options.sizes) {
    std::vector<std::pair<Relaxation, std::string>> kinds{{Relaxation::plain, "plain"}, {Relaxation::two_level, "two-level"}};
    const auto skip = [&](const std::string& name, const std::string& reason) { result["runs"].push_back({{"nodes", nodes}, {"relaxation", name}, {"skipped", reason}}); };
    const double needed = expected_memory(nodes, kind), free_bytes = 1024 * std::strtod(value_in("/proc/meminfo", "MemAvailable").c_str(), nullptr);
    if (needed > free_bytes) {
      for (const auto& [relaxation, name] : kinds) skip(name, concatenate("needs about ", needed * 1e-9, " GB of host memory, ", free_bytes * 1e-9, " GB are free"));
      write();
      continue;
    }
    SampledBody torso;
    const double sampling = seconds_of([&] { torso = sample_torso(nodes, kind); });
    for (const auto& [relaxation, name] : kinds) {
      if (relaxation == Relaxation::two_level && nodes > options.two_level_up_to) {
        skip(name, concatenate("above --two-level-up-to ", options.two_level_up_to));
        continue;
      }
      try {
        result["runs"].push_back(measure(torso, sampling, relaxation, options, device, copy_bandwidth));
      } catch (const std::bad_alloc&) {
        skip(name, "does not fit into memory");
      } catch (const Error& error) {
        if (error.failure() != Failure::memory) throw;
        skip(name, error.what());
      }
      write();
    }
  }
  std::fputs(table(result).c_str(), stdout);
}

}  // namespace
}  // namespace mtled

int main(int argc, char** argv) {
  using namespace mtled;
  install_interrupt_handler();
  CLI::App program("Times the steps of the relaxation on a torso of formulas, per number of nodes; writes step_perf.json and step_perf.md.", "step_perf");
  Options options;
  program.add_option("--device", options.device, "cpu, cuda or cuda:N")->capture_default_str();
  program.add_option("--sizes", options.sizes, "Numbers of nodes, about")->capture_default_str();
  program.add_option("--cloud", options.cloud, "lattice, or general: jittered nodes, every support its own")->check(CLI::IsMember({"lattice", "general"}))->capture_default_str();
  program.add_option("--repetitions", options.repetitions, "Timed repetitions")->check(CLI::Range(1, 1000))->capture_default_str();
  program.add_option("--two-level-up-to", options.two_level_up_to, "Most nodes for which the two-level preconditioner is timed, too")->capture_default_str();
  program.add_option("--threads", options.threads, "Threads of the host")->check(CLI::Range(1, 1024))->capture_default_str();
  program.add_flag("--double", options.double_precision, "Double precision");
  program.add_option("--commit", options.commit, "Commit to report; without it, what git says of the source folder");
  program.add_option("-o,--output", options.output, "Folder of the results")->capture_default_str();
  try {
    program.parse(argc, argv);
    std::string command = "step_perf";
    for (int i = 1; i < argc; ++i) command += std::string(" ") + argv[i];
    run(options, command);
    return 0;
  } catch (const CLI::ParseError& error) {
    return program.exit(error) == 0 ? 0 : int(Failure::usage);
  } catch (const Error& error) {
    std::fprintf(stderr, "step_perf: error: %s\n", error.what());
    return int(error.failure());
  } catch (const std::exception& error) {
    std::fprintf(stderr, "step_perf: error: %s\n", error.what());
    return int(Failure::internal);
  }
}
