// Forces, memory and equilibrium of whole bodies of every material.
#include "core/cpu_forces.hpp"
#include "core/solver.hpp"

#include <gtest/gtest.h>

#include <limits>
#include <numbers>

#include "core/lanes.hpp"
#include "core/motion.hpp"
#include "core/parallel.hpp"
#include "core/point_material.hpp"
#include "scenes.hpp"

namespace mtled {
namespace {

using scenes::Box;
using scenes::Scene;

struct Law {
  const char* name;
  MaterialModel model;
  std::vector<double> further;
};
std::ostream& operator<<(std::ostream& out, const Law& law) { return out << law.name; }
const Law all_laws[] = {{"neo_hookean", MaterialModel::neo_hookean, {}},
                        {"mooney_rivlin", MaterialModel::mooney_rivlin, {0.4}},
                        {"yeoh", MaterialModel::yeoh, {0.5, 0.2}},
                        {"ogden", MaterialModel::ogden, {-4.7}},
                        {"transversely_isotropic", MaterialModel::transversely_isotropic, {3, 0, 0.6, 0.8}}};

void use_law(IntegrationPoints& points, const Law& law) {
  points.model = law.model;
  for (std::size_t p = 0; p < points.size(); ++p) points.further.insert(points.further.end(), law.further.begin(), law.further.end());
}

const double h = 5;
const Box box{{9, 8, 9}, h};  // no multiple of a block of slots or of a pack
// As in forces_test: sums of some 40 points * 40 terms; k / mu = 50 amplifies rounding of J.
template <class Real>
constexpr double force_rounding = 3000 * double(std::numeric_limits<Real>::epsilon());

double largest(const std::vector<Vec3d>& f) {
  double top = 0;
  for (const Vec3d& x : f) top = std::max(top, norm(x));
  return top;
}
std::vector<Vec3d> combine(double a, const std::vector<Vec3d>& f, double b, const std::vector<Vec3d>& g) {
  std::vector<Vec3d> sum(f.size());
  for (std::size_t n = 0; n < f.size(); ++n) sum[n] = a * f[n] + b * g[n];
  return sum;
}
double largest_difference(const std::vector<Vec3d>& f, const std::vector<Vec3d>& g) { return largest(combine(1, f, -1, g)); }

/// A smoothly deformed box, on the lattice (aligned packs) or jittered (gathered packs), with the modulus and the further
/// parameters varying from point to point.
struct Body {
  Cloud cloud;
  IntegrationPoints points;
  std::vector<Vec3d> u, v;
  Body(const Law& law, bool jittered) : cloud(jittered ? scenes::jittered_box(box) : scenes::lattice_box(box)) {
    points = scenes::box_points(box, [](const Vec3d& x) { return 2 + std::sin(x.x) * std::cos(x.y + x.z); });
    use_law(points, law);
    const bool fibres = law.model == MaterialModel::transversely_isotropic;
    for (std::size_t i = 0; i < points.further.size(); ++i)
      if (!fibres || i % 4 == 0) points.further[i] *= 1 + 0.3 * std::sin(double(i));
    for (const Vec3d& x : cloud.nodes) {
      const double s = 0.05;  // [1/mm]
      u.push_back({3 * std::sin(s * x.y), 2 * std::cos(s * x.z), 0.1 * x.z + 2 * std::sin(s * x.x)});
      v.push_back({std::cos(s * x.z + 1), 0.1 * std::sin(x.x), std::sin(s * (x.x + x.y))});
    }
  }
};

template <class Real>
struct Model {
  const Body& body;
  SlotLayout layout;
  SupportTable supports;
  CpuForces<Real> forces;
  Model(const Body& b, const IntegrationPoints& points)
      : body(b), layout(make_slot_layout(b.cloud, 1)), supports(build_supports(ShapeEvaluator(b.cloud, {}, {}), layout, points)), forces(supports, layout, points) {}
  explicit Model(const Body& b) : Model(b, b.points) {}
  NodalField<Real> field(const std::vector<Vec3d>& nodal) const {
    NodalField<Real> result(std::size_t(layout.num_slots));
    for (std::size_t n = 0; n < nodal.size(); ++n)
      for (int c = 0; c < 3; ++c) result.at(std::size_t(layout.slot_of_node[n]), c) = Real(nodal[n][c]);
    return result;
  }
  template <class Work>
  std::vector<Vec3d> nodal(Work&& work) const {
    NodalField<Real> f(std::size_t(layout.num_slots));
    work(f);
    std::vector<Vec3d> result(body.cloud.size());
    for (std::size_t n = 0; n < result.size(); ++n)
      for (int c = 0; c < 3; ++c) result[n][c] = double(f.at(std::size_t(layout.slot_of_node[n]), c));
    return result;
  }
  std::vector<Vec3d> force(const std::vector<Vec3d>& u) const {
    return nodal([&](NodalField<Real>& f) { forces.force(field(u), f); });
  }
  std::vector<Vec3d> tangent(const std::vector<Vec3d>& u, const std::vector<Vec3d>& v) const {
    return nodal([&](NodalField<Real>& f) { forces.tangent(field(u), field(v), f); });
  }
  std::vector<Vec3d> in_time(const std::vector<Vec3d>& u, double time_step) {
    return nodal([&](NodalField<Real>& f) { forces.force_in_time(field(u), time_step, f); });
  }
};

/// f_I = sum_points volume P(F) grad phi_I, or K v, in double, point after point.
std::vector<Vec3d> naive(const Body& body, const std::vector<Vec3d>& u, const std::vector<Vec3d>* along) {
  const ShapeEvaluator evaluator(body.cloud, {}, {});
  std::vector<Vec3d> f(body.cloud.size());
  ShapeFunctions s;
  for (std::size_t p = 0; p < body.points.size(); ++p) {
    EXPECT_TRUE(evaluator.at(body.points.position[p], s));
    Mat3d F = Mat3d::identity(), D;
    for (std::size_t i = 0; i < s.node.size(); ++i)
      for (int a = 0; a < 3; ++a)
        for (int b = 0; b < 3; ++b) {
          F[a][b] += u[std::size_t(s.node[i])][a] * s.gradient[i][b];
          if (along) D[a][b] += (*along)[std::size_t(s.node[i])][a] * s.gradient[i][b];
        }
    const Mat3d P = with_material<double>(body.points, p, [&](const auto& material) {
      double J;
      return along ? stress_derivative(material, F, D) : material.stress(F, J);
    });
    for (std::size_t i = 0; i < s.node.size(); ++i) f[std::size_t(s.node[i])] += body.points.volume[p] * (P * s.gradient[i]);
  }
  return f;
}

class Laws : public testing::TestWithParam<Law> {};
INSTANTIATE_TEST_SUITE_P(All, Laws, testing::ValuesIn(all_laws), [](const auto& law) { return std::string(law.param.name); });

TEST_P(Laws, ForcesAndTangentsEqualTheNaiveLoop) {
  for (const bool jittered : {false, true}) {
    const Body body(GetParam(), jittered);
    const std::vector<Vec3d> f = naive(body, body.u, nullptr), Kv = naive(body, body.u, &body.v);
    const Model<double> twice(body);
    const Model<float> single(body);
    EXPECT_LT(largest_difference(twice.force(body.u), f), force_rounding<double> * largest(f));
    EXPECT_LT(largest_difference(single.force(body.u), f), force_rounding<float> * largest(f));
    EXPECT_LT(largest_difference(twice.tangent(body.u, body.v), Kv), force_rounding<double> * largest(Kv));
    EXPECT_LT(largest_difference(single.tangent(body.u, body.v), Kv), force_rounding<float> * largest(Kv));
    Body other = body;  // parameters of the last point must arrive
    (other.points.further.empty() ? other.points.shear_modulus : other.points.further).back() *= 0.5;
    EXPECT_GT(largest_difference(naive(other, body.u, nullptr), f), 1e-12 * largest(f));
  }
}

TEST_P(Laws, ForcesInTimeAreTheSameBitsForAnyNumberOfThreads) {
  Body body(GetParam(), false);
  body.points.prony = {{0.3, 0, 0.1}, {0.2, 0.1, 2}};
  const auto bits = [&](int threads) {
    const ThreadLimit limit(threads);
    Model<float> model(body);
    model.in_time(body.u, 0.05);
    return std::pair(model.in_time(body.u, 0.05), model.force(body.u));
  };
  const auto one = bits(1);
  for (int threads : {1, 2, 3}) EXPECT_EQ(bits(threads), one) << threads << " threads";
}

/// A body held at a deformation, and the forces that the law of its memory is made of.
struct Held {
  Body body;
  std::vector<Vec3d> isochoric, volumetric;  ///< instantaneous
  explicit Held(const Law& law, bool jittered = false) : body(law, jittered) {
    const std::vector<Vec3d> all = Model<double>(body).force(body.u);
    IntegrationPoints stiffer = body.points;
    for (double& bulk : stiffer.bulk_modulus) bulk *= 2;
    volumetric = combine(1, Model<double>(body, stiffer).force(body.u), -1, all);
    isochoric = combine(1, all, -1, volumetric);
    body.points.prony = {{0.3, 0, 0.1}, {0.2, 0.4, 2}};
  }
  /// Forces when the shares of the two terms that have faded are given.
  std::vector<Vec3d> faded(double first, double second) const {
    return combine(1 - 0.3 * first - 0.2 * second, isochoric, 1 - 0.4 * second, volumetric);
  }
};

TEST_P(Laws, HeldStrainRelaxesAsTheDiscreteLaw) {
  for (const bool jittered : {false, true}) {
    const Held held(GetParam(), jittered);
    Model<double> model(held.body);
    ASSERT_TRUE(model.forces.viscoelastic());
    const double size = largest(held.isochoric) + largest(held.volumetric), tolerance = force_rounding<double> * size;
    EXPECT_LT(largest_difference(model.in_time(held.body.u, 0), held.faded(0, 0)), tolerance) << "at once";
    EXPECT_LT(largest_difference(model.in_time(held.body.u, 0), held.faded(0, 0)), tolerance) << "time stands still";
    const double step = 0.03;
    for (int n = 1; n <= 5; ++n) {
      const std::vector<Vec3d> expected = held.faded(1 - std::pow(0.1 / (0.1 + step), n), 1 - std::pow(2 / (2 + step), n));
      EXPECT_LT(largest_difference(model.in_time(held.body.u, step), expected), tolerance) << n;
      EXPECT_GT(largest_difference(held.faded(0, 0), expected), 1e6 * tolerance);
    }
    for (int n = 0; n < 20; ++n) model.in_time(held.body.u, 1e3);
    EXPECT_LT(largest_difference(model.in_time(held.body.u, 1e3), model.force(held.body.u)), tolerance) << "long-term moduli";
    EXPECT_LT(largest_difference(model.force(held.body.u), held.faded(1, 1)), tolerance);
  }
}

TEST(Memory, TendsToTheExponentialLawWithShorterSteps) {
  // Backward Euler: (tau / (tau + dt))^n - exp(-t / tau) is about t dt / (2 tau^2) exp(-t / tau), 1/2 dt / tau / e here.
  const Held held(all_laws[0]);
  const double t = 0.1;  // tau of the first term
  const std::vector<Vec3d> expected = held.faded(1 - std::exp(-1), 1 - std::exp(-t / 2));
  double last = 0;
  for (int steps : {50, 100}) {
    Model<double> model(held.body);
    std::vector<Vec3d> f;
    for (int n = 0; n < steps; ++n) f = model.in_time(held.body.u, t / steps);
    const double error = largest_difference(f, expected), bound = 0.3 * 0.5 / steps / std::numbers::e * largest(held.isochoric) + 0.4 * 0.5 * 0.05 * 0.05 / steps * largest(held.volumetric);
    EXPECT_LT(error, 1.1 * bound);
    if (last > 0) {
      EXPECT_NEAR(last / error, 2, 0.05);
    }
    last = error;
  }
}

TEST(Memory, TurnsWithTheBody) {
  const Held held(all_laws[1]);
  const RigidMotion turn{{20, 20, 20}, rotation_matrix({0.4, -0.3, 0.6}), {5, 6, 7}};
  std::vector<Vec3d> turned;
  for (std::size_t n = 0; n < held.body.u.size(); ++n) {
    const Vec3d& x = held.body.cloud.nodes[n];
    turned.push_back(turn.apply(x + held.body.u[n]) - x);
  }
  Model<double> still(held.body), turning(held.body);
  still.in_time(held.body.u, 0.05), turning.in_time(held.body.u, 0.05);
  std::vector<Vec3d> expected = still.in_time(held.body.u, 0.05);
  for (Vec3d& f : expected) f = turn.rotation * f;
  EXPECT_LT(largest_difference(turning.in_time(turned, 0.05), expected), force_rounding<double> * (largest(held.isochoric) + largest(held.volumetric)));
}

TEST(Memory, InFloatAgreesWithDouble) {
  const Held held(all_laws[3]);
  Model<double> twice(held.body);
  Model<float> single(held.body);
  for (int n = 0; n < 5; ++n) {
    const std::vector<Vec3d> expected = twice.in_time(held.body.u, 0.05);
    EXPECT_LT(largest_difference(single.in_time(held.body.u, 0.05), expected), force_rounding<float> * (largest(held.isochoric) + largest(held.volumetric)));
  }
}

TEST(Memory, WithoutViscoelasticityForcesInTimeAreForces) {
  const Body body(all_laws[2], false);
  Model<float> model(body);
  EXPECT_FALSE(model.forces.viscoelastic());
  EXPECT_EQ(model.in_time(body.u, 0.1), model.force(body.u));
}

// As in solver_test: the error of integration alone, 0.12 mm in the patch test on this lattice; 0.10 mm measured here.
constexpr double patch_error = 0.015 * 10;

/// A cube between rollers that is stretched along z, its sides free.
struct FreeCube {
  const Box cube{{6, 6, 6}, 10};
  Scene scene;
  double across, stress, energy;  ///< of the homogeneous solution; stress along z [kPa], energy [mN mm]
  FreeCube(const Law& law, double along, double faded = 0) {
    scene.cloud = scenes::lattice_box(cube);
    scenes::prescribe(scene.cloud, scene.constraints, "top", scenes::above(2, cube.length(2)), [=](const Vec3d& x) { return Vec3d{0, 0, (along - 1) * x.z}; }, {false, false, true});
    scenes::prescribe(scene.cloud, scene.constraints, "bottom", scenes::below(2, 0), scenes::nowhere, {false, false, true});
    scenes::prescribe(scene.cloud, scene.constraints, "left", scenes::below(0, 0), scenes::nowhere, {true, false, false});
    scenes::prescribe(scene.cloud, scene.constraints, "front", scenes::below(1, 0), scenes::nowhere, {false, true, false});
    scene.points = scenes::coupled_box_points(cube, scene.cloud, scene.constraints, scenes::uniform(2), 0.45);
    Law along_z = law;
    if (law.model == MaterialModel::transversely_isotropic) along_z.further = {3, 0, 0, 1};  // else the cube shears
    use_law(scene.points, along_z);
    IntegrationPoints equilibrium = scene.points;
    if (faded > 0) scene.points.prony = {{faded, 0, 1}};
    equilibrium.prony = scene.points.prony;
    equilibrium = long_term(std::move(equilibrium));
    with_material<double>(equilibrium, 0, [&](const auto& material) {
      const auto at = [&](double side) {
        Mat3d F;
        F[0][0] = F[1][1] = side, F[2][2] = along;
        return F;
      };
      double low = 0.5, high = 2, J;
      for (int i = 0; i < 60; ++i) (material.stress(at((low + high) / 2), J)[0][0] < 0 ? low : high) = (low + high) / 2;
      across = low, stress = material.stress(at(low), J)[2][2], energy = cube.volume() * material.energy(at(low));
    });
  }
  void expect_solution(const Solution& s) const {
    const double force = std::abs(stress) * cube.length(0) * cube.length(1);
    EXPECT_TRUE(s.converged);
    EXPECT_NEAR(s.reactions.at("top").z, stress * cube.length(0) * cube.length(1), 0.01 * force);
    EXPECT_NEAR(s.reactions.at("left").x, 0, 0.01 * force);
    EXPECT_NEAR(s.strain_energy, energy, 0.01 * energy);
    for (std::size_t n = 0; n < scene.cloud.size(); ++n)
      EXPECT_NEAR(s.displacement[n].x, (across - 1) * scene.cloud.nodes[n].x, patch_error);
  }
};

TEST_P(Laws, SolvedCubeUnderUniaxialStretchHasTheClosedForm) {
  for (const double along : {1.2, 0.9}) {
    const FreeCube cube(GetParam(), along);
    for (const Relaxation relaxation : {Relaxation::two_level, Relaxation::plain}) {
      SolverOptions options;
      options.relaxation = relaxation;
      options.tolerance_mm = 0.005;
      options.double_precision = true;
      cube.expect_solution(cube.scene.solve(options));
    }
  }
}

TEST(ViscoelasticCube, IsInEquilibriumWithItsLongTermModuli) {
  const FreeCube cube(all_laws[1], 1.2, 0.5), elastic(all_laws[1], 1.2);
  EXPECT_LT(cube.stress, 0.6 * elastic.stress);
  SolverOptions options;
  options.tolerance_mm = 0.005;
  options.double_precision = true;
  cube.expect_solution(cube.scene.solve(options));
}

TEST(MaterialErrors, MissingParametersAndTooMuchMemory) {
  Body body(all_laws[2], false);
  body.points.further.pop_back();
  EXPECT_NE(scenes::error_of([&] { Model<float> model(body); }).find("all parameters"), std::string::npos);
  body = Body(all_laws[0], false);
  body.points.prony = {{0.6, 0, 1}, {0.4, 0, 2}};
  EXPECT_NE(scenes::error_of([&] { Model<float> model(body); }).find("less than 1"), std::string::npos);
}

}  // namespace
}  // namespace mtled
