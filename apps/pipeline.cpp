#include "pipeline.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <set>

#include "core/error.hpp"
#include "free_memory.hpp"
#include "image_io/image_io.hpp"
#include "imaging/same_grid.hpp"
#include "io/case_output.hpp"
#include "io/tables.hpp"

namespace mtled {
namespace {

constexpr double bytes_per_node = 900;  ///< measured peak of sampling and solver, images aside (perf/README.md)
constexpr double noticeable_overlap = 0.05, impossible_overlap = 0.3;  ///< of a label's voxels in another label
constexpr double noticeable_deviation_mm = 0.5;  ///< of the field from a body's motion: five times what the solver promises

std::vector<TissueProperties> read_tissue_table(const std::filesystem::path& path) {
  const Table table = Table::read(path);
  const int name = table.column("name"), modulus = table.column("shear_modulus_kpa"), poisson = table.has("poisson_ratio") ? table.column("poisson_ratio") : -1;
  std::vector<TissueProperties> tissues;
  for (std::size_t r = 0; r < table.rows(); ++r) {
    tissues.push_back({std::string(table.text(r, name)), table.number(r, modulus)});
    require(tissues.back().shear_modulus_kpa > 0, table.place(r), ": shear_modulus_kpa is ", tissues.back().shear_modulus_kpa, "; it must be positive");
    if (poisson < 0) continue;
    const double ratio = table.number(r, poisson);
    require(ratio >= 0 && ratio < 0.5, table.place(r), ": poisson_ratio is ", ratio, "; it must be at least 0 and below 0.5 (0.49 is usual, lung has less)");
    tissues.back().poisson_ratio = ratio;
  }
  return tissues;
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

Json describe(const LabelMotion& m) {
  const double degrees = 180 / std::numbers::pi;
  const Vec3d turn = degrees * rotation_vector(m.motion.rotation), t = m.motion.translation;
  return {{"label", m.label}, {"rotation_deg", norm(turn)}, {"rotation_vector_deg", {turn.x, turn.y, turn.z}},
          {"center_displacement_mm", norm(t)}, {"translation_mm", {t.x, t.y, t.z}}};
}

/// Share of the voxels of each label that its motion puts into another, moved one.
struct Collision {
  int label, other;
  double share;
};
std::vector<Collision> collisions(const LabelImage& labels, const std::vector<LabelMotion>& motions) {
  struct Body {
    RigidMotion motion, back;
    Vec3d low, high;  // [mm] corners of the box around its voxels
    std::size_t voxels = 0;
    std::map<int, std::size_t> hits;
  };
  std::map<int, Body> bodies;
  for (const auto& m : motions) bodies[m.label].motion = m.motion, bodies[m.label].back = inverse(m.motion);
  const auto each_voxel = [&](auto&& work) {
    const auto& n = labels.grid.size;
    for (int k = 0; k < n[2]; ++k)
      for (int j = 0; j < n[1]; ++j)
        for (int i = 0; i < n[0]; ++i)
          if (const int label = labels.at(i, j, k))
            if (const auto body = bodies.find(label); body != bodies.end()) work(body->second, labels.grid.point(i, j, k));
  };
  each_voxel([](Body& body, const Vec3d& x) {
    if (body.voxels++ == 0) body.low = body.high = x;
    for (int a = 0; a < 3; ++a) body.low[a] = std::min(body.low[a], x[a]), body.high[a] = std::max(body.high[a], x[a]);
  });
  const double voxel = std::max({labels.grid.spacing.x, labels.grid.spacing.y, labels.grid.spacing.z});
  each_voxel([&](Body& body, const Vec3d& x) {
    const Vec3d y = body.motion.apply(x);
    for (const auto& [other, there] : bodies) {
      if (&there == &body) continue;
      const Vec3d rest = there.back.apply(y);
      bool near = there.voxels > 0;
      for (int a = 0; a < 3; ++a) near = near && rest[a] > there.low[a] - voxel && rest[a] < there.high[a] + voxel;
      if (near && nearest_value<std::uint16_t>(labels, rest, 0) == other) ++body.hits[other];
    }
  });
  std::vector<Collision> result;
  for (const auto& [label, body] : bodies)
    for (const auto& [other, count] : body.hits) result.push_back({label, other, double(count) / double(body.voxels)});
  return result;
}

template <class T>
bool any_marked(const Volume<T>& volume) {
  return std::any_of(volume.data.begin(), volume.data.end(), [](auto v) { return v != 0; });
}

}  // namespace

LabelImage labels_on(const Grid& grid, const std::filesystem::path& path, const char* describe) {
  LabelImage labels = read_labels(path, describe);
  require(any_marked(labels), describe, " '", path.string(), "': every voxel is 0; mark what belongs to it with whole numbers from 1 on");
  if (same_grid(labels.grid, grid)) {
    labels.grid = grid;
    return labels;
  }
  return with_context(std::string(describe) + " '" + path.string() + "'", [&] {
    LabelImage resampled = resample_labels(labels, grid);
    require(any_marked(resampled), "nothing that it marks lies inside the image; do the two belong together?");
    return resampled;
  });
}

Mask mask_on(const Grid& grid, const std::filesystem::path& path, const char* describe) {
  const LabelImage labels = labels_on(grid, path, describe);
  Mask mask(grid);
  for (std::size_t v = 0; v < mask.data.size(); ++v) mask.data[v] = labels.data[v] != 0;
  return mask;
}

void add_tissue_options(CLI::App& verb, TissueOptions& o) {
  verb.add_option("--moving-mask", o.mask, "mask of the body in the moving image (default: found by threshold)")->type_name("IMAGE");
  verb.add_option("--body-threshold", o.body.threshold, "intensity above which a voxel may be body [HU]")->capture_default_str();
  verb.add_option("--shear-modulus", o.shear_modulus, "shear modulus image [kPa] instead of tissue classes")->type_name("IMAGE");
  verb.add_option("--classes", o.fuzzy.classes, "number of fuzzy tissue classes")->check(from_to(2, 100))->capture_default_str();
  verb.add_option("--class-centers", o.fuzzy.fixed_centers, "fixed class centres [intensity] instead of fuzzy c-means");
  verb.add_option("--fuzziness", o.fuzzy.fuzziness, "exponent q > 1 of fuzzy c-means")->check(from_to(1.01, 20))->capture_default_str();
  verb.add_option("--tissue-table", o.tissue_table, "CSV with name,shear_modulus_kpa and perhaps poisson_ratio, one row per class by rising intensity")->type_name("FILE");
}

Tissue find_tissue(const Image& moving, const TissueOptions& options, const CommonOptions& common) {
  Tissue tissue;
  if (options.mask.empty()) {
    announce(common, "finding the body");
    tissue.body = body_mask(moving, options.body);
  } else {
    tissue.body = mask_on(moving.grid, options.mask, "moving mask");
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
  if (tissue.table.front().poisson_ratio) tissue.bulk_modulus = bulk_modulus_map(moving, tissue.body, *tissue.classes, tissue.table);
  return tissue;
}

Json describe(const Tissue& tissue) {
  Json j;
  j["body_litres"] = double(std::count_if(tissue.body.data.begin(), tissue.body.data.end(), [](auto v) { return v != 0; })) * tissue.body.grid.voxel_volume() * 1e-6;
  if (!tissue.classes) return j;
  for (std::size_t c = 0; c < tissue.classes->centers.size(); ++c)
    j["classes"].push_back({{"center", tissue.classes->centers[c]}, {"tissue", tissue.table[c].name}, {"shear_modulus_kpa", tissue.table[c].shear_modulus_kpa}});
  if (tissue.bulk_modulus)
    for (std::size_t c = 0; c < tissue.classes->centers.size(); ++c) j["classes"][c]["poisson_ratio"] = *tissue.table[c].poisson_ratio;
  j["fuzziness"] = tissue.classes->fuzziness;
  j["iterations"] = tissue.classes->iterations;
  return j;
}

void add_motion_options(CLI::App& verb, MotionOptions& o) {
  verb.add_option("--moving-labels", o.moving_labels, "label map of the rigid bodies (vertebrae, ...) in the moving image")->type_name("IMAGE");
  verb.add_option("--fixed-labels", o.fixed_labels, "the same bodies in the fixed image: a better start for their registration")->type_name("IMAGE");
  verb.add_option("--motions", o.motions, "motions.json: use these rigid motions instead of estimating them")->type_name("FILE");
}

BoneLoads read_loads(const Image& moving, const Image& fixed, const MotionOptions& options) {
  BoneLoads loads;
  loads.labels = labels_on(moving.grid, options.moving_labels, "moving labels");
  if (!options.fixed_labels.empty()) loads.fixed_labels = labels_on(fixed.grid, options.fixed_labels, "fixed labels");
  if (options.motions.empty()) return loads;
  loads.motions = read_motions(options.motions);
  const std::string file = "motions '" + options.motions.string() + "'";
  require(!loads.motions.empty(), file, " are empty: nothing moves the body; give at least one label and its motion");
  std::set<int> still;
  for (auto v : loads.labels.data)
    if (v) still.insert(v);
  for (const auto& m : loads.motions) {
    require(still.erase(m.label) == 1, file, " move label ", m.label, ", which no voxel of the moving labels has; remove it or correct the labels");
    loads.report.push_back(describe(m));
  }
  for (const int label : still) loads.warnings.push_back(concatenate("label ", label, " has no motion; it is treated as soft tissue"));
  for (const std::string& w : implausible_neighbours(loads.motions)) loads.warnings.push_back(w);
  return loads;
}

void find_motions(const Image& moving, const Image& fixed, const MotionOptions& options, const CommonOptions& common, BoneLoads& loads) {
  if (options.motions.empty()) {
    announce(common, "registering rigid bodies");
    const BoneMotionResult found = estimate_bone_motions(moving, fixed, loads.labels, loads.fixed_labels ? &*loads.fixed_labels : nullptr, options.registration);
    loads.warnings.insert(loads.warnings.end(), found.warnings.begin(), found.warnings.end());
    for (const BoneMotion& b : found.bones) {
      loads.motions.push_back(b.motion);
      Json j = describe(b.motion);
      j["similarity_before"] = b.similarity_before, j["similarity_after"] = b.similarity_after;
      j["inverse_consistency_mm"] = b.inverse_consistency_mm, j["voxels"] = b.voxels;
      loads.report.push_back(j);
    }
  }
  for (const auto& [label, other, share] : collisions(loads.labels, loads.motions)) {
    if (share < noticeable_overlap) continue;
    const std::string what = concatenate("the motions push label ", label, " into label ", other, " (", std::round(100 * share), " % of its voxels)");
    require(share < impossible_overlap, what, ": two rigid bodies cannot be in one place; correct the motions, or leave one of the labels out");
    loads.warnings.push_back(what + "; check both");
  }
  for (const std::string& w : loads.warnings) warn(w);
}

void compare_with_body(const Mask& body, BoneLoads& loads) {
  std::map<int, std::pair<std::size_t, std::size_t>> voxels;  // of each label: in the body, all
  for (std::size_t v = 0; v < body.data.size(); ++v)
    if (const int label = loads.labels.data[v]) voxels[label].first += body.data[v] != 0, ++voxels[label].second;
  for (const auto& [label, count] : voxels)
    if (2 * count.first < count.second)
      loads.warnings.push_back(concatenate("label ", label, " lies outside the body (", std::round(100.0 * double(count.first) / double(count.second)),
                                           " % of it inside); check the labels, or give --moving-mask"));
}

void report_deviations(const Mask& body, const VectorImage& displacement, const Mask& covered, BoneLoads& loads) {
  struct Deviation {
    const RigidMotion* motion;
    double largest = 0, sum_of_squares = 0;
    std::size_t voxels = 0;
  };
  std::map<int, Deviation> deviations;
  for (const LabelMotion& m : loads.motions) deviations[m.label].motion = &m.motion;
  const Grid& grid = loads.labels.grid;
  for (int k = 0; k < grid.size[2]; ++k)
    for (int j = 0; j < grid.size[1]; ++j)
      for (int i = 0; i < grid.size[0]; ++i) {
        const auto found = deviations.find(loads.labels.at(i, j, k));
        if (found == deviations.end() || !body.at(i, j, k) || !covered.at(i, j, k)) continue;
        Deviation& d = found->second;
        const Vec3f& u = displacement.at(i, j, k);
        const Vec3d off = Vec3d{u.x, u.y, u.z} - d.motion->displacement(grid.point(i, j, k));
        d.largest = std::max(d.largest, norm(off));
        d.sum_of_squares += squared_norm(off);
        ++d.voxels;
      }
  for (Json& j : loads.report) {
    const Deviation& d = deviations.at(j["label"].get<int>());
    if (d.voxels == 0) continue;
    const double rms = std::sqrt(d.sum_of_squares / double(d.voxels));
    j["rms_deviation_mm"] = rms, j["largest_deviation_mm"] = d.largest;
    if (rms > noticeable_deviation_mm) {
      loads.warnings.push_back(concatenate("the field misses the motion of label ", j["label"].get<int>(), " by ", rms, " mm (rms): it is too thin for the node spacing, or pulled hard by its neighbours; use a smaller --node-spacing, or check the motions"));
      warn(loads.warnings.back());
    }
  }
}

void add_mechanics_options(CLI::App& verb, MechanicsOptions& o) {
  verb.add_option("--node-spacing", o.sampling.node_spacing_mm, "distance of the nodes [mm]")->check(positive())->capture_default_str();
  verb.add_option("--poisson-ratio", o.sampling.poisson_ratio, "of all tissue to which --tissue-table gives none")->check(at_least_and_below(0, 0.5))->capture_default_str();
  const std::map<std::string, Basis> bases{{"linear", Basis::linear}, {"quadratic", Basis::quadratic}, {"modified-quadratic", Basis::modified_quadratic}};
  verb.add_option("--basis", o.shapes.basis, "moving least squares: linear, quadratic or modified-quadratic")->transform(CLI::CheckedTransformer(bases))->default_str("linear");
  verb.add_option("--dilatation", o.shapes.dilatation, "support radius in node spacings (about 2.25 for the quadratic bases)")->check(from_to(1.05, 4))->capture_default_str();
  const std::map<std::string, Relaxation> schemes{{"two-level", Relaxation::two_level}, {"plain", Relaxation::plain}};
  verb.add_option("--relaxation", o.solver.relaxation, "two-level, or plain: the published scheme")->transform(CLI::CheckedTransformer(schemes))->default_str("two-level");
  verb.add_option("--tolerance", o.solver.tolerance_mm, "of the estimated displacement error [mm]; 0.05 keeps the true one below 0.1")->check(positive())->capture_default_str();
  verb.add_option("--max-steps", o.solver.max_steps, "give up after so many relaxation steps")->check(positive())->capture_default_str();
}

void require_memory(const Mask& body, double spacing) {
  const double volume = double(std::count_if(body.data.begin(), body.data.end(), [](auto v) { return v != 0; })) * body.grid.voxel_volume();
  const double nodes = 1.1 * volume / (spacing * spacing * spacing), needed = nodes * bytes_per_node, there = free_memory();
  if (there > 0 && needed > there)
    fail(Failure::memory, "a node spacing of ", spacing, " mm gives about ", nodes, " nodes, which need ", needed / 1e9, " GB, but only ", there / 1e9,
         " GB of memory are free; use --node-spacing ", std::ceil(10 * spacing * std::cbrt(needed / there)) / 10, " or more");
}

Deformation::Deformation(const Tissue& tissue, const BoneLoads& loads, const MechanicsOptions& options, const CommonOptions& common, const std::filesystem::path& export_to) {
  announce(common, "placing nodes and integration points");
  const double spacing = options.sampling.node_spacing_mm;
  body_ = sample_body(tissue.body, tissue.shear_modulus, loads.labels, loads.motions, options.sampling, tissue.bulk_modulus ? &*tissue.bulk_modulus : nullptr);
  for (int label : body_.labels_outside) warn(concatenate("label ", label, " holds no part of the body at a spacing of ", spacing, " mm and does not move it; correct the labels or the mask, or use a smaller --node-spacing"));
  evaluator_.emplace(body_.cloud, std::vector<std::uint8_t>(), options.shapes);
  if (!export_to.empty()) {
    announce(common, "exporting the case");
    write_case(export_to, *evaluator_, body_.points, body_.rigid, options.solver);
  }
  announce(common, concatenate("solving: ", body_.cloud.size(), " nodes, ", body_.points.size(), " integration points, ", body_.rigid.position.size(), " pieces of rigid bodies"));
  SolverOptions solver = options.solver;
  solver.progress = progress_printer(common.quiet);
  solution_ = solve(*evaluator_, body_.points, {}, solver, springs_on(body_.rigid, *evaluator_));
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
