#include "imaging/bone_motion.hpp"

#include <gtest/gtest.h>

#include <cmath>

#include "core/error.hpp"
#include "core/parallel.hpp"

namespace mtled {
namespace {

constexpr double degree = 0.017453292519943295;
constexpr double shift_tolerance_mm = 0.2,
                 turn_tolerance_deg = 0.2;  ///< a tenth of a voxel; the turn moves a tip as far

struct Blob {
  Vec3d center;      ///< [mm]
  double sigma = 0;  ///< [mm]
  double height = 0;
};

/// A vertebra of blobs: body, spinous process and two transverse processes of a length of their own.
std::vector<Blob> vertebra(int level) {
  const double z = 28.0 * level - 42, left = 14 + 3 * (level % 3), right = 20 - 2 * (level % 2), lean = 2.0 * level;
  return {{{-7, lean, z - 4}, 5, 400},     {{7, lean, z - 3}, 5, 420},          {{0, lean - 6, z + 4}, 5, 380},
          {{0, lean + 22, z - 6}, 4, 500}, {{-left, lean + 12, z + 2}, 4, 450}, {{right, lean + 12, z}, 4, 450}};
}

/// Four vertebrae in a soft body; `motions` move each vertebra, the body follows the second one.
struct Phantom {
  std::vector<RigidMotion> motions = std::vector<RigidMotion>(4);

