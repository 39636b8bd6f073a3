#include <cmath>
#include <cstdlib>
#include <nlohmann/json.hpp>

#include "image_io/image_io.hpp"
#include "report_data.hpp"
#include "temporary_folder.hpp"

namespace mtled {
namespace {

using program::expect_refusal;
using program::Outcome;
using Strings = std::vector<std::string>;
using Json = nlohmann::json;
namespace fs = std::filesystem;

constexpr int usage = 2, input = 3;

/// Two blurred spheres; the fixed image is the moving one two voxels further along x and one back along z.
class Evaluate : public TemporaryFolder {
 protected:
  static constexpr Vec3d shift{4, 0, -2};  ///< [mm] from a point of the fixed to its point of the moving image: whole voxels
  static constexpr Vec3d centers[] = {{0, 0, 0}, {20, 10, 6}};
  static constexpr double radii[] = {14, 8};

  Evaluate() {
    grid.size = {50, 40, 34}, grid.spacing = {2, 2, 2}, grid.origin = {-44, -38, -34};
    write_image(file("moving.nrrd"), picture({0, 0, 0}));
    write_image(file("fixed.nrrd"), picture(shift));
    write_labels(file("moving_labels.nrrd"), labels({0, 0, 0}));
    write_labels(file("fixed_labels.nrrd"), labels(shift));
    file("right.tfm", transform(shift));
    file("wrong.tfm", transform(-1.0 * shift));
    file("landmarks.csv", "mx,my,mz,fx,fy,fz\n0,0,0,-4,0,2\n20,10,6,16,10,8\n");
  }
  static double depth(const Vec3d& x, int sphere) { return radii[sphere] - norm(x - centers[sphere]); }
  Image picture(const Vec3d& by) const {
    Image image(grid);
    fill(image, [&](const Vec3d& y) { return float(1000 / (1 + std::exp(-depth(y + by, 0))) + 600 / (1 + std::exp(-depth(y + by, 1)))); });
    return image;
  }
  LabelImage labels(const Vec3d& by) const {
    LabelImage image(grid);
    fill(image, [&](const Vec3d& y) { return std::uint16_t(depth(y + by, 0) > 0 ? 1 : depth(y + by, 1) > 0 ? 2 : 0); });
    return image;
  }
  template <class T, class Function>
  static void fill(Volume<T>& volume, const Function& value) {
    for (int k = 0; k < volume.grid.size[2]; ++k)
      for (int j = 0; j < volume.grid.size[1]; ++j)
        for (int i = 0; i < volume.grid.size[0]; ++i) volume.at(i, j, k) = value(volume.grid.point(i, j, k));
  }
  static std::string transform(const Vec3d& v) {
    return "#Insight Transform File V1.0\n#Transform 0\nTransform: TranslationTransform_double_3_3\nParameters: " + std::to_string(v.x) + " " + std::to_string(v.y) + " " + std::to_string(v.z) + "\nFixedParameters:\n";
  }
  /// Runs with the two images unless they are replaced; the report of a run that succeeds.
  Outcome run(Strings more) {
    if (std::find(more.begin(), more.end(), "-f") == more.end()) more.insert(more.end(), {"-f", file("fixed.nrrd").string()});
    more.insert(more.begin(), "evaluate");
    more.insert(more.end(), {"--force", "-o", file("out").string()});
    return program::run(more, file("log"));
  }
  Json report(Strings more) {
    const Outcome outcome = run(std::move(more));
    EXPECT_EQ(outcome.code, 0) << outcome.err;
    for (const char* no_number : {" nan", "-nan", "inf "}) EXPECT_EQ((outcome.out + outcome.err).find(no_number), std::string::npos) << outcome.out << outcome.err;
    printed = outcome.out, said = outcome.err;
    return Json::parse(program::content(file("out/evaluation.json")));
  }
  Strings with_moving(Strings more) const {
    more.insert(more.end(), {"-m", file("moving.nrrd").string()});
    return more;
  }
  Strings everything(const std::string& option, const fs::path& transform_file) const {
    return with_moving({option, transform_file.string(), "--fixed-labels", file("fixed_labels.nrrd"), "--moving-labels", file("moving_labels.nrrd"), "--landmarks", file("landmarks.csv")});
  }

