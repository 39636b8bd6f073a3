#include "core/cpu_forces.hpp"

#include <gtest/gtest.h>

#include <cstring>
#include <limits>
#include <random>

#include "core/constraint_operator.hpp"
#include "core/lanes.hpp"
#include "core/motion.hpp"
#include "core/parallel.hpp"
#include "scenes.hpp"

namespace mtled {
#if defined(__x86_64__)
namespace kernels_baseline { extern const KernelTable<float> float_table; }
namespace kernels_v3 { extern const KernelTable<float> float_table; }
namespace kernels_v4 { extern const KernelTable<float> float_table; }
#endif
namespace {

using scenes::Box;

// Sums of some 40 points * 40 terms of the size of the largest nodal force's parts; k / mu = 50 amplifies rounding of J.
template <class Real>
constexpr double force_rounding = 3000 * double(std::numeric_limits<Real>::epsilon());

const double h = 5;
const Box box{{9, 8, 9}, h};  // no multiple of a block of slots or of a pack

/// A body of one kind, smoothly deformed by some tens of percent, with the modulus varying from point to point.
struct Body {
  Cloud cloud;
  std::vector<std::uint8_t> prescribed;
  IntegrationPoints points;
  std::vector<Vec3d> u, v;  ///< parameters of the state and of a direction
};

Body body_of(const std::string& kind) {
  Body body;
  const auto in_ball = [](const std::array<int, 3>& c) { return squared_norm(Vec3d{c[0] - 4.0, c[1] - 3.5, c[2] - 4.0}) < 17; };
  body.cloud = kind == "cut" ? scenes::on_lattice(scenes::cell_corners(box, in_ball), h)
               : kind == "jittered" ? scenes::jittered_box(box) : scenes::lattice_box(box);
  if (kind == "coupled") {
    body.prescribed.assign(body.cloud.size(), 0);
    for (std::size_t n = 0; n < body.cloud.size(); ++n) body.prescribed[n] = body.cloud.lattice_ijk[n][0] < 3;
  }
  const ShapeEvaluator evaluator(body.cloud, body.prescribed, {});
  const auto modulus = [](const Vec3d& x) { return 2 + std::sin(x.x) * std::cos(x.y + x.z); };
  const IntegrationPoints all = scenes::box_points(box, modulus);
  for (std::size_t p = 0; p < all.size(); ++p)
    if (evaluator.covers(all.position[p])) scenes::add_point(body.points, all.position[p], all.volume[p], all.shear_modulus[p], 0.49);
  std::mt19937 random(5);
  std::uniform_real_distribution<double> noise(-0.02 * h, 0.02 * h);
  for (const Vec3d& x : body.cloud.nodes) {
    const double s = 0.05;  // [1/mm]
    body.u.push_back({3 * std::sin(s * x.y) + noise(random), 2 * std::cos(s * x.z) + noise(random), 0.1 * x.z + 2 * std::sin(s * x.x) + noise(random)});
    body.v.push_back({std::cos(s * x.z + 1), noise(random), std::sin(s * (x.x + x.y))});
  }
  return body;
}

ShapeEvaluator evaluator_of(const Body& body) { return {body.cloud, body.prescribed, {}}; }

/// Forces straight from the definition: f_I = sum_points volume P(F) grad phi_I, in double, point after point.
std::vector<Vec3d> naive_force(const Body& body, const std::vector<Vec3d>& u, const std::vector<Vec3d>* along = nullptr) {
  const ShapeEvaluator evaluator = evaluator_of(body);
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
    const NeoHookean<double> material{body.points.shear_modulus[p], body.points.bulk_modulus[p]};
    double J;
    const Mat3d P = along ? material.stress_derivative(F, D) : material.stress(F, J);
    for (std::size_t i = 0; i < s.node.size(); ++i) f[std::size_t(s.node[i])] += body.points.volume[p] * (P * s.gradient[i]);
  }
  return f;
}

/// The same through the solver's tables.
template <class Real>
struct Model {
  explicit Model(const Body& b) : body(b), layout(make_slot_layout(b.cloud, 1)), supports(build_supports(evaluator_of(b), layout, b.points)), forces(supports, layout, b.points) {}
  NodalField<Real> field(const std::vector<Vec3d>& nodal) const {
    NodalField<Real> result(std::size_t(layout.num_slots));
    for (std::size_t n = 0; n < nodal.size(); ++n)
      for (int c = 0; c < 3; ++c) result.at(std::size_t(layout.slot_of_node[n]), c) = Real(nodal[n][c]);
    return result;
  }
  std::vector<Vec3d> nodal(const NodalField<Real>& field) const {
    std::vector<Vec3d> result(body.cloud.size());
    for (std::size_t n = 0; n < result.size(); ++n)
      for (int c = 0; c < 3; ++c) result[n][c] = double(field.at(std::size_t(layout.slot_of_node[n]), c));
    return result;
  }
  std::vector<Vec3d> force(const std::vector<Vec3d>& u, VolumeRatioStatistics* statistics = nullptr) const {
    NodalField<Real> f(std::size_t(layout.num_slots));
    const VolumeRatioStatistics s = forces.force(field(u), f);
    if (statistics) *statistics = s;
    return nodal(f);
  }
  std::vector<Vec3d> tangent(const std::vector<Vec3d>& u, const std::vector<Vec3d>& v) const {
    NodalField<Real> f(std::size_t(layout.num_slots));
    forces.tangent(field(u), field(v), f);
    return nodal(f);
  }
  const Body& body;
  SlotLayout layout;
  SupportTable supports;
  CpuForces<Real> forces;
};

double largest(const std::vector<Vec3d>& f) {
  double top = 0;
  for (const Vec3d& x : f) top = std::max(top, norm(x));
  return top;
}
double largest_difference(const std::vector<Vec3d>& a, const std::vector<Vec3d>& b) {
  double top = 0;
  for (std::size_t n = 0; n < a.size(); ++n) top = std::max(top, norm(a[n] - b[n]));
  return top;
}
std::vector<Vec3d> moved(std::vector<Vec3d> u, double s, const std::vector<Vec3d>& v) {
  for (std::size_t n = 0; n < u.size(); ++n) u[n] += s * v[n];
  return u;
}

class Forces : public testing::TestWithParam<const char*> {
 protected:
  Body body = body_of(GetParam());

