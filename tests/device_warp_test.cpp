#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>

#include "backends.hpp"
#include "core/body_sampling.hpp"
#include "core/shape_evaluator.hpp"
#include "core/solver.hpp"
#include "cuda/field.hpp"
#include "cuda/field_on.hpp"
#include "image_io/image_io.hpp"
#include "imaging/warp.hpp"
#include "io/tables.hpp"
#include "loop_device.hpp"

namespace mtled {
namespace {

using backends::Backend;

/// The functors on the host, by a loop on all processors, and on a GPU.
class DeviceWarp : public backends::EachBackend {
 protected:
  static Image sample_by_loop(const Image& samples, const VectorImage& displacement, Interpolation interpolation, float outside) {
    LoopDevice device;
    return sample_displaced_on(device, samples, displacement, interpolation, outside);
  }
  static SampleDisplaced sampler() { return GetParam() == Backend::cuda ? cuda_sampler(backends::device().ordinal) : sample_by_loop; }
  static std::unique_ptr<FieldBackend> field(const ShapeEvaluator& evaluator, const std::vector<Vec3d>& parameter) {
    if (GetParam() == Backend::cuda) return cuda_field(backends::device().ordinal, evaluator, parameter);
    return std::make_unique<FieldOn<LoopDevice>>(LoopDevice(), make_lattice_field(evaluator, parameter));
  }
};
INSTANTIATE_TEST_SUITE_P(On, DeviceWarp, backends::device_backends, backends::backend_name);

TEST_P(DeviceWarp, IsTheCpusToTheBit) {
  Grid moving_grid, fixed_grid;
  moving_grid.size = {31, 28, 17}, moving_grid.spacing = {1, 1.1, 2.3}, moving_grid.direction = rotation_matrix({0.3, -0.2, 0.5});
  fixed_grid.size = {29, 33, 19}, fixed_grid.spacing = {1.2, 0.9, 2};
  Image moving(moving_grid);
  for (std::size_t v = 0; v < moving.data.size(); ++v) moving.data[v] = float(100 * std::sin(0.37 * double(v)));
  VectorImage field(fixed_grid);
  for (std::size_t v = 0; v < field.data.size(); ++v) field.data[v] = {float(3 * std::sin(0.01 * double(v))), 2.5f, float(4 * std::cos(0.02 * double(v)))};
  for (const Interpolation interpolation : {Interpolation::nearest, Interpolation::linear, Interpolation::cubic}) {
    const Image expected = warp_image(moving, field, interpolation, -1000), warped = warp_image(moving, field, interpolation, -1000, sampler());
    EXPECT_EQ(warped.data, expected.data);
    EXPECT_GT(std::count(warped.data.begin(), warped.data.end(), -1000), 100);
    EXPECT_LT(std::count(warped.data.begin(), warped.data.end(), -1000), std::ptrdiff_t(warped.data.size()) - 1000);
  }
}

// A real body, deformed by a formula: which voxels are left to the CPU does not depend on how it is deformed.
TEST_P(DeviceWarp, LargeFieldsOfAThoraxLeaveFewVoxelsToTheCpu) {
  const std::filesystem::path folder = std::filesystem::path(MTLED_SOURCE_DIR) / "data/thorax_flex";
  const Mask mask = read_mask(folder / "moving_body_mask.nii.gz", "mask");
  SamplingOptions sampling;
  sampling.node_spacing_mm = 6.25;
  const SampledBody body = sample_body(mask, Image(mask.grid, 1), read_labels(folder / "moving_vertebrae.nii.gz", "labels"), read_motions(folder / "truth_motions.json"), sampling);
  std::vector<Vec3d> parameter;
  for (const Vec3d& x : body.cloud.nodes) parameter.push_back({6 * std::sin(x.x / 60), 0.1 * x.z + 3 * std::cos(x.z / 45), 8 * std::sin(x.y / 60)});
  const ShapeEvaluator evaluator(body.cloud, {}, {});
  const DisplacementFunction u = [&](const Vec3d& X, Vec3d& value) { return evaluator.covers(X) && displacement_at(evaluator, parameter, X, value); };
  const std::unique_ptr<FieldBackend> device = field(evaluator, parameter);
  InverseStatistics by_cpu, by_device;
  const DenseField forward_cpu = forward_field(mask.grid, u), forward = forward_field(mask.grid, u, device.get());
  const DenseField inverse_cpu = inverse_field(mask.grid, forward_cpu, u, 0.01, by_cpu), inverse = inverse_field(mask.grid, forward_cpu, u, 0.01, by_device, device.get());
  EXPECT_EQ(forward.covered.data, forward_cpu.covered.data);
  EXPECT_EQ(inverse.covered.data, inverse_cpu.covered.data);
  EXPECT_EQ(by_device.covered, by_cpu.covered);
  EXPECT_EQ(by_device.unresolved, by_cpu.unresolved);
  EXPECT_LE(by_device.largest_residual_mm, 0.01);
  double largest_forward = 0, largest_inverse = 0;
  const auto compare = [](const VectorImage& a, const VectorImage& b, double& largest) {
    for (std::size_t v = 0; v < a.data.size(); ++v) {
      const Vec3f d = a.data[v] - b.data[v];
      largest = std::max(largest, norm(Vec3d{d.x, d.y, d.z}));
    }
  };
  compare(forward.displacement, forward_cpu.displacement, largest_forward);
  compare(inverse.displacement, inverse_cpu.displacement, largest_inverse);
  std::printf("left to the CPU: %zu and %zu of %zu voxels, differences %.2g and %.2g mm\n", forward.undecided, inverse.undecided, mask.grid.count(), largest_forward, largest_inverse);
  EXPECT_LT(largest_forward, 1e-3);
  EXPECT_LT(largest_inverse, 1e-3);
  EXPECT_LT(double(forward.undecided), 1e-3 * double(mask.grid.count()));
  EXPECT_LT(double(inverse.undecided), 1e-3 * double(mask.grid.count()));
}

}  // namespace
}  // namespace mtled
