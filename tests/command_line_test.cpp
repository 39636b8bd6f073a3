#include <itkDisplacementFieldTransform.h>
#include <itkHDF5TransformIOFactory.h>
#include <itkTransformFileReader.h>

#include <nlohmann/json.hpp>

#include "imaging/evaluation.hpp"
#include "report_data.hpp"
#include "temporary_folder.hpp"
#include "torso.hpp"

namespace mtled {
namespace {

using program::Outcome;
using Strings = std::vector<std::string>;
namespace fs = std::filesystem;
using Json = nlohmann::json;

/// One pair of images and one registration for all tests of this program; removed at its end.
class Shared : public testing::Environment {
 public:
  void SetUp() override {
    std::string name = (fs::temp_directory_path() / "mtled-commands-XXXXXX").string();
    ASSERT_TRUE(mkdtemp(name.data()));
    folder = name;
    torso::write_pair(folder / "pair", torso::straight_grid());
    write_points(folder / "points.csv", points);
    Strings arguments = registration(folder / "pair", folder / "result");
    for (const char* more : {"--fixed-labels", "--points", "--landmarks"}) arguments.push_back(more), arguments.push_back("");
    arguments[arguments.size() - 5] = (folder / "pair" / "fixed_labels.nii.gz").string();
    arguments[arguments.size() - 3] = (folder / "points.csv").string();
    arguments[arguments.size() - 1] = (folder / "landmarks.csv").string();
    std::ofstream landmarks(folder / "landmarks.csv");
    landmarks << "mx,my,mz,fx,fy,fz\n";
    for (const auto& [label, motion] : torso::motions()) {
      const Vec3d x = torso::bone_center(label), y = motion.apply(x);
      landmarks << x.x << ',' << x.y << ',' << x.z << ',' << y.x << ',' << y.y << ',' << y.z << '\n';
    }
    landmarks.close();
    outcome = program::run(arguments, folder / "log");
  }
  void TearDown() override { fs::remove_all(folder); }

  /// The quick registration of the pair in `in`: motions given, nodes 8 mm apart.
  static Strings registration(const fs::path& in, const fs::path& out) {
    return {"register", "-m", (in / "moving.nii.gz").string(), "-f", (in / "fixed.nii.gz").string(), "--moving-labels", (in / "moving_labels.nii.gz").string(),
            "--motions", (in / "motions.json").string(), "--node-spacing", "8", "-o", out.string()};
  }