  template <class Real>
  void expect_naive_forces() const {
    const Model<Real> model(body);
    const std::vector<Vec3d> expected = naive_force(body, body.u);
    const double tolerance = force_rounding<Real> * largest(expected);
    EXPECT_LT(largest_difference(model.force(body.u), expected), tolerance);
    // One point too few must be seen.
    Body poorer = body;
    poorer.points.volume[body.points.size() / 2] = 1e-9;
    EXPECT_GT(largest_difference(naive_force(poorer, body.u), expected), 3 * tolerance);
  }
  template <class Real>
  void expect_naive_tangent() const {
    const std::vector<Vec3d> expected = naive_force(body, body.u, &body.v);
    EXPECT_LT(largest_difference(Model<Real>(body).tangent(body.u, body.v), expected), force_rounding<Real> * largest(expected));
  }
};
INSTANTIATE_TEST_SUITE_P(Clouds, Forces, testing::Values("lattice", "coupled", "cut", "jittered"), [](const auto& kind) { return std::string(kind.param); });

TEST_P(Forces, InDoubleEqualTheNaiveLoop) { expect_naive_forces<double>(); }
TEST_P(Forces, InFloatEqualTheNaiveLoop) { expect_naive_forces<float>(); }
TEST_P(Forces, TangentInDoubleEqualsTheNaiveLoop) { expect_naive_tangent<double>(); }
TEST_P(Forces, TangentInFloatEqualsTheNaiveLoop) { expect_naive_tangent<float>(); }

TEST_P(Forces, TangentIsTheDifferenceOfForces) {
  const Model<double> model(body);
  constexpr double step = 1e-5;        // of v [mm]
  constexpr double truncation = 1e-7;  // of the largest force: (step / h)^2 * k / mu and rounding / step
  const std::vector<Vec3d> tangent = model.tangent(body.u, body.v);
  std::vector<Vec3d> difference = model.force(moved(body.u, step, body.v)), down = model.force(moved(body.u, -step, body.v));
  for (std::size_t n = 0; n < difference.size(); ++n) difference[n] = (0.5 / step) * (difference[n] - down[n]);
  EXPECT_LT(largest_difference(tangent, difference), truncation * largest(tangent));
  const std::vector<Vec3d> at_rest = model.tangent(std::vector<Vec3d>(body.u.size()), body.v);
  EXPECT_GT(largest_difference(at_rest, difference), 1e5 * truncation * largest(tangent));  // the state matters
}

TEST_P(Forces, TangentIsSymmetric) {
  const Model<double> model(body);
  const std::vector<Vec3d> Kv = model.tangent(body.u, body.v), Ku = model.tangent(body.u, body.u);
  double uKv = 0, vKu = 0, size = 0;
  for (std::size_t n = 0; n < Kv.size(); ++n) uKv += dot(body.u[n], Kv[n]), vKu += dot(body.v[n], Ku[n]), size += norm(body.u[n]) * norm(Kv[n]);
  EXPECT_NEAR(uKv, vKu, 1e-12 * size);
}

TEST_P(Forces, SumToZero) {
  const Model<double> model(body);
  Vec3d sum{};
  const std::vector<Vec3d> f = model.force(body.u);
  for (const Vec3d& x : f) sum += x;
  EXPECT_LT(norm(sum), 1e-11 * largest(f));  // rounding of a thousand terms
}

TEST_P(Forces, HaveNoMomentAboutTheDeformedNodes) {
  // sum (X_I + u_I) x f_I = 0 since F P^T is symmetric and sum X_I grad phi_I = I.
  const Model<double> model(body);
  Vec3d moment{}, moment_at_rest{};
  const std::vector<Vec3d> f = model.force(body.u);
  double size = 0;
  for (std::size_t n = 0; n < f.size(); ++n) {
    moment += cross(body.cloud.nodes[n] + body.u[n], f[n]);
    moment_at_rest += cross(body.cloud.nodes[n], f[n]);
    size += norm(body.cloud.nodes[n]) * norm(f[n]);
  }
  EXPECT_LT(norm(moment), 1e-12 * size);
  EXPECT_GT(norm(moment_at_rest), 1e-6 * size);
}

TEST_P(Forces, RigidMotionIsForceFree) {
  const RigidMotion turn{{20, 20, 20}, rotation_matrix({0.4, -0.3, 0.6}), {5, 6, 7}};
  std::vector<Vec3d> u;
  for (const Vec3d& x : body.cloud.nodes) u.push_back(turn.displacement(x));
  VolumeRatioStatistics statistics;
  const double scale = largest(naive_force(body, body.u));
  EXPECT_LT(largest(Model<double>(body).force(u, &statistics)), force_rounding<double> * scale);
  EXPECT_NEAR(statistics.smallest, 1, 1e-12);
  EXPECT_EQ(statistics.inverted, 0);
}

TEST_P(Forces, WorkIsTheChangeOfEnergy) {
  // f . v = dW/ds along u + s v.
  const ShapeEvaluator evaluator = evaluator_of(body);
  const auto energy = [&](const std::vector<Vec3d>& u) {
    double sum = 0;
    ShapeFunctions s;
    for (std::size_t p = 0; p < body.points.size(); ++p) {
      evaluator.at(body.points.position[p], s);
      Mat3d F = Mat3d::identity();
      for (std::size_t i = 0; i < s.node.size(); ++i)
        for (int a = 0; a < 3; ++a)
          for (int b = 0; b < 3; ++b) F[a][b] += u[std::size_t(s.node[i])][a] * s.gradient[i][b];
      sum += body.points.volume[p] * NeoHookean<double>{body.points.shear_modulus[p], body.points.bulk_modulus[p]}.energy(F);
    }
    return sum;
  };
  constexpr double step = 1e-4, truncation = 1e-6;
  const double slope = (energy(moved(body.u, step, body.v)) - energy(moved(body.u, -step, body.v))) / (2 * step);
  const std::vector<Vec3d> f = Model<double>(body).force(body.u);
  double work = 0;
  for (std::size_t n = 0; n < f.size(); ++n) work += dot(f[n], body.v[n]);
  EXPECT_NEAR(work, slope, truncation * std::abs(slope));
}

TEST_P(Forces, AreTheSameBitsForAnyNumberOfThreads) {
  const Model<float> model(body);
  const auto bits = [&](int threads) {
    const ThreadLimit limit(threads);
    return std::pair(model.force(body.u), model.tangent(body.u, body.v));
  };
  const auto one = bits(1);
  for (int threads : {1, 2, 3}) EXPECT_EQ(bits(threads), one) << threads << " threads";
}


TEST(ForcesOnALargerLattice, EqualTheNaiveLoopInFullPacks) {
  const Box larger{{40, 12, 6}, h};
  Body body;
  body.cloud = scenes::lattice_box(larger);
  body.points = scenes::box_points(larger, [](const Vec3d& x) { return 2 + std::sin(x.x); });
  for (const Vec3d& x : body.cloud.nodes) body.u.push_back({2 * std::sin(0.05 * x.y), 0.05 * x.x, 1.5 * std::cos(0.06 * x.x)});
  const std::vector<Vec3d> expected = naive_force(body, body.u);
  const Model<float> single(body);
  const Model<double> twice(body);
  EXPECT_LT(largest_difference(single.force(body.u), expected), force_rounding<float> * largest(expected));
  EXPECT_LT(largest_difference(twice.force(body.u), expected), force_rounding<double> * largest(expected));
  EXPECT_GT(single.forces.aligned_points(), body.points.size() / 2);
  EXPECT_GT(single.forces.aligned_points(), 2 * single.forces.aligned_packs());
}

#if defined(__x86_64__)
/// The kernels that this processor runs, slowest first.
std::vector<const KernelTable<float>*> runnable_kernels() {
  std::vector<const KernelTable<float>*> tables{&kernels_baseline::float_table};
  if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma")) tables.push_back(&kernels_v3::float_table);
  if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512bw"))
    tables.push_back(&kernels_v4::float_table);
  return tables;
}

TEST(Kernels, OfAllInstructionSetsAgree) {
  // One stencil of 20 nodes; an aligned pack with 11 of 16 lanes in use, and a gathered pack with 5.
  constexpr int width = LaneTraits<float>::width, nodes = 20;
  std::mt19937 random(3);
  std::uniform_real_distribution<float> unit(-1, 1);
  std::vector<int> begin{0, nodes}, offset;
  std::vector<float> gradient;
  for (int s = 0; s < nodes; ++s) {
    offset.push_back(3 * s);
    for (int c = 0; c < 4; ++c) gradient.push_back(c < 3 ? 0.1F * unit(random) : 0);
  }
  const int aligned_stencil[] = {0}, aligned_base[] = {7};
  std::vector<int> gathered_stencil(width, -1), gathered_base(width, 0);
  // Room for the largest number of parameters; the further ones of each material in turn, in idle lanes too.
  std::vector<float> aligned_material(7 * width, 0), gathered_material(7 * width, 0);
  const auto set = [&](std::vector<float>& material, int lane) { material[std::size_t(lane)] = 2, material[std::size_t(lane + width)] = 1, material[std::size_t(lane + 2 * width)] = 50; };
  const float further[number_of_material_models][4] = {{}, {0.2F}, {0.3F, 0.1F}, {-4.7F}, {3, 0, 0.6F, 0.8F}};
  int model = 0;
  const auto set_further = [&] {
    for (auto* material : {&aligned_material, &gathered_material})
      for (int i = 0; i < 4; ++i) std::fill_n(material->begin() + (3 + i) * width, width, further[model][i]);
  };
  for (int lane = 0; lane < 11; ++lane) set(aligned_material, lane);
  for (int lane = 0; lane < 5; ++lane) set(gathered_material, lane), gathered_stencil[std::size_t(lane)] = 0, gathered_base[std::size_t(lane)] = 4 * lane;
  const PackView<float> view{begin.data(), offset.data(), gradient.data(), aligned_stencil, aligned_base, aligned_material.data(),
                             gathered_stencil.data(), gathered_base.data(), gathered_material.data()};
  NodalField<float> u(100), v(100);
  for (std::size_t s = 0; s < 100; ++s)
    for (int c = 0; c < 3; ++c) u.at(s, c) = 0.5F * unit(random), v.at(s, c) = unit(random);
  const auto run = [&](const KernelTable<float>& kernels, bool tangent) {
    NodalField<float> f(100);
    const auto view_of = [](const NodalField<float>& a) { return FieldView<float>{{a.component(0), a.component(1), a.component(2)}}; };
    const MutableFieldView<float> to{{f.component(0), f.component(1), f.component(2)}};
    if (tangent) {
      kernels.of[model].tangent(view, {0, 1, 0, 1}, view_of(u), view_of(v), to);
    } else {
      kernels.of[model].force(view, {0, 1, 0, 1}, view_of(u), to);
    }
    std::vector<Vec3d> nodal;
    for (std::size_t s = 0; s < 100; ++s) nodal.push_back({double(f.at(s, 0)), double(f.at(s, 1)), double(f.at(s, 2))});
    return nodal;
  };
  const auto tables = runnable_kernels();
  for (model = 0; model < number_of_material_models; ++model) {
    set_further();
    for (const bool tangent : {false, true}) {
      const std::vector<Vec3d> expected = run(*tables[0], tangent);
      EXPECT_GT(largest(expected), 1);
      for (const auto* table : tables) EXPECT_LT(largest_difference(run(*table, tangent), expected), force_rounding<float> * largest(expected)) << "model " << model;
    }
  }
}
#endif

TEST(VolumeRatios, CountInvertedPoints) {
  Body body = body_of("lattice");
  const Model<float> model(body);
  std::vector<Vec3d> u;
  for (const Vec3d& x : body.cloud.nodes) u.push_back({-1.5 * x.x, 0, 0});  // F_xx = -0.5 everywhere
  VolumeRatioStatistics statistics;
  const std::vector<Vec3d> f = model.force(u, &statistics);
  EXPECT_EQ(statistics.inverted, long(body.points.size()));
  EXPECT_NEAR(statistics.smallest, -0.5, 1e-4);
  EXPECT_TRUE(std::isfinite(largest(f)));
}

TEST(VolumeRatios, ReportWhatIsNotANumber) {
  const Body body = body_of("lattice");
  std::vector<Vec3d> u = body.u;
  u[100].x = std::numeric_limits<double>::quiet_NaN();
  EXPECT_TRUE(std::isnan(largest(Model<float>(body).force(u))) || !std::isfinite(Model<float>(body).force(u)[100].x));
}

TEST(SlotLayout, PutsEveryFourthLatticePositionNextToEachOther) {
  const Cloud cloud = scenes::lattice_box(box);
  const SlotLayout layout = make_slot_layout(cloud, 1);
  const auto slot = [&](int i, int j, int k) { return layout.slot_of_node[std::size_t(cloud.lattice->node(i, j, k))]; };
  EXPECT_EQ(slot(5, 2, 3) - slot(1, 2, 3), 1);
  EXPECT_EQ(slot(5, 6, 3) - slot(5, 2, 3), slot(1, 7, 0) - slot(1, 3, 0));
  EXPECT_EQ(slot(4, 4, 4) - slot(4, 4, 3), slot(1, 0, 9) - slot(1, 0, 8));
}

/// Prescribed nodes inside and on the surface of a jittered cloud.
struct Prescribed {
  Cloud cloud;
  Constraints constraints;
  SlotLayout layout;
  std::unique_ptr<ShapeEvaluator> evaluator;

