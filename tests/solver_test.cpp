#include "core/shape_evaluator.hpp"
#include "core/solver.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <numbers>
#include <tuple>

#include "backends.hpp"
#include "core/motion.hpp"
#include "core/parallel.hpp"
#include "core/stabilisation.hpp"
#include "scenes.hpp"

namespace mtled {
namespace {

using backends::Backend;
using scenes::Box;
using scenes::Scene;

constexpr double degree = std::numbers::pi / 180;
constexpr double h = 10;  ///< node spacing [mm]

double largest_difference(const std::vector<Vec3d>& a, const std::vector<Vec3d>& b) {
  double top = 0;
  for (std::size_t n = 0; n < a.size(); ++n) top = std::max(top, norm(a[n] - b[n]));
  return top;
}
double root_mean_square(const std::vector<Vec3d>& a, const std::vector<Vec3d>& b) {
  double sum = 0;
  for (std::size_t n = 0; n < a.size(); ++n) sum += squared_norm(a[n] - b[n]);
  return std::sqrt(sum / double(a.size()));
}

/// Equilibrium to a thousandth of what matters: the truth of the discrete problem.
SolverOptions tight(Relaxation relaxation = Relaxation::two_level) {
  SolverOptions options;
  options.relaxation = relaxation;
  options.tolerance_mm = 5e-4;  // a hundredth of the usual one
  options.double_precision = true;
  return options;
}
SolverOptions usual(Relaxation relaxation = Relaxation::two_level) {
  SolverOptions options;
  options.relaxation = relaxation;
  return options;
}

constexpr double promised_error = 0.1;  ///< [mm] true error at the usual stop, the purpose of the solver

/// A box with all surface nodes prescribed.
Scene surface_scene(const Box& box, bool jittered, const scenes::Displacement& displacement, const std::array<double, 3>& ratio = scenes::usual_ratio) {
  Scene scene;
  scene.cloud = jittered ? scenes::jittered_box(box) : scenes::lattice_box(box);
  scenes::prescribe(scene.cloud, scene.constraints, "surface", [&](const Vec3d& x) { return box.on_surface(x); }, displacement);
  scene.points = jittered ? scenes::box_points(box, scenes::uniform(1), 0.49, ratio)
                          : scenes::coupled_box_points(box, scene.cloud, scene.constraints, scenes::uniform(1), 0.49, ratio);
  return scene;
}
std::vector<Vec3d> exact(const Scene& scene, const scenes::Displacement& displacement) {
  std::vector<Vec3d> u;
  for (const Vec3d& x : scene.cloud.nodes) u.push_back(displacement(x));
  return u;
}

/// Cube pressed between clamped ends.
Scene clamped_cube(double move = -10, bool jittered = false) {
  const Box box{{8, 8, 9}, h};
  Scene scene;
  scene.cloud = jittered ? scenes::jittered_box(box) : scenes::lattice_box(box);
  scenes::prescribe(scene.cloud, scene.constraints, "bottom", scenes::below(2, 0), scenes::nowhere);
  scenes::prescribe(scene.cloud, scene.constraints, "top", scenes::above(2, box.length(2)), [=](const Vec3d&) { return Vec3d{3, 0, move}; });
  scene.points = jittered ? scenes::box_points(box, scenes::uniform(1)) : scenes::coupled_box_points(box, scene.cloud, scene.constraints, scenes::uniform(1));
  return scene;
}

/// Bar with a soft pocket (1 : 8), bent and pulled.
Scene bar_with_pocket() {
  const Box box{{6, 6, 16}, h};
  Scene scene;
  scene.cloud = scenes::lattice_box(box);
  scenes::prescribe(scene.cloud, scene.constraints, "bottom", scenes::below(2, 0), scenes::nowhere);
  const RigidMotion motion{{30, 30, 160}, rotation_matrix({0, 15 * degree, 0}), {15, 0, 5}};
  scenes::prescribe(scene.cloud, scene.constraints, "top", scenes::above(2, box.length(2)), [=](const Vec3d& x) { return motion.displacement(x); });
  scene.points = scenes::coupled_box_points(box, scene.cloud, scene.constraints, [](const Vec3d& x) { return norm(x - Vec3d{40, 30, 80}) < 25 ? 0.5 : 4.0; });
  return scene;
}

/// A wide body on a thin column of prescribed nodes near one side, whose upper half bends: the body swings after it.
Scene body_on_a_spine() {
  const Box box{{16, 12, 12}, h};
  Scene scene;
  scene.cloud = scenes::lattice_box(box);
  const auto spine = [](const Vec3d& x) { return std::abs(x.x - 25) < 6 && std::abs(x.y - 65) < 6; };
  const RigidMotion upper{{25, 65, 60}, rotation_matrix({8 * degree, 10 * degree, 0}), {0, 0, 0}};
  scenes::prescribe(scene.cloud, scene.constraints, "lower", [=](const Vec3d& x) { return spine(x) && x.z < 51; }, scenes::nowhere);
  scenes::prescribe(scene.cloud, scene.constraints, "upper", [=](const Vec3d& x) { return spine(x) && x.z > 69; }, [=](const Vec3d& x) { return upper.displacement(x); });
  scene.points = scenes::coupled_box_points(box, scene.cloud, scene.constraints, scenes::uniform(1));
  return scene;
}

struct Affine {
  Mat3d gradient;
  Vec3d operator()(const Vec3d& x) const { return gradient * x; }
  double energy_density(double shear_modulus) const {
    Mat3d F = gradient;
    for (int i = 0; i < 3; ++i) F[i][i] += 1;
    return NeoHookean<double>{shear_modulus, bulk_modulus(shear_modulus, 0.49)}.energy(F);
  }
};
const Affine simple_shear{{{{0, 0.2, 0}, {0, 0, 0}, {0, 0, 0}}}};
const Affine general_affine{{{{0.05, 0.1, 0}, {-0.03, -0.06, 0.08}, {0.02, 0, 0.01}}}};

// An affine field is in equilibrium only if sum volume grad phi_I = 0 at every free node, which one point per background
// cell fulfils approximately: the patch test measures integration error alone. Measured: 0.12 mm on the lattice and
// 0.26 mm on the jittered cloud, of 16 mm moved, and four to five times less with 27 times as many points.
constexpr double patch_error_lattice = 0.015 * h, patch_error_jittered = 0.03 * h;

class PatchTest : public testing::TestWithParam<std::tuple<bool, Backend>> {
 protected:
  void SetUp() override { backends::skip_without_device(std::get<1>(GetParam())); }
  Solution solve(const Scene& scene, const SolverOptions& options) const { return scene.solve(options, backends::mechanics_of(std::get<1>(GetParam()))); }
  const bool jittered = std::get<0>(GetParam());
  const double tolerance = jittered ? patch_error_jittered : patch_error_lattice;
  const Box box{{8, 8, 9}, h};
};
std::string name_of_patch_test(const testing::TestParamInfo<PatchTest::ParamType>& info) { return (std::get<0>(info.param) ? "jittered_" : "lattice_") + backends::name(std::get<1>(info.param)); }
INSTANTIATE_TEST_SUITE_P(Clouds, PatchTest, testing::Combine(testing::Bool(), backends::every_backend), name_of_patch_test);

TEST_P(PatchTest, AffineMotionOfTheSurface) {
  for (const Affine& motion : {simple_shear, general_affine}) {
    const Scene scene = surface_scene(box, jittered, motion);
    const Solution s = solve(scene, tight());
    EXPECT_TRUE(s.converged);
    EXPECT_LT(largest_difference(s.displacement, exact(scene, motion)), tolerance);
    EXPECT_LT(root_mean_square(s.displacement, exact(scene, motion)), tolerance / 3);
    const double energy = box.volume() * motion.energy_density(1);
    EXPECT_NEAR(s.strain_energy, energy, 0.015 * energy);  // the field relaxes into the integration error
    EXPECT_LE(s.strain_energy, energy * (1 + 1e-6));       // the affine field itself is admissible
  }
}

TEST_P(PatchTest, SeesWrongVolumes) {
  Scene scene = surface_scene(box, jittered, simple_shear);
  for (std::size_t p = 0; p < scene.points.size(); p += 10) scene.points.volume[p] *= 2;
  const Solution s = solve(scene, tight());
  EXPECT_GT(largest_difference(s.displacement, exact(scene, simple_shear)), tolerance);
}

TEST_P(PatchTest, RigidMotionOfTheSurface) {
  // Exact whatever the integration, since every point is free of stress.
  const RigidMotion turn{{0, 50, 20}, rotation_matrix({0.3, -0.2, 0.4}), {5, -8, 3}};
  const auto motion = [&](const Vec3d& x) { return turn.displacement(x); };
  const Scene scene = surface_scene(box, jittered, motion);
  const Solution s = solve(scene, tight());
  const double shear_energy = box.volume() * simple_shear.energy_density(1);
  EXPECT_LT(largest_difference(s.displacement, exact(scene, motion)), tight().tolerance_mm);
  EXPECT_NEAR(s.smallest_volume_ratio, 1, 1e-4);
  EXPECT_LT(s.strain_energy, 1e-8 * shear_energy);
  EXPECT_LT(norm(s.reactions.at("surface")), 1e-2);  // [mN]; the shear's stress on one face is 1440 mN
  EXPECT_LT(largest_difference(solve(scene, usual()).displacement, exact(scene, motion)), usual().tolerance_mm);
}

TEST(Solver, FinerIntegrationLeavesLessErrorInThePatchTest) {
  for (const bool jittered : {false, true}) {
    const Box box{{8, 8, 9}, h};
    const Scene usual_points = surface_scene(box, jittered, simple_shear), fine = surface_scene(box, jittered, simple_shear, {0.25, 0.25, 0.25});
    const double error = largest_difference(usual_points.solve(tight()).displacement, exact(usual_points, simple_shear));
    EXPECT_LT(largest_difference(fine.solve(tight()).displacement, exact(fine, simple_shear)), error / 2);
  }
}

/// Stretch across a bar that is stretched by `along` and free at its sides, and the stress along it [kPa].
std::pair<double, double> free_bar(double along, const NeoHookean<double>& material) {
  const auto stress = [&](double across) {
    Mat3d F;
    F[0][0] = F[1][1] = across, F[2][2] = along;
    double J;
    return material.stress(F, J);
  };
  double low = 0.5, high = 2;
  for (int i = 0; i < 60; ++i) (stress((low + high) / 2)[0][0] < 0 ? low : high) = (low + high) / 2;
  return {low, stress(low)[2][2]};
}

/// A bar of shear modulus 2 kPa that is shortened by 15 % between rollers, and its homogeneous solution.
struct FreeBar {
  static constexpr double along = 0.85;
  const Box box{{8, 8, 9}, h};
  NeoHookean<double> material;
  double across, stress;
  Scene scene;
  Affine motion;

