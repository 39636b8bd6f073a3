#include <nlohmann/json.hpp>

#include "imaging/warp.hpp"
#include "program.hpp"
#include "temporary_folder.hpp"
#include "torso.hpp"

namespace mtled {
namespace {

using program::Outcome;
using Strings = std::vector<std::string>;
using Json = nlohmann::json;

/// `mtled baseline` on the torso, coarsely; few evaluations are enough to see that everything fits together.
class BaselineCommand : public TemporaryFolder {
 protected:
  BaselineCommand() { torso::write_pair(file("pair"), torso::straight_grid()); }
  Outcome run(const Strings& arguments) const { return program::run(arguments, file("log")); }
  Outcome baseline(const std::string& method, const std::string& output, const Strings& more = {}) const {
    Strings arguments{"baseline", method, "-m", pair("moving"), "-f", pair("fixed"), "-o", file(output).string(), "--samples", "20000", "--evaluations", "30"};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return run(arguments);
  }
  std::string pair(const std::string& name) const { return (file("pair") / (name + ".nii.gz")).string(); }
  Json summary(const std::string& output) const { return Json::parse(program::content(file(output) / "summary.json")); }
  VectorImage field(const std::string& output, const char* name = "fixed_to_moving.nrrd") const { return read_vector_image(file(output) / name, "field"); }
};

const Strings common_files{"fixed_to_moving.h5", "fixed_to_moving.nrrd", "moving_to_fixed.nrrd", "overlay.png", "summary.json", "warped.nii.gz"};

/// y + v(y), then on by the other field, comes back to y: largest distance of points in the middle of the torso [mm].
double round_trip(const VectorImage& back, const VectorImage& on) {
  double largest = 0;
  for (const Vec3d& y : {Vec3d{0, 0, 0}, Vec3d{40, 10, 20}, Vec3d{-30, -20, -10}, Vec3d{10, 36, 16}}) {
    Vec3d v, u;
    EXPECT_TRUE(linear_value(back, y, v) && linear_value(on, y + v, u));
    largest = std::max(largest, norm(v + u));
  }
  return largest;
}

TEST_F(BaselineCommand, WritesWhatTheOtherVerbsRead) {
  for (const std::string method : {"rigid", "bspline"}) {
    const Outcome outcome = baseline(method, method, {"--mesh", "5", "5", "4"});
    ASSERT_EQ(outcome.code, 0) << outcome.err;
    Strings files = common_files;
    files.insert(files.begin() + 2, "fixed_to_moving.tfm");
    EXPECT_EQ(program::listing(file(method)), files);
    const Json report = summary(method);
    EXPECT_EQ(report["method"], method);
    EXPECT_EQ(report["settings"]["samples"][0], "20000");
    EXPECT_EQ(report["inputs"]["fixed"]["md5"].get<std::string>().size(), 32u);
    EXPECT_EQ(report["rigid"]["levels"].size(), 3u);
    EXPECT_EQ(report.contains("bspline"), method == "bspline");
    EXPECT_GT(report["rigid"]["levels"][0]["mutual_information_after"], report["rigid"]["levels"][0]["mutual_information_before"]);
    for (const char* key : {"min", "median", "folded_voxels"}) EXPECT_TRUE(report["jacobian"].contains(key)) << key;
    for (const char* key : {"reading", "rigid", "warp", "writing"}) EXPECT_GE(report["seconds"][key], 0) << key;
    // The inverse is exact to 0.01 mm at voxels; between voxels 4 mm apart both fields are linear.
    EXPECT_LT(round_trip(field(method), field(method, "moving_to_fixed.nrrd")), 0.3);
    const Image warped = read_image(file(method) / "warped.nii.gz", "warped"), again = warp_image(read_image(pair("moving"), "moving"), field(method), Interpolation::linear, -1000);
    for (std::size_t v = 0; v < warped.data.size(); ++v) ASSERT_EQ(warped.data[v], again.data[v]) << v;

    const Outcome evaluated = run({"evaluate", "-f", pair("fixed"), "-w", (file(method) / "warped.nii.gz").string(), "-o", file(method + "-check").string()});
    EXPECT_EQ(evaluated.code, 0) << evaluated.err;
    write_points(file("points.csv"), {{0, 0, 0}, {10, 36, 16}});
    const Outcome carried = run({"warp", "-r", file(method).string(), "--points", file("points.csv").string(), "-o", file(method + ".csv").string()});
    EXPECT_EQ(carried.code, 0) << carried.err;
  }
}

TEST_F(BaselineCommand, HasTheSameBitsForAnyNumberOfThreads) {
  ASSERT_EQ(baseline("bspline", "one", {"--threads", "1", "--levels", "2"}).code, 0);
  ASSERT_EQ(baseline("bspline", "two", {"--threads", "2", "--levels", "2"}).code, 0);
  for (const char* name : {"fixed_to_moving.tfm", "fixed_to_moving.nrrd"}) EXPECT_EQ(program::content(file("one") / name), program::content(file("two") / name)) << name;
}

TEST_F(BaselineCommand, RefinesMechanicsButNotItsRigidBodies) {
  const Outcome registered = run({"register", "-m", pair("moving"), "-f", pair("fixed"), "--moving-labels", pair("moving_labels"), "--motions", (file("pair") / "motions.json").string(),
                                  "--node-spacing", "10", "--no-evaluation", "-o", file("mechanics").string()});
  ASSERT_EQ(registered.code, 0) << registered.err;
  const Outcome refined = baseline("bspline", "refined", {"--start", file("mechanics").string(), "--mesh", "6", "6", "5"});
  ASSERT_EQ(refined.code, 0) << refined.err;
  EXPECT_EQ(program::listing(file("refined")), common_files);
  const VectorImage before = field("mechanics"), after = field("refined");
  const LabelImage labels = read_labels(file("mechanics") / "warped_labels.nii.gz", "labels");
  std::size_t bone = 0, changed = 0;
  for (std::size_t v = 0; v < labels.data.size(); ++v) {
    changed += before.data[v] != after.data[v];
    if (!labels.data[v]) continue;
    ASSERT_EQ(before.data[v], after.data[v]) << v;
    ++bone;
  }
  EXPECT_GT(bone, 500u);
  EXPECT_GT(changed, labels.data.size() / 2);
  const Json report = summary("refined");
  EXPECT_GE(report["bspline"]["reductions"], 0);
  EXPECT_LE(report["jacobian"]["folded_voxels"], report["jacobian_of_start"]["folded_voxels"]);
  EXPECT_FALSE(report.contains("rigid"));

  // The result of another pair of grids.
  torso::write_pair(file("other"), torso::oblique_grid());
  program::expect_refusal(run({"baseline", "bspline", "-m", pair("moving"), "-f", (file("other") / "fixed.nii.gz").string(), "--start", file("mechanics").string(), "-o", file("none").string()}), 3,
                          {"another grid", "--resample"});
  program::expect_refusal(baseline("rigid", "none", {"--start", file("mechanics").string()}), 2, {"--start", "bspline"});
  EXPECT_FALSE(std::filesystem::exists(file("none")));
}

TEST_F(BaselineCommand, RefusesWhatItCannotDo) {
  program::expect_refusal(baseline("affine", "none"), 2, {"affine", "rigid", "bspline"});
  program::expect_refusal(run({"baseline", "rigid", "-m", pair("moving"), "-o", file("none").string()}), 2, {"--fixed is missing"});
  program::expect_refusal(baseline("bspline", "none", {"--mesh", "0", "5", "5"}), 2, {"--mesh"});
  program::expect_refusal(baseline("rigid", "none", {"--bins", "5"}), 2, {"--bins"});
  program::expect_refusal(baseline("rigid", "none", {"--initial", "luck"}), 2, {"--initial", "moments"});
  program::expect_refusal(baseline("bspline", "none", {"--start", file("nowhere").string()}), 3, {"nowhere"});
  write_image(file("constant.nii.gz"), Image(torso::straight_grid(), 7));
  program::expect_refusal(run({"baseline", "rigid", "-m", file("constant.nii.gz").string(), "-f", pair("fixed"), "-o", file("none").string()}), 3, {"moving image", "is constant (7)"});
  Image far = torso::moving_image(torso::straight_grid());
  far.grid.origin.x += 2000;
  write_image(file("far.nii.gz"), far);
  program::expect_refusal(run({"baseline", "rigid", "-m", file("far.nii.gz").string(), "-f", pair("fixed"), "-o", file("none").string()}), 3, {"do not overlap in space"});
  EXPECT_FALSE(std::filesystem::exists(file("none")));
}

}  // namespace
}  // namespace mtled
