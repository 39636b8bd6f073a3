// The mechanics of a device with functors, on the serial launcher, against those of the CPU: the whole interface, without a GPU.
#include "cuda/device_mechanics.hpp"

#include <gtest/gtest.h>

#include <random>

#include "cuda/serial_device.hpp"
#include "scenes.hpp"

namespace mtled {
namespace {

using scenes::Box;

constexpr double h = 5;
const Box box{{7, 5, 6}, h};

// As in forces_test.cpp: sums of some 40 points * 40 terms, and k / mu = 50 amplifies rounding of J.
template <class Real>
constexpr double force_rounding = 3000 * double(std::numeric_limits<Real>::epsilon());
constexpr double coarse_rounding = 100 * double(std::numeric_limits<float>::epsilon());  ///< the inverse is in single precision

/// A block between a held and a moved face, with springs and weight. On the lattice constraints are direct, on the cloud not.
struct Problem {
  Cloud cloud;
  Constraints constraints;
  IntegrationPoints points;
  std::unique_ptr<ShapeEvaluator> field;
  SolverOptions options;
  DiscreteModel model;

  Problem(bool lattice, bool two_level, bool double_precision) : cloud(lattice ? scenes::lattice_box(box) : scenes::jittered_box(box)) {
    scenes::prescribe(cloud, constraints, "bottom", scenes::below(2, 0), scenes::nowhere);
    scenes::prescribe(cloud, constraints, "top", scenes::above(2, box.length(2)), [](const Vec3d& x) { return Vec3d{2, 0, -0.05 * x.x}; }, {true, false, true});
    const auto modulus = [](const Vec3d& x) { return 2 + std::sin(x.x) * std::cos(x.y + x.z); };
    points = lattice ? scenes::coupled_box_points(box, cloud, constraints, modulus) : scenes::box_points(box, modulus);
    field = std::make_unique<ShapeEvaluator>(cloud, scenes::prescribed_flags(cloud, constraints), MlsOptions{});
    options.relaxation = two_level ? Relaxation::two_level : Relaxation::plain;
    options.double_precision = double_precision, options.coarse_unknowns = 300;
    Springs springs;
    std::mt19937 random(3);
    std::uniform_real_distribution<double> along(0, 1);
    for (int r = 0; r < 40; ++r) {
      ShapeFunctions s;
      if (field->at({along(random) * box.length(0), along(random) * box.length(1), along(random) * box.length(2)}, s)) springs.add(s.node, s.value, 20, {along(random), -1, 0}, -1);
    }
    std::vector<double> points_of_nodes;
    model = make_static_model(*field, points, constraints, springs, {}, options, points_of_nodes);
    model.external.resize(model.slots());
    for (int s : model.layout.slot_of_node) model.external[std::size_t(s)] = {0, along(random), -1};
  }
  /// Smooth with a little noise, 0 where there is no node.
  std::vector<Vec3d> displacement(unsigned seed) const {
    std::mt19937 random(seed);
    std::uniform_real_distribution<double> noise(-0.02 * h, 0.02 * h);
    std::vector<Vec3d> u(model.slots());
    for (int s : model.layout.slot_of_node) {
      const Vec3d& x = model.position[std::size_t(s)];
      u[std::size_t(s)] = {2 * std::sin(0.05 * x.y) + noise(random), std::cos(0.05 * x.z) + noise(random), -0.05 * x.z + noise(random)};
    }
    return u;
  }
};

double relative_difference(const std::vector<Vec3d>& a, const std::vector<Vec3d>& expected) {
  double top = 0, difference = 0;
  for (std::size_t s = 0; s < a.size(); ++s) {
    top = std::max(top, norm(expected[s]));
    const double d = norm(a[s] - expected[s]);
    difference = d > difference || std::isnan(d) ? d : difference;
  }
  EXPECT_GT(top, 0);
  return difference / top;
}

template <class Real>
void equals_the_cpu(bool lattice, bool two_level) {
  const Problem problem(lattice, two_level, sizeof(Real) == sizeof(double));
  ASSERT_EQ(problem.model.constraints->direct(), lattice);
  const std::unique_ptr<Mechanics> cpu = make_cpu_mechanics(problem.model, problem.options);
  DeviceMechanics<Real, SerialDevice> device(problem.model, problem.options);
  constexpr double tolerance = force_rounding<Real>;
  const std::vector<Vec3d> u0 = problem.displacement(1), v0 = problem.displacement(2);

  EXPECT_EQ(device.coarse_unknowns(), cpu->coarse_unknowns());
  EXPECT_EQ(device.coarse_unknowns() > 0, two_level);
  EXPECT_GT(device.bytes(), 0);
  struct State {
    explicit State(Mechanics& m) : mechanics(m), u(m.vector()), v(m.vector()), f(m.vector()), g(m.vector()) {}
    Mechanics& mechanics;
    VectorPointer u, v, f, g;
  };
  State a(*cpu), b(device);
  const auto both = [&](const auto& work) { work(a), work(b); };
  const auto difference = [&](VectorPointer State::*x) { return relative_difference(device.download(*(b.*x)), cpu->download(*(a.*x))); };
  both([&](State& s) { s.mechanics.upload(u0, *s.u), s.mechanics.upload(v0, *s.v); });
  both([](State& s) { s.mechanics.impose(*s.u, 0.8); });
  EXPECT_LT(difference(&State::u), tolerance) << "impose";
  EXPECT_NEAR(device.dot(*b.u, *b.v), cpu->dot(*a.u, *a.v), tolerance * std::abs(cpu->dot(*a.u, *a.u)));
  both([](State& s) { s.mechanics.copy(*s.u, *s.f), s.mechanics.force(*s.u, 0.8, *s.f); });  // what was in f shall not matter
  EXPECT_LT(difference(&State::f), tolerance) << "force";
  const VolumeRatioStatistics ratio = device.force(*b.u, 0.8, *b.f), expected_ratio = cpu->force(*a.u, 0.8, *a.f);
  EXPECT_LT(expected_ratio.smallest, 1);
  EXPECT_NEAR(ratio.smallest, expected_ratio.smallest, tolerance);
  EXPECT_EQ(ratio.inverted, expected_ratio.inverted);
  both([](State& s) { s.mechanics.tangent(*s.u, *s.v, *s.g); });
  EXPECT_LT(difference(&State::g), tolerance) << "tangent";
  both([](State& s) { s.mechanics.reduce(*s.f); });
  EXPECT_LT(difference(&State::f), tolerance) << "reduce";
  EXPECT_NEAR(device.strain_energy(*b.u), cpu->strain_energy(*a.u), tolerance * cpu->strain_energy(*a.u));
  EXPECT_NEAR(device.largest_displacement(*b.u), cpu->largest_displacement(*a.u), tolerance * cpu->largest_displacement(*a.u));
  if (two_level) both([](State& s) { s.mechanics.assemble_coarse(*s.u); });
  // The coarse matrices differ by the rounding of the displacement that they are assembled at, which its condition magnifies.
  both([](State& s) { s.mechanics.precondition(*s.f, *s.g); });
  EXPECT_LT(difference(&State::g), tolerance + coarse_rounding) << "precondition";
  both([](State& s) { s.mechanics.multiply_by_diagonal(*s.v, *s.g); });
  EXPECT_LT(difference(&State::g), tolerance) << "diagonal";
  both([](State& s) { s.mechanics.combine(*s.v, 0.5, *s.u, -2); });
  EXPECT_LT(difference(&State::v), tolerance) << "combine";

  // Steps: over the end of a ramp, then stopped by the control in the middle of a batch.
  StepControl start;
  start.ramp = 6, start.largest_increment = 1e3, start.factor = 3, start.tolerance = 1e-9, start.impatient_from = 12;
  StepControl control[2] = {start, start};
  both([](State& s) { s.mechanics.clear(*s.u), s.mechanics.clear(*s.f), s.mechanics.clear(*s.g); });
  for (int batch = 0; batch < 3; ++batch) {
    cpu->steps(7, {0.8, 20}, control[0], *a.u, *a.f, *a.g);
    device.steps(7, {0.8, 20}, control[1], *b.u, *b.f, *b.g);
  }
  EXPECT_EQ(control[0].verdict, StepControl::impatient);
  EXPECT_EQ(control[0].step, 13);
  EXPECT_EQ(control[1].verdict, control[0].verdict);
  EXPECT_EQ(control[1].step, control[0].step);
  EXPECT_NEAR(control[1].largest, control[0].largest, 10 * tolerance * control[0].largest + coarse_rounding);
  EXPECT_LT(difference(&State::u), tolerance + coarse_rounding) << "displacement after steps";
  EXPECT_LT(difference(&State::g), tolerance + coarse_rounding) << "change in steps";
}
TEST(DeviceMechanics, EqualsTheCpuOnALatticeInFloat) { equals_the_cpu<float>(true, true); }
TEST(DeviceMechanics, EqualsTheCpuOnALatticeInDouble) { equals_the_cpu<double>(true, true); }
TEST(DeviceMechanics, EqualsTheCpuOnACloudInFloat) { equals_the_cpu<float>(false, true); }
TEST(DeviceMechanics, EqualsTheCpuOnACloudInDouble) { equals_the_cpu<double>(false, true); }
TEST(DeviceMechanics, EqualsTheCpuInPlainRelaxation) { equals_the_cpu<float>(true, false), equals_the_cpu<double>(false, false); }

}  // namespace
}  // namespace mtled
