#include "report.hpp"

#include <algorithm>
#include <chrono>
#include <ctime>

#include "io/output.hpp"
#include "report/page.hpp"
#include "report/verdict.hpp"

namespace mtled {
namespace {

constexpr const char* names_of_candidates[][2] = {{"before", "Before"}, {"rigid", "Rigid"}, {"mtled", "mtled"}, {"after", "Registered"}};

std::string now() {
  const std::time_t time = std::chrono::system_clock::to_time_t(std::chrono::system_clock::now());
  char text[32];
  std::tm utc;
  gmtime_r(&time, &utc);
  std::strftime(text, sizeof text, "%Y-%m-%d %H:%M UTC", &utc);
  return text;
}

std::string name_of(const std::string& id) {
  for (const auto& [known, name] : names_of_candidates)
    if (id == known) return name;
  return id;
}

/// Those of which something is known: the images as they lay first, the registration that is judged last.
Json candidates_in(const Json& facts) {
  Json list = Json::array();
  for (const char* group : {"edges", "landmarks", "labels"}) {
    if (!facts.contains(group)) continue;
    for (const auto& [id, values] : facts[group].items())
      if (std::none_of(list.begin(), list.end(), [&, key = id](const Json& c) { return c["id"] == key; })) list.push_back({{"id", id}, {"name", name_of(id)}});
  }
  const auto place = [](const Json& c) { return c["id"] == "before" ? 0 : c["id"] == "after" || c["id"] == "mtled" ? 2 : 1; };
  std::stable_sort(list.begin(), list.end(), [&](const Json& a, const Json& b) { return place(a) < place(b); });
  return list;
}

void copy(const Json& from, Json& to, std::initializer_list<const char*> keys) {
  for (const char* key : keys)
    if (from.contains(key)) to[key] = from[key];
}

Json stages_of(const Json& stages) {
  Json list = Json::array();
  for (const auto& [name, stage] : stages.items()) list.push_back({{"name", name}, {"seconds", stage["seconds"]}, {"peak_memory_MB", stage["peak_memory_MB"]}});
  return list;
}

/// Columns of the history of the solver.
Json columns_of(const Json& history) {
  Json columns;
  for (const auto& [to, from] : {std::pair{"step", "step"}, {"error_mm", "error_estimate_mm"}, {"rate", "convergence_rate"}, {"energy_mN_mm", "strain_energy_mN_mm"}})
    for (const Json& row : history) columns[to].push_back(row[from]);
  return columns;
}

}  // namespace

std::string role_of(std::string option) {
  if (option == "fixed" || option == "moving" || option == "warped") option += " image";
  std::replace(option.begin(), option.end(), '-', ' ');
  return option;
}

void list_input(Json& inputs, const std::string& role, const std::string& path, const Grid* grid, const std::string& md5) {
  Json input{{"role", role}, {"path", path}};
  if (!md5.empty()) input["md5"] = md5;
  if (grid) input["size"] = grid->size, input["spacing_mm"] = {grid->spacing.x, grid->spacing.y, grid->spacing.z};
  inputs.push_back(input);
}

Json settings_of(const CLI::App& verb) {
  Json settings = Json::array();
  for (const CLI::Option* option : verb.get_options()) {
    if (option->get_lnames().empty() || option->count() == 0) continue;
    std::string value;
    for (const std::string& part : option->results()) value += (value.empty() ? "" : " ") + part;
    settings.push_back({{"name", option->get_lnames()[0]}, {"value", value}});
  }
  return settings;
}

Json facts_of_registration(const Json& metrics, const Json& manifest) {
  Json facts{{"version", 1}, {"kind", "register"}, {"program", manifest["program"]}};
  copy(metrics, facts, {"warnings", "edges", "landmarks", "labels"});
  facts["jacobian"] = metrics["inverse"]["jacobian"];  // as the pictures: of the map fixed -> moving; where the other one folds, it is not known
  facts["jacobian"]["folded_voxels"] = metrics["jacobian"]["folded_voxels"];
  copy(manifest, facts, {"tissue"});
  facts["candidates"] = candidates_in(facts);
  facts["motions"] = Json::array();
  for (const Json& m : metrics["motions"]) {
    Json row{{"label", m["label"]}, {"angle_deg", m["rotation_deg"]}, {"shift_mm", m["center_displacement_mm"]}};
    copy(m, row, {"similarity_before", "similarity_after", "inverse_consistency_mm", "rms_deviation_mm", "largest_deviation_mm", "voxels"});
    facts["motions"].push_back(row);
  }
  const Json& s = manifest["solver"];
  copy(s, facts["solver"], {"steps", "error_estimate_mm", "converged", "nodes", "device", "tolerance_mm"});
  facts["solver"]["points"] = s["integration_points"];
  facts["solver"]["history"] = columns_of(s.value("history", Json::array()));
  facts["stages"] = stages_of(manifest["stages"]);
  return facts;
}

Json facts_of_evaluation(const Json& evaluation) {
  Json facts{{"version", 1}, {"kind", "evaluate"}, {"program", "mtled " MTLED_VERSION}};
  copy(evaluation, facts, {"warnings", "edges", "landmarks", "labels", "contours", "rigidity", "direction", "field_difference", "beside"});
  if (facts.contains("landmarks")) facts["landmarks"].erase("left_out_rows");
  if (evaluation.contains("field")) copy(evaluation["field"], facts, {"jacobian", "inverse_consistency"});
  if (evaluation.contains("stages")) facts["stages"] = stages_of(evaluation["stages"]);
  facts["edge_settings"] = evaluation["settings"];
  facts["candidates"] = candidates_in(facts);
  return facts;
}

void write_report(const std::filesystem::path& file, Json facts, const ReportView& view, Json nodes) {
  facts["created"] = now();
  facts["verdict"] = verdict_of(facts);
  facts["view"] = view.json();
  if (!nodes.is_null()) facts["nodes"] = std::move(nodes);
  write_text(file, report_page(facts));
}

}  // namespace mtled
