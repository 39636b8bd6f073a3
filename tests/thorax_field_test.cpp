#include <gtest/gtest.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>

#include "core/body_sampling.hpp"
#include "core/shape_evaluator.hpp"
#include "core/solver.hpp"
#include "image_io/image_io.hpp"
#include "io/tables.hpp"

namespace mtled {
namespace {

class ThoraxField : public testing::TestWithParam<const char*> {};
INSTANTIATE_TEST_SUITE_P(Postures, ThoraxField, testing::Values("thorax_flex", "thorax_bend"), [](const auto& name) { return std::string(name.param); });

// A spacing that is coarse for the ribs. The finite element truth is itself uncertain by 0.25 mm (99.5 %).
TEST_P(ThoraxField, FollowsTheTruthAtACoarseSpacing) {
  std::filesystem::path folder = std::filesystem::path(MTLED_SOURCE_DIR) / "data" / GetParam();
  if (const char* shared = std::getenv("MTLED_SHARED_DATA"); shared && !std::filesystem::exists(folder / "shear_modulus.nii.gz")) folder = std::filesystem::path(shared) / GetParam();
  if (!std::filesystem::exists(folder / "shear_modulus.nii.gz"))
    GTEST_SKIP() << GetParam() << "/shear_modulus.nii.gz is neither in data/ (make_shear_modulus.py makes it) nor where MTLED_SHARED_DATA points";
  SamplingOptions options;
  options.node_spacing_mm = 5;
  const SampledBody body = sample_body(read_mask(folder / "moving_body_mask.nii.gz", "mask"), read_image(folder / "shear_modulus.nii.gz", "modulus"),
                                       read_labels(folder / "moving_vertebrae.nii.gz", "labels"), read_motions(folder / "truth_motions.json"), options);
  const ShapeEvaluator field(body.cloud, {}, {});
  const Solution solution = solve(field, body.points, {}, {}, springs_on(body.rigid, field));
  ASSERT_TRUE(solution.converged);

  const std::filesystem::path table = folder / "truth_points.csv";
  const std::vector<Vec3d> place = read_points(table), truth = read_points(table, {"ux", "uy", "uz"}), in_fixed = read_points(table, {"in_fixed_fov", "in_fixed_fov", "in_fixed_fov"});
  std::size_t count = 0, near = 0;
  double largest = 0;
  for (std::size_t p = 0; p < place.size(); ++p) {
    if (in_fixed[p].x == 0) continue;
    Vec3d u;
    ASSERT_TRUE(displacement_at(field, solution.parameter, place[p], u));
    const double error = norm(u - truth[p]);
    ++count, near += error <= 0.5, largest = std::max(largest, error);
  }
  EXPECT_GT(count, 10000u);
  EXPECT_GE(double(near), 0.995 * double(count));
  EXPECT_LE(largest, 2);
}

}  // namespace
}  // namespace mtled
