#include <gtest/gtest.h>

#include <algorithm>
#include <numbers>

#include "core/coupled_integration.hpp"
#include "core/motion.hpp"
#include "scenes.hpp"

/// Prescribed displacements by both schemes: lattice nodes coupled with trilinear finite elements, and collocation, on
/// lattices and irregular clouds.
namespace mtled {
namespace {

using scenes::Box;

constexpr double h = 10;  ///< node spacing [mm]
constexpr double degree = std::numbers::pi / 180;

enum class Scheme { coupling, collocation, collocation_jittered };

/// What is prescribed besides the lower face, which is held.
enum class Region { volumes, face, face_component, edge, node };

struct Setting {
  Scheme scheme;
  Region region;
  Basis basis;
};
const char* name_of(Scheme s) { return s == Scheme::coupling ? "Coupling" : s == Scheme::collocation ? "Collocation" : "CollocationJittered"; }
std::string name_of(const Setting& s) {
  const char* regions[] = {"Volumes", "Face", "FaceComponent", "Edge", "Node"};
  const char* bases[] = {"Linear", "Quadratic", "Modified"};
  return std::string(name_of(s.scheme)) + regions[int(s.region)] + bases[int(s.basis)];
}
std::ostream& operator<<(std::ostream& out, const Setting& s) { return out << name_of(s); }

MlsOptions shapes_of(Basis basis) {
  MlsOptions options;
  options.basis = basis;
  if (basis != Basis::linear) options.dilatation = 2.25;
  return options;
}

SolverOptions solver_options(bool double_precision, double tolerance = 1e-4) {
  SolverOptions options;
  options.double_precision = double_precision;
  options.tolerance_mm = tolerance;
  return options;
}

/// A box that is moved at nodes. Keep it where it is: the field refers to the cloud.
struct Problem {
  Cloud cloud;
  Constraints constraints;  ///< every node is a set of its own, so that each has its reaction
  IntegrationPoints points;
  Scheme scheme;
  MlsOptions shapes;

