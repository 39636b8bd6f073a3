#include "core/dynamics.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "core/body_sampling.hpp"
#include "core/parallel.hpp"
#include "scenes.hpp"

namespace mtled {
namespace {

using scenes::Box;
using scenes::Scene;

constexpr double h = 10;          ///< node spacing [mm]
constexpr double mu = 2;          ///< shear modulus [kPa]
constexpr double density = 1e-6;  ///< of the scenes [kg/mm^3]
constexpr double balance_error = 1e-3;  ///< allowed, of the energies; smooth runs show 1e-5 to 2e-4, by the trapezoidal rule of the internal work

Scene box_scene(const Box& box, bool jittered, double poisson_ratio, const std::function<void(const Cloud&, Constraints&)>& hold = nullptr) {
  Scene scene;
  scene.cloud = jittered ? scenes::jittered_box(box) : scenes::lattice_box(box);
  if (hold) hold(scene.cloud, scene.constraints);
  scene.points = jittered ? scenes::box_points(box, scenes::uniform(mu), poisson_ratio)
                          : scenes::coupled_box_points(box, scene.cloud, scene.constraints, scenes::uniform(mu), poisson_ratio);
  return scene;
}
auto held_at_bottom(const Vec3d& top_move = {}, double top = 1e9) {
  return [=](const Cloud& cloud, Constraints& constraints) {
    scenes::prescribe(cloud, constraints, "bottom", scenes::below(2, 0), scenes::nowhere);
    if (top < 1e9) scenes::prescribe(cloud, constraints, "top", scenes::above(2, top), [=](const Vec3d&) { return top_move; });
  };
}

/// Forces on the face z = `at`, `traction` [kPa] times its area, at the centres of squares of half a spacing.
void add_traction(Loads& loads, const Box& box, double at, const Vec3d& traction, const std::string& set = "traction") {
  loads.set_names.push_back(set);
  const double part = h / 2;
  for (int j = 0; j < 2 * box.cells[1]; ++j)
    for (int i = 0; i < 2 * box.cells[0]; ++i)
      loads.place.push_back({(i + 0.5) * part, (j + 0.5) * part, at}), loads.force.push_back((part * part) * traction), loads.set.push_back(int(loads.set_names.size()) - 1);
}

struct Motion {
  DynamicsResult result;
  std::vector<DynamicsFrame> frames;
  Vec3d displacement(const Approximation& field, const Vec3d& x, std::size_t frame) const {
    Vec3d u;
    EXPECT_TRUE(displacement_at(field, frames[frame].parameter, x, u));
    return u;
  }
};
Motion move(const Scene& scene, const Loads& loads, DynamicsOptions options) {
  Motion run;
  options.observe = [&](const DynamicsFrame& frame) { run.frames.push_back(frame); };
  run.result = run_dynamics(scene.evaluator(), scene.points, scene.constraints, {}, loads, options);
  return run;
}
DynamicsOptions for_seconds(double duration, int outputs = 1) {
  DynamicsOptions options;
  options.duration = duration;
  options.output_every = duration / outputs;
  return options;
}

Vec3d momentum(const std::vector<double>& mass, const DynamicsFrame& frame) {
  Vec3d sum{};
  for (std::size_t n = 0; n < mass.size(); ++n) sum += mass[n] * frame.velocity_parameter[n];
  return sum;
}
/// Times when the values pass `level`, by linear interpolation.
std::vector<double> crossings(const std::vector<double>& time, const std::vector<double>& value, double level) {
  std::vector<double> at;
  for (std::size_t i = 1; i < time.size(); ++i)
    if ((value[i - 1] < level) != (value[i] < level)) at.push_back(time[i - 1] + (level - value[i - 1]) / (value[i] - value[i - 1]) * (time[i] - time[i - 1]));
  return at;
}

TEST(History, IsLinearOrSmoothBetweenRowsAndConstantOutside) {
  History history{{1, 2, 4}, {0, 1, -1}, false};
  for (const auto& [t, factor] : std::vector<std::pair<double, double>>{{0, 0}, {1, 0}, {1.25, 0.25}, {2, 1}, {3.5, -0.5}, {4, -1}, {9, -1}}) EXPECT_DOUBLE_EQ(history.at(t), factor) << t;
  history.smooth = true;
  for (const double t : {1.0, 1.5, 2.0, 3.0, 4.0}) EXPECT_DOUBLE_EQ(history.at(t), History(history.time, history.factor, false).at(t)) << t;
  const double e = 1e-3;
  for (const double t : {1.0, 2.0, 4.0}) EXPECT_LT(std::abs(history.at(t + e) - history.at(t)) + std::abs(history.at(t - e) - history.at(t)), 60 * e * e * e) << "no velocity, no acceleration at " << t;
}

TEST(LumpedMass, KeepsMassAndCentreAndIsPositiveAtOuterNodes) {
  Mask body(Grid{{49, 49, 49}, {-24, -24, -24}, {1, 1, 1}});
  for (int k = 0; k < 49; ++k)
    for (int j = 0; j < 49; ++j)
      for (int i = 0; i < 49; ++i) body.at(i, j, k) = norm(body.grid.point(i, j, k) - Vec3d{0.3, -0.7, 0.4}) < 20;
  SamplingOptions options;
  for (const double spacing : {4.0, 5.5, 7.0}) {
    options.node_spacing_mm = spacing;
    const SampledBody ball = sample_body(body, Image(body.grid, 1.0f), LabelImage(body.grid), {}, options);
    const Scene scene{ball.cloud, {}, ball.points};
    const std::vector<double> mass = lumped_mass(scene.evaluator(), scene.points);
    double total = 0, points = 0;
    Vec3d moment{}, moment_of_points{};
    for (std::size_t n = 0; n < mass.size(); ++n) total += mass[n], moment += mass[n] * scene.cloud.nodes[n];
    for (std::size_t p = 0; p < scene.points.size(); ++p) {
      const double m = scene.points.density[p] * scene.points.volume[p];
      points += m, moment_of_points += m * scene.points.position[p];
    }
    EXPECT_NEAR(total, points, 1e-12 * points);
    EXPECT_LT(norm(moment - moment_of_points), 1e-12 * points * 20);
    EXPECT_GT(*std::min_element(mass.begin(), mass.end()), 0);
  }
}

TEST(Dynamics, FreeFall) {
  const Vec3d g{100, -300, -9810};
  Loads loads;
  loads.gravity = g;
  for (const bool jittered : {false, true}) {
    const Scene scene = box_scene({{3, 3, 3}, h}, jittered, 0.49);
    const Motion run = move(scene, loads, for_seconds(0.2, 4));
    ASSERT_EQ(run.frames.size(), 5u);
    for (const DynamicsFrame& frame : run.frames) {
      const double t = frame.entry.time;
      for (std::size_t n = 0; n < scene.cloud.size(); ++n) {
        EXPECT_LT(norm(frame.parameter[n] - (t * t / 2) * g), 1e-9 * norm(g) * 0.02);
        EXPECT_LT(norm(frame.velocity_parameter[n] - t * g), 1e-9 * norm(g) * 0.2);
      }
      EXPECT_LT(std::abs(frame.entry.balance_error()), 1e-9 * run.frames.back().entry.kinetic);
    }
  }
}

TEST(Dynamics, MomentumIsTheImpulseOfTheLoadsAndThenKept) {
  const Box box{{3, 3, 5}, h};
  for (const bool jittered : {false, true}) {
    const Scene scene = box_scene(box, jittered, 0.45);
    Loads loads;  // pulled at one end, off the centre: it flies, turns and swings
    loads.set_names = {"pull"};
    loads.place = {{5, 12, box.length(2) - 1}}, loads.force = {{60, 20, 40}}, loads.set = {0};
    DynamicsOptions options = for_seconds(0.2, 20);
    options.histories["pull"] = {{0, 0.02, 0.04, 0.06}, {0, 1, 1, 0}, false};  // area 0.04 s
    const Motion run = move(scene, loads, options);
    const std::vector<double> mass = lumped_mass(scene.evaluator(), scene.points);
    const Vec3d expected = 0.04 * loads.force[0];
    const Vec3d flown = momentum(mass, run.frames[10]);
    // The trapezoidal rule of the steps misses the kinks of the history by at most slope * dt^2 / 8 each.
    EXPECT_LT(norm(flown - expected), 4.0 / 8 * norm(loads.force[0]) / 0.02 * run.result.time_step * run.result.time_step);
    for (std::size_t i = 10; i < run.frames.size(); ++i) EXPECT_LT(norm(momentum(mass, run.frames[i]) - flown), 1e-11 * norm(flown));
    EXPECT_GT(run.result.history.back().strain, 1) << "it swings";
    EXPECT_LT(run.result.largest_balance_error, balance_error);
  }
}

TEST(Dynamics, DampingSlowsAFreeBody) {
  const double damping = 20;
  const Scene scene = box_scene({{3, 3, 3}, h}, true, 0.4);
  Loads loads;
  loads.gravity = {0, 0, 1000};
  DynamicsOptions options = for_seconds(0.3, 3);
  options.damping = damping;
  options.histories["gravity"] = {{0, 0.05, 0.1}, {1, 1, 0}, false};
  const Motion run = move(scene, loads, options);
  const std::vector<double> mass = lumped_mass(scene.evaluator(), scene.points);
  const double first = momentum(mass, run.frames[1]).z, last = momentum(mass, run.frames[3]).z, time = run.frames[3].entry.time - run.frames[1].entry.time;
  const double second_order = std::pow(damping * run.result.time_step, 2) / 12 * damping * time;  // of (2 - c dt) / (2 + c dt) per step
  EXPECT_NEAR(last / first, std::exp(-damping * time), 1.1 * second_order * std::exp(-damping * time));
  EXPECT_LT(run.result.largest_balance_error, balance_error);
}

TEST(Dynamics, BarUnderASuddenPullSwingsWithThePeriodOfLongitudinalWaves) {
  const Box box{{2, 2, 20}, h};
  for (bool jittered : {false, true}) {
    const Scene scene = box_scene(box, jittered, 0, held_at_bottom());
    const double young = 2 * mu, length = box.length(2), period = 4 * length / std::sqrt(young / density), traction = 1e-3 * young;
    Loads loads;
    add_traction(loads, box, length, {0, 0, traction});
    const Motion run = move(scene, loads, for_seconds(1.5 * period, 600));
    const ShapeEvaluator field = scene.evaluator();
    std::vector<double> time, tip;
    for (std::size_t i = 0; i < run.frames.size(); ++i) time.push_back(run.frames[i].entry.time), tip.push_back(run.displacement(field, {h, h, length}, i).z);
    const std::vector<double> at = crossings(time, tip, traction / young * length);
    ASSERT_EQ(at.size(), 3u);
    EXPECT_NEAR(at[2] - at[0], period, 0.02 * period);
  }
}

TEST(Dynamics, EnergyIsBalanced) {
  const Box box{{3, 3, 5}, h};
  for (int parts = 1; parts < 16; ++parts)
    for (bool jittered : {false, true}) {
      const bool motion = parts & 1, gravity = parts & 2, damping = parts & 4, force = parts & 8;
      if (parts == 4) continue;
      const Scene scene = box_scene(box, jittered, 0.45, held_at_bottom({2, 0, motion ? -6.0 : 0.0}, motion ? box.length(2) : 1e9));
      Loads loads;
      if (gravity) loads.gravity = {0, 2000, -9810};
      if (force) add_traction(loads, box, box.length(2) - h, {0.2, 0, 0.1});
      DynamicsOptions options = for_seconds(0.1, 50);
      if (damping) options.damping = 50;
      const Motion run = move(scene, loads, options);
      const DynamicsEntry& e = run.result.history.back();
      EXPECT_LT(run.result.largest_balance_error, balance_error) << "parts " << parts;
      EXPECT_GT(e.strain, 100) << "enough happens";
      EXPECT_EQ(e.work_of_motions != 0, motion);
      EXPECT_EQ(e.work_of_loads != 0, gravity || force);
      EXPECT_EQ(e.dissipated > 100, damping);
    }
}

/// Column between smooth walls: it stays uniform.
Scene confined_column(const Box& box, bool jittered, double poisson_ratio) {
  return box_scene(box, jittered, poisson_ratio, [&](const Cloud& cloud, Constraints& constraints) {
    scenes::prescribe(cloud, constraints, "floor", scenes::below(2, 0), scenes::nowhere, {false, false, true});
    scenes::prescribe(cloud, constraints, "x walls", [=](const Vec3d& x) { return x.x < 1e-6 || x.x > box.length(0) - 1e-6; }, scenes::nowhere, {true, false, false});
    scenes::prescribe(cloud, constraints, "y walls", [=](const Vec3d& x) { return x.y < 1e-6 || x.y > box.length(1) - 1e-6; }, scenes::nowhere, {false, true, false});
  });
}

TEST(Dynamics, ColumnUnderPressureSettlesAtTheClosedForm) {
  const Box box{{3, 3, 6}, h};
  const double nu = 0.3, pressure = 1.5, length = box.length(2);
  const NeoHookean<double> material{mu, bulk_modulus(mu, nu)};
  double low = 0.3, high = 1;  // stretch at which the nominal stress is -pressure
  for (int i = 0; i < 60; ++i) {
    Mat3d F = Mat3d::identity();
    double J;
    F[2][2] = (low + high) / 2;
    (material.stress(F, J)[2][2] < -pressure ? low : high) = F[2][2];
  }
  const double shortening = (1 - low) * length;
  for (const bool jittered : {false, true}) {
    const Scene scene = confined_column(box, jittered, nu);
    Loads loads;
    add_traction(loads, box, length, {0, 0, -pressure});
    DynamicsOptions options = for_seconds(1.0);
    options.damping = 40, options.safety = 0.4;  // the shock compresses twice as far, which is too much for 0.8
    const Motion run = move(scene, loads, options);
    const ShapeEvaluator field = scene.evaluator();
    const Vec3d top = run.displacement(field, {15, 15, length}, 1);
    const double area = box.length(0) * box.length(1);
    SolverOptions tight;
    tight.tolerance_mm = 1e-4, tight.double_precision = true;
    const Solution still = solve(field, scene.points, scene.constraints, tight, {}, loads);
    Vec3d still_top;
    ASSERT_TRUE(displacement_at(field, still.parameter, {15, 15, length}, still_top));
    const DynamicsEntry& e = run.result.history.back();
    EXPECT_LT(std::abs(top.z - still_top.z), 1e-3) << "the static solution";
    EXPECT_NEAR(e.reactions.at("floor").z, pressure * area, 1e-6 * pressure * area);
    EXPECT_NEAR(still.reactions.at("floor").z, pressure * area, 1e-3 * pressure * area);
    EXPECT_LT(e.kinetic, 1e-9 * e.strain);
    // One point per cell on a lattice without outer nodes errs by 0.1 %, on a rough cloud by a few per cent.
    EXPECT_NEAR(top.z, -shortening, (jittered ? 0.03 : 0.003) * shortening);
    EXPECT_LT(run.result.largest_balance_error, 0.01) << "a shock";
    options.safety = 0.2;
    EXPECT_LT(move(scene, loads, options).result.largest_balance_error, 0.3 * run.result.largest_balance_error) << "of second order in the step";
  }
}

TEST(Dynamics, ViscoelasticColumnCreepsAsAStandardLinearSolid) {
  const Box box{{3, 3, 6}, h};
  const double nu = 0.3, traction = 0.05, length = box.length(2), modulus = bulk_modulus(mu, nu) + 4 * mu / 3, alpha = 0.5, tau = 0.5;
  Scene scene = confined_column(box, false, nu);
  scene.points.prony = {{alpha, alpha, tau}};
  Loads loads;
  add_traction(loads, box, length, {0, 0, -traction});
  DynamicsOptions options = for_seconds(1.5, 3);
  options.damping = 40, options.safety = 0.95;
  const Motion run = move(scene, loads, options);
  const ShapeEvaluator field = scene.evaluator();
  for (std::size_t frame = 1; frame < run.frames.size(); ++frame) {
    // Relaxation modulus M (1 - alpha + alpha exp(-t / tau)).
    const double t = run.frames[frame].entry.time;
    const double strain = traction / modulus / (1 - alpha) * (1 - alpha * std::exp(-t * (1 - alpha) / tau));
    EXPECT_NEAR(-run.displacement(field, {15, 15, length}, frame).z, strain * length, 0.02 * strain * length) << "at " << t << " s";
  }
  EXPECT_TRUE(std::isnan(run.result.largest_balance_error)) << "memory is not in the balance";
  // The step is that of the moduli at once.
  Scene elastic = scene;
  elastic.points.prony.clear();
  EXPECT_NEAR(run.result.stable_time_step, move(elastic, loads, for_seconds(0.01)).result.stable_time_step, 1e-9);
}

TEST(Dynamics, WeightOfAColumn) {
  const Box box{{3, 3, 6}, h};
  const double nu = 0.3, length = box.length(2), modulus = bulk_modulus(mu, nu) + 4 * mu / 3;
  Loads loads;
  loads.gravity = {0, 0, -500};
  for (const bool jittered : {false, true}) {
    const Scene scene = confined_column(box, jittered, nu);
    const ShapeEvaluator field = scene.evaluator();
    SolverOptions tight;
    tight.tolerance_mm = 1e-4, tight.double_precision = true;
    for (auto relaxation : {Relaxation::two_level, Relaxation::plain}) {
      tight.relaxation = relaxation;
      const Solution still = solve(field, scene.points, scene.constraints, tight, {}, loads);
      Vec3d top;
      ASSERT_TRUE(displacement_at(field, still.parameter, {15, 15, length}, top));
      const double sag = density * 500 * length * length / 2 / modulus;
      EXPECT_TRUE(still.converged);
      EXPECT_NEAR(-top.z, sag, (jittered ? 0.04 : 0.01) * sag);
      EXPECT_NEAR(still.reactions.at("floor").z, density * box.volume() * 500, 1e-4 * density * box.volume() * 500);
    }
  }
}

TEST(Dynamics, ShearWavesInASlab) {
  const Box box{{2, 2, 20}, h};
  const Scene scene = box_scene(box, true, 0.3, [&](const Cloud& cloud, Constraints& constraints) {
    scenes::prescribe(cloud, constraints, "floor", scenes::below(2, 0), scenes::nowhere);
    scenes::prescribe(cloud, constraints, "all", scenes::all_of_it(), scenes::nowhere, {false, true, true});
  });
  const double length = box.length(2), period = 4 * length / std::sqrt(mu / density);
  Loads loads;
  add_traction(loads, box, length, {1e-3 * mu, 0, 0});
  const Motion run = move(scene, loads, for_seconds(1.5 * period, 600));
  const ShapeEvaluator field = scene.evaluator();
  std::vector<double> time, tip;
  for (std::size_t i = 0; i < run.frames.size(); ++i) time.push_back(run.frames[i].entry.time), tip.push_back(run.displacement(field, {h, h, length}, i).x);
  const std::vector<double> at = crossings(time, tip, 1e-3 * length);
  ASSERT_EQ(at.size(), 3u);
  EXPECT_NEAR(at[2] - at[0], period, 0.02 * period);
}

TEST(Dynamics, PrescribedMotionIsReproducedAtTheNodes) {
  const Box box{{3, 3, 5}, h};
  for (const bool jittered : {false, true}) {
    const Scene scene = box_scene(box, jittered, 0.45, held_at_bottom({4, -2, -6}, box.length(2)));
    DynamicsOptions options = for_seconds(0.1, 10);
    options.histories["top"] = {{0, 0.05, 0.08}, {0, 1, 0.5}, false};
    const Motion run = move(scene, {}, options);
    const ShapeEvaluator field = scene.evaluator();
    double worst = 0;
    for (std::size_t i = 0; i < run.frames.size(); ++i)
      for (std::size_t b = 0; b < scene.constraints.node.size(); ++b) {
        const double factor = scene.constraints.set[b] == 1 ? options.histories["top"].at(run.frames[i].entry.time) : 0;
        worst = std::max(worst, norm(run.displacement(field, scene.cloud.nodes[std::size_t(scene.constraints.node[b])], i) - factor * scene.constraints.displacement[b]));
      }
    EXPECT_LT(worst, 1e-9);
    EXPECT_LT(run.result.largest_balance_error, 0.01) << "kinks are jumps of velocity";
  }
}

TEST(Dynamics, ReactionsAreTheChangeOfMomentum) {
  const Box box{{3, 3, 5}, h};
  for (const bool jittered : {false, true}) {
    const Scene scene = box_scene(box, jittered, 0.45, held_at_bottom({4, -2, -6}, box.length(2)));
    const Motion run = move(scene, {}, for_seconds(0.1, 400));
    ASSERT_EQ(run.result.steps, 400) << "every step is an output";
    Vec3d impulse{}, last{};
    const std::vector<double> mass = lumped_mass(scene.evaluator(), scene.points);
    double largest = 0, worst = 0;
    for (std::size_t i = 0; i < run.frames.size(); ++i) {
      const Vec3d force = run.frames[i].entry.reactions.at("top") + run.frames[i].entry.reactions.at("bottom");
      if (i > 0) impulse += (run.result.time_step / 2) * (last + force);
      last = force;
      const Vec3d p = momentum(mass, run.frames[i]);
      largest = std::max(largest, norm(p)), worst = std::max(worst, norm(p - impulse));
    }
    EXPECT_LT(worst, 1e-10 * largest);
  }
}

TEST(Dynamics, SpringsAreInTheBalance) {
  const Box box{{3, 3, 5}, h};
  const Scene scene = box_scene(box, false, 0.45);
  const ShapeEvaluator field = scene.evaluator();
  Springs springs;
  springs.set_names = {"floor", "lid"};
  for (std::size_t n = 0; n < scene.cloud.size(); ++n) {
    const double z = scene.cloud.nodes[n].z;
    if (z > 1e-6 && z < box.length(2) - 1e-6) continue;
    ShapeFunctions shapes;
    ASSERT_TRUE(field.at(scene.cloud.nodes[n], shapes));
    springs.add(shapes.node, shapes.value, 50, z > 1 ? Vec3d{2, 0, -5} : Vec3d{}, z > 1);
  }
  DynamicsOptions options = for_seconds(0.1, 20);
  options.histories["lid"] = {{0, 0.06}, {0, 1}, false};
  const DynamicsResult result = run_dynamics(field, scene.points, {}, springs, {}, options);
  const DynamicsEntry& e = result.history.back();
  EXPECT_GT(e.springs, 0.01 * e.work_of_motions);
  EXPECT_LT(result.largest_balance_error, balance_error);
}

TEST(Dynamics, SameBitsForAnyThreads) {
  const Box box{{4, 4, 6}, h};
  for (const bool jittered : {false, true}) {
    const Scene scene = box_scene(box, jittered, 0.45, held_at_bottom({2, 0, -6}, box.length(2)));
    Loads loads;
    loads.gravity = {0, 0, -9810};
    std::vector<DynamicsFrame> last;
    for (const int threads : {1, 2}) {
      const ThreadLimit limit(threads);
      last.push_back(move(scene, loads, for_seconds(0.05)).frames.back());
    }
    EXPECT_EQ(last[0].parameter, last[1].parameter);
    EXPECT_EQ(last[0].velocity_parameter, last[1].velocity_parameter);
    EXPECT_EQ(last[0].entry.strain, last[1].entry.strain);
    EXPECT_EQ(last[0].entry.work_of_motions, last[1].entry.work_of_motions);
  }
}

TEST(Dynamics, RunsBelowTheStableStepAndReportsGrowthAboveIt) {
  const Box box{{3, 3, 4}, h};
  for (bool jittered : {false, true}) {
    const Scene scene = box_scene(box, jittered, 0.49, held_at_bottom());
    Loads loads;
    add_traction(loads, box, box.length(2), {0.001, 0, 0});
    DynamicsOptions options = for_seconds(1e-9);
    const double stable = move(scene, loads, options).result.stable_time_step;
    options.duration = 2000 * 0.99 * stable, options.output_every = 0, options.safety = 0.99;
    const Motion run = move(scene, loads, options);
    EXPECT_EQ(run.result.steps, 2000);
    EXPECT_LT(run.result.largest_balance_error, balance_error);
    options.safety = 1.05;
    Failure failure{};
    const std::string message = scenes::error_of([&] { move(scene, loads, options); }, &failure);
    EXPECT_NE(message.find("grows without bound at step"), std::string::npos) << message;
    EXPECT_EQ(failure, Failure::numerical);
  }
}

TEST(DynamicsErrors, SayWhatIsWrong) {
  const Box box{{3, 3, 4}, h};
  const Scene scene = box_scene(box, true, 0.45, held_at_bottom({1, 0, 0}, box.length(2)));
  const auto error = [&](const std::function<void(Loads&, DynamicsOptions&)>& spoil, Failure expected = Failure::input) {
    Loads loads;
    DynamicsOptions options = for_seconds(0.01);
    spoil(loads, options);
    Failure failure{};
    const std::string message = scenes::error_of([&] { move(scene, loads, options); }, &failure);
    EXPECT_EQ(failure, expected) << message;
    return message;
  };
  const auto has = [](const std::string& message, const std::vector<std::string>& parts) {
    for (const std::string& part : parts) EXPECT_NE(message.find(part), std::string::npos) << part << " is not in: " << message;
  };
  has(error([](Loads&, DynamicsOptions& o) { o.time_step = 0.01; }), {"time step of 0.01 s is not stable", "needs one below 0.00"});
  has(error([](Loads&, DynamicsOptions& o) { o.duration = 0; }), {"duration", "positive"});
  has(error([](Loads&, DynamicsOptions& o) { o.duration = 1e9; }), {"steps", "shorten"});
  has(error([](Loads&, DynamicsOptions& o) { o.damping = -1; }), {"damping", "negative"});
  has(error([](Loads&, DynamicsOptions& o) { o.histories["lid"] = {{0}, {0}, false}; }), {"history of 'lid'", "no set"});
  has(error([](Loads&, DynamicsOptions& o) { o.histories["top"] = {{0, 1}, {0.5, 1}, false}; }), {"'top' begins with a jump", "0.5"});
  has(error([](Loads& l, DynamicsOptions&) { l.set_names = {"top"}; }), {"'top' names a set of constraints and one of loads"});
  has(error([](Loads& l, DynamicsOptions&) { l.set_names = {"pull"}, l.set = {0}, l.place = {{0, 0, 900}}, l.force = {{1, 0, 0}}; }), {"row 0", "outside the body"});
  has(error([](Loads& l, DynamicsOptions& o) { l.gravity = {0, 0, 1e8}, o.duration = 1; }, Failure::numerical), {"grows without bound at step", "time"});
}

}  // namespace
}  // namespace mtled