  fs::path folder;
  Outcome outcome;
  /// In fat, muscle, lung and bone.
  const std::vector<Vec3d> points{{0, 0, 0}, {45, -14, 6}, {-45, -20, 20}, {0, 36, 16}, {60, 30, -20}, {-70, 5, -30}, {5, -50, 40}, {20, 40, -40}};
};
Shared& shared = *static_cast<Shared*>(testing::AddGlobalTestEnvironment(new Shared));

class CommandLine : public TemporaryFolder {
 protected:
  Outcome run(const Strings& arguments) const { return program::run(arguments, shared.folder / "log"); }
  Json json(const fs::path& path) const { return Json::parse(program::content(path)); }
  fs::path pair(const std::string& name) const { return shared.folder / "pair" / name; }
  fs::path result(const std::string& name) const { return shared.folder / "result" / name; }
};

constexpr double voxel_mm = 4;
constexpr double same_nodes_mm = 0.02;  ///< rounding, up to the tolerance of the solver
constexpr double other_nodes_mm = 0.8;  ///< a tenth of the node spacing: other nodes lie in the bones; wrong axes cost 5 mm

double largest_distance(const std::vector<Vec3d>& a, const std::vector<Vec3d>& b) {
  const PointErrors errors = point_errors(a, b);
  return errors.maximum;
}

std::vector<Vec3d> moved(std::vector<Vec3d> points, const VectorImage& field) {
  for (Vec3d& x : points) {
    Vec3d u;
    EXPECT_TRUE(linear_value(field, x, u));
    x += u;
  }
  return points;
}

TEST_F(CommandLine, RegisterWritesEveryFileAndNoOther) {
  ASSERT_EQ(shared.outcome.code, 0) << shared.outcome.err;
  EXPECT_EQ(program::listing(shared.folder / "result"),
            (Strings{"body_mask.nii.gz", "convergence.png", "displacement.png", "fixed_to_moving.h5", "fixed_to_moving.nrrd", "manifest.json", "metrics.json", "motions.json", "moving_to_fixed.nrrd",
                     "nodes.csv", "nodes.vtu", "overlay.png", "points.csv", "report.html", "shear_modulus.nii.gz", "shear_modulus.png", "warped.nii.gz", "warped_body.nii.gz", "warped_labels.nii.gz"}));
}

TEST_F(CommandLine, MetricsAndManifestHaveTheDocumentedKeys) {
  const Json metrics = json(result("metrics.json")), manifest = json(result("manifest.json"));
  for (const char* key : {"motions", "warnings", "solver", "jacobian", "inverse", "edges", "labels", "landmarks"}) EXPECT_TRUE(metrics.contains(key)) << key;
  for (const char* key : {"program", "settings", "inputs", "tissue", "solver", "stages"}) EXPECT_TRUE(manifest.contains(key)) << key;
  EXPECT_EQ(manifest["settings"]["node-spacing"][0], "8");
  for (const char* input : {"moving", "fixed", "moving-labels", "motions"}) EXPECT_EQ(manifest["inputs"][input]["md5"].get<std::string>().size(), 32u) << input;
  EXPECT_NE(manifest["inputs"]["moving"]["md5"], manifest["inputs"]["fixed"]["md5"]);
  for (const char* stage : {"reading", "tissue", "motions", "mechanics", "evaluation"}) {
    EXPECT_GE(manifest["stages"][stage]["seconds"], 0) << stage;
    EXPECT_GT(manifest["stages"][stage]["peak_memory_MB"], 1) << stage;
  }
  EXPECT_TRUE(manifest["solver"]["converged"]);
  EXPECT_GT(manifest["solver"]["history"].size(), 3u);
  for (const char* key : {"step", "error_estimate_mm", "convergence_rate", "strain_energy_mN_mm"}) EXPECT_TRUE(manifest["solver"]["history"].back()[key].is_number()) << key;
  EXPECT_LT(metrics["solver"]["error_estimate_mm"], 0.05);
  EXPECT_GT(manifest["solver"]["nodes"], 1000);
  EXPECT_EQ(metrics["jacobian"]["folded_voxels"], 0);
  EXPECT_EQ(metrics["motions"].size(), std::size_t(torso::bones));
  for (const Json& bone : metrics["motions"]) {  // moved by 5 mm and more; 0.08 to 0.11 mm rms and at most 0.71 measured, at their surface
    EXPECT_LT(bone["rms_deviation_mm"], 0.2) << bone;
    EXPECT_LT(bone["largest_deviation_mm"], 1) << bone;
    EXPECT_GT(bone["largest_deviation_mm"], bone["rms_deviation_mm"].get<double>());
  }
  EXPECT_TRUE(metrics["warnings"].empty()) << metrics["warnings"];
  EXPECT_NEAR(manifest["tissue"]["body_litres"], 3.3, 0.8);
  for (const char* candidate : {"before", "rigid", "mtled"})
    for (const char* key : {"within_two_voxels", "within_two_voxels_all_edges", "hausdorff_mm", "consistent_fraction"})
      EXPECT_TRUE(metrics["edges"][candidate].contains(key)) << candidate << ' ' << key;
}

TEST_F(CommandLine, ReportShowsTheRegistration) {
  const Json report = program::report_data(result("report.html")), metrics = json(result("metrics.json")), manifest = json(result("manifest.json"));
  EXPECT_EQ(report["kind"], "register");
  EXPECT_EQ(program::ids_of(report["candidates"]), (Strings{"before", "rigid", "mtled"}));
  for (const char* key : {"edges", "landmarks", "labels"}) EXPECT_EQ(report[key], metrics[key]) << key;
  EXPECT_EQ(report["jacobian"], metrics["inverse"]["jacobian"]) << "of the map fixed -> moving, as the pictures";
  const VectorImage inverse = read_vector_image(result("fixed_to_moving.nrrd"), "field");
  const LabelImage covered = read_labels(result("warped_body.nii.gz"), "body");
  Mask body(inverse.grid);
  std::copy(covered.data.begin(), covered.data.end(), body.data.begin());
  const JacobianStatistics jacobian = jacobian_statistics(inverse, body);
  EXPECT_NEAR(report["jacobian"]["min"], jacobian.minimum, 1e-6);
  EXPECT_NEAR(report["jacobian"]["max"], jacobian.maximum, 1e-6);
  EXPECT_EQ(report["verdict"]["level"], "good") << report["verdict"];
  EXPECT_EQ(program::ids_of(report["view"]["volumes"]), (Strings{"fixed", "before", "mtled", "moving", "shear_modulus", "displacement", "jacobian", "rigid", "edges"}));
  EXPECT_EQ(report["motions"].size(), std::size_t(torso::bones));
  EXPECT_EQ(report["motions"][0]["angle_deg"], metrics["motions"][0]["rotation_deg"]);
  EXPECT_EQ(report["inputs"][0]["md5"], manifest["inputs"]["moving"]["md5"]);
  EXPECT_EQ(report["solver"]["history"]["step"].size(), manifest["solver"]["history"].size());
  EXPECT_EQ(report["solver"]["tolerance_mm"], 0.05);
  EXPECT_EQ(report["nodes"]["count"], manifest["solver"]["nodes"]);
  EXPECT_EQ(report["stages"].size(), manifest["stages"].size());
}

TEST_F(CommandLine, EdgeTableGoesFromBeforeToResult) {
  const std::string& out = shared.outcome.out;
  EXPECT_LT(out.find("\nbefore"), out.find("\nrigid"));
  EXPECT_LT(out.find("\nrigid"), out.find("\nmtled"));
  EXPECT_NE(out.find("<2 vox. all"), std::string::npos) << out;
}

TEST_F(CommandLine, RegistrationImprovesEdgesLabelsAndLandmarks) {
  const Json evaluation = json(result("metrics.json"));
  EXPECT_GT(evaluation["edges"]["mtled"]["within_two_voxels_all_edges"], evaluation["edges"]["before"]["within_two_voxels_all_edges"]);
  for (int label = 0; label < torso::bones; ++label)
    EXPECT_GT(evaluation["labels"]["mtled"][label]["dice"], evaluation["labels"]["before"][label]["dice"].get<double>() + 0.1) << label;
  EXPECT_GT(evaluation["landmarks"]["before"]["mean_mm"], 6);
  EXPECT_LT(evaluation["landmarks"]["mtled"]["mean_mm"], 0.1) << "bones move as prescribed";
}

TEST_F(CommandLine, WarpedLabelsFollowTheMotions) {
  const LabelImage before = read_labels(pair("moving_labels.nii.gz"), "labels"), after = read_labels(result("warped_labels.nii.gz"), "labels");
  for (const auto& [label, motion] : torso::motions()) {
    const RigidMotion back = inverse(motion);
    double both = 0, warped = 0, moved_rigidly = 0;
    for (int k = 0; k < after.grid.size[2]; ++k)
      for (int j = 0; j < after.grid.size[1]; ++j)
        for (int i = 0; i < after.grid.size[0]; ++i) {
          const bool a = after.at(i, j, k) == label, b = nearest_value<std::uint16_t>(before, back.apply(after.grid.point(i, j, k)), 0) == label;
          both += a && b, warped += a, moved_rigidly += b;
        }
    EXPECT_GT(2 * both / (warped + moved_rigidly), 0.9) << "label " << label;
  }
}

TEST_F(CommandLine, InverseFieldUndoesTheForwardField) {
  const VectorImage forward = read_vector_image(result("moving_to_fixed.nrrd"), "field"), inverse = read_vector_image(result("fixed_to_moving.nrrd"), "field");
  EXPECT_GT(largest_distance(moved(shared.points, forward), shared.points), 5);
  EXPECT_LT(largest_distance(moved(moved(shared.points, forward), inverse), shared.points), 0.02 * voxel_mm) << "interpolation between voxels";
}

TEST_F(CommandLine, ItkTransformIsTheInverseField) {
  itk::HDF5TransformIOFactory::RegisterOneFactory();
  const auto reader = itk::TransformFileReaderTemplate<float>::New();
  reader->SetFileName(result("fixed_to_moving.h5").string());
  reader->Update();
  ASSERT_EQ(reader->GetTransformList()->size(), 1u);
  using Transform = itk::DisplacementFieldTransform<float, 3>;
  const auto* transform = dynamic_cast<const Transform*>(reader->GetTransformList()->front().GetPointer());
  ASSERT_TRUE(transform);
  std::vector<Vec3d> by_itk;
  for (const Vec3d& x : shared.points) {
    Transform::InputPointType p;
    for (int a = 0; a < 3; ++a) p[unsigned(a)] = float(x[a]);
    const auto y = transform->TransformPoint(p);
    by_itk.push_back({y[0], y[1], y[2]});
  }
  EXPECT_LT(largest_distance(by_itk, moved(shared.points, read_vector_image(result("fixed_to_moving.nrrd"), "field"))), 1e-3);
}

TEST_F(CommandLine, PointsGetTheFieldOfTheMechanics) {
  const std::vector<Vec3d> u = read_points(result("points.csv"), {"ux", "uy", "uz"}), x = read_points(result("points.csv"));
  EXPECT_LT(largest_distance(x, shared.points), 1e-6);
  std::vector<Vec3d> y = x;
  for (std::size_t p = 0; p < y.size(); ++p) y[p] += u[p];
  EXPECT_LT(largest_distance(y, moved(x, read_vector_image(result("moving_to_fixed.nrrd"), "field"))), 0.1 * voxel_mm);
  const Vec3d bone{0, 36, 16};  // centre of label 3
  EXPECT_LT(norm(bone + u[3] - torso::motions()[2].motion.apply(bone)), 0.05);
}

TEST_F(CommandLine, OrderOfVoxelsAndObliqueGridsDoNotMatter) {
  const std::vector<Vec3d> straight = read_points(result("points.csv"), {"ux", "uy", "uz"});
  for (const auto& [name, grid, tolerance_mm] : {std::tuple{"flipped", torso::flipped_grid(), same_nodes_mm}, std::tuple{"oblique", torso::oblique_grid(), other_nodes_mm}}) {
    torso::write_pair(file(name), grid);
    Strings arguments = Shared::registration(file(name), file(name) / "result");
    for (const std::string& more : Strings{"--points", (shared.folder / "points.csv").string(), "--no-evaluation", "-q"}) arguments.push_back(more);
    const Outcome outcome = run(arguments);
    ASSERT_EQ(outcome.code, 0) << outcome.err;
    EXPECT_LT(largest_distance(read_points(file(name) / "result" / "points.csv", {"ux", "uy", "uz"}), straight), tolerance_mm) << name;
  }
}

TEST_F(CommandLine, SameBitsForOneAndTwoThreads) {
  for (const char* threads : {"1", "2"}) {
    Strings arguments = Shared::registration(shared.folder / "pair", file(threads));
    for (const char* more : {"--threads", threads, "--no-evaluation", "-q"}) arguments.push_back(more);
    ASSERT_EQ(run(arguments).code, 0);
  }
  for (const char* name : {"nodes.csv", "moving_to_fixed.nrrd", "fixed_to_moving.nrrd", "warped.nii.gz", "warped_labels.nii.gz", "shear_modulus.nii.gz"})
    EXPECT_TRUE(program::content(file("1") / name) == program::content(file("2") / name)) << name;
}

// nodes.csv has 9 digits; the numbers of the reports are doubles with all of theirs.
TEST_F(CommandLine, AnExportedCaseHasTheSameSolution) {
  Strings arguments = Shared::registration(shared.folder / "pair", file("result"));
  for (const std::string& more : Strings{"--export-case", file("result/case").string(), "--tolerance", "0.03", "--no-evaluation", "-q"}) arguments.push_back(more);
  Outcome outcome = run(arguments);
  ASSERT_EQ(outcome.code, 0) << outcome.err;
  EXPECT_EQ(program::listing(file("result/case")), (Strings{"body_cells.csv", "case.toml", "nodes.csv", "points.csv", "springs.csv"}));
  outcome = run({"solve", file("result/case/case.toml").string(), "-o", file("solved").string(), "-q"});
  ASSERT_EQ(outcome.code, 0) << outcome.err;
  EXPECT_TRUE(program::content(file("result/nodes.csv")) == program::content(file("solved/nodes.csv")));
  const Json registered = json(file("result/manifest.json"))["solver"], solved = json(file("solved/summary.json"));
  for (const char* key : {"steps", "force_evaluations", "error_estimate_mm", "strain_energy_mN_mm", "smallest_volume_ratio", "integration_points"}) EXPECT_EQ(registered[key], solved[key]) << key;
  EXPECT_LT(solved["error_estimate_mm"], 0.03);
  for (int label = 1; label <= torso::bones; ++label) EXPECT_TRUE(solved["reactions_mN"].contains("label " + std::to_string(label)));

  arguments[std::size_t(std::find(arguments.begin(), arguments.end(), "-o") - arguments.begin()) + 1] = file("again").string();
  program::expect_refusal(run(arguments), 7, {"result/case", "not empty", "--force"});
  EXPECT_FALSE(fs::exists(file("again")));
  arguments[std::size_t(std::find(arguments.begin(), arguments.end(), "--export-case") - arguments.begin()) + 1] = file("again").string();
  program::expect_refusal(run(arguments), 2, {"--export-case", "--output", "choose another one"});
  EXPECT_FALSE(fs::exists(file("again")));
}

TEST_F(CommandLine, QuietSaysNothingOnStandardError) {
  EXPECT_NE(shared.outcome.err.find("solving"), std::string::npos);
  const Outcome quiet = run({"classify", "-i", pair("moving.nii.gz").string(), "-o", file("out").string(), "--quiet"});
  EXPECT_EQ(quiet.code, 0);
  EXPECT_EQ(quiet.err, "");
}

TEST_F(CommandLine, ConfigGivesSettingsAndTheCommandLineWins) {
  fs::create_directories(file("case"));
  torso::write_pair(file("case") / "images", torso::straight_grid());
  file("case/run.toml",
       "moving = \"images/moving.nii.gz\"\nfixed = \"images/fixed.nii.gz\"\nmoving-labels = \"images/moving_labels.nii.gz\"\nmotions = \"images/motions.json\"\n"
       "output = \"result\"\nnode-spacing = 12\ntolerance = 0.2\nno-evaluation = true\nresample = [5, 5, 5]\nrelaxation = \"plain\"\n");
  const Outcome outcome = run({"register", "--config", file("case/run.toml").string(), "--node-spacing", "10"});
  ASSERT_EQ(outcome.code, 0) << outcome.err;
  const Json manifest = json(file("case/result/manifest.json"));
  EXPECT_EQ(manifest["settings"]["node-spacing"][0], "10");
  EXPECT_EQ(manifest["settings"]["tolerance"][0], "0.2");
  EXPECT_FALSE(json(file("case/result/metrics.json")).contains("edges"));
  EXPECT_EQ(manifest["solver"]["coarse_unknowns"], 0) << "plain relaxation has no coarse space";
  EXPECT_NEAR(read_image(file("case/result/warped.nii.gz"), "image").grid.spacing.x, 5, 0.1);
}

TEST_F(CommandLine, TissueTableMayMakeLungsCompressible) {
  const auto displacements = [&](const std::string& lung_ratio) {
    const std::string lung = ",0.53," + lung_ratio + "\n";
    file("table.csv", "name,shear_modulus_kpa,poisson_ratio\nlung 1" + lung + "lung 2" + lung + "lung 3" + lung +
                          "fat,1.07,0.49\nligament,3.57,0.49\nmuscle,4.05,0.49\nbone 1,40.5,0.49\nbone 2,40.5,0.49\n");
    Strings arguments = Shared::registration(shared.folder / "pair", file("out"));
    for (const std::string& more : {std::string("--tissue-table"), file("table.csv").string(), std::string("--points"), (shared.folder / "points.csv").string(), std::string("--no-evaluation"), std::string("--force")})
      arguments.push_back(more);
    const Outcome outcome = run(arguments);
    EXPECT_EQ(outcome.code, 0) << outcome.err;
    EXPECT_EQ(json(file("out/manifest.json"))["tissue"]["classes"][0]["poisson_ratio"].get<double>(), std::stod(lung_ratio));
    return read_points(file("out/points.csv"), {"ux", "uy", "uz"});
  };
  const std::vector<Vec3d> plain = read_points(result("points.csv"), {"ux", "uy", "uz"});
  EXPECT_LT(largest_distance(displacements("0.49"), plain), same_nodes_mm);
  EXPECT_GT(largest_distance(displacements("0.1"), plain), 2 * same_nodes_mm);  // measured: 0.05 mm; this torso has little lung
}

TEST_F(CommandLine, MotionsAreEstimated) {
  const Outcome outcome = run({"motions", "-m", pair("moving.nii.gz").string(), "-f", pair("fixed.nii.gz").string(), "--moving-labels", pair("moving_labels.nii.gz").string(),
                               "--fixed-labels", pair("fixed_labels.nii.gz").string(), "-o", file("out").string()});
  ASSERT_EQ(outcome.code, 0) << outcome.err;
  EXPECT_EQ(program::listing(file("out")), (Strings{"motions.json", "summary.json"}));
  const std::vector<LabelMotion> found = read_motions(file("out/motions.json")), truth = torso::motions();
  ASSERT_EQ(found.size(), truth.size());
  for (std::size_t m = 0; m < truth.size(); ++m) {
    const Vec3d c = torso::bone_center(truth[m].label);
    EXPECT_LT(norm(found[m].motion.apply(c) - truth[m].motion.apply(c)), 0.5 * voxel_mm) << "label " << truth[m].label;
  }
  for (const auto& m : json(file("out/summary.json"))["motions"]) EXPECT_GE(m["similarity_after"], m["similarity_before"]);
}

TEST_F(CommandLine, RegisterEstimatesMotionsByItself) {
  const Outcome outcome = run({"register", "-m", pair("moving.nii.gz").string(), "-f", pair("fixed.nii.gz").string(), "--moving-labels", pair("moving_labels.nii.gz").string(),
                               "--fixed-labels", pair("fixed_labels.nii.gz").string(), "--node-spacing", "10", "-o", file("out").string(), "--landmarks",
                               (shared.folder / "landmarks.csv").string()});
  ASSERT_EQ(outcome.code, 0) << outcome.err;
  const Json landmarks = json(file("out/metrics.json"))["landmarks"];
  EXPECT_LT(landmarks["mtled"]["mean_mm"], 0.5 * voxel_mm);
  EXPECT_LT(landmarks["mtled"]["mean_mm"], 0.5 * landmarks["before"]["mean_mm"].get<double>());
}

TEST_F(CommandLine, ClassifyFindsBodyAndTissue) {
  const Outcome outcome = run({"classify", "-i", pair("moving.nii.gz").string(), "-o", file("out").string()});
  ASSERT_EQ(outcome.code, 0) << outcome.err;
  EXPECT_EQ(program::listing(file("out")), (Strings{"body_mask.nii.gz", "classes.nii.gz", "shear_modulus.nii.gz", "summary.json"}));
  const Image modulus = read_image(file("out/shear_modulus.nii.gz"), "modulus");
  EXPECT_NEAR(nearest_value<float>(modulus, {45, -14, 6}, 0), 0.53, 0.1) << "lung";
  EXPECT_NEAR(nearest_value<float>(modulus, {0, -60, 0}, 0), 4.05, 1.5) << "muscle";
  EXPECT_GT(nearest_value<float>(modulus, {0, 36, 16}, 0), 30) << "bone";
  EXPECT_EQ(nearest_value<float>(modulus, {-118, -90, 0}, 9), 0) << "air";
}

TEST_F(CommandLine, WarpRepeatsWhatRegisterDid) {
  const std::string folder = (shared.folder / "result").string();
  ASSERT_EQ(run({"warp", "-r", folder, "-i", pair("moving.nii.gz").string(), "-o", file("image.nii.gz").string()}).code, 0);
  ASSERT_EQ(run({"warp", "-r", folder, "--labels", pair("moving_labels.nii.gz").string(), "-o", file("labels.nii.gz").string()}).code, 0);
  EXPECT_EQ(read_image(file("image.nii.gz"), "image").data, read_image(result("warped.nii.gz"), "image").data);
  EXPECT_EQ(read_labels(file("labels.nii.gz"), "labels").data, read_labels(result("warped_labels.nii.gz"), "labels").data);
  EXPECT_EQ(entries(), 2) << "no temporary file is left";
}

TEST_F(CommandLine, WarpTakesPointsThereAndBack) {
  const std::string folder = (shared.folder / "result").string();
  ASSERT_EQ(run({"warp", "-r", folder, "--points", (shared.folder / "points.csv").string(), "-o", file("there.csv").string()}).code, 0);
  ASSERT_EQ(run({"warp", "-r", folder, "--points", file("there.csv").string(), "--direction", "fixed-to-moving", "-o", file("back.csv").string()}).code, 0);
  EXPECT_GT(largest_distance(read_points(file("there.csv")), shared.points), 5);
  EXPECT_LT(largest_distance(read_points(file("back.csv")), shared.points), 0.02 * voxel_mm);
}

TEST_F(CommandLine, WarpBackUndoesWarp) {
  const std::string folder = (shared.folder / "result").string();
  ASSERT_EQ(run({"warp", "-r", folder, "--labels", result("warped_labels.nii.gz").string(), "--direction", "fixed-to-moving", "-o", file("back.nii.gz").string()}).code, 0);
  for (const LabelOverlap& o : label_overlap(read_labels(file("back.nii.gz"), "labels"), read_labels(pair("moving_labels.nii.gz"), "labels"))) EXPECT_GT(o.dice, 0.85) << o.label;
}

TEST_F(CommandLine, EvaluateComparesEdgesLabelsAndLandmarks) {
  const Outcome outcome = run({"evaluate", "-f", pair("fixed.nii.gz").string(), "-w", result("warped.nii.gz").string(), "--fixed-labels", pair("fixed_labels.nii.gz").string(),
                               "--warped-labels", result("warped_labels.nii.gz").string(), "--landmarks", (shared.folder / "landmarks.csv").string(), "--result",
                               (shared.folder / "result").string(), "--mask", result("warped_body.nii.gz").string(), "-o", file("out").string()});
  ASSERT_EQ(outcome.code, 0) << outcome.err;
  const Json evaluation = json(file("out/evaluation.json")), metrics = json(result("metrics.json"));
  EXPECT_GT(evaluation["edges"]["after"]["within_two_voxels"], 0.95);
  EXPECT_EQ(evaluation["labels"]["after"], metrics["labels"]["mtled"]);
  EXPECT_LT(evaluation["landmarks"]["after"]["mean_mm"], 0.2);
}

TEST_F(CommandLine, InfoAndHelpExplainTheProgram) {
  const Outcome info = run({"info"});
  EXPECT_EQ(info.code, 0);
  EXPECT_NE(info.out.find("ITK"), std::string::npos);
  for (const char* verb : {"register", "classify", "motions", "warp", "evaluate", "solve", "info"}) {
    const Outcome help = run({verb, "--help"});
    EXPECT_EQ(help.code, 0);
    EXPECT_NE(help.out.find("mtled " + std::string(verb)), std::string::npos) << help.out;
  }
  EXPECT_EQ(run({"--version"}).code, 0);
}

}  // namespace
}  // namespace mtled
