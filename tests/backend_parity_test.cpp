// Every call of core/mechanics.hpp, steps and whole solutions on the device backends, against those of the CPU.
#include <algorithm>
#include <cmath>
#include <limits>
#include <random>

#include "backends.hpp"
#include "core/error.hpp"
#include "core/mechanics.hpp"
#include "core/relaxation.hpp"
#include "scenes.hpp"

namespace mtled {
namespace {

using backends::Backend;
using scenes::Box;

constexpr double h = 5;
const Box box{{7, 5, 6}, h};  // nothing is a multiple of a warp, a block or a period of the layout

/// What the body is made of: a lattice; one with an empty layer of cells but for its end; a jittered cloud; one with so few points
/// that springs stabilise it. On lattices constraints are direct, on clouds not.
enum class Kind { lattice, gap, cloud, sparse_cloud };
const char* const kind_name[] = {"lattice", "gap", "cloud", "sparse_cloud"};
const char* const material_name[number_of_material_models] = {"neo_hookean", "mooney_rivlin", "yeoh", "ogden", "transversely_isotropic"};

/// A block of uneven stiffness between a held and a moved face, with springs and weight.
struct Problem {
  Cloud cloud;
  Constraints constraints;
  IntegrationPoints points;
  std::unique_ptr<ShapeEvaluator> field;
  Springs springs;
  Loads loads;

  Problem(Kind kind, MaterialModel material) {
    const bool lattice = kind == Kind::lattice || kind == Kind::gap;
    const auto kept = [&](const std::array<int, 3>& c) { return kind != Kind::gap || c[2] != 3 || c[0] < 2; };
    cloud = lattice ? scenes::on_lattice(scenes::cell_corners(box, kept), h) : scenes::jittered_box(box);
    scenes::prescribe(cloud, constraints, "bottom", scenes::below(2, 0), scenes::nowhere);
    scenes::prescribe(cloud, constraints, "top", scenes::above(2, box.length(2)), [](const Vec3d& x) { return Vec3d{2, 0, -0.05 * x.x}; }, {true, false, true});
    const auto modulus = [](const Vec3d& x) { return 2 + std::sin(x.x) * std::cos(x.y + x.z); };
    const ShapeEvaluator evaluator(cloud, scenes::prescribed_flags(cloud, constraints), {});
    const std::array<double, 3> ratio = kind == Kind::sparse_cloud ? std::array<double, 3>{1.3, 1.3, 1.4} : scenes::usual_ratio;
    points = scenes::box_points(box, modulus, 0.49, ratio, [&](const std::array<int, 3>& c) {
      return !kept(c) ? scenes::CellKind::absent : lattice && evaluator.coupled(c) ? scenes::CellKind::coupled : scenes::CellKind::free;
    });
    const std::vector<double> further[number_of_material_models] = {{}, {0.4}, {0.3, 0.1}, {-4.7}, {3, 0, 0.6, 0.8}};
    points.model = material;
    for (std::size_t p = 0; p < points.size(); ++p) points.further.insert(points.further.end(), further[int(material)].begin(), further[int(material)].end());
    if (lattice) mark_body_cells(cloud, points);
    field = std::make_unique<ShapeEvaluator>(cloud, scenes::prescribed_flags(cloud, constraints), MlsOptions{});
    std::mt19937 random(3);
    std::uniform_real_distribution<double> along(0, 1);
    springs.set_names = {"plate"};
    for (int r = 0; r < 40; ++r) {
      ShapeFunctions s;
      const Vec3d place{along(random) * box.length(0), along(random) * box.length(1), along(random) * box.length(2)};
      if (field->at(place, s)) springs.add(s.node, s.value, 20, {along(random), -1, 0}, r % 2 - 1);
    }
    loads.gravity = {1000, 0, -9810};
  }
  SolverOptions options(Relaxation relaxation, bool double_precision) const {
    SolverOptions o;
    o.relaxation = relaxation, o.double_precision = double_precision, o.coarse_unknowns = 300, o.stabilisation = 2;
    return o;
  }
  Solution solve(const SolverOptions& o, Backend backend) const { return mtled::solve(*field, points, constraints, o, springs, loads, backends::mechanics_of(backend)); }
};

/// Smooth with a little noise, 0 where there is no node [mm].
std::vector<Vec3d> rough_displacement(const DiscreteModel& model, unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> noise(-0.02 * h, 0.02 * h);
  std::vector<Vec3d> u(model.slots());
  for (int s : model.layout.slot_of_node) {
    const Vec3d& x = model.position[std::size_t(s)];
    u[std::size_t(s)] = {2 * std::sin(0.05 * x.y) + noise(random), std::cos(0.05 * x.z) + noise(random), -0.05 * x.z + noise(random)};
  }
  return u;
}

double largest_difference(const std::vector<Vec3d>& a, const std::vector<Vec3d>& b) {
  double top = 0;
  for (std::size_t s = 0; s < a.size(); ++s) {
    const double d = norm(a[s] - b[s]);
    top = d > top || std::isnan(d) ? d : top;
  }
  return top;
}
double largest(const std::vector<Vec3d>& a) { return largest_difference(a, std::vector<Vec3d>(a.size())); }

constexpr double epsilon(bool double_precision) { return double_precision ? std::numeric_limits<double>::epsilon() : std::numeric_limits<float>::epsilon(); }

/// A result may differ from that of the CPU in double by so many times what rounding to float does to the CPU (to double: that
/// much smaller). Sums are taken in another order, so that errors are of the same size but not the same: measured up to 3.0
/// times in float, and 4.2 in double, where both sides round.
constexpr double margin = 8;
/// Also this many roundings of the largest result: on general clouds the CPU multiplies by the inverse of the constraints in
/// double, and rounds once; measured 7.7 where the device does so in its own precision.
constexpr double least_roundings = 16;
/// Scalars: their own rounding error may be small by chance. As in forces_test.cpp: sums of some 40 points * 40 terms, and
/// k / mu = 50 amplifies rounding of J.
constexpr double scalar_roundings = 3000;

struct State {
  explicit State(std::unique_ptr<Mechanics> m)
      : mechanics(std::move(m)), u(mechanics->vector()), v(mechanics->vector()), f(mechanics->vector()), g(mechanics->vector()) {}
  std::unique_ptr<Mechanics> mechanics;
  VectorPointer u, v, f, g;
};
/// The same calls on the CPU in double and in float, and on a device.
struct Parity {
  Parity(const Problem& problem, Relaxation relaxation, Backend backend, bool in_double)
      : double_precision(in_double), two_level(relaxation == Relaxation::two_level),
        points(problem.points), model(model_of(problem, relaxation)), exact(make_cpu_mechanics(model, problem.options(relaxation, true))),
        single(make_cpu_mechanics(model, problem.options(relaxation, false))), device(backends::mechanics_of(backend)(model, problem.options(relaxation, in_double))) {}
  DiscreteModel model_of(const Problem& problem, Relaxation relaxation) {
    std::vector<double> points_of_nodes;
    return make_static_model(*problem.field, points, problem.constraints, problem.springs, problem.loads, problem.options(relaxation, true), points_of_nodes);
  }
  template <class Work>
  void all(const Work& work) { work(exact), work(single), work(device); }

