#include "command.hpp"

#include <unistd.h>

#include <charconv>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <thread>

#include "core/discrete_model.hpp"
#include "core/error.hpp"
#include "core/mechanics.hpp"
#include "io/toml_reader.hpp"

namespace mtled {

void add_common(CLI::App& verb, CommonOptions& common, bool with_config) {
  verb.add_option("--threads", common.threads, "threads to use (default: all processors)")->type_name("N")->check(positive());
  verb.add_option("--device", common.device, "where to solve: auto, cpu, cuda or cuda:N")->capture_default_str();
  verb.add_flag("--quiet,-q", common.quiet, "no progress on standard error");
  verb.add_flag("--force", common.force, "write into an output folder that is not empty");
  if (with_config) verb.add_option("--config,-c", common.config, "TOML file with the same settings (keys: option names); the command line wins")->type_name("FILE");
}

namespace {

CLI::Validator number_that(const std::string& rule, std::function<bool(double)> holds) {
  return CLI::Validator(
      [rule, holds](std::string& text) {
        double value = 0;
        if (!CLI::detail::lexical_cast(text, value)) return "'" + text + "' is not a number; it must be " + rule;
        if (!std::isfinite(value) || !holds(value)) return text + " is not allowed: it must be " + rule;
        return std::string();
      },
      rule);
}

}  // namespace

CLI::Validator positive() {
  return number_that("above 0", [](double v) { return v > 0; });
}
CLI::Validator not_negative() {
  return number_that("at least 0", [](double v) { return v >= 0; });
}
CLI::Validator at_least_and_below(double low, double high) {
  return number_that(concatenate("at least ", low, " and below ", high), [=](double v) { return v >= low && v < high; });
}
CLI::Validator from_to(double low, double high) {
  return number_that(concatenate("from ", low, " to ", high), [=](double v) { return v >= low && v <= high; });
}

namespace {

std::string text_of(const toml::node& node, const std::string& place) {
  if (const auto s = node.value<std::string>(); s && node.is_string()) return *s;
  if (node.is_boolean()) return *node.value<bool>() ? "true" : "false";
  if (node.is_integer()) return std::to_string(*node.value<std::int64_t>());
  if (node.is_floating_point()) {
    char buffer[32];
    return {buffer, std::to_chars(buffer, buffer + sizeof buffer, *node.value<double>()).ptr};
  }
  fail(Failure::input, place, " must be a text, a number, true, false or an array of these");
}

/// A value of an option of type `type`, its path, if it holds one, seen from `folder`.
std::string seen_from(const std::filesystem::path& folder, const std::string& type, const std::string& value) {
  if (type == "FILE" || type == "IMAGE" || type == "DIR") return (folder / value).string();
  const std::size_t equals = value.find('=');
  if (type != "NAME=FILE" || equals == std::string::npos || equals + 1 == value.size()) return value;
  return value.substr(0, equals + 1) + (folder / value.substr(equals + 1)).string();
}

}  // namespace

void apply_config(CLI::App& verb, const CommonOptions& common) {
  if (common.config.empty()) return;
  const toml::table table = parse_toml(common.config);
  for (const auto& [key, node] : table) {
    const std::string name(key.str()), place = common.config.string() + ": `" + name + "`";
    CLI::Option* option = name == "config" || name == "help" ? nullptr : verb.get_option_no_throw("--" + name);
    if (!option) {
      std::string known;
      for (const CLI::Option* o : verb.get_options())
        if (!o->get_lnames().empty() && o->get_lnames()[0] != "help" && o->get_lnames()[0] != "config") known += (known.empty() ? "" : ", ") + o->get_lnames()[0];
      fail(Failure::input, place, " is not a known setting (line ", node.source().begin.line, "); known: ", known);
    }
    if (option->count() > 0) continue;
    std::vector<std::string> values;
    if (const toml::array* array = node.as_array()) {
      for (const auto& element : *array) values.push_back(text_of(element, place));
    } else {
      values.push_back(text_of(node, place));
    }
    for (std::string& v : values) {
      v = seen_from(common.config.parent_path(), option->get_type_name(), v);
      if (option->get_expected_min() == 0) v = option->get_flag_value(name, v);  // "true" of a --no-... flag is false
      option->add_result(v);
    }
    try {
      option->run_callback();
    } catch (const CLI::Error& error) {
      fail(Failure::input, place, ": ", error.what());
    }
  }
}

void require_option(const CLI::App& verb, const std::string& name) {
  const CLI::Option* option = verb.get_option(name);
  if (option->count() == 0) fail(Failure::usage, name, " is missing (", option->get_description(), "); see `mtled ", verb.get_name(), " --help`");
}

std::unique_ptr<ThreadLimit> start(const CommonOptions& common) {
  if (const DeviceRequest request = parse_device(common.device); request.kind == DeviceRequest::cuda) choose_device(request, cuda_status());
  const int processors = int(std::max(1u, std::thread::hardware_concurrency()));
  if (common.threads > processors)
    warn(concatenate("--threads ", common.threads, ": there are only ", processors, " processors; ", processors, " threads are used"));
  return std::make_unique<ThreadLimit>(common.threads > 0 ? std::min(common.threads, processors) : processors);
}

MakeMechanics on_device(const CommonOptions& common, DeviceChoice& used) {
  return [&common, &used](const DiscreteModel& model, const SolverOptions& options) {
    const DeviceRequest request = parse_device(common.device);
    CudaStatus status = request.kind == DeviceRequest::cpu ? CudaStatus() : cuda_status();
    std::unique_ptr<Mechanics> mechanics;
    for (used = choose_device(request, status); !used.on_cpu() && !mechanics; used = choose_device(request, status)) {
      try {
        mechanics = cuda_mechanics(used.ordinal)(model, options);
        break;
      } catch (const Error& error) {
        const bool another = status.devices.size() > 1 && request.ordinal < 0;
        if (!another && request.kind == DeviceRequest::cuda) throw;
        for (DeviceDescription& d : status.devices)
          if (d.ordinal == used.ordinal) d.unusable = error.what();
      }
    }
    if (!mechanics) mechanics = make_cpu_mechanics(model, options);
    announce(common, concatenate(used.sentence(), ", ", mechanics->bytes() / 1e9, " GB for ", model.field->cloud().size(), " nodes and ", model.points->size(), " integration points"));
    return mechanics;
  };
}

std::function<void(const Progress&)> progress_printer(bool quiet) {
  if (quiet) return {};
  const bool terminal = isatty(STDERR_FILENO);
  return [terminal, last = std::chrono::steady_clock::time_point{}](const Progress& p) mutable {
    const auto now = std::chrono::steady_clock::now();
    if (now - last < std::chrono::milliseconds(terminal ? 200 : 5000)) return;
    last = now;
    std::fprintf(stderr, "%s%s: step %d", terminal ? "\r\033[K" : "", p.stage, p.step);
    if (std::isfinite(p.error_estimate_mm)) std::fprintf(stderr, ", estimated error %.3g mm", p.error_estimate_mm);
    std::fprintf(stderr, ", %.0f s", p.seconds);
    if (std::isfinite(p.seconds_left)) std::fprintf(stderr, ", about %.0f s left", p.seconds_left);
    std::fprintf(stderr, terminal ? "" : "\n");
    std::fflush(stderr);
  };
}

void announce(const CommonOptions& common, const std::string& text) {
  if (!common.quiet) std::fprintf(stderr, "%s%s\n", isatty(STDERR_FILENO) ? "\r\033[K" : "", text.c_str());
}

void warn(const std::string& text) { std::fprintf(stderr, "%swarning: %s\n", isatty(STDERR_FILENO) ? "\r\033[K" : "", text.c_str()); }

}  // namespace mtled
