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

/// Prints a warning and adds it to report["warnings"].
void note(Json& report, const std::string& text);

/// Null for what is no number.
Json number_or_null(double value);
/// A comma and a number for a table, or a comma alone for null.
std::string next_cell(const Json& value);

Json describe(const CannyOptions& canny, EdgeSpace space);
/// Null for what has no value: distances without edges, of labels without voxels.
Json describe(const EdgeDistance& d);
Json describe(const JacobianStatistics& s);
Json describe(const std::vector<LabelRigidity>& rigidity);
Json describe(const InverseConsistency& c);
Json describe(const PointErrors& e);
Json describe(const std::vector<LabelOverlap>& overlap);

struct NamedImage {
  std::string name;
  const Image* image;
};
/// Edge distances between the fixed image and each named candidate on the fixed grid, inside `where`. Images without edges
/// are noted in `report`. `source`: grid of the moving image, if it is known, whose voxels count in `within two voxels`.
/// `seen` gets the edges of the fixed image ("fixed") and of each candidate.
Json compare_edges_of(const Image& fixed, const std::vector<NamedImage>& candidates, const CannyOptions& canny, const Mask& where, const Grid* source, EdgeSpace space, Json& report,
                      const std::function<void(const std::string& name, const Mask& edges)>& seen = {});

/// One line per candidate for the terminal: percentile Hausdorff distances of consistent edges and how many these are,
/// and the share of edges within two voxels, of the consistent ones and of all (the consistency filter hides large errors).
void print_edges(const Json& edges);
/// One line per candidate and label.
void print_labels(const Json& labels);

/// Tables for spreadsheets. edges.csv: percentile Hausdorff distances [mm] for 1 to 100 per cent; labels.csv: one row per
/// label and candidate.
std::string edge_table(const Json& edges);
std::string label_table(const Json& labels);

}  // namespace mtled
