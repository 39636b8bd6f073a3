#pragma once
#include <CLI/CLI.hpp>
#include <filesystem>
#include <memory>
#include <string>

#include "core/parallel.hpp"
#include "core/solver.hpp"
#include "cuda/device_choice.hpp"

namespace mtled {

/// What every verb has: --threads, --device, --quiet, --force, --config.
struct CommonOptions {
  int threads = 0;                 ///< 0 = all
  std::string device = "auto";
  bool quiet = false;
  bool force = false;
  std::filesystem::path config;
};

/// Declares the common options; `with_output` adds --output and --force.
void add_common(CLI::App& verb, CommonOptions& common, bool with_config);

/// Gives options that were not on the command line their values from the TOML file named by --config: keys are the long
/// option names without dashes. Paths there are relative to the file. Input errors: unknown key, value out of range.
void apply_config(CLI::App& verb, const CommonOptions& common);

/// Checks of numbers for CLI11: finite, and above 0 / at least 0 / in [low, high) / in [low, high].
CLI::Validator positive();
CLI::Validator not_negative();
CLI::Validator at_least_and_below(double low, double high);
CLI::Validator from_to(double low, double high);

/// Usage error naming the option and what it is for, unless it was given.
void require_option(const CLI::App& verb, const std::string& name);

/// Checks --threads and --device and limits parallel loops while the result lives. A device that was asked for must be there.
std::unique_ptr<ThreadLimit> start(const CommonOptions& common);
/// Makes the mechanics of a model on the device of --device, and says which that is and how much memory it takes, unless quiet.
/// `used` [out] is filled when it is called. With `auto` any failure of a GPU to take the model makes it the CPU's.
MakeMechanics on_device(const CommonOptions& common, DeviceChoice& used);

/// Lines on stderr: one that is rewritten when it is a terminal, a plain line every few seconds when it is not.
std::function<void(const Progress&)> progress_printer(bool quiet);
/// A line on stderr for a stage that begins; nothing when quiet.
void announce(const CommonOptions& common, const std::string& text);
void warn(const std::string& text);

/// Each declares one verb and what it does when called.
void add_solve(CLI::App& program);
void add_info(CLI::App& program);
void add_register(CLI::App& program);
void add_classify(CLI::App& program);
void add_motions(CLI::App& program);
void add_warp(CLI::App& program);
void add_evaluate(CLI::App& program);
void add_baseline(CLI::App& program);

}  // namespace mtled