  explicit Prescribed(bool jittered) : cloud(jittered ? scenes::jittered_box(box) : scenes::lattice_box(box)) {
    scenes::prescribe(cloud, constraints, "bottom", scenes::below(2, 0), [](const Vec3d& x) { return Vec3d{0.1 * x.x, 3, -0.2 * x.y}; });
    scenes::prescribe(cloud, constraints, "middle", [](const Vec3d& x) { return norm(x - Vec3d{22, 20, 25}) < 9; }, [](const Vec3d& x) { return Vec3d{5, 0.1 * x.z, 2}; });
    scenes::prescribe(cloud, constraints, "slide", scenes::above(2, box.length(2)), scenes::nowhere, {false, false, true});
    layout = make_slot_layout(cloud, 1);
    evaluator = std::make_unique<ShapeEvaluator>(cloud, scenes::prescribed_flags(cloud, constraints), MlsOptions{});
  }
  /// Field at a node.
  template <class Real>
  Vec3d at_node(const NodalField<Real>& u, int node) const {
    ShapeFunctions s;
    EXPECT_TRUE(evaluator->at(cloud.nodes[std::size_t(node)], s));
    Vec3d sum{};
    for (std::size_t i = 0; i < s.node.size(); ++i)
      for (int c = 0; c < 3; ++c) sum[c] += s.value[i] * double(u.at(std::size_t(layout.slot_of_node[std::size_t(s.node[i])]), c));
    return sum;
  }
  NodalField<double> rough(unsigned seed) const {
    NodalField<double> u(std::size_t(layout.num_slots));
    std::mt19937 random(seed);
    std::uniform_real_distribution<double> noise(-1, 1);
    for (std::size_t n = 0; n < cloud.size(); ++n)
      for (int c = 0; c < 3; ++c) u.at(std::size_t(layout.slot_of_node[n]), c) = noise(random);
    return u;
  }
};

class ConstraintOperators : public testing::TestWithParam<bool> {};
INSTANTIATE_TEST_SUITE_P(Clouds, ConstraintOperators, testing::Bool(), [](const auto& jittered) { return jittered.param ? "jittered" : "lattice"; });

TEST_P(ConstraintOperators, ImposeTheFieldAtPrescribedNodes) {
  const Prescribed scene(GetParam());
  const ConstraintOperator operators(*scene.evaluator, scene.layout, scene.constraints);
  EXPECT_EQ(operators.direct(), !GetParam());
  for (double load : {0.0, 0.3, 1.0}) {
    NodalField<double> u = scene.rough(1);
    operators.impose(u, load);
    for (std::size_t b = 0; b < scene.constraints.node.size(); ++b) {
      const Vec3d field = scene.at_node(u, scene.constraints.node[b]);
      for (int c = 0; c < 3; ++c)
        if (scene.constraints.fixed[b][std::size_t(c)]) {
          EXPECT_NEAR(field[c], load * scene.constraints.displacement[b][c], 1e-11);  // a sparse LU in double
        }
    }
  }
}

TEST_P(ConstraintOperators, ReduceIsTheAdjointOfImpose) {
  // For any force f and any admissible change v of the free parameters, f . impose(v, 0) = reduce(f) . v.
  const Prescribed scene(GetParam());
  const ConstraintOperator operators(*scene.evaluator, scene.layout, scene.constraints);
  NodalField<double> f = scene.rough(2), v = scene.rough(3);
  const NodalField<double> free_v = scene.rough(3);
  const auto product = [](const NodalField<double>& a, const NodalField<double>& b) {
    double sum = 0;
    for (std::size_t s = 0; s < a.slots(); ++s)
      for (int c = 0; c < 3; ++c) sum += a.at(s, c) * b.at(s, c);
    return sum;
  };
  operators.impose(v, 0);
  const double with_constraint = product(f, v);
  operators.reduce(f);
  EXPECT_NEAR(product(f, free_v), with_constraint, 1e-10);
  EXPECT_NEAR(product(f, v), with_constraint, 1e-10);
}

TEST_P(ConstraintOperators, ReactionsDoTheWorkOfTheForce) {
  // Equilibrium forces f = Phi^T lambda: their work on any field v is that of the reactions on the field at the nodes.
  const Prescribed scene(GetParam());
  const ConstraintOperator operators(*scene.evaluator, scene.layout, scene.constraints);
  std::vector<Vec3d> lambda(scene.constraints.node.size());
  NodalField<double> f(std::size_t(scene.layout.num_slots));
  std::mt19937 random(4);
  std::uniform_real_distribution<double> noise(-1, 1);
  for (std::size_t b = 0; b < lambda.size(); ++b) {
    ShapeFunctions s;
    ASSERT_TRUE(scene.evaluator->at(scene.cloud.nodes[std::size_t(scene.constraints.node[b])], s));
    for (int c = 0; c < 3; ++c) {
      if (!scene.constraints.fixed[b][std::size_t(c)]) continue;
      lambda[b][c] = noise(random);
      for (std::size_t i = 0; i < s.node.size(); ++i) f.at(std::size_t(scene.layout.slot_of_node[std::size_t(s.node[i])]), c) += s.value[i] * lambda[b][c];
    }
  }
  std::vector<Vec3d> internal(f.slots());
  for (std::size_t s = 0; s < f.slots(); ++s) internal[s] = {f.at(s, 0), f.at(s, 1), f.at(s, 2)};
  const std::vector<Vec3d> reaction = operators.reactions(internal);
  for (std::size_t b = 0; b < lambda.size(); ++b) EXPECT_LT(norm(reaction[b] - lambda[b]), 1e-11);
  operators.reduce(f);
  for (std::size_t s = 0; s < f.slots(); ++s)
    for (int c = 0; c < 3; ++c) EXPECT_NEAR(f.at(s, c), 0, 1e-11);
}

TEST(ConstraintOperatorInFloat, KeepsTheFieldToAMillionth) {
  const Prescribed scene(true);
  const ConstraintOperator operators(*scene.evaluator, scene.layout, scene.constraints);
  NodalField<float> u(std::size_t(scene.layout.num_slots));
  operators.impose(u, 1);
  double largest_value = 0, worst = 0;
  for (std::size_t b = 0; b < scene.constraints.node.size(); ++b) {
    const Vec3d field = scene.at_node(u, scene.constraints.node[b]);
    for (int c = 0; c < 3; ++c) {
      if (!scene.constraints.fixed[b][std::size_t(c)]) continue;
      largest_value = std::max(largest_value, std::abs(scene.constraints.displacement[b][c]));
      worst = std::max(worst, std::abs(field[c] - scene.constraints.displacement[b][c]));
    }
  }
  EXPECT_LT(worst, 1e-6 * largest_value);
}

TEST(ConstraintOperatorErrors, NodesAtOnePlaceCannotBothBePrescribed) {
  std::vector<Vec3d> nodes = scenes::jittered_box(box).nodes;
  nodes.push_back(nodes[0]);
  const Cloud cloud{nodes, std::nullopt, {}};  // make_cloud() would refuse it
  Constraints constraints;
  scenes::prescribe(cloud, constraints, "all", [&](const Vec3d& x) { return x == nodes[0] || x.z < 1; }, scenes::nowhere);
  const ShapeEvaluator evaluator(cloud, scenes::prescribed_flags(cloud, constraints), {});
  Failure failure{};
  const std::string message = scenes::error_of([&] { ConstraintOperator(evaluator, make_slot_layout(cloud, 1), constraints); }, &failure);
  EXPECT_EQ(failure, Failure::input) << message;
  EXPECT_NE(message.find("too close together"), std::string::npos) << message;
}

}  // namespace
}  // namespace mtled
