#include <cmath>
#include <limits>

#include "core/error.hpp"
#include "program.hpp"
#include "temporary_folder.hpp"
#include "torso.hpp"

namespace mtled {
namespace {

using program::expect_refusal;
using program::Outcome;
using Strings = std::vector<std::string>;
namespace fs = std::filesystem;

constexpr int usage = 2, input = 3, numerical = 4, device = 5, memory = 6, output = 7;

/// The pair that every test spoils in one way.
class Pair : public testing::Environment {
 public:
  void SetUp() override {
    std::string name = (fs::temp_directory_path() / "mtled-bad-input-XXXXXX").string();
    ASSERT_TRUE(mkdtemp(name.data()));
    folder = name;
    torso::write_pair(folder, torso::straight_grid());
  }
  void TearDown() override { fs::remove_all(folder); }
  fs::path folder;
};
Pair& pair_of_images = *static_cast<Pair*>(testing::AddGlobalTestEnvironment(new Pair));

class BadInput : public TemporaryFolder {
 protected:
  fs::path pair(const std::string& name) const { return pair_of_images.folder / name; }
  fs::path out() const { return file("out"); }
  Outcome run(const Strings& arguments) const { return program::run(arguments, pair_of_images.folder / "log"); }

  /// A registration with some options replaced ("" drops one) or added.
  Strings registration(const std::vector<std::pair<std::string, std::string>>& changes) const {
    std::vector<std::pair<std::string, std::string>> options{{"--moving", pair("moving.nii.gz")}, {"--fixed", pair("fixed.nii.gz")}, {"--moving-labels", pair("moving_labels.nii.gz")},
                                                             {"--motions", pair("motions.json")}, {"--node-spacing", "10"}, {"--output", out()}};
    for (const auto& change : changes) {
      const auto same = std::find_if(options.begin(), options.end(), [&](const auto& o) { return o.first == change.first; });
      if (same == options.end()) options.push_back(change);
      else same->second = change.second;
    }
    Strings arguments{"register", "--no-evaluation"};
    for (const auto& [name, value] : options)
      if (!value.empty()) arguments.push_back(name), arguments.push_back(value);
    return arguments;
  }
  /// Refused with this exit code and message, and nothing was written.
  void refused(const std::vector<std::pair<std::string, std::string>>& changes, int code, const Strings& parts) const {
    const Outcome outcome = run(registration(changes));
    expect_refusal(outcome, code, parts);
    EXPECT_FALSE(fs::exists(out())) << "an output folder was left";
    EXPECT_LE(std::count(outcome.err.begin(), outcome.err.end(), '\n'), 12) << outcome.err;
  }
};

TEST_F(BadInput, MissingFile) { refused({{"--moving", file("none.nii.gz")}}, input, {"moving image", "none.nii.gz", "no such file", "check the name"}); }

TEST_F(BadInput, TruncatedFile) {
  const std::string bytes = program::content(pair("moving.nii.gz"));
  refused({{"--moving", file("cut.nii.gz", bytes.substr(0, bytes.size() / 2))}}, input, {"moving image", "cut.nii.gz", "cut off"});
}

TEST_F(BadInput, NotAnImage) { refused({{"--fixed", file("text.nrrd", "hello")}}, input, {"fixed image", "text.nrrd"}); }

TEST_F(BadInput, FlatImage) {
  Grid grid = torso::straight_grid();
  file("flat.nhdr", "NRRD0004\ntype: float\ndimension: 2\nsizes: 4 4\nencoding: ascii\ndata file: flat.txt\n");
  file("flat.txt", "0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0\n");
  refused({{"--moving", file("flat.nhdr")}}, input, {"3-D", "4 x 4"});
  grid.size[2] = 1;
  write_image(file("slice.nii.gz"), torso::moving_image(grid));
  EXPECT_EQ(run(registration({{"--moving", file("slice.nii.gz")}, {"--motions", ""}})).code, input);
}

TEST_F(BadInput, EmptyLabels) {
  write_labels(file("empty.nii.gz"), LabelImage(torso::straight_grid()));
  refused({{"--moving-labels", file("empty.nii.gz")}}, input, {"moving labels", "empty.nii.gz", "every voxel is 0", "mark"});
  refused({{"--fixed-labels", file("empty.nii.gz")}}, input, {"fixed labels"});
}

TEST_F(BadInput, LabelsThatAreNoWholeNumbers) { refused({{"--moving-labels", pair("moving.nii.gz")}}, input, {"labels must be whole numbers"}); }

TEST_F(BadInput, LabelsOnAnotherGridAreResampledIfTheyOverlap) {
  write_labels(file("oblique.nii.gz"), torso::moving_labels(torso::oblique_grid()));
  EXPECT_EQ(run(registration({{"--moving-labels", file("oblique.nii.gz")}})).code, 0);
  fs::remove_all(out());
  Grid away = torso::straight_grid();
  away.origin.x += 1000;
  write_labels(file("away.nii.gz"), torso::on_grid<std::uint16_t>(away, [](const Vec3d& x) { return torso::label_at(x - Vec3d{1000, 0, 0}); }));
  refused({{"--moving-labels", file("away.nii.gz")}}, input, {"moving labels", "do not overlap"});
}

TEST_F(BadInput, MaskOnAnotherGridIsResampledIfItOverlaps) {
  const auto in_body = [](const Vec3d& x) { return torso::intensity(x) > -500; };
  write_mask(file("oblique.nii.gz"), torso::on_grid<std::uint8_t>(torso::oblique_grid(), in_body));
  EXPECT_EQ(run(registration({{"--moving-mask", file("oblique.nii.gz")}})).code, 0);
  fs::remove_all(out());
  write_mask(file("empty.nii.gz"), Mask(torso::straight_grid()));
  refused({{"--moving-mask", file("empty.nii.gz")}}, input, {"moving mask", "every voxel is 0"});
}

TEST_F(BadInput, APartOfTheMaskThatFloats) {
  Mask mask = torso::on_grid<std::uint8_t>(torso::straight_grid(), [](const Vec3d& x) { return torso::intensity(x) > -500; });
  for (int k = 0; k < 8; ++k)
    for (int j = 0; j < 8; ++j)
      for (int i = 0; i < 8; ++i) {
        ASSERT_EQ(mask.at(i, j, k), 0) << "the corner is air";
        mask.at(i, j, k) = 1;
      }
  write_mask(file("island.nii.gz"), mask);
  refused({{"--moving-mask", file("island.nii.gz")}}, input, {"a part of", "integration points", "float away", "mask"});
}

TEST_F(BadInput, ImagesThatDoNotOverlap) {
  Image away = torso::fixed_image(torso::straight_grid());
  away.grid.origin.z += 500;
  write_image(file("away.nii.gz"), away);
  refused({{"--fixed", file("away.nii.gz")}}, input, {"do not overlap in space", "headers"});
}

TEST_F(BadInput, NotANumberAmongTheVoxels) {
  Image image = torso::moving_image(torso::straight_grid());
  image.at(3, 2, 1) = std::numeric_limits<float>::quiet_NaN();
  for (const char* name : {"nan.nii.gz", "nan.nii", "nan.nrrd", "nan.mha"}) {
    write_image(file(name), image);
    refused({{"--moving", file(name)}}, input, {"1 voxel is NaN", "(3, 2, 1)"});
    fs::remove(file(name));
  }
}

TEST_F(BadInput, ConstantImage) {
  write_image(file("constant.nii.gz"), Image(torso::straight_grid(), 7));
  refused({{"--moving", file("constant.nii.gz")}}, input, {"constant", "7"});
  refused({{"--fixed", file("constant.nii.gz")}}, input, {"constant", "7"});
  expect_refusal(run({"classify", "-i", file("constant.nii.gz"), "-o", out()}), input, {"image"});
  EXPECT_FALSE(fs::exists(out()));
}

TEST_F(BadInput, NumbersOutOfRangeAreUsageErrors) {
  for (const auto& [option, value] : {std::pair{"--node-spacing", "0"}, {"--node-spacing", "-3.5"}, {"--node-spacing", "nan"}, {"--node-spacing", "wide"}, {"--threads", "0"}, {"--threads", "-1"},
                                      {"--threads", "many"}, {"--poisson-ratio", "0.5"}, {"--poisson-ratio", "-0.1"}, {"--tolerance", "0"}, {"--tolerance", "inf"}, {"--max-steps", "0"},
                                      {"--classes", "1"}, {"--fuzziness", "1"}, {"--dilatation", "9"}, {"--canny-sigma", "-1"}, {"--interpolation", "best"}, {"--basis", "cubic"}, {"--device", "gpu"}})
    refused({{option, value}}, usage, {option});
  Strings arguments = registration({});
  for (const char* more : {"--resample", "1", "1", "0"}) arguments.push_back(more);
  expect_refusal(run(arguments), usage, {"--resample", "above 0"});
}

TEST_F(BadInput, MoreThreadsThanProcessorsIsSaid) {
  const Outcome outcome = run(registration({{"--threads", "100000"}}));
  EXPECT_EQ(outcome.code, 0);
  EXPECT_NE(outcome.err.find("there are only"), std::string::npos) << outcome.err;
}

TEST_F(BadInput, CommandLineMistakes) {
  expect_refusal(run({}), usage, {"subcommand"});
  expect_refusal(run({"conjure"}), usage, {"'conjure'", "register", "solve"});
  expect_refusal(run({"register", "--colour", "red"}), usage, {"--colour"});
  refused({{"--moving", ""}}, usage, {"--moving is missing", "--help"});
  refused({{"--moving-labels", ""}}, usage, {"--moving-labels is missing"});
  refused({{"--device", "cuda:9999"}}, device, {"--device", "cpu"});
  expect_refusal(run({"warp", "-r", file(""), "-o", file("x.csv")}), usage, {"exactly one of"});
  expect_refusal(run({"evaluate", "-f", "a.nii", "-w", "b.nii", "-o", out(), "--fixed-labels", "c.nii"}), usage, {"--warped-labels is missing"});
}

TEST_F(BadInput, ConfigMistakes) {
  refused({{"--config", file("a.toml", "node-distance = 4\n")}}, input, {"node-distance", "not a known setting", "line 1", "node-spacing"});
  refused({{"--config", file("b.toml", "tolerance = -1\n")}}, input, {"b.toml", "tolerance", "above 0"});
  refused({{"--config", file("c.toml", "tolerance = = 1\n")}}, input, {"c.toml", "line 1"});
  refused({{"--config", file("d.toml", "[solver]\ntolerance = 1\n")}}, input, {"solver"});
  refused({{"--config", file("none.toml")}}, input, {"none.toml"});
}

TEST_F(BadInput, TooFewNodes) { refused({{"--node-spacing", "60"}}, input, {"nodes", "60 mm", "smaller spacing"}); }

TEST_F(BadInput, TooMuchMemoryIsSaidBeforeTheWork) {
  refused({{"--node-spacing", "0.02"}, {"--motions", ""}}, memory, {"GB", "free", "--node-spacing"});
  EXPECT_EQ(run(registration({{"--node-spacing", "0.02"}, {"--motions", ""}})).err.find("registering rigid bodies"), std::string::npos);
}

TEST_F(BadInput, MotionsThatDoNotFit) {
  std::vector<LabelMotion> motions = torso::motions();
  motions[1].motion.translation.z += 32;  // label 2 goes where label 3 is
  write_motions(file("overlap.json"), motions);
  refused({{"--motions", file("overlap.json")}}, input, {"label 2", "label 3", "two rigid bodies"});
  motions = torso::motions();
  motions[0].label = 9;
  write_motions(file("unknown.json"), motions);
  refused({{"--motions", file("unknown.json")}}, input, {"label 9", "no voxel"});
  write_motions(file("none.json"), {});
  refused({{"--motions", file("none.json")}}, input, {"nothing moves the body"});
  refused({{"--motions", file("text.json", "{")}}, input, {"not valid JSON"});
}

TEST_F(BadInput, MotionsThatTearTheBodyAreANumericalFailure) {
  std::vector<LabelMotion> motions = torso::motions();
  motions[0].motion.translation = {0, -90, 60};  // through lungs and other bones' surroundings
  motions[3].motion.translation = {0, -90, -60};
  write_motions(file("torn.json"), motions);
  const Outcome outcome = run(registration({{"--motions", file("torn.json")}, {"--max-steps", "2000"}}));
  expect_refusal(outcome, numerical, {"inside out", "check the motions"});
  EXPECT_FALSE(fs::exists(out()));
}

TEST_F(BadInput, NoConvergence) { refused({{"--max-steps", "3"}}, numerical, {"no convergence within 3 steps", "--max-steps"}); }

TEST_F(BadInput, LabelsOutsideTheBodyAreSaid) {
  LabelImage labels = torso::moving_labels(torso::straight_grid());
  for (int k = 10; k < 14; ++k)
    for (int j = 1; j < 5; ++j)
      for (int i = 1; i < 5; ++i) labels.at(i, j, k) = 5;
  write_labels(file("labels.nii.gz"), labels);
  const Outcome outcome = run(registration({{"--moving-labels", file("labels.nii.gz")}}));
  EXPECT_EQ(outcome.code, 0) << outcome.err;
  EXPECT_NE(outcome.err.find("label 5 lies outside the body"), std::string::npos) << outcome.err;
}

TEST_F(BadInput, OtherTablesAndImages) {
  refused({{"--landmarks", file("l.csv", "mx,my,mz,fx,fy\n1,2,3,4,5\n")}}, input, {"l.csv", "no column 'fz'"});
  refused({{"--landmarks", file("l2.csv", "mx,my,mz,fx,fy,fz\n")}}, input, {"l2.csv", "no landmarks"});
  refused({{"--points", file("p.csv", "x,y,z\n1,2,here\n")}}, input, {"p.csv, line 2", "'z'", "here"});
  refused({{"--tissue-table", file("t.csv", "name,shear_modulus_kpa\nfat,1\n")}}, input, {"8 tissue classes", "1 rows"});
  refused({{"--tissue-table", file("t2.csv", "name,shear_modulus_kpa\nfat,-1\n")}}, input, {"t2.csv, line 2", "positive"});
  for (const char* ratio : {"0.5", "-0.1"}) refused({{"--tissue-table", file("t3.csv", concatenate("name,shear_modulus_kpa,poisson_ratio\nfat,1,", ratio, '\n'))}}, input, {"t3.csv, line 2", concatenate("poisson_ratio is ", ratio), "below 0.5"});
  for (const char* ratio : {"nan", "", "soft"}) refused({{"--tissue-table", file("t3.csv", concatenate("name,shear_modulus_kpa,poisson_ratio\nfat,1,", ratio, '\n'))}}, input, {"t3.csv, line 2", "poisson_ratio"});
  write_image(file("mu.nii.gz"), Image(torso::straight_grid(), -1));
  refused({{"--shear-modulus", file("mu.nii.gz")}}, input, {"shear modulus image", "negative"});
  write_image(file("zero.nii.gz"), Image(torso::straight_grid()));
  refused({{"--shear-modulus", file("zero.nii.gz")}}, input, {"shear modulus is not positive"});
}

TEST_F(BadInput, OutputFolderThatCannotBeUsed) {
  const Outcome below_file = run(registration({{"--output", file("taken", "x") / "sub"}}));
  expect_refusal(below_file, output, {"cannot create the output folder"});
  fs::create_directory(out());
  file("out/precious.txt", "x");
  expect_refusal(run(registration({})), output, {"not empty", "--force"});
  EXPECT_EQ(program::listing(out()), Strings{"precious.txt"});
  Strings forced = registration({});
  forced.push_back("--force");
  EXPECT_EQ(run(forced).code, 0);
  EXPECT_TRUE(fs::exists(out() / "precious.txt"));
  if (::geteuid() == 0) return;  // may write anywhere
  fs::create_directory(file("locked"));
  fs::permissions(file("locked"), fs::perms::owner_read | fs::perms::owner_exec);
  expect_refusal(run(registration({{"--output", file("locked") / "sub"}})), output, {"cannot create the output folder"});
}

TEST_F(BadInput, OldResultsSurviveAFailure) {
  ASSERT_EQ(run(registration({})).code, 0);
  const std::string before = program::content(out() / "manifest.json");
  Strings again = registration({{"--max-steps", "3"}});
  again.push_back("--force");
  EXPECT_EQ(run(again).code, numerical);
  EXPECT_EQ(program::content(out() / "manifest.json"), before);
}

TEST_F(BadInput, WarpAndEvaluateRefuseWhatDoesNotFit) {
  ASSERT_EQ(run(registration({})).code, 0);
  const std::string image = pair("moving.nii.gz"), x = file("x.nii.gz");
  expect_refusal(run({"warp", "-r", file("none"), "-i", image, "-o", x}), input, {"displacement field", "no such file"});
  expect_refusal(run({"warp", "-r", out(), "-i", image, "-o", file("x.jpg")}), output, {"format is not supported", ".nii.gz"});
  expect_refusal(run({"warp", "-r", out(), "-i", image, "-o", file("none") / "x.nii.gz"}), output, {"there is no folder"});
  expect_refusal(run({"warp", "-r", out(), "-i", image, "-o", file("taken.nii.gz", "x")}), output, {"exists", "--force"});
  expect_refusal(run({"warp", "-r", out(), "--points", file("p.csv", "x,y,z\n0,0,999\n"), "-o", file("q.csv")}), input, {"1 of 1 points", "outside the moving image"});
  Image away = torso::moving_image(torso::straight_grid());
  away.grid.origin.x += 1000;
  write_image(file("away.nii.gz"), away);
  expect_refusal(run({"warp", "-r", out(), "-i", file("away.nii.gz"), "-o", x}), input, {"do not overlap", "--direction"});
  write_image(file("flipped.nii.gz"), torso::fixed_image(torso::flipped_grid()));
  expect_refusal(run({"evaluate", "-f", file("flipped.nii.gz"), "-w", out() / "warped.nii.gz", "-o", file("e")}), input, {"another grid"});
  EXPECT_FALSE(fs::exists(x));
  EXPECT_FALSE(fs::exists(file("q.csv")));
  EXPECT_FALSE(fs::exists(file("e")));
}

TEST_F(BadInput, InterruptedRunLeavesNothing) {
  for (const int signal : {SIGINT, SIGTERM}) {
    program::Run run(registration({{"--node-spacing", "4"}, {"--tolerance", "1e-9"}, {"--relaxation", "plain"}}), pair_of_images.folder / "log");
    EXPECT_TRUE(run.wait_for("solving"));
    EXPECT_TRUE(fs::exists(out())) << "it is there during the work";
    ::usleep(300000);
    run.interrupt(signal);
    EXPECT_EQ(run.finish().code, 128 + signal);
    EXPECT_FALSE(fs::exists(out())) << program::listing(out()).size();
  }
}

}  // namespace
}  // namespace mtled
