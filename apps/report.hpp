#pragma once
#include "command.hpp"
#include "io/json.hpp"
#include "report/report_view.hpp"

namespace mtled {

/// Adds a file that was read to the list `inputs` of the facts. `grid`: null where it is no image.
/// What the file of an option is: "fixed image" of fixed, "moving labels" of moving-labels.
std::string role_of(std::string option);
void list_input(Json& inputs, const std::string& role, const std::string& path, const Grid* grid = nullptr, const std::string& md5 = {});

/// The options that were given, on the command line or in a file: list of name, value.
Json settings_of(const CLI::App& verb);

/// The facts of a report (docs/report.md) of what `register` found: its metrics.json and manifest.json.
Json facts_of_registration(const Json& metrics, const Json& manifest);
/// The same of evaluation.json.
Json facts_of_evaluation(const Json& evaluation);

/// Writes report.html: the facts with verdict and date, what the viewer shows, and perhaps the cloud of nodes.
void write_report(const std::filesystem::path& file, Json facts, const ReportView& view, Json nodes = nullptr);

constexpr std::size_t report_voxels = 4000000;  ///< at most, of each space that the viewer shows

}  // namespace mtled
