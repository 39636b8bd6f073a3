#include <array>
#include <cmath>
#include <cstdlib>
#include <nlohmann/json.hpp>

#include "image_io/image_io.hpp"
#include "imaging/field_quality.hpp"
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

Strings operator+(Strings a, const Strings& b) {
  a.insert(a.end(), b.begin(), b.end());
  return a;
}

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
    for (const char* key : {"hausdorff_95_mm", "hausdorff_95_pooled_mm", "hausdorff_95_learn2reg_mm", "average_surface_distance_mm"}) EXPECT_EQ(l[key], 0);
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

TEST_F(Evaluate, DirectionsAreNotComparedInAMaskBetweenTheVoxelsOfAThinnedImage) {
  grid.size = {100, 80, 68}, grid.spacing = {1, 1, 1};
  write_image(file("moving.nrrd"), picture({0, 0, 0}));
  write_image(file("fixed.nrrd"), picture(shift));
  Mask mask(grid);  // every voxel has an odd index
  for (const auto& [i, j, k] : {std::array{51, 41, 35}, std::array{52, 41, 35}, std::array{51, 42, 35}, std::array{51, 41, 36}}) mask.at(i, j, k) = 1;
  write_mask(file("mask.nrrd"), mask);
  const Json direction = report(with_moving({"-t", file("right.tfm"), "--mask", file("mask.nrrd")}))["direction"];
  EXPECT_EQ(direction, (Json{{"reversed_fits_better", false}}));
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

TEST_F(Evaluate, TheDifferenceFromAReferenceTransform) {
  const double difference = 2 * norm(shift);
  const auto check = [&](const Json& r, std::size_t points) {
    const Json& d = r["field_difference"];
    EXPECT_EQ(d["points"], points);
    EXPECT_EQ(d["unknown_points"], 0);
    for (const char* key : {"mean_mm", "root_mean_square_mm", "median_mm", "percentile_95_mm", "percentile_99_5_mm", "max_mm"}) EXPECT_NEAR(d[key], difference, 1e-5) << key;
    for (const Json& value : d["difference_1_to_100_mm"]) EXPECT_NEAR(value, difference, 1e-5);
    EXPECT_EQ(d["within_half_mm"], 0);
  };
  check(report(with_moving({"-t", file("right.tfm"), "--reference-transform", file("wrong.tfm")})), grid.count());
  EXPECT_EQ(program::listing(file("out")), (Strings{"edges.csv", "evaluation.json", "field_difference.csv", "field_difference.png", "report.html"}));
  const std::string table = program::content(file("out/field_difference.csv"));
  EXPECT_EQ(table.substr(0, 30), "percent,difference_mm\n1,8.9442");
  EXPECT_EQ(std::count(table.begin(), table.end(), '\n'), 101);
  EXPECT_NE(printed.find("difference from the reference: median 8.944"), std::string::npos) << printed;
  const Json figures = program::report_data(file("out/report.html"))["figures"];
  ASSERT_EQ(figures.size(), 1u);
  EXPECT_EQ(figures[0]["picture"].get<std::string>().substr(0, 22), "data:image/png;base64,");
  check(report(with_moving({"--inverse-transform", file("wrong.tfm"), "--reference-inverse-transform", file("right.tfm")})), grid.count());
  Mask half(grid);
  fill(half, [](const Vec3d& y) { return std::uint8_t(y.x > 0); });
  write_mask(file("half.nrrd"), half);
  const std::size_t columns = std::size_t(std::count(half.data.begin(), half.data.begin() + grid.size[0], 1)), rows = std::size_t(grid.size[1]), slices = std::size_t(grid.size[2]);
  check(report(with_moving({"-t", file("right.tfm"), "--reference-transform", file("wrong.tfm"), "--mask", file("half.nrrd")})), columns * rows * slices);
  // The reference leads two columns further, of which as many lie in the mask, and one slice down, so that the lowest slice leaves the image.
  check(report(with_moving({"--inverse-transform", file("wrong.tfm"), "--reference-inverse-transform", file("right.tfm"), "--mask", file("half.nrrd")})), columns * rows * (slices - 1));
}

TEST_F(Evaluate, TheDifferenceFromReferencePoints) {
  VectorImage back(grid);
  for (Vec3f& v : back.data) v = {float(-shift.x), float(-shift.y), float(-shift.z)};
  write_vector_image(file("back.nrrd"), back);
  const Strings known = with_moving({"--inverse-transform", file("back.nrrd")});
  const auto with_points = [&](const std::string& rows) {
    Strings arguments = known;
    arguments.insert(arguments.end(), {"--reference-points", file("reference.csv", "x,y,z,ux,uy,uz\n" + rows)});
    return arguments;
  };
  const Json d = report(with_points("0,0,0,-4,0,2\n5,5,5,-4,3,6\n-20,3,1,-1,0,-2\n900,0,0,0,0,0\n"))["field_difference"];  // 0, 5 and 5 mm off, and outside
  EXPECT_EQ(d["points"], 3);
  EXPECT_EQ(d["unknown_points"], 1);
  EXPECT_NEAR(d["mean_mm"], 10.0 / 3, 1e-5);
  EXPECT_NEAR(d["median_mm"], 5, 1e-5);
  EXPECT_NEAR(d["within_half_mm"], 1.0 / 3, 1e-12);
  EXPECT_NEAR(d["by_displacement"][0]["from_mm"], std::sqrt(5.0), 1e-6);
  EXPECT_NE(said.find("not known at 1 of 4 points of the moving image"), std::string::npos) << said;
  EXPECT_NE(program::content(file("out/field_difference.png")).find("PNG"), std::string::npos);
  expect_refusal(run(with_points("900,0,0,0,0,0\n")), input, {"reference.csv", "none of the 1 points", "LPS"});
  expect_refusal(run(with_moving({"-t", file("right.tfm"), "--reference-points", file("reference.csv")})), usage, {"--inverse-transform is missing"});
  expect_refusal(run({"--inverse-transform", file("back.nrrd"), "--reference-points", file("reference.csv")}), usage, {"--moving is missing"});
  expect_refusal(run(with_moving({"-r", "x", "--reference-points", file("reference.csv"), "--reference-transform", file("right.tfm")})), usage, {"--reference-"});
  file("settings.toml", "reference-points = 'reference.csv'\n");
  expect_refusal(run(with_moving({"-r", "x", "--config", file("settings.toml"), "--reference-transform", file("right.tfm")})), usage, {"exclude each other", "2 of them", "--config"});
}

TEST_F(Evaluate, ContoursOfLabels) {
  Strings arguments = everything("-t", file("right.tfm"));
  arguments.insert(arguments.end(), {"--contour", "ball=1", "--contour", "ghost=9"});
  const Json contours = report(arguments)["contours"];
  for (const char* direction : {"from_fixed", "to_fixed"}) {
    const Json &after = contours["ball"]["after"][direction], &before = contours["ball"]["before"][direction];
    EXPECT_GT(after["voxels"], 200);
    EXPECT_EQ(after["max_mm"], 0);
    EXPECT_GT(before["mean_mm"], 1);
    EXPECT_LE(before["percentile_95_mm"], before["max_mm"]);
    EXPECT_EQ(contours["ghost"]["after"][direction]["voxels"], 0);
    EXPECT_TRUE(contours["ghost"]["after"][direction]["mean_mm"].is_null());
  }
  // The balls lie one slice apart before: the first slice of one and the last of the other have no counterpart.
  EXPECT_GT(contours["ball"]["before"]["from_fixed"]["unmatched_voxels"], 0);
  EXPECT_NE(said.find("contour 'ghost': label 9 has no contour in the fixed labels"), std::string::npos) << said;
  EXPECT_NE(said.find("contour 'ghost': label 9 has no contour in the warped labels"), std::string::npos) << said;
  const std::string table = program::content(file("out/contours.csv"));
  EXPECT_EQ(std::count(table.begin(), table.end(), '\n'), 1 + 2 * 2 * 2);
  EXPECT_NE(table.find("ghost,after,to_fixed,0,0,,,,\n"), std::string::npos) << table;
  EXPECT_NE(printed.find("ball             after         0.00"), std::string::npos) << printed;
  for (const char* wrong : {"ball", "ball=", "=1", "ball=0", "ball=1x", "ball=70000", "a,b=1"}) expect_refusal(run(everything("-t", file("right.tfm")) + Strings{"--contour", wrong}), usage, {std::string("--contour ") + wrong});
  expect_refusal(run(everything("-t", file("right.tfm")) + Strings{"--contour", "ball=1", "--contour", "ball=2"}), usage, {"twice"});
  expect_refusal(run(with_moving({"-t", file("right.tfm"), "--contour", "ball=1"})), usage, {"--fixed-labels is missing"});
}

TEST_F(Evaluate, ContoursOfLabelsAsTheyLie) {
  const Json contours = report(with_moving({"--fixed-labels", file("fixed_labels.nrrd"), "--moving-labels", file("moving_labels.nrrd"), "--contour", "ball=1"}))["contours"];
  EXPECT_GT(contours["ball"]["before"]["from_fixed"]["mean_mm"], 1);
  EXPECT_FALSE(contours["ball"].contains("after"));
  expect_refusal(run(with_moving({"--fixed-labels", file("fixed_labels.nrrd"), "--contour", "ball=1"})), usage, {"--warped-labels is missing"});
}

TEST_F(Evaluate, ContoursOfTheLungs) {
  const auto trunk = [&](const Vec3d& by) {
    Grid coarse;
    coarse.size = {96, 68, 20}, coarse.spacing = {3, 3, 4}, coarse.origin = {-142.5, -100.5, -38};
    Image ct(coarse);
    fill(ct, [&](const Vec3d& y) {
      const Vec3d x = y + by;
      const bool body = std::hypot(x.x / 120, x.y / 85) < 1, lung = std::hypot((std::abs(x.x) - 55) / 40, x.y / 55) < 1;
      return float(!body ? -1000 : lung ? -850 : 30);
    });
    return ct;
  };
  write_image(file("trunk_moving.nrrd"), trunk({0, 0, 0})), write_image(file("trunk_fixed.nrrd"), trunk({6, 0, 0}));
  file("across.tfm", transform({6, 0, 0}));
  const Json lungs = report({"-f", file("trunk_fixed.nrrd"), "-m", file("trunk_moving.nrrd"), "-t", file("across.tfm"), "--contour", "lungs"})["contours"]["lungs"];
  for (const char* direction : {"from_fixed", "to_fixed"}) {
    EXPECT_GT(lungs["after"][direction]["voxels"], 2000);
    EXPECT_EQ(lungs["after"][direction]["max_mm"], 0);
    EXPECT_NEAR(lungs["before"][direction]["max_mm"], 6, 1e-9) << "at the outermost voxels, which lie on the shift's line";
    EXPECT_GT(lungs["before"][direction]["mean_mm"], 2);
  }
  EXPECT_TRUE(report(with_moving({"-t", file("right.tfm"), "--contour", "lungs"}))["contours"]["lungs"]["after"]["from_fixed"]["max_mm"].is_null());
  EXPECT_NE(said.find("no air was found inside the body of the fixed image"), std::string::npos) << said;
  Image nothing(grid, -1000);
  write_image(file("air.nrrd"), nothing);
  expect_refusal(run({"-w", file("fixed.nrrd"), "-f", file("air.nrrd"), "--contour", "lungs"}), input, {"contour of the lungs in the fixed image", "NAME=LABEL", "no body was found"});
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
  EXPECT_NE(program::content(file("out/labels.csv")).find("2,after,0,,,,\n"), std::string::npos);
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

  report({"-w", file("fixed.nrrd"), "-t", file("right.tfm"), "--landmarks", file("landmarks.csv")});
  EXPECT_EQ(program::ids_of(program::report_data(file("out/report.html"))["candidates"]), (Strings{"before", "after"})) << "the judged one is last, though edges are known of it alone";

  report({"-w", file("fixed.nrrd")});
  const Json little = program::report_data(file("out/report.html"));
  EXPECT_EQ(program::ids_of(little["candidates"]), (Strings{"after"}));
  EXPECT_EQ(program::ids_of(little["view"]["volumes"]), (Strings{"fixed", "after", "edges"}));
  EXPECT_FALSE(little.contains("landmarks"));
}

TEST_F(Evaluate, RegistrationsBesideEachOther) {
  Strings arguments = everything("-t", file("right.tfm"));
  arguments.insert(arguments.end(), {"--beside", "the wrong way=" + file("wrong.tfm").string(), "--beside", "again=" + file("right.tfm").string(), "--contour", "sphere=1"});
  const Json r = report(arguments);
  const Strings in_order{"before", "the wrong way", "again", "after"};
  EXPECT_EQ(r["edges"]["again"], r["edges"]["after"]);
  EXPECT_EQ(r["labels"]["again"], r["labels"]["after"]);
  EXPECT_EQ(r["landmarks"]["again"], r["landmarks"]["after"]);
  EXPECT_EQ(r["contours"]["sphere"]["again"], r["contours"]["sphere"]["after"]);
  EXPECT_EQ(r["beside"]["again"]["jacobian"], r["field"]["jacobian"]);
  EXPECT_EQ(r["beside"]["again"]["rigidity"], r["rigidity"]);
  EXPECT_NEAR(r["landmarks"]["the wrong way"]["max_mm"], 2 * norm(shift), 1e-9);
  EXPECT_GT(r["edges"]["the wrong way"]["hausdorff_all_edges_mm"][3], r["edges"]["before"]["hausdorff_all_edges_mm"][3].get<double>());
  const Json shown = program::report_data(file("out/report.html"));
  EXPECT_EQ(program::ids_of(shown["candidates"]), in_order);
  EXPECT_EQ(program::ids_of(shown["view"]["volumes"]), (Strings{"fixed", "before", "the wrong way", "again", "after", "displacement", "jacobian", "edges"}));
  EXPECT_EQ(program::content(file("out/landmarks.csv")).substr(0, 69), "row,fx,fy,fz,mx,my,mz,before_mm,the wrong way_mm,again_mm,after_mm\n1,");
  expect_refusal(run(with_moving({"--beside", "a=" + file("right.tfm").string()})), usage, {"--transform is missing"});
  file("far.tfm", transform({1000, 0, 0}));
  expect_refusal(run(with_moving({"-t", file("right.tfm"), "--beside", "a=" + file("far.tfm").string()})), input, {"--beside a", "far.tfm", "no common voxel"});
  expect_refusal(run(with_moving({"-t", file("right.tfm"), "--beside", "edges=" + file("right.tfm").string()})), usage, {"'edges'", "choose another"});
  expect_refusal(run(with_moving({"-t", file("right.tfm"), "--beside", file("right.tfm")})), usage, {"--beside", "NAME=FILE"});
  expect_refusal(run(with_moving({"-t", file("right.tfm"), "--beside", "after=" + file("right.tfm").string()})), usage, {"'after'", "choose another"});
  expect_refusal(run(with_moving({"-t", file("right.tfm"), "--beside", "a=" + file("right.tfm").string(), "--beside", "a=" + file("right.tfm").string()})), usage, {"'a'", "twice"});
  expect_refusal(run(with_moving({"-t", file("right.tfm"), "--beside", "a=nowhere.nrrd"})), input, {"nowhere.nrrd"});
  expect_refusal(run({"-w", file("fixed.nrrd"), "--beside", "a=" + file("right.tfm").string()}), usage, {"--moving is missing"});
}

TEST_F(Evaluate, RegistrationsBesideEachOtherOfASettingsFile) {
  fs::create_directory(file("settings"));
  file("settings/beside.toml", "beside = ['again=../right.tfm', 'the wrong way=" + file("wrong.tfm").string() + "']\nno-report = true\n");
  const Json r = report(with_moving({"-t", file("right.tfm"), "--config", file("settings/beside.toml")}));
  EXPECT_EQ(r["edges"]["again"], r["edges"]["after"]);
  EXPECT_TRUE(r["edges"].contains("the wrong way"));
  file("settings/wrong.toml", "beside = 'again='\n");
  expect_refusal(run(with_moving({"-t", file("right.tfm"), "--config", file("settings/wrong.toml")})), usage, {"--beside again=", "NAME=FILE"});
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
  constexpr double least_correlation = 0.99, most_correlation_before = 0.8;  // 0.9979 (0.9977 by the inverse) and 0.743 were measured
  constexpr double least_edges = 0.99, most_edges_before = 0.9;              // within two voxels; 0.9988 and 0.888 were measured
  const char* shared = std::getenv("MTLED_SHARED_DATA");
  const fs::path data = fs::path(shared ? shared : "") / "brainweb_known_field";
  if (!shared || !fs::exists(data / "field_yLPS_4mm.nii.gz")) GTEST_SKIP() << "MTLED_SHARED_DATA does not name a folder with brainweb_known_field";
  const Image along_y = read_image(data / "field_yLPS_4mm.nii.gz", "field");
  VectorImage field(along_y.grid);
  for (std::size_t v = 0; v < field.data.size(); ++v) field.data[v] = {0, along_y.data[v], 0};
  write_vector_image(file("field.nrrd"), field);
  const std::string original = (data / "t1_2mm.nii.gz").string(), warped = (data / "t1_warped_2mm.nii.gz").string();
  const Json right = report({"-f", warped, "-m", original, "-t", file("field.nrrd"), "--reference-transform", file("field.nrrd"), "--canny-lower", "3", "--canny-upper", "8"});
  EXPECT_FALSE(right["direction"]["reversed_fits_better"]) << right["direction"];
  EXPECT_GT(right["correlation"]["after"], least_correlation);
  EXPECT_LT(right["correlation"]["before"], most_correlation_before);
  EXPECT_GT(right["edges"]["after"]["within_two_voxels_all_edges"], least_edges);
  EXPECT_EQ(right["field"]["jacobian"]["folded_voxels"], 0);
  EXPECT_LT(right["edges"]["before"]["within_two_voxels_all_edges"], most_edges_before);
  EXPECT_EQ(right["field_difference"]["max_mm"], 0);
  // With the images exchanged the field points the other way: wrong, and right when it is given as what it is.
  const Json wrong = report({"-f", original, "-m", warped, "-t", file("field.nrrd")});
  EXPECT_TRUE(wrong["direction"]["reversed_fits_better"]) << wrong["direction"];
  EXPECT_NE(said.find("wrong direction"), std::string::npos);
  EXPECT_GT(report({"-f", original, "-m", warped, "--inverse-transform", file("field.nrrd")})["correlation"]["after"], least_correlation);
  // The same of the inverse field and the images as they are.
  const DenseField inverse = inverted(read_transform(file("field.nrrd"), "field"), field.grid, field.grid);
  write_vector_image(file("inverse.nrrd"), inverse.displacement);
  EXPECT_TRUE(report({"-f", warped, "-m", original, "-t", file("inverse.nrrd")})["direction"]["reversed_fits_better"]);
  EXPECT_NE(said.find("wrong direction"), std::string::npos);
}

}  // namespace
}  // namespace mtled
