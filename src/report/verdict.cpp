#include "report/verdict.hpp"

#include <algorithm>
#include <cstdio>
#include <functional>
#include <optional>

#include "core/error.hpp"

namespace mtled {
namespace {

std::string text(double value, int digits, const char* unit) {
  char buffer[64];
  std::snprintf(buffer, sizeof buffer, "%.*f%s", digits, value, unit);
  return buffer;
}

/// A figure of one candidate; nothing where there is none.
using Figure = std::function<std::optional<double>(const std::string& candidate)>;

std::optional<double> number_at(const Json& facts, const char* group, const std::string& candidate, const char* key) {
  if (!facts.contains(group) || !facts[group].contains(candidate)) return {};
  const Json& value = facts[group][candidate].value(key, Json());
  if (!value.is_number()) return {};
  return value.get<double>();
}

std::optional<double> mean_dice(const Json& facts, const std::string& candidate) {
  if (!facts.contains("labels") || !facts["labels"].contains(candidate)) return {};
  double sum = 0;
  int found = 0;
  for (const Json& l : facts["labels"][candidate])
    if (l["dice"].is_number()) sum += l["dice"].get<double>(), ++found;
  if (found == 0) return {};
  return sum / found;
}

struct Judged {
  const char* label;
  const char* better;  ///< "more" or "less" of it
  int digits;
  double factor;
  const char* unit;
  double noise;  ///< smaller differences do not count
};

/// An item for a figure of the last candidate beside those of the others; nothing where it has none.
void judge(const Json& facts, const Judged& j, const Figure& figure, Json& items) {
  const Json& candidates = facts["candidates"];
  if (candidates.empty()) return;
  const std::string last = candidates.back()["id"];
  const auto value = figure(last);
  if (!value) return;
  const double sign = j.better[0] == 'm' ? 1 : -1;
  std::string compared, better;
  bool worse_than_nothing = false;
  for (std::size_t c = 0; c + 1 < candidates.size(); ++c) {
    const std::string id = candidates[c]["id"];
    const auto other = figure(id);
    if (!other) continue;
    compared += concatenate(compared.empty() ? "" : ", ", text(j.factor * *other, j.digits, j.unit), " ", id);
    if (sign * (*value - *other) >= -j.noise) continue;
    if (id == "before") worse_than_nothing = true;
    else better += (better.empty() ? "" : ", ") + id;
  }
  const std::string level = worse_than_nothing ? "bad" : better.empty() ? "good" : "check";
  const std::string detail = worse_than_nothing ? "Worse than doing nothing." : better.empty() ? "" : "Worse than: " + better + ".";
  Json item{{"level", compared.empty() ? "info" : level}, {"label", j.label}, {"value", text(j.factor * *value, j.digits, j.unit)}};
  if (!compared.empty()) item["compared"] = compared;
  if (!detail.empty()) item["detail"] = detail;
  items.push_back(item);
}

void judge_folds(const Json& facts, Json& items) {
  if (!facts.contains("jacobian")) return;
  const auto folded = facts["jacobian"]["folded_voxels"].get<std::size_t>();
  Json item{{"level", folded ? "bad" : "good"}, {"label", "Folded voxels"}, {"value", std::to_string(folded)},
            {"compared", concatenate("volume ratio ", text(facts["jacobian"]["min"], 2, ""), " to ", text(facts["jacobian"]["max"], 2, ""))}};
  if (folded) item["detail"] = "Where a transform folds it has no inverse, and what it shows there is wrong.";
  items.push_back(item);
}

void judge_bones(const Json& facts, Json& items) {
  const auto worst_of = [&](const char* list, const char* key) {
    double worst = -1;
    std::string label;
    for (const Json& row : facts.value(list, Json::array()))
      if (const Json& rms = row.value(key, Json()); rms.is_number() && rms.get<double>() > worst) worst = rms, label = std::to_string(row["label"].get<int>());
    return std::pair{worst, label};
  };
  const auto add = [&](const char* title, const std::pair<double, std::string>& worst, const char* detail) {
    if (worst.first < 0) return;
    const bool noticeable = worst.first > noticeable_rigidity_mm;
    Json item{{"level", noticeable ? "check" : "good"}, {"label", title}, {"value", text(worst.first, 2, " mm")}, {"compared", "rms of the worst label, " + worst.second}};
    if (noticeable) item["detail"] = detail;
    items.push_back(item);
  };
  add("Bones off their motions", worst_of("motions", "rms_deviation_mm"), "The field misses the motion of a rigid label: use a smaller node spacing, or check the motions.");
  add("Labels off rigid motion", worst_of("rigidity", "rms_mm"), "The transform bends a label. If it is bone, that is wrong.");
}

void judge_solver(const Json& facts, Json& items) {
  if (!facts.contains("solver") || !facts["solver"]["error_estimate_mm"].is_number()) return;
  const Json& s = facts["solver"];
  items.push_back({{"level", s["converged"].get<bool>() ? "good" : "bad"}, {"label", "Solver"}, {"value", s["converged"].get<bool>() ? "converged" : "not converged"},
                   {"compared", concatenate("estimated error ", text(s["error_estimate_mm"], 3, " mm"), " after ", s["steps"].get<int>(), " steps")}});
}

void judge_direction(const Json& facts, Json& items) {
  if (!facts.contains("direction") || !facts["direction"].value("reversed_fits_better", false)) return;
  items.push_back({{"level", "bad"}, {"label", "Direction"}, {"value", "reversed"}, {"detail", "The inverse of the transform fits much better: it seems to map the moving to the fixed image."}});
}

}  // namespace

Json verdict_of(const Json& facts) {
  Json items = Json::array();
  judge_direction(facts, items);  // first: it explains the rest
  judge(facts, {"Edges within two voxels", "more", 1, 100, " %", 0.002}, [&](const std::string& c) { return number_at(facts, "edges", c, "within_two_voxels_all_edges"); }, items);
  judge(facts, {"Landmark error, mean", "less", 2, 1, " mm", 0.01}, [&](const std::string& c) { return number_at(facts, "landmarks", c, "mean_mm"); }, items);
  judge(facts, {"Label overlap, mean Dice", "more", 3, 1, "", 0.002}, [&](const std::string& c) { return mean_dice(facts, c); }, items);
  judge_folds(facts, items);
  judge_bones(facts, items);
  judge_solver(facts, items);
  const std::size_t warnings = facts.value("warnings", Json::array()).size();
  if (warnings > 0) items.push_back({{"level", "check"}, {"label", "Warnings"}, {"value", std::to_string(warnings)}, {"detail", "They are listed below."}});

  const auto first = [&](const char* level) { return std::find_if(items.begin(), items.end(), [&](const Json& i) { return i["level"] == level; }); };
  std::string level = "good", headline = "Nothing that was measured speaks against this registration.";
  if (items.empty()) level = "check", headline = "Nothing was measured: give the moving image, landmarks, labels or a transform.";
  else if (const auto bad = first("bad"); bad != items.end()) level = "bad", headline = concatenate("Not to be used as it is. ", (*bad)["label"].get<std::string>(), ": ", (*bad)["value"].get<std::string>(), ". ", bad->value("detail", ""));
  else if (const auto check = first("check"); check != items.end()) level = "check", headline = concatenate("Look closer before use. ", (*check)["label"].get<std::string>(), ": ", (*check)["value"].get<std::string>(), ". ", check->value("detail", ""));
  return {{"level", level}, {"headline", headline}, {"items", items}};
}

}  // namespace mtled
