#pragma once
#include <functional>
#include <optional>

#include "command.hpp"
#include "imaging/evaluation.hpp"
#include "imaging/field_quality.hpp"
#include "io/json.hpp"

namespace mtled {

struct EvaluationOptions {
  CannyOptions canny;
  std::filesystem::path landmarks;  ///< CSV with mx,my,mz,fx,fy,fz [mm LPS]; may be empty
};
void add_evaluation_options(CLI::App& verb, EvaluationOptions& options);

/// Null for what has no value: distances without edges, of labels without voxels.
Json describe(const EdgeDistance& d);
Json describe(const JacobianStatistics& s);
Json describe(const std::vector<LabelRigidity>& rigidity);
Json describe(const InverseConsistency& c);
Json describe(const PointErrors& e);
Json describe(const std::vector<LabelOverlap>& overlap);

/// Edge distances between the fixed image and each named candidate on the fixed grid, inside `where`. Warns of images
/// without edges. `source`: grid of the moving image, if it is known, whose voxels count in `within two voxels`.
struct NamedImage {
  std::string name;
  const Image* image;
};
/// `seen` gets the edges of the fixed image ("fixed") and of each candidate.
Json compare_edges_of(const Image& fixed, const std::vector<NamedImage>& candidates, const CannyOptions& canny, const Mask& where, const Grid* source, EdgeSpace space = EdgeSpace::volume,
                      const std::function<void(const std::string& name, const Mask& edges)>& seen = {});

/// One line per candidate for the terminal: percentile Hausdorff distances of consistent edges and how many these are,
/// and the share of edges within two voxels, of the consistent ones and of all (the consistency filter hides large errors).
void print_edges(const Json& edges);
/// One line per label, its figures before and after side by side.
void print_labels(const Json& labels);

/// Tables for spreadsheets. edges.csv: percentile Hausdorff distances [mm] for 1 to 100 per cent; labels.csv: one row per
/// label and candidate; landmarks.csv: one row per pair [mm].
std::string edge_table(const Json& edges);
std::string label_table(const Json& labels);

}  // namespace mtled