  /// Largest difference that rounding explains. The coarse correction is in single precision in every backend.
  double tolerance(VectorPointer State::*x, bool with_coarse) const {
    const std::vector<Vec3d> expected = exact.mechanics->download(*(exact.*x));
    const bool rounded_to_double = double_precision && !(with_coarse && two_level);
    const double rounding = largest_difference(single.mechanics->download(*(single.*x)), expected), ratio = rounded_to_double ? epsilon(true) / epsilon(false) : 1;
    return ratio * (margin * rounding + least_roundings * epsilon(false) * largest(expected));
  }
  double difference(VectorPointer State::*x) const { return largest_difference(device.mechanics->download(*(device.*x)), exact.mechanics->download(*(exact.*x))); }
  void expect_equal(VectorPointer State::*x, const char* what, bool with_coarse = false) const {
    EXPECT_GT(largest(exact.mechanics->download(*(exact.*x))), 0) << what;
    EXPECT_LT(difference(x), tolerance(x, with_coarse)) << what;
  }
  void expect_equal(double value, double expected, double scale, const char* what) const { EXPECT_NEAR(value, expected, scalar_roundings * epsilon(double_precision) * scale) << what; }

  bool double_precision, two_level;
  IntegrationPoints points;
  DiscreteModel model;
  State exact, single, device;
};

class Calls : public testing::TestWithParam<std::tuple<Kind, MaterialModel, Backend>> {
 protected:
  void SetUp() override { backends::skip_without_device(backend); }
  const Backend backend = std::get<2>(GetParam());
  const Problem problem{std::get<0>(GetParam()), std::get<1>(GetParam())};

