#pragma once
#include "io/json.hpp"
#include "program.hpp"

namespace mtled::program {

/// The data inside a report.html.
inline nlohmann::ordered_json report_data(const fs::path& path) {
  const std::string page = content(path), start = "<script type=\"application/json\" id=\"report-data\">";
  const std::size_t from = page.find(start);
  EXPECT_NE(from, std::string::npos) << path << " holds no data";
  return from == std::string::npos ? nlohmann::ordered_json() : nlohmann::ordered_json::parse(page.substr(from + start.size(), page.find("</script>", from) - from - start.size()));
}

inline std::vector<std::string> ids_of(const nlohmann::ordered_json& list) {
  std::vector<std::string> ids;
  for (const auto& entry : list) ids.push_back(entry["id"]);
  return ids;
}

}  // namespace mtled::program
