#include "core/moving_least_squares.hpp"

#include <gtest/gtest.h>

#include <random>

namespace mtled {
namespace {

constexpr double h = 3.5;  ///< node spacing [mm]

// Double precision with moment matrices of condition up to 1e4.
constexpr double reproduction_tolerance = 1e-10;

struct Case {
  const char* name;
  Basis basis;
  double dilatation, jitter;
};
std::ostream& operator<<(std::ostream& out, const Case& c) { return out << c.name; }

struct Nodes {
  std::vector<int> number;
  std::vector<Vec3d> position;
};

/// 9 x 9 x 9 nodes around the origin, moved by up to jitter * h along each axis.
Nodes block(double jitter) {
  std::mt19937 random(3);
  std::uniform_real_distribution<double> move(-jitter * h, jitter * h);
  Nodes nodes;
  for (int k = -4; k <= 4; ++k)
    for (int j = -4; j <= 4; ++j)
      for (int i = -4; i <= 4; ++i) {
        nodes.number.push_back(int(nodes.number.size()));
        nodes.position.push_back(h * Vec3d{double(i), double(j), double(k)} + Vec3d{move(random), move(random), move(random)});
      }
  return nodes;
}

bool shapes_at(const Nodes& nodes, const Vec3d& x, double radius, const MlsOptions& options, ShapeFunctions& shapes) {
  std::vector<Vec3d> relative;
  for (const Vec3d& p : nodes.position) relative.push_back(p - x);
  return moving_least_squares(nodes.number, relative, radius, options, shapes);
}

/// Places off the symmetry planes of the lattice.
std::vector<Vec3d> places() {
  std::mt19937 random(9);
  std::uniform_real_distribution<double> within(-h / 2, h / 2);
  std::vector<Vec3d> result;
  for (int n = 0; n < 20; ++n) result.push_back({within(random), within(random), within(random)});
  return result;
}

class MovingLeastSquares : public testing::TestWithParam<Case> {
 protected:
  Nodes nodes = block(GetParam().jitter);
  MlsOptions options{GetParam().basis, GetParam().dilatation};
  double radius = GetParam().dilatation * h;
};

TEST_P(MovingLeastSquares, ReproducesConstantsAndLinearFields) {
  for (const Vec3d& x : places()) {
    ShapeFunctions s;
    ASSERT_TRUE(shapes_at(nodes, x, radius, options, s));
    double one = 0;
    Vec3d position{}, gradient_of_one{};
    Mat3d gradient_of_position;
    for (std::size_t i = 0; i < s.node.size(); ++i) {
      const Vec3d& p = nodes.position[std::size_t(s.node[i])];
      one += s.value[i], position += s.value[i] * p, gradient_of_one += s.gradient[i];
      for (int a = 0; a < 3; ++a)
        for (int b = 0; b < 3; ++b) gradient_of_position[a][b] += p[a] * s.gradient[i][b];
    }
    EXPECT_NEAR(one, 1, reproduction_tolerance);
    EXPECT_LT(norm(position - x), reproduction_tolerance * h);
    EXPECT_LT(norm(gradient_of_one), reproduction_tolerance / h);
    for (int a = 0; a < 3; ++a)
      for (int b = 0; b < 3; ++b) EXPECT_NEAR(gradient_of_position[a][b], a == b, reproduction_tolerance);
  }
}

TEST_P(MovingLeastSquares, ReproducesQuadraticFieldsOnlyWithTheFullQuadraticBasis) {
  const auto field = [](const Vec3d& x) { return (x.x * x.y - 2 * x.z * x.z + 0.5 * x.y * x.z) / (h * h); };
  const auto gradient = [](const Vec3d& x) { return (1 / (h * h)) * Vec3d{x.y, x.x + 0.5 * x.z, -4 * x.z + 0.5 * x.y}; };
  double worst = 0;
  for (const Vec3d& x : places()) {
    ShapeFunctions s;
    ASSERT_TRUE(shapes_at(nodes, x, radius, options, s));
    double value = -field(x);
    Vec3d slope = Vec3d{} - gradient(x);
    for (std::size_t i = 0; i < s.node.size(); ++i) {
      const double f = field(nodes.position[std::size_t(s.node[i])]);
      value += s.value[i] * f, slope += f * s.gradient[i];
    }
    worst = std::max({worst, std::abs(value), h * norm(slope)});
  }
  if (GetParam().basis == Basis::quadratic)
    EXPECT_LT(worst, reproduction_tolerance);
  else
    EXPECT_GT(worst, 1e-3);  // shows that the field tells the bases apart
}

TEST_P(MovingLeastSquares, GradientsAreDifferencesOfValues) {
  constexpr double step = 1e-4 * h;
  constexpr double truncation = 1e-6;  // (step / h)^2 times third derivatives up to 100
  double worst = 0, worst_with_wrong_radius = 0;
  for (const Vec3d& x : places()) {
    ShapeFunctions s, other, up, down;
    ASSERT_TRUE(shapes_at(nodes, x, radius, options, s));
    ASSERT_TRUE(shapes_at(nodes, x, 1.01 * radius, options, other));
    const auto value_of = [](const ShapeFunctions& f, int node) {
      for (std::size_t i = 0; i < f.node.size(); ++i)
        if (f.node[i] == node) return f.value[i];
      return 0.0;
    };
    for (int a = 0; a < 3; ++a) {
      Vec3d d{};
      d[a] = step;
      ASSERT_TRUE(shapes_at(nodes, x + d, radius, options, up));
      ASSERT_TRUE(shapes_at(nodes, x - d, radius, options, down));
      for (std::size_t i = 0; i < s.node.size(); ++i) {
        const double slope = (value_of(up, s.node[i]) - value_of(down, s.node[i])) / (2 * step);
        worst = std::max(worst, h * std::abs(s.gradient[i][a] - slope));
        for (std::size_t o = 0; o < other.node.size(); ++o)
          if (other.node[o] == s.node[i]) worst_with_wrong_radius = std::max(worst_with_wrong_radius, h * std::abs(other.gradient[o][a] - slope));
      }
    }
  }
  EXPECT_LT(worst, truncation);
  EXPECT_GT(worst_with_wrong_radius, 100 * truncation);
}

TEST_P(MovingLeastSquares, DoesNotDependOnUnitsOrOrientation) {
  constexpr double scale = 1e-3;  // metres
  const Mat3d turn{{{0, -1, 0}, {0, 0, 1}, {-1, 0, 0}}};
  for (const Vec3d& x : places()) {
    ShapeFunctions a, b;
    Nodes turned = nodes;
    for (Vec3d& p : turned.position) p = scale * (turn * p);
    ASSERT_TRUE(shapes_at(nodes, x, radius, options, a));
    ASSERT_TRUE(shapes_at(turned, scale * (turn * x), scale * radius, options, b));
    ASSERT_EQ(a.node, b.node);
    for (std::size_t i = 0; i < a.node.size(); ++i) {
      EXPECT_NEAR(a.value[i], b.value[i], reproduction_tolerance);
      EXPECT_LT(norm(turn * a.gradient[i] - scale * b.gradient[i]), reproduction_tolerance);
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Bases, MovingLeastSquares,
                         testing::Values(Case{"LinearLattice", Basis::linear, 1.75, 0}, Case{"LinearJittered", Basis::linear, 1.75, 0.3},
                                         Case{"QuadraticLattice", Basis::quadratic, 2.5, 0}, Case{"QuadraticJittered", Basis::quadratic, 2.6, 0.2},
                                         Case{"ModifiedLattice", Basis::modified_quadratic, 2.25, 0},
                                         Case{"ModifiedJittered", Basis::modified_quadratic, 2.25, 0.3}),
                         testing::PrintToStringParamName());

/// The eight corners of a cube of edge 2 a around the origin.
Nodes cube_corners(double a) {
  Nodes nodes;
  for (int c = 0; c < 8; ++c) {
    nodes.number.push_back(10 + c);
    nodes.position.push_back({c & 1 ? a : -a, c & 2 ? a : -a, c & 4 ? a : -a});
  }
  return nodes;
}

TEST(MovingLeastSquaresOfACube, IsTrilinearInItsMiddle) {
  // By symmetry phi_I = 1/8; linear reproduction then leaves gradients of +-1/(8 a) per axis.
  const double a = h / 2;
  ShapeFunctions s;
  ASSERT_TRUE(shapes_at(cube_corners(a), {}, 1.75 * h, {}, s));
  ASSERT_EQ(s.node.size(), 8u);
  for (int c = 0; c < 8; ++c) {
    EXPECT_EQ(s.node[std::size_t(c)], 10 + c);
    EXPECT_NEAR(s.value[std::size_t(c)], 0.125, 1e-14);
    const Vec3d expected{c & 1 ? 1 : -1., c & 2 ? 1 : -1., c & 4 ? 1 : -1.};
    EXPECT_LT(norm(s.gradient[std::size_t(c)] - (1 / (8 * a)) * expected), 1e-14);
  }
}

TEST(MovingLeastSquaresOfPoorSupports, FewNodesAreRefused) {
  Nodes seven = cube_corners(h / 2);
  seven.number.pop_back(), seven.position.pop_back();
  ShapeFunctions s;
  s.add(1, 2, {});
  EXPECT_FALSE(shapes_at(seven, {}, 1.75 * h, {}, s));
  EXPECT_TRUE(s.node.empty() && s.value.empty() && s.gradient.empty());
}

TEST(MovingLeastSquaresOfPoorSupports, NodesBeyondTheRadiusTakeNoPart) {
  Nodes nodes = cube_corners(h / 2);
  nodes.number.push_back(99), nodes.position.push_back({1.7500001 * h, 0, 0});
  ShapeFunctions s;
  ASSERT_TRUE(shapes_at(nodes, {}, 1.75 * h, {}, s));
  EXPECT_EQ(s.node.size(), 8u);
}

TEST(MovingLeastSquaresOfPoorSupports, CoplanarNodesAreRefused) {
  Nodes plane;
  for (int j = -2; j <= 2; ++j)
    for (int i = -2; i <= 2; ++i) plane.number.push_back(int(plane.number.size())), plane.position.push_back({i * h, j * h, 0});
  for (const Basis basis : {Basis::linear, Basis::quadratic, Basis::modified_quadratic}) {
    ShapeFunctions s;
    EXPECT_FALSE(shapes_at(plane, {0.1, 0.2, 0}, 3 * h, {basis}, s));
    EXPECT_FALSE(shapes_at(plane, {0.1, 0.2, 0.5}, 3 * h, {basis}, s));
    EXPECT_TRUE(s.node.empty());
  }
}

TEST(MovingLeastSquaresOfPoorSupports, FarFromAllNodesTheConditionIsRefused) {
  // Just inside the hull of a half space the support is good; one spacing outside, all nodes are on one side.
  Nodes half = block(0);
  for (Vec3d& p : half.position) p.z -= 4 * h;  // highest plane at z = 0
  ShapeFunctions s;
  EXPECT_TRUE(shapes_at(half, {0.3, 0.4, -0.1}, 1.75 * h, {}, s));
  EXPECT_FALSE(shapes_at(half, {0.3, 0.4, 1.2 * h}, 1.75 * h, {}, s));
}

TEST(MovingLeastSquaresOfPoorSupports, ThePenaltyMakesNarrowQuadraticSupportsSolvable) {
  const Nodes nodes = block(0);
  ShapeFunctions s;
  // In the middle of a cell: eight corners, and 24 nodes at 1.658 h that hardly count.
  const Vec3d x{0.5 * h, 0.5 * h, 0.5 * h};
  EXPECT_FALSE(shapes_at(nodes, x, 1.7 * h, {Basis::quadratic}, s));
  EXPECT_TRUE(shapes_at(nodes, x, 1.7 * h, {Basis::modified_quadratic}, s));
}

}  // namespace
}  // namespace mtled