  template <class Check>
  void each(const Check& check) const {
    for (const Relaxation relaxation : {Relaxation::two_level, Relaxation::plain})
      for (const bool double_precision : {false, true}) {
        SCOPED_TRACE(concatenate(relaxation == Relaxation::plain ? "plain" : "two-level", double_precision ? ", double" : ", float"));
        Parity parity(problem, relaxation, backend, double_precision);
        check(parity);
      }
  }
};
std::string name_of_calls(const testing::TestParamInfo<Calls::ParamType>& info) {
  const auto [kind, material, backend] = info.param;
  return concatenate(kind_name[int(kind)], "_", material_name[int(material)], "_", backends::name(backend));
}
INSTANTIATE_TEST_SUITE_P(On, Calls,
                         testing::Combine(testing::Values(Kind::lattice, Kind::gap, Kind::cloud, Kind::sparse_cloud),
                                          testing::Values(MaterialModel::neo_hookean, MaterialModel::mooney_rivlin, MaterialModel::yeoh, MaterialModel::ogden, MaterialModel::transversely_isotropic),
                                          backends::device_backends),
                         name_of_calls);

TEST_P(Calls, AreThoseOfTheCpu) {
  each([&](Parity& p) {
    Mechanics &device = *p.device.mechanics, &exact = *p.exact.mechanics;
    const State &a = p.exact, &b = p.device;
    EXPECT_EQ(p.model.constraints->direct(), p.model.layout.lattice);
    EXPECT_EQ(p.model.springs.size() > problem.springs.size(), std::get<0>(GetParam()) == Kind::sparse_cloud) << "stabilised";
    EXPECT_EQ(device.coarse_unknowns(), exact.coarse_unknowns());
    EXPECT_EQ(device.coarse_unknowns() > 0, p.two_level);
    EXPECT_GT(device.bytes(), 0);

    const std::vector<Vec3d> u0 = rough_displacement(p.model, 1), v0 = rough_displacement(p.model, 2);
    p.all([&](State& s) { s.mechanics->upload(u0, *s.u), s.mechanics->upload(v0, *s.v); });
    p.all([](State& s) { s.mechanics->impose(*s.u, 0.8); });
    p.expect_equal(&State::u, "impose");
    p.expect_equal(device.dot(*b.u, *b.v), exact.dot(*a.u, *a.v), exact.dot(*a.u, *a.u), "dot");
    p.all([](State& s) { s.mechanics->copy(*s.u, *s.f), s.mechanics->force(*s.u, 0.8, *s.f); });  // what was in f shall not matter
    p.expect_equal(&State::f, "force");
    const VolumeRatioStatistics ratio = device.force(*b.u, 0.8, *b.f), expected = exact.force(*a.u, 0.8, *a.f);
    EXPECT_LT(expected.smallest, 1);
    p.expect_equal(ratio.smallest, expected.smallest, 1, "smallest volume ratio");
    EXPECT_EQ(ratio.inverted, expected.inverted);
    p.all([](State& s) { s.mechanics->tangent(*s.u, *s.v, *s.g); });
    p.expect_equal(&State::g, "tangent");
    p.all([](State& s) { s.mechanics->force(*s.u, 0.8, *s.f), s.mechanics->reduce(*s.f); });
    p.expect_equal(&State::f, "reduce");
    p.expect_equal(device.strain_energy(*b.u), exact.strain_energy(*a.u), exact.strain_energy(*a.u), "strain energy");
    p.expect_equal(device.largest_displacement(*b.u), exact.largest_displacement(*a.u), exact.largest_displacement(*a.u), "largest displacement");
    // At rest, where every backend has the same displacement to the last bit: the condition of the coarse matrix magnifies others.
    if (p.two_level) p.all([](State& s) { s.mechanics->clear(*s.g), s.mechanics->assemble_coarse(*s.g); });
    p.all([](State& s) { s.mechanics->precondition(*s.f, *s.g); });
    p.expect_equal(&State::g, "precondition", true);
    p.all([](State& s) { s.mechanics->multiply_by_diagonal(*s.v, *s.g); });
    p.expect_equal(&State::g, "multiply by the diagonal");
    p.all([](State& s) { s.mechanics->combine(*s.v, 0.5, *s.u, -2); });
    p.expect_equal(&State::v, "combine");
  });
}

TEST_P(Calls, CountPointsInsideOut) {
  each([&](Parity& p) {
    std::vector<Vec3d> u = rough_displacement(p.model, 1);
    for (std::size_t s = 0; s < u.size(); ++s) u[s].x *= p.model.position[s].x > 20 ? -10 : 1;
    p.all([&](State& s) { s.mechanics->upload(u, *s.u); });
    const VolumeRatioStatistics ratio = p.device.mechanics->force(*p.device.u, 1, *p.device.f), expected = p.exact.mechanics->force(*p.exact.u, 1, *p.exact.f);
    EXPECT_GT(expected.inverted, 0);
    EXPECT_EQ(ratio.inverted, expected.inverted);
    p.expect_equal(ratio.smallest, expected.smallest, std::abs(expected.smallest), "smallest volume ratio");
  });
}

/// Steps of the relaxation from rest: one, 13 and 40, over the end of a ramp; a device may repeat them in batches and a remainder.
struct Steps {
  explicit Steps(Parity& parity) : p(parity) {
    const VectorPointer rest = p.exact.mechanics->vector(), rough = p.exact.mechanics->vector();
    p.exact.mechanics->upload(rough_vector(p.model.active), *rough);
    if (p.two_level) p.all([](State& s) { s.mechanics->assemble_coarse(*s.u); });
    lambda = 1.4 * largest_eigenvalue(*p.exact.mechanics, *rest, 20, *rough);
    for (StepControl& c : control) c.ramp = 6, c.largest_increment = 1e3, c.factor = 3, c.tolerance = 1e-9, c.impatient_from = 1000;
  }
  void take(int count, double rho_of_device = rho) {
    int i = 0;
    p.all([&](State& s) { s.mechanics->steps(count, {&s == &p.device ? rho_of_device : rho, lambda}, control[i++], *s.u, *s.f, *s.g); });
  }
  void expect_equal(const char* what) const {
    p.expect_equal(&State::u, what, true);
    p.expect_equal(&State::f, what, true);
    p.expect_equal(&State::g, what, true);
    EXPECT_EQ(control[2].step, control[0].step);
    EXPECT_EQ(control[2].verdict, control[0].verdict);
    EXPECT_NEAR(control[2].largest, control[0].largest, p.tolerance(&State::f, true)) << what;
    EXPECT_NEAR(control[2].estimate, control[0].estimate, 3 * p.tolerance(&State::f, true) + 1e-6 * control[0].estimate) << what;
  }
  static constexpr double rho = 0.8;
  Parity& p;
  double lambda;
  StepControl control[3];
};

TEST_P(Calls, StepsAreThoseOfTheCpu) {
  each([&](Parity& p) {
    Steps steps(p);
    steps.take(1);
    steps.expect_equal("one step");
    steps.take(13);
    steps.expect_equal("14 steps");
    steps.take(40);
    steps.expect_equal("54 steps");
  });
}

TEST_P(Calls, StepsEndWhereTheControlSaysSo) {
  each([&](Parity& p) {
    Steps steps(p);
    for (StepControl& c : steps.control) c.impatient_from = 16;
    steps.take(40);
    EXPECT_EQ(steps.control[0].verdict, StepControl::impatient);
    EXPECT_EQ(steps.control[0].step, 17);
    steps.expect_equal("17 of 40 steps");
    steps.take(13);  // none of them
    EXPECT_EQ(steps.control[2].step, 17);
    steps.expect_equal("and no more");
  });
}

TEST_P(Calls, AWrongDampingIsSeen) {
  each([&](Parity& p) {
    Steps steps(p);
    steps.take(13, 1.01 * Steps::rho);
    EXPECT_GT(p.difference(&State::u), p.tolerance(&State::u, true));
  });
}

/// Large in the sense of backends.hpp: thousands of steps.
class LargeSolutions : public testing::TestWithParam<std::tuple<Kind, Relaxation, Backend>> {
 protected:
  void SetUp() override { backends::skip_without_device(backend); }
  const Relaxation relaxation = std::get<1>(GetParam());
  const Backend backend = std::get<2>(GetParam());
  const Problem problem{std::get<0>(GetParam()), MaterialModel::neo_hookean};
};
std::string name_of_solutions(const testing::TestParamInfo<LargeSolutions::ParamType>& info) {
  const auto [kind, relaxation, backend] = info.param;
  return concatenate(kind_name[int(kind)], relaxation == Relaxation::plain ? "_plain_" : "_two_level_", backends::name(backend));
}
INSTANTIATE_TEST_SUITE_P(On, LargeSolutions,
                         testing::Combine(testing::Values(Kind::lattice, Kind::gap, Kind::cloud), testing::Values(Relaxation::plain, Relaxation::two_level), backends::device_backends), name_of_solutions);

TEST_P(LargeSolutions, AreThoseOfTheCpuWithinTheTolerances) {
  for (const bool double_precision : {false, true})
    for (const double tolerance : {0.1, 0.001}) {
      SolverOptions options = problem.options(relaxation, double_precision);
      options.tolerance_mm = tolerance;
      const Solution expected = problem.solve(options, Backend::cpu), s = problem.solve(options, backend);
      SCOPED_TRACE(concatenate(tolerance, double_precision ? " mm, double, " : " mm, float, ", s.steps, " steps, ", expected.steps, " on the CPU"));
      EXPECT_TRUE(expected.converged && s.converged);
      EXPECT_LT(s.error_estimate_mm, tolerance);
      EXPECT_GT(largest(expected.displacement), 1);
      EXPECT_LT(largest_difference(s.displacement, expected.displacement), 2 * tolerance);
      EXPECT_EQ(problem.solve(options, backend).parameter, s.parameter) << "another run, other bits";
    }
}

}  // namespace
}  // namespace mtled
