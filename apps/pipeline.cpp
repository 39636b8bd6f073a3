#include "pipeline.hpp"

#include <algorithm>
#include <cmath>
#include <fstream>
#include <numbers>

#include "core/error.hpp"
#include "image_io/image_io.hpp"
#include "io/tables.hpp"

namespace mtled {
namespace {

constexpr double bytes_per_node = 900;  ///< measured peak of sampling and solver, images aside (perf/README.md)

std::vector<TissueProperties> read_tissue_table(const std::filesystem::path& path) {
  const Table table = Table::read(path);
  const int name = table.column("name"), modulus = table.column("shear_modulus_kpa");
  std::vector<TissueProperties> tissues;
  for (std::size_t r = 0; r < table.rows(); ++r) {
    tissues.push_back({std::string(table.text(r, name)), table.number(r, modulus)});
    require(tissues.back().shear_modulus_kpa > 0, table.place(r), ": shear_modulus_kpa is ", tissues.back().shear_modulus_kpa, "; it must be positive");
  }
  return tissues;
}

/// Memory that is free for this program [bytes]; 0 when the system does not tell.
double available_memory() {
  std::ifstream file("/proc/meminfo");
  for (std::string key, unit; file >> key;) {
    double value = 0;
    file >> value;
    std::getline(file, unit);
    if (key == "MemAvailable:") return 1024 * value;
  }
  return 0;
}

bool overlap(const Grid& a, const Grid& b) {
  constexpr int steps = 16;
  for (int k = 0; k <= steps; ++k)
    for (int j = 0; j <= steps; ++j)
      for (int i = 0; i <= steps; ++i) {
        const Vec3d x = a.point(Vec3d{double(a.size[0] - 1) * i / steps, double(a.size[1] - 1) * j / steps, double(a.size[2] - 1) * k / steps});
        const Vec3d c = b.index(x);
        if (c.x >= -0.5 && c.y >= -0.5 && c.z >= -0.5 && c.x <= b.size[0] - 0.5 && c.y <= b.size[1] - 0.5 && c.z <= b.size[2] - 0.5) return true;
      }
  return false;
}

LabelImage labels_on(const Grid& grid, const std::filesystem::path& path, const char* describe) {
  LabelImage labels = read_labels(path, describe);
  require(std::any_of(labels.data.begin(), labels.data.end(), [](auto v) { return v != 0; }), describe, " '", path.string(),
          "' has no label: every voxel is 0; give one number per rigid body");
  if (labels.grid == grid) return labels;
  return with_context(std::string(describe) + " '" + path.string() + "'", [&] {
    LabelImage resampled = resample_labels(labels, grid);
    require(std::any_of(resampled.data.begin(), resampled.data.end(), [](auto v) { return v != 0; }), "no label lies inside the image; do the two belong together?");
    return resampled;
  });
}

nlohmann::json describe(const LabelMotion& m) {
  const double degrees = 180 / std::numbers::pi;
  const Vec3d turn = degrees * rotation_vector(m.motion.rotation), t = m.motion.translation;
  return {{"label", m.label}, {"rotation_deg", norm(turn)}, {"rotation_vector_deg", {turn.x, turn.y, turn.z}},
          {"center_displacement_mm", norm(t)}, {"translation_mm", {t.x, t.y, t.z}}};
}

/// Neighbouring rigid bodies that the motions push into each other: voxels of one that land in another.
std::vector<std::string> collisions(const LabelImage& labels, const std::vector<LabelMotion>& motions) {
  std::map<std::pair<int, int>, std::size_t> hits;
  std::map<int, std::size_t> voxels;
  std::map<int, const RigidMotion*> motion_of;
  std::map<int, RigidMotion> back;
  for (const auto& m : motions) motion_of[m.label] = &m.motion, back[m.label] = inverse(m.motion);
  const auto& n = labels.grid.size;
  for (int k = 0; k < n[2]; ++k)
    for (int j = 0; j < n[1]; ++j)
      for (int i = 0; i < n[0]; ++i) {
        const int label = labels.at(i, j, k);
        if (!label || !motion_of.count(label)) continue;
        ++voxels[label];
        const Vec3d y = motion_of[label]->apply(labels.grid.point(i, j, k));
        for (const auto& [other, motion] : back)
          if (other != label && std::abs(other - label) <= 2 && nearest_value<std::uint16_t>(labels, motion.apply(y), 0) == other) ++hits[{label, other}];
      }
  std::vector<std::string> warnings;
  for (const auto& [pair, count] : hits)
    if (double(count) > 0.05 * double(voxels[pair.first]))
      warnings.push_back(concatenate("the motions push label ", pair.first, " into label ", pair.second, " (", 100 * count / voxels[pair.first], " % of its voxels); check both"));
  return warnings;
}

}  // namespace

void add_tissue_options(CLI::App& verb, TissueOptions& o) {
  verb.add_option("--moving-mask", o.mask, "mask of the body in the moving image (default: found by threshold)")->type_name("IMAGE");
  verb.add_option("--body-threshold", o.body.threshold, "intensity above which a voxel may be body [HU]")->capture_default_str();
  verb.add_option("--shear-modulus", o.shear_modulus, "shear modulus image [kPa] instead of tissue classes")->type_name("IMAGE");
  verb.add_option("--classes", o.fuzzy.classes, "number of fuzzy tissue classes")->capture_default_str();
  verb.add_option("--class-centers", o.fuzzy.fixed_centers, "fixed class centres [intensity] instead of fuzzy c-means");
  verb.add_option("--fuzziness", o.fuzzy.fuzziness, "exponent q > 1 of fuzzy c-means")->capture_default_str();
  verb.add_option("--tissue-table", o.tissue_table, "CSV with name,shear_modulus_kpa, one row per class by rising intensity")->type_name("FILE");
}

Tissue find_tissue(const Image& moving, const TissueOptions& options, const CommonOptions& common) {
  Tissue tissue;
  if (options.mask.empty()) {
    announce(common, "finding the body");
    tissue.body = body_mask(moving, options.body);
  } else {
    tissue.body = read_mask(options.mask, "moving mask");
    require(tissue.body.grid.size == moving.grid.size && norm(tissue.body.grid.origin - moving.grid.origin) < 0.01, "moving mask '", options.mask.string(),
            "' is on another grid than the moving image; resample it");
    tissue.body.grid = moving.grid;
    require(std::any_of(tissue.body.data.begin(), tissue.body.data.end(), [](auto v) { return v != 0; }), "moving mask '", options.mask.string(), "' is empty");
  }
  if (!options.shear_modulus.empty()) {
    tissue.shear_modulus = read_image(options.shear_modulus, "shear modulus image");
    require(overlap(tissue.shear_modulus.grid, moving.grid), "shear modulus image '", options.shear_modulus.string(), "' does not overlap the moving image");
    for (float v : tissue.shear_modulus.data) require(v >= 0, "shear modulus image '", options.shear_modulus.string(), "' has negative values");
    return tissue;
  }
  announce(common, "classifying tissue");
  tissue.table = options.tissue_table.empty() ? default_tissue_table() : read_tissue_table(options.tissue_table);
  FuzzyCMeansOptions fuzzy = options.fuzzy;
  if (!fuzzy.fixed_centers.empty()) fuzzy.classes = int(fuzzy.fixed_centers.size());
  require(int(tissue.table.size()) == fuzzy.classes, fuzzy.classes, " tissue classes but a tissue table of ", tissue.table.size(),
          " rows; give --tissue-table with one row per class");
  tissue.classes = fuzzy_c_means(histogram(moving, tissue.body, 1.0), fuzzy);
  if (!tissue.classes->converged) warn("fuzzy c-means did not converge; class centres may be off");
  tissue.shear_modulus = shear_modulus_map(moving, tissue.body, *tissue.classes, tissue.table);
  return tissue;
}

nlohmann::json describe(const Tissue& tissue) {
  nlohmann::json j;
  j["body_litres"] = double(std::count_if(tissue.body.data.begin(), tissue.body.data.end(), [](auto v) { return v != 0; })) * tissue.body.grid.voxel_volume() * 1e-6;
  if (!tissue.classes) return j;
  for (std::size_t c = 0; c < tissue.classes->centers.size(); ++c)
    j["classes"].push_back({{"center", tissue.classes->centers[c]}, {"tissue", tissue.table[c].name}, {"shear_modulus_kpa", tissue.table[c].shear_modulus_kpa}});
  j["fuzziness"] = tissue.classes->fuzziness;
  j["iterations"] = tissue.classes->iterations;
  return j;
}

void add_motion_options(CLI::App& verb, MotionOptions& o) {
  verb.add_option("--moving-labels", o.moving_labels, "label map of the rigid bodies (vertebrae, ...) in the moving image")->type_name("IMAGE");
  verb.add_option("--fixed-labels", o.fixed_labels, "the same bodies in the fixed image: a better start for their registration")->type_name("IMAGE");
  verb.add_option("--motions", o.motions, "motions.json: use these rigid motions instead of estimating them")->type_name("FILE");
}

BoneLoads find_motions(const Image& moving, const Image& fixed, const MotionOptions& options, const CommonOptions& common) {
  BoneLoads loads;
  loads.labels = labels_on(moving.grid, options.moving_labels, "moving labels");
  if (!options.fixed_labels.empty()) loads.fixed_labels = labels_on(fixed.grid, options.fixed_labels, "fixed labels");
  if (!options.motions.empty()) {
    loads.motions = read_motions(options.motions);
    std::map<int, bool> present;
    for (auto v : loads.labels.data)
      if (v) present[v] = true;
    for (const auto& m : loads.motions) {
      loads.report.push_back(describe(m));
      require(present.count(m.label), "motions '", options.motions.string(), "' move label ", m.label, ", which no voxel of the moving labels has; remove it or correct the labels");
      present.erase(m.label);
    }
    for (const auto& [label, unused] : present) loads.warnings.push_back(concatenate("label ", label, " has no motion; it is treated as soft tissue"));
  } else {
    announce(common, "registering rigid bodies");
    const BoneMotionResult found = estimate_bone_motions(moving, fixed, loads.labels, loads.fixed_labels ? &*loads.fixed_labels : nullptr, options.registration);
    loads.warnings = found.warnings;
    for (const BoneMotion& b : found.bones) {
      loads.motions.push_back(b.motion);
      nlohmann::json j = describe(b.motion);
      j["similarity_before"] = b.similarity_before, j["similarity_after"] = b.similarity_after;
      j["inverse_consistency_mm"] = b.inverse_consistency_mm, j["voxels"] = b.voxels;
      loads.report.push_back(j);
    }
  }
  for (const std::string& w : collisions(loads.labels, loads.motions)) loads.warnings.push_back(w);
  for (const std::string& w : loads.warnings) warn(w);
  return loads;
}

void add_mechanics_options(CLI::App& verb, MechanicsOptions& o) {
  verb.add_option("--node-spacing", o.sampling.node_spacing_mm, "distance of the nodes [mm]")->capture_default_str();
  verb.add_option("--poisson-ratio", o.sampling.poisson_ratio, "of all tissue, at least 0 and below 0.5")->capture_default_str();
  const std::map<std::string, Basis> bases{{"linear", Basis::linear}, {"quadratic", Basis::quadratic}, {"modified-quadratic", Basis::modified_quadratic}};
  verb.add_option("--basis", o.shapes.basis, "moving least squares: linear, quadratic or modified-quadratic")->transform(CLI::CheckedTransformer(bases))->default_str("linear");
  verb.add_option("--dilatation", o.shapes.dilatation, "support radius in node spacings (about 2.25 for the quadratic bases)")->check(CLI::Range(1.05, 4.0))->capture_default_str();
  const std::map<std::string, Relaxation> schemes{{"two-level", Relaxation::two_level}, {"plain", Relaxation::plain}};
  verb.add_option("--relaxation", o.solver.relaxation, "two-level, or plain: the published scheme")->transform(CLI::CheckedTransformer(schemes))->default_str("two-level");
  verb.add_option("--tolerance", o.solver.tolerance_mm, "of the estimated displacement error [mm]; 0.05 keeps the true one below 0.1")->check(CLI::PositiveNumber)->capture_default_str();
  verb.add_option("--max-steps", o.solver.max_steps, "give up after so many relaxation steps")->check(CLI::PositiveNumber)->capture_default_str();
}

Deformation::Deformation(const Tissue& tissue, const BoneLoads& loads, const MechanicsOptions& options, const CommonOptions& common) {
  announce(common, "placing nodes and integration points");
  const double spacing = options.sampling.node_spacing_mm;
  require(spacing > 0, "--node-spacing is ", spacing, " mm; it must be positive");
  const double litres = double(std::count_if(tissue.body.data.begin(), tissue.body.data.end(), [](auto v) { return v != 0; })) * tissue.body.grid.voxel_volume();
  const double nodes = 1.1 * litres / (spacing * spacing * spacing), needed = nodes * bytes_per_node, there = available_memory();
  if (there > 0 && needed > there)
    fail(Failure::memory, "about ", nodes, " nodes need ", needed / 1e9, " GB, but only ", there / 1e9, " GB of memory are free; use a node spacing of ",
         spacing * std::cbrt(needed / there), " mm or more");
  body_ = sample_body(tissue.body, tissue.shear_modulus, loads.labels, loads.motions, options.sampling);
  for (int label : body_.labels_without_nodes) warn(concatenate("label ", label, " holds no node at a spacing of ", spacing, " mm and does not move the body; use a smaller --node-spacing"));
  std::vector<std::uint8_t> prescribed(body_.cloud.size(), 0);
  for (int n : body_.constraints.node) prescribed[std::size_t(n)] = 1;
  evaluator_.emplace(body_.cloud, std::move(prescribed), options.shapes);
  announce(common, concatenate("solving: ", body_.cloud.size(), " nodes, ", body_.points.size(), " integration points, ", body_.constraints.node.size(), " prescribed nodes"));
  SolverOptions solver = options.solver;
  solver.progress = progress_printer(common.quiet);
  solution_ = solve(*evaluator_, body_.points, body_.constraints, solver);
  if (!solution_.converged)
    fail(Failure::numerical, "no convergence within ", solver.max_steps, " steps (estimated error ", solution_.error_estimate_mm, " mm); raise --max-steps, or use a larger --tolerance");
}

bool Deformation::displacement(const Vec3d& X, Vec3d& u) const {
  return evaluator_->covers(X) && displacement_at(*evaluator_, solution_.parameter, X, u);
}

ImagePair read_pair(const std::filesystem::path& moving, const std::filesystem::path& fixed, const std::vector<double>& spacing) {
  ImagePair pair{read_image(moving, "moving image"), read_image(fixed, "fixed image")};
  for (const auto& [image, name, path] : {std::tuple{&pair.moving, "moving", moving}, std::tuple{&pair.fixed, "fixed", fixed}}) {
    const auto [low, high] = std::minmax_element(image->data.begin(), image->data.end());
    require(*low < *high, name, " image '", path.string(), "' is constant (", *low, "); is it the right file?");
  }
  require(overlap(pair.moving.grid, pair.fixed.grid), "the moving and the fixed image do not overlap in space; check that both are of one patient and their headers are right");
  if (!spacing.empty()) {
    const Vec3d s{spacing[0], spacing[1], spacing[2]};
    pair.moving = resample(pair.moving, s), pair.fixed = resample(pair.fixed, s);
  }
  return pair;
}

}  // namespace mtled
