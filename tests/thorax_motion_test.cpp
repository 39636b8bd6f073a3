#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>

#include "image_io/image_io.hpp"
#include "imaging/body.hpp"
#include "imaging/bone_motion.hpp"
#include "io/tables.hpp"

namespace mtled {
namespace {

constexpr double degrees = 57.29577951308232;

/// The simulated posture change of a real thorax: shipped, or in the folder that MTLED_SHARED_DATA names.
class ThoraxFlex : public testing::Test {
 protected:
  void SetUp() override {
    folder = std::filesystem::path(MTLED_SOURCE_DIR) / "data/thorax_flex";
    if (const char* shared = std::getenv("MTLED_SHARED_DATA"); shared && !std::filesystem::exists(folder))
      folder = std::filesystem::path(shared) / "thorax_flex";
    if (!std::filesystem::exists(folder / "truth_motions.json"))
      GTEST_SKIP() << "thorax_flex is not in data/ and MTLED_SHARED_DATA does not name a folder with it";
    moving = read_image(folder / "moving.nii.gz", "moving image");
    fixed = read_image(folder / "fixed.nii.gz", "fixed image");
    moving_labels = read_labels(folder / "moving_vertebrae.nii.gz", "moving labels");
  }
  void expect_truth(const BoneMotionResult& result) const {
    const std::vector<LabelMotion> truth = read_motions(folder / "truth_motions.json");
    ASSERT_EQ(result.bones.size(), truth.size());
    for (std::size_t i = 0; i < truth.size(); ++i) {
      const RigidMotion &found = result.bones[i].motion.motion, &true_motion = truth[i].motion;
      // Label 12 has 540 voxels of 2 x 2 x 2.5 mm: half a degree moves its edge by 0.15 mm.
      const double turn_limit_deg = result.bones[i].voxels < 1000 ? 1.0 : 0.5;
      EXPECT_LT(norm(found.apply(true_motion.center) - true_motion.apply(true_motion.center)), 0.5) << truth[i].label;
      EXPECT_LT(norm(rotation_vector(found.rotation * transpose(true_motion.rotation))) * degrees, turn_limit_deg)
          << truth[i].label;
    }
    EXPECT_TRUE(result.warnings.empty()) << result.warnings.front();
  }

  std::filesystem::path folder;
  Image moving, fixed;
  LabelImage moving_labels;
};

TEST_F(ThoraxFlex, BonesAreFoundWithFixedLabels) {
  const LabelImage fixed_labels = read_labels(folder / "fixed_vertebrae.nii.gz", "fixed labels");
  expect_truth(estimate_bone_motions(moving, fixed, moving_labels, &fixed_labels, {.check_inverse = false}));
}

TEST_F(ThoraxFlex, BonesAreFoundWithoutFixedLabels) {
  expect_truth(estimate_bone_motions(moving, fixed, moving_labels, nullptr, {.check_inverse = false}));
}

TEST_F(ThoraxFlex, BodyMaskMatchesTheReference) {
  if (!std::filesystem::exists(folder / "moving_body_mask.nii.gz")) GTEST_SKIP() << "no moving_body_mask.nii.gz";
  const Mask body = body_mask(moving, {}), reference = read_mask(folder / "moving_body_mask.nii.gz", "body mask");
  double both = 0, sum = 0;
  for (std::size_t v = 0; v < body.data.size(); ++v) {
    both += body.data[v] && reference.data[v];
    sum += (body.data[v] != 0) + (reference.data[v] != 0);
  }
  EXPECT_GT(2 * both / sum, 0.985);
}

}  // namespace
}  // namespace mtled