  double vertebra_intensity(int level, const Vec3d& y) const {
    double sum = 0;
    for (const Blob& blob : vertebra(level))
      sum +=
          blob.height * std::exp(-squared_norm(y - motions[level].apply(blob.center)) / (2 * blob.sigma * blob.sigma));
    return sum;
  }
  double intensity(const Vec3d& y) const {
    const Vec3d x = inverse(motions[1]).apply(y);
    const double radius = std::hypot(x.x / 50, (x.y - 8) / 40, x.z / 400);
    double sum = -1000 + 1040 / (1 + std::exp((radius - 1) * 20));
    for (int level = 0; level < 4; ++level) sum += vertebra_intensity(level, y);
    return sum;
  }
  int label(const Vec3d& y) const {
    for (int level = 0; level < 4; ++level)
      if (vertebra_intensity(level, y) > 120) return level + 1;
    return 0;
  }
};

struct Pair {
  Image image;
  LabelImage labels;
};
Pair scan(const Phantom& phantom, const Grid& grid) {
  Pair pair{Image(grid), LabelImage(grid)};
  for (int k = 0; k < grid.size[2]; ++k)
    for (int j = 0; j < grid.size[1]; ++j)
      for (int i = 0; i < grid.size[0]; ++i) {
        pair.image.at(i, j, k) = float(phantom.intensity(grid.point(i, j, k)));
        pair.labels.at(i, j, k) = std::uint16_t(phantom.label(grid.point(i, j, k)));
      }
  return pair;
}

Grid moving_grid() { return {{62, 54, 70}, {-61, -45, -86}, {2, 2, 2.5}, Mat3d::identity()}; }
/// Oblique, with a table offset.
Grid fixed_grid() {
  Grid grid = moving_grid();
  grid.direction = rotation_matrix({0.05, -0.03, 0.1});
  grid.origin += Vec3d{12, -20, 30};
  return grid;
}

/// Shift of 25 mm and a bend of 3 deg per level.
Phantom bent() {
  Phantom phantom;
  RigidMotion motion{{0, 0, -42}, rotation_matrix({0.08, -0.05, 0.04}), {8, -14, 20}};
  for (int level = 0; level < 4; ++level) {
    const Vec3d hinge{0, 0, 28.0 * level - 56};
    if (level > 0) motion = compose(motion, {hinge, rotation_matrix({2.5 * degree, 1.5 * degree, -1 * degree}), {}});
    phantom.motions[level] = motion;
  }
  return phantom;
}

const Pair& moving() {
  static const Pair pair = scan(Phantom{}, moving_grid());
  return pair;
}
const Pair& fixed() {
  static const Pair pair = scan(bent(), fixed_grid());
  return pair;
}

void expect_near(const RigidMotion& found, const RigidMotion& truth, const std::string& what) {
  EXPECT_LT(norm(found.apply(found.center) - truth.apply(found.center)), shift_tolerance_mm) << what;
  EXPECT_LT(norm(rotation_vector(found.rotation * transpose(truth.rotation))) / degree, turn_tolerance_deg) << what;
}
void expect_truth(const BoneMotionResult& result) {
  ASSERT_EQ(result.bones.size(), 4u);
  for (int level = 0; level < 4; ++level) {
    const BoneMotion& bone = result.bones[level];
    EXPECT_EQ(bone.motion.label, level + 1);
    expect_near(bone.motion.motion, bent().motions[level], concatenate("label ", level + 1));
    EXPECT_GT(bone.similarity_after, 0.99);
    EXPECT_GE(bone.similarity_after, bone.similarity_before);
    EXPECT_LT(bone.inverse_consistency_mm, 0.3);
    EXPECT_GT(bone.voxels, 100);
  }
}
bool mentions(const std::vector<std::string>& warnings, const std::string& text) {
  for (const auto& warning : warnings)
    if (warning.find(text) != std::string::npos) return true;
  return false;
}
template <class Work>
std::string input_error(Work&& work) {
  try {
    work();
  } catch (const Error& error) {
    EXPECT_EQ(error.failure(), Failure::input);
    return error.what();
  }
  return "no error";
}

TEST(BoneMotion, IsFoundWithFixedLabels) {
  const auto result = estimate_bone_motions(moving().image, fixed().image, moving().labels, &fixed().labels, {});
  expect_truth(result);
  EXPECT_TRUE(result.warnings.empty()) << result.warnings.front();
}

TEST(BoneMotion, IsFoundWithoutFixedLabels) {
  const auto result = estimate_bone_motions(moving().image, fixed().image, moving().labels, nullptr, {});
  expect_truth(result);
  EXPECT_TRUE(result.warnings.empty()) << result.warnings.front();
}

TEST(BoneMotion, DoesNotDependOnTheNumberOfThreads) {
  const BoneMotionOptions options{.check_inverse = false};
  const auto many = estimate_bone_motions(moving().image, fixed().image, moving().labels, nullptr, options);
  const ThreadLimit one(1);
  const auto single = estimate_bone_motions(moving().image, fixed().image, moving().labels, nullptr, options);
  for (int level = 0; level < 4; ++level) {
    const RigidMotion &a = many.bones[level].motion.motion, &b = single.bones[level].motion.motion;
    EXPECT_EQ(a.translation, b.translation);
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) EXPECT_EQ(a.rotation[i][j], b.rotation[i][j]);
  }
}

TEST(BoneMotion, IsZeroBetweenEqualImages) {
  const auto result = estimate_bone_motions(moving().image, moving().image, moving().labels, &moving().labels, {});
  for (const auto& bone : result.bones) expect_near(bone.motion.motion, {}, concatenate("label ", bone.motion.label));
  EXPECT_TRUE(result.warnings.empty()) << result.warnings.front();
}

TEST(BoneMotion, LeavesOutLabelsThatOneSideLacks) {
  LabelImage some = fixed().labels;
  for (auto& label : some.data)
    if (label == 2) label = 9;
  const auto result =
      estimate_bone_motions(moving().image, fixed().image, moving().labels, &some, {.check_inverse = false});
  EXPECT_EQ(result.bones.size(), 3u);
  EXPECT_TRUE(mentions(result.warnings, "label 2 is in the moving but not in the fixed labels"));
  EXPECT_TRUE(mentions(result.warnings, "label 9 is in the fixed but not in the moving labels"));
}

TEST(BoneMotion, WarnsOfLabelsThatLeaveTheFixedImage) {
  Grid lower = fixed_grid();
  lower.size[2] = 44;
  const Image part = scan(bent(), lower).image;
  const auto result = estimate_bone_motions(moving().image, part, moving().labels, nullptr, {.check_inverse = false});
  ASSERT_EQ(result.bones.size(), 4u);
  EXPECT_TRUE(mentions(result.warnings, "label 4 leaves the fixed image"));
  EXPECT_FALSE(mentions(result.warnings, "taken for its neighbour"));
  for (int level = 0; level < 2; ++level)
    expect_near(result.bones[level].motion.motion, bent().motions[level], concatenate("label ", level + 1));
}

TEST(BoneMotion, WarnsOfLabelsAtTheBorderOfTheMovingImage) {
  Grid cut = moving_grid();
  cut.origin.z += 40, cut.size[2] -= 16;
  const Pair part = scan(Phantom{}, cut);
  const auto result =
      estimate_bone_motions(part.image, fixed().image, part.labels, &fixed().labels, {.check_inverse = false});
  EXPECT_TRUE(mentions(result.warnings, "label 1 touches the border"));
  EXPECT_FALSE(mentions(result.warnings, "label 2 touches the border"));
}

TEST(BoneMotion, ExplainsUnusableLabels) {
  const LabelImage empty(moving_grid());
  LabelImage others = fixed().labels, far = moving().labels;
  for (auto& label : others.data) label = label ? std::uint16_t(label + 10) : std::uint16_t(0);
  far.grid.origin.x += 500;
  const auto run = [&](const LabelImage& labels, const LabelImage* fixed_labels) {
    return input_error([&] { estimate_bone_motions(moving().image, fixed().image, labels, fixed_labels, {}); });
  };
  EXPECT_NE(run(empty, nullptr).find("moving labels are empty"), std::string::npos);
  EXPECT_NE(run(moving().labels, &empty).find("fixed labels are empty"), std::string::npos);
  EXPECT_NE(run(moving().labels, &others).find("no number in common"), std::string::npos);
  EXPECT_NE(run(far, nullptr).find("outside the moving image"), std::string::npos);
}

TEST(RegisterRigidly, RecoversAShiftAndTurn) {
  Phantom rigid;
  for (auto& motion : rigid.motions) motion = bent().motions[0];
  const Image turned = scan(rigid, fixed_grid()).image;
  const RigidMotion found = register_rigidly(moving().image, turned, nullptr, nullptr);
  for (const Vec3d& x : {Vec3d{0, 0, -42}, Vec3d{20, 10, 0}, Vec3d{0, 20, 42}})
    EXPECT_LT(norm(found.apply(x) - rigid.motions[0].apply(x)), 1) << "a third of a coarse voxel";
}

TEST(RegisterRigidly, ExplainsEmptyMasks) {
  const Mask none(moving_grid());
  const auto text = input_error([&] { register_rigidly(moving().image, fixed().image, &none, nullptr); });
  EXPECT_NE(text.find("mask is empty"), std::string::npos);
}

/// Eight levels, each turned by 1.7 deg about the disc below it.
std::vector<LabelMotion> smooth_column() {
  std::vector<LabelMotion> motions;
  RigidMotion motion;
  for (int level = 0; level < 8; ++level) {
    motion = compose(motion, {{0, 0, 25.0 * level - 12.5}, rotation_matrix({0.03, 0, 0}), {}});
    const Vec3d center{0, 0, 25.0 * level};
    motions.push_back({level + 1, {center, motion.rotation, motion.displacement(center)}});
  }
  return motions;
}

TEST(ImplausibleNeighbours, AcceptASmoothColumn) { EXPECT_TRUE(implausible_neighbours(smooth_column()).empty()); }

TEST(ImplausibleNeighbours, NameAMixUpByOneLevel) {
  auto motions = smooth_column();
  for (int level = 4; level < 8; ++level)
    motions[level].motion.translation += motions[level].motion.rotation * Vec3d{0, 0, 25};
  const auto warnings = implausible_neighbours(motions);
  ASSERT_EQ(warnings.size(), 1u);
  EXPECT_NE(warnings[0].find("labels 4 and 5"), std::string::npos);
  EXPECT_NE(warnings[0].find("taken for its neighbour"), std::string::npos);
}

TEST(ImplausibleNeighbours, NameAnOddTurn) {
  auto motions = smooth_column();
  motions[2].motion.rotation = rotation_matrix({0.09, 0.4, 0});
  const auto warnings = implausible_neighbours(motions);
  EXPECT_TRUE(mentions(warnings, "labels 2 and 3 turn by"));
  EXPECT_TRUE(mentions(warnings, "labels 3 and 4 turn by"));
  EXPECT_FALSE(mentions(warnings, "labels 4 and 5"));
}

TEST(ImplausibleNeighbours, NameAnOddShift) {
  auto motions = smooth_column();
  motions[7].motion.translation.x += 9;
  const auto warnings = implausible_neighbours(motions);
  ASSERT_EQ(warnings.size(), 1u);
  EXPECT_NE(warnings[0].find("labels 7 and 8 shift by 9 mm"), std::string::npos) << warnings[0];
}

TEST(ImplausibleNeighbours, NameThemWhereMostJointsAreWrong) {
  auto motions = smooth_column();
  for (int level = 1; level < 8; level += 2) motions[std::size_t(level)].motion.translation.x += 100;
  EXPECT_EQ(implausible_neighbours(motions).size(), 7u);
}

}  // namespace
}  // namespace mtled
