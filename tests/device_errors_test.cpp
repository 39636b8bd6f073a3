// What a device cannot do: errors with reason and remedy, before or instead of a result.
#include <gtest/gtest.h>

#include "core/error.hpp"
#include "core/shape_evaluator.hpp"
#include "cuda/backend.hpp"
#include "cuda/device_mechanics.hpp"
#include "cuda/field.hpp"
#include "cuda/serial_device.hpp"
#include "scenes.hpp"

namespace mtled {
namespace {

using scenes::Box;

constexpr double h = 5;

/// A serial device of some memory, which counts what is taken of it.
class SmallDevice : public SerialDevice {
 public:
  template <class T>
  struct Buffer : SerialDevice::Buffer<T> {
    Buffer(SmallDevice& device, std::size_t size) : SerialDevice::Buffer<T>(device, size) { device.taken_ += double(this->bytes()); }
  };
  SmallDevice(double free_bytes, double& taken) : SerialDevice(false, free_bytes), taken_(taken) {}

 private:
  double& taken_;
};

/// Claims to be a field that no device computes.
struct AveragesPressure : ShapeEvaluator {
  using ShapeEvaluator::ShapeEvaluator;
  bool averages_pressure() const override { return true; }
};

/// A block with springs and weight.
template <class Evaluator = ShapeEvaluator>
struct Block {
  Cloud cloud = scenes::lattice_box({{12, 11, 13}, h});
  Constraints constraints;
  IntegrationPoints points;
  std::unique_ptr<ShapeEvaluator> field;
  SolverOptions options;
  DiscreteModel model;
  mutable double taken = 0;

  Block() {
    scenes::prescribe(cloud, constraints, "bottom", scenes::below(2, 0), scenes::nowhere);
    points = scenes::coupled_box_points({{12, 11, 13}, h}, cloud, constraints, scenes::uniform(1));
    field = std::make_unique<Evaluator>(cloud, scenes::prescribed_flags(cloud, constraints), MlsOptions{});
    options.coarse_unknowns = 300;
    Springs springs;
    ShapeFunctions shapes;
    for (double x = 3; x < 55; x += 7)
      if (field->at({x, 20, 30}, shapes)) springs.add(shapes.node, shapes.value, 1, {}, -1);
    Loads loads;
    loads.gravity = {0, 0, -9810};
    std::vector<double> points_of_nodes;
    model = make_static_model(*field, points, constraints, springs, loads, options, points_of_nodes);
  }
  DeviceMechanics<float, SmallDevice> mechanics(double free_bytes) const { return {model, options, SmallDevice(free_bytes, taken)}; }
};

void expect_parts(const std::string& message, const std::vector<std::string>& parts) {
  for (const std::string& part : parts) EXPECT_NE(message.find(part), std::string::npos) << "'" << part << "' is not in: " << message;
}

TEST(DeviceErrors, AModelThatDoesNotFitIsRefusedBeforeMemoryIsTaken) {
  const Block block;
  const double needed = block.mechanics(1e30).free_bytes_needed();
  block.mechanics(needed);
  block.taken = 0;
  Failure failure{};
  const std::string message = scenes::error_of([&] { block.mechanics(needed - 1); }, &failure);
  EXPECT_EQ(failure, Failure::memory);
  expect_parts(message, {concatenate("needs ", needed / 1e9, " GB"), concatenate(block.cloud.size(), " nodes"), "bytes per node", "GB are free", "larger node spacing", "--device cpu"});
  EXPECT_EQ(block.taken, 0);
}

TEST(DeviceErrors, NoMoreMemoryIsTakenThanCounted) {
  const Block block;
  const DeviceMechanics<float, SmallDevice> mechanics = block.mechanics(1e30);
  std::vector<VectorPointer> vectors;
  for (int i = 0; i < 12; ++i) vectors.push_back(mechanics.vector());  // as many as the relaxation has at a time
  mechanics.largest_displacement(*vectors[0]);                         // makes its rows
  EXPECT_LE(block.taken, mechanics.bytes());
  EXPECT_GT(block.taken, 0.8 * mechanics.bytes());  // measured 0.90: the field has fewer terms at nodes than at points
}

TEST(DeviceErrors, AveragedPressureIsRefused) {
  const Block<AveragesPressure> block;
  Failure failure{};
  const std::string message = scenes::error_of([&] { block.mechanics(1e30); }, &failure);
  EXPECT_EQ(failure, Failure::input);
  expect_parts(message, {"averaged pressure", "CPU only", "--device cpu"});
}

TEST(DeviceErrors, ADeviceThatIsNotThereIsADeviceErrorInEveryCall) {
  constexpr int nowhere = 9999;
  const Block block;
  const Image image(Grid{});
  const auto refused = [](const auto& work) {
    Failure failure{};
    const std::string message = scenes::error_of(work, &failure);
    EXPECT_EQ(failure, Failure::device) << message;
    expect_parts(message, {"--device cpu"});
  };
  refused([&] { cuda_mechanics(nowhere)(block.model, block.options); });
  refused([&] { cuda_copy_bandwidth(nowhere); });
  refused([&] { cuda_field(nowhere, *block.field, std::vector<Vec3d>(block.cloud.size())); });
  refused([&] { cuda_sampler(nowhere)(image, VectorImage(Grid{}), Interpolation::linear, 0); });
}

}  // namespace
}  // namespace mtled