  ShapeEvaluator field() const {
    return {cloud, scheme == Scheme::coupling ? scenes::prescribed_flags(cloud, constraints) : std::vector<std::uint8_t>{}, shapes};
  }
  /// With `load` times the prescribed displacements.
  Solution solve(const SolverOptions& options, double load = 1) const {
    Constraints scaled = constraints;
    for (Vec3d& d : scaled.displacement) d = load * d;
    const ShapeEvaluator here = field();
    return mtled::solve(here, reduce_volumetric_integration(here, points), scaled, options);
  }
  Vec3d reaction(const Solution& s, std::size_t row) const { return s.reactions.at(constraints.set_names[row]); }
};

Problem problem(const Setting& setting) {
  Problem p{{}, {}, {}, setting.scheme, shapes_of(setting.basis)};
  const Box box{{6, 6, 7}, h};
  p.cloud = setting.scheme == Scheme::collocation_jittered ? scenes::jittered_box(box) : scenes::lattice_box(box);
  const double top = box.length(2);
  // Of irregular clouds, whatever node lies there.
  const auto inside = [](const Vec3d& low, const Vec3d& high) {
    return [=](const Vec3d& x) {
      for (int a = 0; a < 3; ++a)
        if (x[a] < low[a] || x[a] > high[a]) return false;
      return true;
    };
  };
  const RigidMotion turn{{30, 30, top}, rotation_matrix({4 * degree, 12 * degree, -6 * degree}), {3, 1, -4}};
  const auto turned = [=](const Vec3d& x) { return turn.displacement(x); };
  const RigidMotion lean{{30, 30, 15}, rotation_matrix({0, -6 * degree, 3 * degree}), {1, 0, 0}};
  Constraints& c = p.constraints;
  if (setting.region == Region::volumes) {
    scenes::prescribe(p.cloud, c, "lower", inside({14, 14, 4}, {46, 46, 26}), [=](const Vec3d& x) { return lean.displacement(x); });
    scenes::prescribe(p.cloud, c, "upper", inside({14, 14, 44}, {46, 46, 66}), turned);
  } else {
    scenes::prescribe(p.cloud, c, "bottom", scenes::below(2, 0), scenes::nowhere);
  }
  if (setting.region == Region::face) scenes::prescribe(p.cloud, c, "top", scenes::above(2, top), turned);
  if (setting.region == Region::face_component) scenes::prescribe(p.cloud, c, "top", scenes::above(2, top), [](const Vec3d&) { return Vec3d{0, 0, -5}; }, {false, false, true});
  if (setting.region == Region::edge) scenes::prescribe(p.cloud, c, "edge", [=](const Vec3d& x) { return x.z > top - 1 && x.x > 59; }, turned);
  if (setting.region == Region::node) scenes::prescribe(p.cloud, c, "node", inside({24, 24, top - 0.1}, {36, 36, top}), [](const Vec3d&) { return Vec3d{2, 1, 3}; });
  c.set_names.clear();
  for (std::size_t b = 0; b < c.node.size(); ++b) c.set[b] = int(b), c.set_names.push_back(std::to_string(c.node[b]));
  const ShapeEvaluator field = p.field();
  const auto kind = [&](const std::array<int, 3>& cell) { return setting.scheme == Scheme::coupling && field.coupled(cell) ? scenes::CellKind::coupled : scenes::CellKind::free; };
  p.points = scenes::box_points(box, scenes::uniform(2), 0.45, scenes::usual_ratio, kind);
  return p;
}

const std::vector<Scheme> every_scheme{Scheme::coupling, Scheme::collocation, Scheme::collocation_jittered};
std::vector<Setting> settings(const std::vector<Scheme>& schemes, const std::vector<Region>& regions, const std::vector<Basis>& bases) {
  std::vector<Setting> all;
  for (const Scheme s : schemes)
    for (const Region r : regions)
      for (const Basis b : bases) all.push_back({s, r, b});
  return all;
}
std::string name(const testing::TestParamInfo<Setting>& info) { return name_of(info.param); }

/// Size of the largest prescribed displacement [mm].
double largest_value(const Constraints& c) {
  double top = 0;
  for (const Vec3d& d : c.displacement) top = std::max(top, norm(d));
  return top;
}

class Values : public testing::TestWithParam<Setting> {
 protected:
  const Problem p = problem(GetParam());
  double worst(const Solution& s) const {
    double top = 0;
    for (std::size_t b = 0; b < p.constraints.node.size(); ++b)
      for (int c = 0; c < 3; ++c)
        if (p.constraints.fixed[b][std::size_t(c)])
          top = std::max(top, std::abs(s.displacement[std::size_t(p.constraints.node[b])][c] - p.constraints.displacement[b][c]));
    return top;
  }
};
INSTANTIATE_TEST_SUITE_P(Everywhere, Values,
                         testing::ValuesIn(settings(every_scheme, {Region::volumes, Region::face, Region::face_component, Region::edge, Region::node},
                                                    {Basis::linear, Basis::quadratic, Basis::modified_quadratic})),
                         name);

TEST_P(Values, OfTheFieldArePrescribedOnes) {
  const Solution s = p.solve(solver_options(true));
  EXPECT_TRUE(s.converged);
  EXPECT_LT(worst(s), 1e-6 * largest_value(p.constraints));
}

TEST_P(Values, OfTheFieldDifferInFloatByTheRoundingOfParameters) {
  // Prescribed nodes' parameters come in double from free ones that are floats, and are then rounded: each by at most 2^-24 of
  // itself. What double leaves is smaller by far.
  const Solution s = p.solve(solver_options(false, 0.01));
  EXPECT_TRUE(s.converged);
  const ShapeEvaluator field = p.field();
  std::vector<std::array<bool, 3>> fixed(p.cloud.size(), {false, false, false});
  for (std::size_t b = 0; b < p.constraints.node.size(); ++b) fixed[std::size_t(p.constraints.node[b])] = p.constraints.fixed[b];
  ShapeFunctions shapes;
  for (std::size_t b = 0; b < p.constraints.node.size(); ++b) {
    const std::size_t n = std::size_t(p.constraints.node[b]);
    ASSERT_TRUE(field.at(p.cloud.nodes[n], shapes));
    for (int c = 0; c < 3; ++c) {
      if (!fixed[n][std::size_t(c)]) continue;
      double rounding = 1e-12 * largest_value(p.constraints);
      for (std::size_t i = 0; i < shapes.node.size(); ++i)
        if (fixed[std::size_t(shapes.node[i])][std::size_t(c)]) rounding += std::abs(shapes.value[i] * s.parameter[std::size_t(shapes.node[i])][c]) / (1 << 24);
      EXPECT_LE(std::abs(s.displacement[n][c] - p.constraints.displacement[b][c]), rounding) << "node " << n;
    }
  }
}

class Collocation : public Values {};
INSTANTIATE_TEST_SUITE_P(Everywhere, Collocation,
                         testing::ValuesIn(settings({Scheme::collocation, Scheme::collocation_jittered}, {Region::volumes, Region::face, Region::edge, Region::node},
                                                    {Basis::linear, Basis::quadratic, Basis::modified_quadratic})),
                         name);

TEST_P(Collocation, IsNeeded) {
  // The values themselves as parameters put the field off by far more than the tolerances above.
  Solution s = p.solve(solver_options(true));
  for (std::size_t b = 0; b < p.constraints.node.size(); ++b)
    for (int c = 0; c < 3; ++c)
      if (p.constraints.fixed[b][std::size_t(c)]) s.parameter[std::size_t(p.constraints.node[b])][c] = p.constraints.displacement[b][c];
  const ShapeEvaluator field = p.field();
  for (std::size_t n = 0; n < p.cloud.size(); ++n) displacement_at(field, s.parameter, p.cloud.nodes[n], s.displacement[n]);
  EXPECT_GT(worst(s), 1e-3 * largest_value(p.constraints));
}

/// Two prescribed nodes `distance` spacings apart on the moved face of an irregular cloud.
Problem close_nodes(double distance) {
  Problem p = problem({Scheme::collocation_jittered, Region::face, Basis::linear});
  std::vector<Vec3d> nodes = p.cloud.nodes;
  const std::size_t row = std::size_t(std::max_element(p.constraints.displacement.begin(), p.constraints.displacement.end(), [](const Vec3d& a, const Vec3d& b) { return norm(a) < norm(b); }) - p.constraints.displacement.begin());
  nodes.push_back(nodes[std::size_t(p.constraints.node[row])] - Vec3d{distance * h, 0.5 * distance * h, 0});
  p.cloud = make_cloud(std::move(nodes), std::nullopt);
  p.constraints.node.push_back(int(p.cloud.size()) - 1), p.constraints.displacement.push_back(p.constraints.displacement[row]);
  p.constraints.fixed.push_back({true, true, true}), p.constraints.set.push_back(int(p.constraints.set_names.size())), p.constraints.set_names.push_back("close");
  return p;
}

TEST(CloseNodes, AreSolvedUntilRoundingTakesOver) {
  // Same displacement at both: with 0.001 spacings between them a gradient of zero is all that is asked for there.
  const Problem near = close_nodes(1e-3);
  const Solution s = near.solve(solver_options(false, 0.01));
  EXPECT_TRUE(s.converged);
  for (std::size_t b = 0; b < near.constraints.node.size(); ++b)
    EXPECT_LT(norm(s.displacement[std::size_t(near.constraints.node[b])] - near.constraints.displacement[b]), 1e-6 * largest_value(near.constraints));
  Failure failure{};
  const Problem too_near = close_nodes(1e-6);
  const std::string message = scenes::error_of([&] { too_near.solve(solver_options(false, 0.01)); }, &failure);
  EXPECT_EQ(failure, Failure::input);
  for (const char* part : {"prescribed displacement", "too close together, remove one"}) EXPECT_NE(message.find(part), std::string::npos) << message;
  const std::size_t at = message.find("node ");
  ASSERT_EQ(at, 0u);
  const int named = std::stoi(message.substr(5));
  EXPECT_LT(norm(too_near.cloud.nodes[std::size_t(named)] - too_near.cloud.nodes.back()), 1e-5 * h) << "names one of the two";
}

class Forces : public testing::TestWithParam<Setting> {
 protected:
  const Problem p = problem(GetParam());
};
INSTANTIATE_TEST_SUITE_P(Everywhere, Forces,
                         testing::ValuesIn(settings(every_scheme, {Region::volumes, Region::face, Region::edge, Region::node}, {Basis::linear, Basis::modified_quadratic})), name);

TEST_P(Forces, AreInBalanceAndTheirWorkIsTheStrainEnergy) {
  // dW/ds = sum R(s) . d along the load path s d, if equilibrium is that of the constraint. By Simpson's rule, twice.
  constexpr int intervals = 8;
  const auto simpson = [](const double* f, int every) {
    double sum = 0;
    for (int i = 0; i < intervals; i += 2 * every) sum += f[i] + 4 * f[i + every] + f[i + 2 * every];
    return sum * every / (3.0 * intervals);
  };
  double power[intervals + 1] = {}, power_on_parameters[intervals + 1] = {};
  Solution s;
  for (int i = 1; i <= intervals; ++i) {
    const double load = double(i) / intervals;
    s = p.solve(solver_options(true, 1e-6), load);
    EXPECT_TRUE(s.converged);
    for (std::size_t b = 0; b < p.constraints.node.size(); ++b) {
      power[i] += dot(p.reaction(s, b), p.constraints.displacement[b]);
      power_on_parameters[i] += dot(p.reaction(s, b), (1 / load) * s.parameter[std::size_t(p.constraints.node[b])]);
    }
  }
  // Halving the interval divides the error by 16, so what remains is a fifteenth of the difference; and the stop, which shows in
  // the balance below.
  constexpr double stop = 1e-8;
  const double work = simpson(power, 1), tolerance = std::abs(work - simpson(power, 2)) / 10 + stop * s.strain_energy;
  EXPECT_LT(tolerance, 1e-4 * s.strain_energy);
  EXPECT_NEAR(work, s.strain_energy, tolerance);
  // The reactions work on the field. On the parameters it is another work, by far more than the tolerance.
  if (GetParam().scheme != Scheme::coupling) {
    EXPECT_GT(std::abs(simpson(power_on_parameters, 1) - s.strain_energy), 10 * tolerance);
  }

  Vec3d force{}, moment{};
  double forces = 0, moments = 0;
  for (std::size_t b = 0; b < p.constraints.node.size(); ++b) {
    const Vec3d r = p.reaction(s, b), x = p.cloud.nodes[std::size_t(p.constraints.node[b])] + p.constraints.displacement[b];
    force += r, moment += cross(x, r);
    forces += norm(r), moments += norm(cross(x, r));
  }
  EXPECT_LT(norm(force), stop * forces);
  EXPECT_LT(norm(moment), stop * moments);
}

}  // namespace
}  // namespace mtled