  Grid grid;
  std::string printed, said;
};

TEST_F(Evaluate, AnExactTransformIsExact) {
  const Json r = report(everything("-t", file("right.tfm")));
  const double distance = norm(shift);
  EXPECT_EQ(r["edges"]["after"]["hausdorff_1_to_100_all_edges_mm"][99], 0);
  EXPECT_EQ(r["edges"]["after"]["modified_hausdorff_mm"], 0);
  EXPECT_EQ(r["edges"]["after"]["within_two_voxels_all_edges"], 1);
  EXPECT_GT(r["edges"]["before"]["hausdorff_all_edges_mm"][3], 2);
  EXPECT_LE(r["edges"]["before"]["hausdorff_1_to_100_all_edges_mm"][99], distance + 1e-9) << "every edge has its like at the shift";
  EXPECT_EQ(r["settings"]["canny_sigma_mm"], 2);
  for (const Json& l : r["labels"]["after"]) {
    EXPECT_EQ(l["dice"], 1);
    for (const char* key : {"hausdorff_95_mm", "hausdorff_95_pooled_mm", "average_surface_distance_mm"}) EXPECT_EQ(l[key], 0);
  }
  EXPECT_LT(r["labels"]["before"][1]["dice"], 0.8);
  EXPECT_NEAR(r["landmarks"]["before"]["max_mm"], distance, 1e-9);
  EXPECT_NEAR(r["landmarks"]["after"]["max_mm"], 0, 1e-9);
  for (const Json& l : r["rigidity"]) EXPECT_LT(l["largest_mm"], 1e-5);
  EXPECT_EQ(r["rigidity"].size(), 2u);
  EXPECT_NEAR(r["field"]["jacobian"]["min"], 1, 1e-6);
  EXPECT_EQ(r["field"]["jacobian"]["folded_voxels"], 0);
  EXPECT_NEAR(r["field"]["jacobian"]["sd_log"], 0, 1e-6);
  EXPECT_FALSE(r["direction"]["reversed_fits_better"]);
  EXPECT_NEAR(r["correlation"]["after"], 1, 1e-6);
  EXPECT_TRUE(r["warnings"].empty()) << r["warnings"];
  EXPECT_EQ(program::listing(file("out")), (Strings{"edges.csv", "evaluation.json", "labels.csv", "landmarks.csv", "report.html"}));
  const std::string table = program::content(file("out/edges.csv"));
  EXPECT_EQ(std::count(table.begin(), table.end(), '\n'), 101);
  EXPECT_EQ(program::content(file("out/landmarks.csv")).substr(0, 43), "row,fx,fy,fz,mx,my,mz,before_mm,after_mm\n1,");
}

TEST_F(Evaluate, TheInverseIsRecognisedAndCanBeGivenAsSuch) {
  const Json wrong = report(everything("-t", file("wrong.tfm")));
  EXPECT_NE(said.find("wrong direction"), std::string::npos) << said;
  EXPECT_NE(wrong["warnings"][0].get<std::string>().find("--inverse-transform"), std::string::npos);
  EXPECT_TRUE(wrong["direction"]["reversed_fits_better"]);
  EXPECT_NEAR(wrong["direction"]["landmarks_as_given_mm"], 2 * norm(shift), 1e-9);
  EXPECT_NEAR(wrong["direction"]["landmarks_reversed_mm"], 0, 1e-9);
  EXPECT_GT(wrong["direction"]["correlation_reversed"], 0.999);
  EXPECT_LT(wrong["direction"]["correlation_as_given"], 0.9);
  const Json by_images = report(with_moving({"-t", file("wrong.tfm")}));  // without landmarks
  EXPECT_TRUE(by_images["direction"]["reversed_fits_better"]);

  const Json inverted = report(everything("--inverse-transform", file("wrong.tfm")));
  EXPECT_TRUE(inverted["warnings"].empty()) << inverted["warnings"];
  EXPECT_EQ(inverted["edges"]["after"]["within_two_voxels_all_edges"], 1);
  EXPECT_LT(inverted["landmarks"]["after"]["max_mm"], 0.1);  // the tolerance of the inversion
}

TEST_F(Evaluate, TheInverseIsRecognisedInSomeOfTheVoxelsOfALargeImage) {
  grid.size = {100, 80, 68}, grid.spacing = {1, 1, 1};
  write_image(file("moving.nrrd"), picture({0, 0, 0}));
  write_image(file("fixed.nrrd"), picture(shift));
  for (const bool reversed : {false, true}) {
    const Json direction = report(with_moving({"-t", file(reversed ? "wrong.tfm" : "right.tfm")}))["direction"];
    EXPECT_EQ(direction["reversed_fits_better"], reversed);
    EXPECT_GT(direction[reversed ? "correlation_reversed" : "correlation_as_given"], 0.999);
    EXPECT_GT(direction["voxels"], 50000);
    EXPECT_LE(direction["voxels"], 50 * 40 * 34) << "every second along each axis";
  }
}

TEST_F(Evaluate, FormatsOfTheSameFieldAgree) {
  VectorImage field(grid);
  for (Vec3f& v : field.data) v = {float(shift.x), float(shift.y), float(shift.z)};
  write_vector_image(file("f.nrrd"), field);
  write_vector_image(file("f.mha"), field);
  write_displacement_transform(file("f.h5"), field);
  const Json expected = report(everything("-t", file("right.tfm")));
  for (const char* name : {"f.nrrd", "f.mha", "f.h5"}) {
    const Json r = report(everything("-t", file(name)));
    for (const char* key : {"edges", "labels"}) EXPECT_EQ(r[key], expected[key]) << name;
  }
  const Json both = report(with_moving({"-t", file("f.nrrd"), "--inverse-transform", file("wrong.tfm")}));
  EXPECT_EQ(both["field"]["inverse_consistency"]["max_mm"], 0);
  EXPECT_EQ(both["field"]["inverse_consistency"]["voxels"], grid.count());
}

TEST_F(Evaluate, AWarpedImageByAnyProgram) {
  write_image(file("warped.nrrd"), picture({2, 0, 0}));
  const Json r = report(with_moving({"-w", file("warped.nrrd")}));
  EXPECT_FALSE(r.contains("field"));
  EXPECT_GT(r["edges"]["after"]["hausdorff_all_edges_mm"][3], 0);
  EXPECT_LT(r["edges"]["after"]["hausdorff_all_edges_mm"][3], r["edges"]["before"]["hausdorff_all_edges_mm"][3]);
  const Json same = report({"-w", file("fixed.nrrd")});
  EXPECT_EQ(same["edges"]["after"]["hausdorff_1_to_100_all_edges_mm"][99], 0);
  EXPECT_EQ(same["edges"]["after"]["within_two_voxels"], 1);
  EXPECT_NEAR(same["correlation"]["after"], 1, 1e-9);
  EXPECT_FALSE(same["edges"].contains("before"));
}

TEST_F(Evaluate, EdgesOfSlices) {
  const Json r = report(with_moving({"-t", file("right.tfm"), "--slices"}));
  EXPECT_EQ(r["settings"]["edges"], "2-D, slice by slice along k");
  EXPECT_EQ(r["edges"]["after"]["hausdorff_1_to_100_all_edges_mm"][99], 0);
  EXPECT_GT(r["edges"]["before"]["unmatched_voxels"][0], 0) << "the shift along k leaves slices without a counterpart";
}

TEST_F(Evaluate, ImagesWithoutEdgesHaveNoDistances) {
  write_image(file("flat.nrrd"), Image(grid, 7));
  for (const Strings& arguments : {Strings{"-w", file("flat.nrrd")}, Strings{"-f", file("flat.nrrd"), "-w", file("flat.nrrd")}, Strings{"-w", file("flat.nrrd"), "--slices"}}) {
    const Json r = report(arguments);
    for (const char* key : {"hausdorff_mm", "mean_mm", "modified_hausdorff_mm", "within_two_voxels", "hausdorff_1_to_100_mm"}) EXPECT_TRUE(r["edges"]["after"][key].is_null()) << key;
    EXPECT_EQ(r["edges"]["after"]["edge_voxels"][1], 0);
    EXPECT_EQ(r["correlation"]["after"], 0);
    EXPECT_NE(said.find("no edges to compare"), std::string::npos) << said;
    EXPECT_NE(printed.find(" - "), std::string::npos) << printed;
  }
}

TEST_F(Evaluate, LabelsMissingOnOneSideAreSaid) {
  LabelImage some = labels({0, 0, 0});
  for (auto& v : some.data) v = v == 2 ? 5 : v;
  write_labels(file("renumbered.nrrd"), some);
  const Json r = report({"-w", file("fixed.nrrd"), "--fixed-labels", file("fixed_labels.nrrd"), "--warped-labels", file("renumbered.nrrd")});
  EXPECT_NE(said.find("label 2 is missing in the warped labels"), std::string::npos) << said;
  EXPECT_NE(said.find("label 5 is missing in the fixed labels"), std::string::npos) << said;
  EXPECT_EQ(r["labels"]["after"][1]["dice"], 0);
  EXPECT_TRUE(r["labels"]["after"][1]["hausdorff_95_mm"].is_null());
  EXPECT_NE(program::content(file("out/labels.csv")).find("2,after,0,,,\n"), std::string::npos);
}

TEST_F(Evaluate, LandmarksOutsideAreLeftOutAndNamed) {
  file("some.csv", "mx,my,mz,fx,fy,fz\n0,0,0,-4,0,2\n500,0,0,496,0,2\n0,0,0,-4,0,-2000\n");
  const Json r = report(with_moving({"-t", file("right.tfm"), "--landmarks", file("some.csv")}));
  EXPECT_NE(said.find("2 of 3 landmarks lie outside"), std::string::npos) << said;
  EXPECT_NE(said.find("row 2, 3"), std::string::npos) << said;
  EXPECT_EQ(r["landmarks"]["after"]["points"], 1);
  file("none.csv", "mx,my,mz,fx,fy,fz\n500,0,0,496,0,2\n");
  expect_refusal(run(with_moving({"--landmarks", file("none.csv")})), input, {"all 1 landmarks", "LPS"});
  file("f.csv", "x,y,z\n-4,0,2\n"), file("m.csv", "x,y,z\n0,0,0\n1,1,1\n");
  expect_refusal(run({"-w", file("fixed.nrrd"), "--fixed-landmarks", file("f.csv"), "--moving-landmarks", file("m.csv")}), input, {"has 1 landmarks", "has 2", "same order"});
  file("m.csv", "x,y,z\n0,0,0\n");
  EXPECT_NEAR(report({"-w", file("fixed.nrrd"), "--fixed-landmarks", file("f.csv"), "--moving-landmarks", file("m.csv")})["landmarks"]["before"]["mean_mm"], norm(shift), 1e-9);
}

TEST_F(Evaluate, SingleSlices) {
  const auto slice = [&](const std::string& name, const Vec3d& by) {
    Grid one = grid;
    one.size[2] = 1, one.origin.z = 0;
    Image image(one);
    fill(image, [&](const Vec3d& y) { return float(1000 / (1 + std::exp(-depth(y + by, 0)))); });
    write_image(file(name), image);
  };
  slice("moving_slice.nrrd", {0, 0, 0}), slice("fixed_slice.nrrd", {4, 0, 0});
  file("in_plane.tfm", transform({4, 0, 0}));
  const Json r = report({"-f", file("fixed_slice.nrrd"), "-m", file("moving_slice.nrrd"), "-t", file("in_plane.tfm")});
  EXPECT_EQ(r["edges"]["after"]["hausdorff_1_to_100_all_edges_mm"][99], 0);
  EXPECT_GT(r["edges"]["before"]["hausdorff_all_edges_mm"][3], 2);
  EXPECT_TRUE(r["field"]["jacobian"]["sd_log_learn2reg"].is_null());
  expect_refusal(run({"-f", file("fixed_slice.nrrd"), "-m", file("moving.nrrd")}), input, {"single slice"});
}

TEST_F(Evaluate, FoldsAreCountedAndSaid) {
  VectorImage field(grid);
  for (int k = 0; k < grid.size[2]; ++k)
    for (int j = 0; j < grid.size[1]; ++j)
      for (int i = 20; i < 25; ++i) field.at(i, j, k).x = 8;  // ends within 2 mm: 1 - 8 / 4 at the voxels on both sides of that
  write_vector_image(file("fold.nrrd"), field);
  const Json r = report(with_moving({"-t", file("fold.nrrd")}));
  EXPECT_EQ(r["field"]["jacobian"]["folded_voxels"], 2 * grid.size[1] * grid.size[2]);
  EXPECT_EQ(r["field"]["jacobian"]["min"], -1);
  EXPECT_NE(said.find("folds at"), std::string::npos) << said;
}

TEST_F(Evaluate, BadInputIsExplained) {
  Grid other = grid;
  other.origin.x += 1;
  write_image(file("shifted.nrrd"), Image(other));
  expect_refusal(run({"-w", file("shifted.nrrd")}), input, {"another grid", "resample"});
  other.origin.x += 1000;
  write_image(file("far.nrrd"), Image(other));
  expect_refusal(run({"-m", file("far.nrrd")}), input, {"does not overlap", "transform"});
  file("away.tfm", transform({1000, 0, 0}));
  expect_refusal(run(with_moving({"-t", file("away.tfm")})), input, {"leads no voxel", "fixed to the moving"});
  VectorImage part(grid);
  part.grid.size[0] /= 2;
  part.data.resize(part.grid.count());
  write_vector_image(file("part.nrrd"), part);
  report(with_moving({"-t", file("part.nrrd")}));
  EXPECT_NE(said.find("50 % of the voxels"), std::string::npos) << said;
  expect_refusal(run(with_moving({"-t", file("fixed.nrrd")})), input, {"transform", "1 value", "three"});
  expect_refusal(run({}), usage, {"--warped is missing"});
  expect_refusal(run({"-w", file("fixed.nrrd"), "--fixed-labels", file("fixed_labels.nrrd")}), usage, {"--warped-labels is missing"});
  expect_refusal(run({"-w", file("fixed.nrrd"), "--moving-landmarks", "m.csv"}), usage, {"--fixed-landmarks is missing"});
}

TEST_F(Evaluate, ReportShowsWhatThereIs) {
  const Json r = report(everything("-t", file("right.tfm"))), all = program::report_data(file("out/report.html"));
  EXPECT_EQ(all["kind"], "evaluate");
  EXPECT_EQ(program::ids_of(all["candidates"]), (Strings{"before", "after"}));
  EXPECT_EQ(program::ids_of(all["view"]["volumes"]), (Strings{"fixed", "before", "after", "displacement", "jacobian", "edges"}));
  for (const char* key : {"edges", "labels", "rigidity"}) EXPECT_EQ(all[key], r[key]) << key;
  EXPECT_EQ(all["landmarks"]["after"], r["landmarks"]["after"]);
  EXPECT_EQ(all["jacobian"], r["field"]["jacobian"]);
  EXPECT_EQ(all["verdict"]["level"], "good") << all["verdict"];
  EXPECT_EQ(all["inputs"][0]["size"], (Json{50, 40, 34}));

  report(everything("-t", file("wrong.tfm")));
  EXPECT_EQ(program::report_data(file("out/report.html"))["verdict"]["level"], "bad");

  report({"-w", file("fixed.nrrd")});
  const Json little = program::report_data(file("out/report.html"));
  EXPECT_EQ(program::ids_of(little["candidates"]), (Strings{"after"}));
  EXPECT_EQ(program::ids_of(little["view"]["volumes"]), (Strings{"fixed", "after", "edges"}));
  EXPECT_FALSE(little.contains("landmarks"));
}

TEST_F(Evaluate, NoReportWhenItIsNotWanted) {
  fs::remove_all(file("out"));
  report({"-w", file("fixed.nrrd"), "--no-report"});
  EXPECT_EQ(program::listing(file("out")), (Strings{"edges.csv", "evaluation.json"}));
}

TEST_F(Evaluate, HasTheSameBitsForAnyNumberOfThreads) {
  const auto bytes = [&](const char* threads) {
    Strings arguments = everything("-t", file("wrong.tfm"));
    arguments.insert(arguments.end(), {"--threads", threads});
    Json r = report(arguments);
    for (const auto& [name, stage] : r["stages"].items()) {
      EXPECT_GE(stage["seconds"], 0) << name;
      EXPECT_GT(stage["peak_memory_MB"], 1) << name;
    }
    EXPECT_EQ(r.erase("stages"), 1u);
    return r.dump();
  };
  EXPECT_EQ(bytes("1"), bytes("2"));
}

TEST_F(Evaluate, TheSourcesVoxelsCountInTwoVoxels) {
  Grid coarse = grid;
  coarse.size = {25, 20, 12}, coarse.spacing = {4, 4, 6};
  Image moving(coarse);
  fill(moving, [&](const Vec3d& y) { return float(1000 / (1 + std::exp(-depth(y, 0)))); });
  write_image(file("coarse.nrrd"), moving);
  EXPECT_EQ(report({"-w", file("fixed.nrrd")})["edges"]["after"]["two_voxels_mm"], 4);
  EXPECT_EQ(report({"-m", file("coarse.nrrd"), "-t", file("right.tfm")})["edges"]["after"]["two_voxels_mm"], 12);
}

/// Two sessions of one patient; the figures are those of data/lung_pair/README.md for the mean translation of the landmarks.
TEST_F(Evaluate, LandmarksOfTheLungPair) {
  const fs::path data = fs::path(MTLED_SOURCE_DIR) / "data/lung_pair";
  if (!fs::exists(data / "landmarks.csv")) GTEST_SKIP() << data << " has no landmarks.csv";
  file("mean.tfm", transform({3.865824, 9.539098, -33.529412}));
  const Json r = report({"-f", data / "followup.nii.gz", "-m", data / "baseline.nii.gz", "-t", file("mean.tfm"), "--landmarks", data / "landmarks.csv"})["landmarks"];
  constexpr double last_digit = 0.05;
  EXPECT_EQ(r["after"]["points"], 51);
  EXPECT_NEAR(r["before"]["mean_mm"], 35.3, last_digit);
  EXPECT_NEAR(r["before"]["percentile_95_mm"], 38.8, last_digit);
  EXPECT_NEAR(r["after"]["mean_mm"], 4.2, last_digit);
  EXPECT_NEAR(r["after"]["median_mm"], 4.0, last_digit);
  EXPECT_NEAR(r["after"]["percentile_95_mm"], 7.9, last_digit);
}

/// A simulated MR image warped by a known field along y.
TEST_F(Evaluate, KnownFieldOfBrainWeb) {
  const char* shared = std::getenv("MTLED_SHARED_DATA");
  const fs::path data = fs::path(shared ? shared : "") / "brainweb_known_field";
  if (!shared || !fs::exists(data / "field_yLPS_4mm.nii.gz")) GTEST_SKIP() << "MTLED_SHARED_DATA does not name a folder with brainweb_known_field";
  const Image along_y = read_image(data / "field_yLPS_4mm.nii.gz", "field");
  VectorImage field(along_y.grid);
  for (std::size_t v = 0; v < field.data.size(); ++v) field.data[v] = {0, along_y.data[v], 0};
  write_vector_image(file("field.nrrd"), field);
  const std::string original = (data / "t1_2mm.nii.gz").string(), warped = (data / "t1_warped_2mm.nii.gz").string();
  const Json right = report({"-f", warped, "-m", original, "-t", file("field.nrrd"), "--canny-lower", "3", "--canny-upper", "8"});
  EXPECT_FALSE(right["direction"]["reversed_fits_better"]) << right["direction"];
  EXPECT_GT(right["correlation"]["after"], 0.99);
  EXPECT_LT(right["correlation"]["before"], 0.8);
  EXPECT_GT(right["edges"]["after"]["within_two_voxels_all_edges"], 0.99);
  EXPECT_EQ(right["field"]["jacobian"]["folded_voxels"], 0);
  // With the images exchanged the field points the other way: wrong, and right when it is given as what it is.
  const Json wrong = report({"-f", original, "-m", warped, "-t", file("field.nrrd")});
  EXPECT_TRUE(wrong["direction"]["reversed_fits_better"]) << wrong["direction"];
  EXPECT_NE(said.find("wrong direction"), std::string::npos);
  EXPECT_GT(report({"-f", original, "-m", warped, "--inverse-transform", file("field.nrrd")})["correlation"]["after"], 0.99);
}

}  // namespace
}  // namespace mtled
