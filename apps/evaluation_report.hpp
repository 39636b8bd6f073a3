#pragma once
#include <optional>

#include "command.hpp"
#include "imaging/evaluation.hpp"
#include "io/json.hpp"

namespace mtled {

struct EvaluationOptions {
  CannyOptions canny;
  std::filesystem::path landmarks;  ///< CSV with mx,my,mz,fx,fy,fz [mm LPS]; may be empty
};
void add_evaluation_options(CLI::App& verb, EvaluationOptions& options);

Json describe(const EdgeDistance& d);
Json describe(const PointErrors& e);
Json describe(const std::vector<LabelOverlap>& overlap);

/// Edge distances between the fixed image and each named candidate on the fixed grid, inside `where`.
struct NamedImage {
  std::string name;
  const Image* image;
};
Json compare_edges_of(const Image& fixed, const std::vector<NamedImage>& candidates, const CannyOptions& canny, const Mask& where);

/// One line per candidate for the terminal: percentile Hausdorff distances of consistent edges and how many these are,
/// and the share of edges within two voxels, of the consistent ones and of all (the consistency filter hides large errors).
void print_edges(const Json& edges);

}  // namespace mtled
