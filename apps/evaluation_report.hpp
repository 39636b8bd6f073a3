#pragma once
#include <nlohmann/json.hpp>
#include <optional>

#include "command.hpp"
#include "imaging/evaluation.hpp"

namespace mtled {

struct EvaluationOptions {
  CannyOptions canny;
  std::filesystem::path landmarks;  ///< CSV with mx,my,mz,fx,fy,fz [mm LPS]; may be empty
};
void add_evaluation_options(CLI::App& verb, EvaluationOptions& options);

nlohmann::json describe(const EdgeDistance& d);
nlohmann::json describe(const PointErrors& e);
nlohmann::json describe(const std::vector<LabelOverlap>& overlap);

/// Edge distances between the fixed image and each named candidate on the fixed grid, inside `where`.
struct NamedImage {
  std::string name;
  const Image* image;
};
nlohmann::json compare_edges_of(const Image& fixed, const std::vector<NamedImage>& candidates, const CannyOptions& canny, const Mask& where);

/// One line per candidate for the terminal.
void print_edges(const nlohmann::json& edges);

}  // namespace mtled
