#pragma once
#include <optional>
#include <string>
#include <vector>

#include "command.hpp"
#include "core/body_sampling.hpp"
#include "core/shape_evaluator.hpp"
#include "core/solver.hpp"
#include "imaging/body.hpp"
#include "imaging/bone_motion.hpp"
#include "imaging/tissue.hpp"
#include "imaging/warp.hpp"
#include "io/json.hpp"

namespace mtled {

/// Settings of the tissue stage, as options of a verb.
struct TissueOptions {
  std::filesystem::path mask, shear_modulus, tissue_table;
  BodyOptions body;
  FuzzyCMeansOptions fuzzy;
};
void add_tissue_options(CLI::App& verb, TissueOptions& options);

/// The body and what it is made of, on the moving grid.
struct Tissue {
  Mask body;
  Image shear_modulus;                        ///< [kPa], 0 outside the body
  std::optional<Image> bulk_modulus;          ///< [kPa]; absent: from one Poisson ratio of all tissue
  std::optional<FuzzyClasses> classes;        ///< absent when a modulus image was given
  std::vector<TissueProperties> table;
};
Tissue find_tissue(const Image& moving, const TissueOptions& options, const CommonOptions& common);
Json describe(const Tissue& tissue);

/// Settings of the motion stage.
struct MotionOptions {
  std::filesystem::path moving_labels, fixed_labels, motions;
  BoneMotionOptions registration;
};
void add_motion_options(CLI::App& verb, MotionOptions& options);

/// The rigid bodies and how they move.
struct BoneLoads {
  LabelImage labels;                          ///< on the moving grid
  std::optional<LabelImage> fixed_labels;     ///< on the fixed grid
  std::vector<LabelMotion> motions;
  Json report;                      ///< per label: rotation, translation, similarity, ...
  std::vector<std::string> warnings;
};
/// Reads the labels, resampled to the images' grids, and the motions if they are given.
BoneLoads read_loads(const Image& moving, const Image& fixed, const MotionOptions& options);
/// Estimates the motions unless they were given; warns of what looks wrong. Input error: one body moves into another.
void find_motions(const Image& moving, const Image& fixed, const MotionOptions& options, const CommonOptions& common, BoneLoads& loads);
/// Warns of labels that lie outside the body.
void compare_with_body(const Mask& body, BoneLoads& loads);

/// Adds to the report of each label how far `displacement` [mm], where it is `covered`, is from its motion at its voxels in
/// the body; warns of large deviations. All on the moving grid.
void report_deviations(const Mask& body, const VectorImage& displacement, const Mask& covered, BoneLoads& loads);

/// Settings of discretisation and solver.
struct MechanicsOptions {
  SamplingOptions sampling;
  MlsOptions shapes;
  SolverOptions solver;
};
void add_mechanics_options(CLI::App& verb, MechanicsOptions& options);

/// Memory error when a body sampled at this node spacing would need more than is free.
void require_memory(const Mask& body, double node_spacing_mm);

/// The deformed body.
class Deformation {
 public:
  /// `export_to`: where the problem is written as a case of `mtled solve` before it is solved; empty: nowhere.
  Deformation(const Tissue& tissue, const BoneLoads& loads, const MechanicsOptions& options, const CommonOptions& common, const std::filesystem::path& export_to);
  /// u(X) [mm]; false outside the body's lattice cells.
  bool displacement(const Vec3d& X, Vec3d& u) const;
  DisplacementFunction function() const {
    return [this](const Vec3d& X, Vec3d& u) { return displacement(X, u); };
  }
  const Solution& solution() const { return solution_; }
  const SampledBody& body() const { return body_; }

 private:
  SampledBody body_;
  std::optional<ShapeEvaluator> evaluator_;
  Solution solution_;
};

/// `mask` or labels read from a file, on the grid of the image they belong to. Input errors: no overlap, nothing marked.
Mask mask_on(const Grid& grid, const std::filesystem::path& path, const char* describe);
LabelImage labels_on(const Grid& grid, const std::filesystem::path& path, const char* describe);

/// Both images, resampled to `spacing` when it is not empty. Input error when they do not overlap in space.
struct ImagePair {
  Image moving, fixed;
};
ImagePair read_pair(const std::filesystem::path& moving, const std::filesystem::path& fixed, const std::vector<double>& spacing);

}  // namespace mtled