  explicit FreeBar(double poisson_ratio) : material{2, bulk_modulus(2, poisson_ratio)} {
    std::tie(across, stress) = free_bar(along, material);
    motion = {{{{across - 1, 0, 0}, {0, across - 1, 0}, {0, 0, along - 1}}}};
    scene.cloud = scenes::lattice_box(box);
    scenes::prescribe(scene.cloud, scene.constraints, "top", scenes::above(2, box.length(2)), motion, {false, false, true});
    scenes::prescribe(scene.cloud, scene.constraints, "bottom", scenes::below(2, 0), scenes::nowhere, {false, false, true});
    scenes::prescribe(scene.cloud, scene.constraints, "left", scenes::below(0, 0), scenes::nowhere, {true, false, false});
    scenes::prescribe(scene.cloud, scene.constraints, "front", scenes::below(1, 0), scenes::nowhere, {false, true, false});
    scene.points = scenes::coupled_box_points(box, scene.cloud, scene.constraints, scenes::uniform(2), poisson_ratio);
  }
  void expect_solution(const Solution& s) const {
    const double area = box.length(0) * box.length(1), force = std::abs(stress) * area;
    EXPECT_LT(largest_difference(s.displacement, exact(scene, motion)), patch_error_lattice);
    EXPECT_NEAR(s.reactions.at("top").z, stress * area, 0.01 * force);
    EXPECT_NEAR(s.reactions.at("bottom").z, -stress * area, 0.01 * force);
    EXPECT_NEAR(s.reactions.at("left").x, 0, 0.01 * force);
    Mat3d F;
    F[0][0] = F[1][1] = across, F[2][2] = along;
    const double energy = box.volume() * material.energy(F);
    EXPECT_NEAR(s.strain_energy, energy, 0.01 * energy);
  }
};

/// Problems with a known solution, on every backend.
class KnownSolution : public backends::EachBackend {
 protected:
  Solution solve(const Scene& scene, const SolverOptions& options) const { return scene.solve(options, backends::mechanics_of(GetParam())); }
};
INSTANTIATE_TEST_SUITE_P(On, KnownSolution, backends::every_backend, backends::backend_name);

TEST_P(KnownSolution, FrictionlessCompressionHasClosedForm) {
  const FreeBar compressible(0.3), nearly_incompressible(0.49);
  compressible.expect_solution(solve(compressible.scene, tight()));
  compressible.expect_solution(solve(compressible.scene, tight(Relaxation::plain)));
  nearly_incompressible.expect_solution(solve(nearly_incompressible.scene, tight(Relaxation::plain)));
}

// Diverges at about step 30 whatever its step size; 7 % of compression, and plain relaxation, do not. At the linear-elastic
// start the volume is 2 % too small, a pressure of the size of the shear modulus, so the tangent there may be indefinite.
TEST_P(KnownSolution, TwoLevelsManageFrictionlessCompression) {
  const FreeBar bar(0.49);
  bar.expect_solution(solve(bar.scene, tight()));
}

struct Problem {
  const char* name;
  Scene (*make)();
};
std::ostream& operator<<(std::ostream& out, const Problem& p) { return out << p.name; }

class Accuracy : public testing::TestWithParam<Problem> {};
INSTANTIATE_TEST_SUITE_P(Problems, Accuracy,
                         testing::Values(Problem{"ClampedCube", [] { return clamped_cube(); }}, Problem{"ClampedJitteredCube", [] { return clamped_cube(-10, true); }},
                                         Problem{"BarWithSoftPocket", [] { return bar_with_pocket(); }}, Problem{"BodyOnASpine", [] { return body_on_a_spine(); }}),
                         testing::PrintToStringParamName());

TEST_P(Accuracy, BothRelaxationsReachTheSameSolution) {
  const Scene scene = GetParam().make();
  const Solution two_level = scene.solve(tight()), plain = scene.solve(tight(Relaxation::plain));
  EXPECT_TRUE(two_level.converged && plain.converged);
  EXPECT_LT(largest_difference(two_level.displacement, plain.displacement), 4 * tight().tolerance_mm);
  EXPECT_NEAR(two_level.strain_energy, plain.strain_energy, 1e-6 * plain.strain_energy);
  for (const auto& [name, force] : plain.reactions) EXPECT_LT(norm(two_level.reactions.at(name) - force), 1e-3 * norm(force)) << name;
}

TEST_P(Accuracy, TrueErrorAtTheUsualStopOfTwoLevels) {
  const Scene scene = GetParam().make();
  const Solution truth = scene.solve(tight()), s = scene.solve(usual());
  EXPECT_TRUE(s.converged);
  EXPECT_LT(s.error_estimate_mm, usual().tolerance_mm);
  EXPECT_LT(largest_difference(s.displacement, truth.displacement), promised_error);
  // The linear-elastic solution, where relaxation starts, is not good enough to pass.
  SolverOptions one_step = usual();
  one_step.max_steps = 1;
  EXPECT_GT(largest_difference(scene.solve(one_step).displacement, truth.displacement), 2 * promised_error);
}

TEST_P(Accuracy, TrueErrorAtTheUsualStopOfPlainRelaxation) {
  const Scene scene = GetParam().make();
  SolverOptions options = usual(Relaxation::plain);
  options.double_precision = true;
  const Solution truth = scene.solve(tight()), s = scene.solve(options);
  EXPECT_TRUE(s.converged);
  EXPECT_LT(largest_difference(s.displacement, truth.displacement), promised_error);
}

TEST_P(Accuracy, FloatAndDoubleAgree) {
  const Scene scene = GetParam().make();
  SolverOptions single = usual();
  single.tolerance_mm = 0.005;
  EXPECT_LT(largest_difference(scene.solve(single).displacement, scene.solve(tight()).displacement), 0.02);
}

TEST_P(Accuracy, PrescribedNodesGetTheirValue) {
  const Scene scene = GetParam().make();
  const Solution s = scene.solve(usual());
  double largest_value = 0, worst = 0;
  for (std::size_t b = 0; b < scene.constraints.node.size(); ++b) {
    const Vec3d& value = scene.constraints.displacement[b];
    largest_value = std::max(largest_value, norm(value));
    worst = std::max(worst, norm(s.displacement[std::size_t(scene.constraints.node[b])] - value));
  }
  EXPECT_LT(worst, 1e-6 * largest_value);  // float rounding of some twenty parameters
}

TEST_P(Accuracy, ReactionsBalance) {
  const Solution s = GetParam().make().solve(tight());
  Vec3d sum{};
  double size = 0;
  for (const auto& [name, force] : s.reactions) sum += force, size = std::max(size, norm(force));
  EXPECT_GT(size, 1);
  EXPECT_LT(norm(sum), 1e-4 * size);  // what is left in the free nodes at the stop
}

TEST_P(Accuracy, IsTheSameBitsForAnyNumberOfThreads) {
  const Scene scene = GetParam().make();
  for (const Relaxation relaxation : {Relaxation::plain, Relaxation::two_level}) {
    SolverOptions options = usual(relaxation);
    options.max_steps = 250;
    const auto parameters = [&](int threads) {
      const ThreadLimit limit(threads);
      return scene.solve(options).parameter;
    };
    const auto one = parameters(1);
    for (int threads : {1, 2, 3}) EXPECT_EQ(parameters(threads), one) << threads << " threads";
  }
}

// In float the plain relaxation stops 0.6 mm short on this slow problem: its rho stays at 0.9924 where double finds 0.9972,
// presumably because the slowest mode's change over 40 steps drowns in rounding.
TEST(PlainRelaxation, TrueErrorInFloatOnASpine) {
  const Scene scene = body_on_a_spine();
  EXPECT_LT(largest_difference(scene.solve(usual(Relaxation::plain)).displacement, scene.solve(tight()).displacement), promised_error);
}

TEST_P(KnownSolution, WorkOfTheReactionsIsTheStrainEnergy) {
  // W(1) = int_0^1 R(s) . d ds over the load path s d, here by four Gauss points.
  constexpr double place[] = {0.0694318442, 0.3300094782, 0.6699905218, 0.9305681558}, weight[] = {0.1739274226, 0.3260725774, 0.3260725774, 0.1739274226};
  for (const bool jittered : {false, true}) {
    const Scene scene = clamped_cube(-10, jittered);
    double work = 0;
    for (int i = 0; i < 4; ++i) {
      Scene part = clamped_cube(-10, jittered);
      for (Vec3d& d : part.constraints.displacement) d = place[i] * d;
      work += weight[i] * dot(solve(part, tight()).reactions.at("top"), Vec3d{3, 0, -10});
    }
    const double energy = solve(scene, tight()).strain_energy;
    EXPECT_NEAR(work, energy, 1e-4 * energy) << (jittered ? "jittered" : "lattice");
  }
}

TEST(Solver, EnergyIsLeastAmongNeighbouringFields) {
  // Twice the tolerance away from the solution, the field of a coarser stop has more energy.
  const Scene scene = clamped_cube();
  EXPECT_LE(scene.solve(tight()).strain_energy, scene.solve(usual()).strain_energy * (1 + 1e-7));
}

TEST_P(KnownSolution, SmallLoadsGiveLinearElasticity) {
  // Twice a small load: twice the displacement, four times the energy, to the size of the strain (1e-4).
  const auto scaled = [&](double s) {
    Scene scene = clamped_cube();
    for (Vec3d& d : scene.constraints.displacement) d = s * d;
    SolverOptions options = tight();
    options.tolerance_mm = 1e-8;
    return solve(scene, options);
  };
  const Solution one = scaled(1e-3), two = scaled(2e-3);
  std::vector<Vec3d> doubled = one.displacement;
  for (Vec3d& u : doubled) u = 2.0 * u;
  EXPECT_LT(largest_difference(two.displacement, doubled), 1e-3 * 0.02);
  EXPECT_NEAR(two.strain_energy / one.strain_energy, 4, 4e-3);
}

TEST(Solver, TheModulusScalesForcesButNotTheField) {
  Scene soft = clamped_cube(), hard = clamped_cube();
  for (std::size_t p = 0; p < hard.points.size(); ++p) hard.points.shear_modulus[p] *= 1000, hard.points.bulk_modulus[p] *= 1000;
  const Solution a = soft.solve(tight()), b = hard.solve(tight());
  EXPECT_LT(largest_difference(a.displacement, b.displacement), 2 * tight().tolerance_mm);
  EXPECT_NEAR(b.reactions.at("top").z / a.reactions.at("top").z, 1000, 0.1);
}

TEST(Solver, DisplacementAtIsTheFieldBetweenNodes) {
  const Scene scene = clamped_cube();
  const Solution s = scene.solve(usual());
  const ShapeEvaluator evaluator = scene.evaluator();
  Vec3d u;
  for (std::size_t n = 0; n < scene.cloud.size(); n += 7) {
    ASSERT_TRUE(displacement_at(evaluator, s.parameter, scene.cloud.nodes[n], u));
    EXPECT_LT(norm(u - s.displacement[n]), 1e-12);
  }
  // In the middle of the clamped top face the field is that of the face, also between nodes.
  ASSERT_TRUE(displacement_at(evaluator, s.parameter, {33, 47, 90}, u));
  EXPECT_LT(norm(u - Vec3d{3, 0, -10}), 1e-5);
  EXPECT_FALSE(displacement_at(evaluator, s.parameter, {500, 0, 0}, u));
}

TEST(Solver, ReportsWhatItDid) {
  const Scene scene = clamped_cube();
  int calls = 0, last_step = 0;
  SolverOptions options = usual();
  options.progress = [&](const Progress& p) {
    ++calls;
    EXPECT_GE(p.step, last_step);
    last_step = p.step;
  };
  const Solution s = scene.solve(options);
  EXPECT_GT(calls, 1);
  EXPECT_EQ(last_step, s.steps);
  EXPECT_EQ(s.points, scene.points.size());
  EXPECT_GT(s.force_evaluations, s.steps);
  EXPECT_GT(s.coarse_unknowns, 0u);
  EXPECT_GT(s.bytes, 0);
  EXPECT_EQ(s.dropped_points, 0u);
  ASSERT_FALSE(s.history.empty());
  EXPECT_EQ(s.history.back().step, s.steps);
  EXPECT_DOUBLE_EQ(s.history.back().error_estimate_mm, s.error_estimate_mm);
  EXPECT_EQ(s.inverted_points, 0u);
  EXPECT_GT(s.smallest_volume_ratio, 0.8);
  EXPECT_LT(s.smallest_volume_ratio, 1);
}

TEST(Solver, PointsWithoutASupportGiveTheirVolumeToTheNearest) {
  Scene with_stray = clamped_cube(), with_more = clamped_cube();
  scenes::add_point(with_stray.points, {40, 40, 200}, 77, 1, 0.49);
  std::size_t nearest = 0;
  for (std::size_t p = 0; p < with_more.points.size(); ++p)
    if (norm(with_more.points.position[p] - Vec3d{40, 40, 200}) < norm(with_more.points.position[nearest] - Vec3d{40, 40, 200})) nearest = p;
  with_more.points.volume[nearest] += 77;
  const Solution a = with_stray.solve(usual()), b = with_more.solve(usual());
  EXPECT_EQ(a.dropped_points, 1u);
  EXPECT_LT(largest_difference(a.displacement, b.displacement), 1e-4);
  EXPECT_NEAR(a.strain_energy, b.strain_energy, 1e-5 * b.strain_energy);
}

class SolverErrors : public testing::TestWithParam<Relaxation> {
 protected:
  /// Message of the error that solving ends with; checks its kind.
  std::string error(const Scene& scene, Failure expected = Failure::input) const {
    Failure failure{};
    const std::string message = scenes::error_of([&] { scene.solve(usual(GetParam())); }, &failure);
    EXPECT_EQ(failure, expected) << message;
    return message;
  }
};
INSTANTIATE_TEST_SUITE_P(Relaxations, SolverErrors, testing::Values(Relaxation::plain, Relaxation::two_level),
                         [](const auto& r) { return r.param == Relaxation::plain ? "plain" : "two_level"; });

bool mentions(const std::string& message, const char* part) { return message.find(part) != std::string::npos; }

TEST_P(SolverErrors, NothingPrescribed) {
  Scene scene = clamped_cube();
  scene.constraints = {};
  EXPECT_TRUE(mentions(error(scene), "no prescribed displacements"));
}

TEST_P(SolverErrors, RigidMotionsLeftFree) {
  const auto message = [&](const scenes::Region& where, std::array<bool, 3> fixed) {
    Scene scene = clamped_cube();
    scene.constraints = {};
    scenes::prescribe(scene.cloud, scene.constraints, "few", where, scenes::nowhere, fixed);
    return error(scene);
  };
  EXPECT_TRUE(mentions(message([](const Vec3d& x) { return norm(x) < 1; }, {true, true, true}), "leave 3 rigid motions"));
  EXPECT_TRUE(mentions(message([](const Vec3d& x) { return x.x < 1 && x.y < 1; }, {true, true, true}), "leave 1 rigid motions"));
  EXPECT_TRUE(mentions(message(scenes::below(2, 0), {false, false, true}), "leave 3 rigid motions"));
}

TEST_P(SolverErrors, ARoundedSetOfRollersHoldsTheBody) {
  // Six components at three corners: just enough.
  Scene scene = clamped_cube();
  scene.constraints = {};
  const auto corner = [](double x, double y) { return [=](const Vec3d& p) { return norm(p - Vec3d{x, y, 0}) < 1; }; };
  scenes::prescribe(scene.cloud, scene.constraints, "a", corner(0, 0), scenes::nowhere);
  scenes::prescribe(scene.cloud, scene.constraints, "b", corner(80, 0), scenes::nowhere, {false, true, true});
  scenes::prescribe(scene.cloud, scene.constraints, "c", corner(0, 80), scenes::nowhere, {false, false, true});
  const Solution s = scene.solve(tight(GetParam()));
  EXPECT_LT(largest_difference(s.displacement, std::vector<Vec3d>(s.displacement.size())), tight().tolerance_mm);
}

TEST_P(SolverErrors, APartThatFloats) {
  const Box box{{12, 6, 6}, h};
  Scene scene;
  scene.cloud = scenes::on_lattice(scenes::cell_corners(box, [](const std::array<int, 3>& c) { return c[0] < 4 || c[0] > 8; }), h);
  scenes::prescribe(scene.cloud, scene.constraints, "left", scenes::below(0, 0), scenes::nowhere);
  const IntegrationPoints all = scenes::box_points(box, scenes::uniform(1));
  for (std::size_t p = 0; p < all.size(); ++p)
    if (all.position[p].x < 40 || all.position[p].x > 90) scenes::add_point(scene.points, all.position[p], all.volume[p], 1, 0.49);
  EXPECT_TRUE(mentions(error(scene), "could float away"));
}

TEST_P(SolverErrors, EveryNodePrescribed) {
  Scene scene = clamped_cube();
  scene.constraints = {};
  scenes::prescribe(scene.cloud, scene.constraints, "all", scenes::all_of_it(), scenes::nowhere);
  EXPECT_NE(scenes::error_of([&] { scene.solve(usual(GetParam())); }), "");
}

TEST_P(SolverErrors, PointsFarFromAllNodes) {
  Scene scene = clamped_cube();
  scene.points = {};
  scenes::add_point(scene.points, {500, 500, 500}, 100, 1, 0.49);
  EXPECT_TRUE(mentions(error(scene), "no integration point has enough nodes"));
}

TEST_P(SolverErrors, ABodyTurnedInsideOut) {
  const Scene scene = clamped_cube(-110);  // the top goes through the bottom
  EXPECT_NE(error(scene, Failure::numerical), "");
}

TEST_P(KnownSolution, BlocksOnBothSidesOfASlitMoveApartFreely) {
  // One layer of cells is empty. The upper block is moved by its top: that takes no energy, unless the slit is bridged.
  const Box box{{5, 5, 9}, h};
  const auto kept = [](const std::array<int, 3>& c) { return c[2] != 4; };
  Scene scene;
  scene.cloud = scenes::on_lattice(scenes::cell_corners(box, kept), h);
  scene.points = scenes::box_points(box, scenes::uniform(1), 0.49, scenes::usual_ratio, [&](const std::array<int, 3>& c) { return kept(c) ? scenes::CellKind::free : scenes::CellKind::absent; });
  const Vec3d away{2, 0, 5};
  scenes::prescribe(scene.cloud, scene.constraints, "bottom", scenes::below(2, 0), scenes::nowhere);
  scenes::prescribe(scene.cloud, scene.constraints, "top", scenes::above(2, 9 * h), [&](const Vec3d&) { return away; });
  const double bridged = solve(scene, tight()).strain_energy;
  mark_body_cells(scene.cloud, scene.points);
  const Solution s = solve(scene, tight());
  EXPECT_LT(largest_difference(s.displacement, exact(scene, [&](const Vec3d& x) { return x.z < 4.5 * h ? Vec3d{} : away; })), tight().tolerance_mm);
  EXPECT_LT(s.strain_energy, 1e-6 * bridged);
  const double solid_bar = 3 * 25 * h * h * 25 / (2 * 9 * h);  // Young's modulus * area * stretch^2 / (2 length) [mN mm]
  EXPECT_GT(bridged, 0.5 * solid_bar) << "without knowledge of the cells the slit is as good as solid";
}

constexpr std::array<double, 3> too_few{1.3, 1.3, 1.4};  ///< integration cells in node spacings: 0.42 points per node

/// A clamped cube of irregular nodes with few integration points; `points`: another set of integration cells.
Scene sparse_cube(const std::array<double, 3>& cells) {
  Scene scene = clamped_cube(-10, true);
  scene.points = scenes::box_points({{8, 8, 9}, h}, scenes::uniform(1), 0.49, cells);
  return scene;
}

TEST(Stabilisation, PointsPerNodeAreThoseOfTheCells) {
  for (const double edge : {1.0, 1.25, 0.5}) {
    const Box box{{10, 10, 10}, h};
    Scene scene;
    scene.cloud = scenes::lattice_box(box);
    scene.points = scenes::box_points(box, scenes::uniform(1), 0.49, {edge, edge, edge});
    const SlotLayout layout = make_slot_layout(scene.cloud, 1);
    const std::vector<double> per_node = points_per_node(build_supports(scene.evaluator(), layout, scene.points), layout, scene.points);
    const double wanted = 1 / (edge * edge * edge);
    for (std::size_t n = 0; n < per_node.size(); ++n) {
      const bool inside = !box.on_surface(scene.cloud.nodes[n]);  // volumes of nodes vary by where the points lie
      EXPECT_NEAR(per_node[n], wanted, (inside ? 0.25 : 0.36) * wanted) << edge << ", node " << n;
    }
  }
}

TEST(Stabilisation, FewPointsAreNoticedAndEnoughAreNot) {
  const auto few = [](const Solution& s) { return std::count_if(s.points_per_node.begin(), s.points_per_node.end(), [](double n) { return n < enough_points_per_node; }); };
  SolverOptions quick = usual();
  quick.max_steps = 1;
  EXPECT_EQ(few(clamped_cube().solve(quick)), 0);
  EXPECT_EQ(few(clamped_cube(-10, true).solve(quick)), 0);
  EXPECT_GT(few(sparse_cube(too_few).solve(quick)), 700) << "of 810; the last cells along an axis are cut, and small";
}

TEST(Stabilisation, CuresWhatTooFewPointsDoNotSee) {
  SolverOptions plain = usual(), cured = usual();
  cured.stabilisation = 2;
  const std::vector<Vec3d> truth = clamped_cube(-10, true).solve(plain).displacement;
  const double without = root_mean_square(sparse_cube(too_few).solve(plain).displacement, truth), with = root_mean_square(sparse_cube(too_few).solve(cured).displacement, truth);
  EXPECT_GT(without, 4) << "visibly wrong: nearly half of the motion of 10.4 mm";
  EXPECT_LT(with, 0.8);
  const double once = root_mean_square(sparse_cube({1, 1, 1}).solve(plain).displacement, truth), once_with = root_mean_square(sparse_cube({1, 1, 1}).solve(cured).displacement, truth);
  EXPECT_LT(once_with, 0.6 * once) << "one point per node";
  std::printf("[          ] rms %.3f -> %.3f mm at 0.42 points per node, %.3f -> %.3f mm at 1\n", without, with, once, once_with);
}

TEST(Stabilisation, LeavesLinearFieldsFreeAndHoldsOscillatingOnes) {
  const Scene scene = sparse_cube(too_few);
  const ShapeEvaluator field = scene.evaluator();
  const SlotLayout layout = make_slot_layout(scene.cloud, 1);
  const SupportTable supports = build_supports(field, layout, scene.points);
  Springs springs;
  add_stabilisation(field, supports, layout, scene.points, points_per_node(supports, layout, scene.points), 2, springs);
  EXPECT_GT(springs.size(), 700u);
  const auto largest_stretch = [&](const auto& displacement) {
    double largest = 0;
    for (std::size_t r = 0; r < springs.size(); ++r) {
      double q = 0;
      for (std::size_t e = springs.begin[r]; e < springs.begin[r + 1]; ++e) q += springs.coefficient[e] * displacement(springs.node[e]);
      largest = std::max(largest, std::abs(q));
    }
    return largest;
  };
  const auto linear = [&](int n) { const Vec3d& x = scene.cloud.nodes[std::size_t(n)]; return 3 + 0.3 * x.x - 0.2 * x.y + x.z; };
  EXPECT_LT(largest_stretch(linear), 1e-10 * 100) << "[mm]: rounding of displacements up to 100 mm";
  EXPECT_GT(largest_stretch([](int n) { return n % 2 ? 1 : -1; }), 1);
}

TEST(Solver, NoConvergenceIsNotCalledConvergence) {
  SolverOptions options = usual();
  options.max_steps = 50;
  EXPECT_FALSE(clamped_cube().solve(options).converged);
}

}  // namespace
}  // namespace mtled
