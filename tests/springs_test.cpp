#include "core/springs.hpp"

#include <gtest/gtest.h>

#include <cstring>
#include <random>

#include "core/coarse_space.hpp"
#include "core/parallel.hpp"
#include "scenes.hpp"

namespace mtled {
namespace {

using scenes::Box;

constexpr double h = 10;  ///< node spacing [mm]
const Box box{{5, 5, 6}, h};
constexpr double modulus_times_spacing = 51 * h;  ///< (k + 4 mu / 3) h of 1 kPa [mN/mm]: the stiffness of the body around a node

/// Springs of all kinds on a box: at places between nodes, with sets and without.
Springs some_springs(const Cloud& cloud, int count) {
  const ShapeEvaluator field(cloud, {}, {});
  std::mt19937 random(3);
  std::uniform_real_distribution<double> along(0, 1);
  Springs springs;
  springs.set_names = {"a", "b"};
  for (int r = 0; r < count; ++r) {
    ShapeFunctions shapes;
    EXPECT_TRUE(field.at({along(random) * box.length(0), along(random) * box.length(1), along(random) * box.length(2)}, shapes));
    if (r % 3 == 2)
      for (double& v : shapes.value) v -= 0.3;  // nothing in the interface says that coefficients sum to 1
    springs.add(shapes.node, shapes.value, 1 + 5 * along(random), {along(random), -along(random), 2}, r % 3 - 1);
  }
  return springs;
}

NodalField<double> some_displacement(const SlotLayout& layout) {
  std::mt19937 random(4);
  std::uniform_real_distribution<double> move(-1, 1);
  NodalField<double> u(std::size_t(layout.num_slots));
  for (int s : layout.slot_of_node)
    for (int c = 0; c < 3; ++c) u.at(std::size_t(s), c) = move(random);
  return u;
}

TEST(Springs, ForceIsTheGradientOfTheEnergy) {
  const Cloud cloud = scenes::lattice_box(box);
  const SlotLayout layout = make_slot_layout(cloud, 1);
  const SpringForces<double> forces(some_springs(cloud, 60), layout);
  NodalField<double> u = some_displacement(layout), f(u.slots());
  const double load = 0.7;
  forces.add_force(u, load, f);
  double largest = 0;
  for (int n : {0, 40, 101, 200})
    for (int c = 0; c < 3; ++c) {
      double& x = u.at(std::size_t(layout.slot_of_node[std::size_t(n)]), c);
      const double at = x, step = 0.5;  // the energy is quadratic: central differences are exact
      x = at + step;
      const double above = forces.energy(u, load);
      x = at - step;
      const double below = forces.energy(u, load);
      x = at;
      const double force = f.at(std::size_t(layout.slot_of_node[std::size_t(n)]), c);
      EXPECT_NEAR((above - below) / (2 * step), force, 1e-10 * forces.energy(u, load));
      largest = std::max(largest, std::abs(force));
    }
  EXPECT_GT(largest, 1);
}

TEST(Springs, TangentAndDiagonalAreThoseOfTheForce) {
  const Cloud cloud = scenes::lattice_box(box);
  const SlotLayout layout = make_slot_layout(cloud, 1);
  const SpringForces<double> forces(some_springs(cloud, 60), layout);
  const NodalField<double> u = some_displacement(layout);
  NodalField<double> f(u.slots()), rest(u.slots()), product(u.slots()), diagonal(u.slots());
  forces.add_force(u, 1, f);
  forces.add_force(NodalField<double>(u.slots()), 1, rest);
  forces.add_tangent(u, product);
  forces.each_diagonal_term([&](std::size_t slot, double k) { diagonal.at(slot, 0) += k; });
  for (int n : layout.slot_of_node) {
    for (int c = 0; c < 3; ++c) EXPECT_NEAR(product.at(std::size_t(n), c), f.at(std::size_t(n), c) - rest.at(std::size_t(n), c), 1e-11);
    NodalField<double> one(u.slots()), column(u.slots());
    one.at(std::size_t(n), 0) = 1;
    forces.add_tangent(one, column);
    EXPECT_NEAR(column.at(std::size_t(n), 0), diagonal.at(std::size_t(n), 0), 1e-11);
  }
}

TEST(Springs, ReactionsAreTheResultantsOfTheSets) {
  const Cloud cloud = scenes::lattice_box(box);
  const SlotLayout layout = make_slot_layout(cloud, 1);
  const Springs all = some_springs(cloud, 60);
  const NodalField<double> u = some_displacement(layout);
  const auto reactions = SpringForces<double>(all, layout).reactions(u, 1);
  ASSERT_EQ(reactions.size(), 2u);
  for (int set : {0, 1}) {
    Springs own;
    for (std::size_t r = 0; r < all.size(); ++r)
      if (all.set[r] == set)
        own.add({all.node.begin() + std::ptrdiff_t(all.begin[r]), all.node.begin() + std::ptrdiff_t(all.begin[r + 1])},
                {all.coefficient.begin() + std::ptrdiff_t(all.begin[r]), all.coefficient.begin() + std::ptrdiff_t(all.begin[r + 1])}, all.stiffness[r], all.target[r], -1);
    NodalField<double> f(u.slots());
    SpringForces<double>(own, layout).add_force(u, 1, f);
    Vec3d sum{};
    for (int s : layout.slot_of_node)
      for (int c = 0; c < 3; ++c) sum[c] += f.at(std::size_t(s), c);
    EXPECT_GT(norm(sum), 1);
    EXPECT_LT(norm(sum + reactions.at(all.set_names[std::size_t(set)])), 1e-10);
  }
}

TEST(Springs, ForcesAreTheSameBitsForAnyNumberOfThreads) {
  const Cloud cloud = scenes::lattice_box(box);
  const SlotLayout layout = make_slot_layout(cloud, 1);
  const Springs springs = some_springs(cloud, 20000);  // several pieces of work
  const NodalField<double> u = some_displacement(layout);
  const auto forces = [&](int threads) {
    const ThreadLimit limit(threads);
    NodalField<double> f(u.slots());
    SpringForces<double>(springs, layout).add_force(u, 1, f);
    return f;
  };
  const NodalField<double> one = forces(1), two = forces(2);
  for (int c = 0; c < 3; ++c) EXPECT_EQ(std::memcmp(one.component(c), two.component(c), one.slots() * sizeof(double)), 0);
}

// With springs alone, the coarse correction must give a smooth displacement back from its force. Left out of the coarse
// matrix, or with a wrong factor, they do not.
TEST(Springs, AreInTheCoarseMatrix) {
  const Cloud cloud = scenes::lattice_box(box);
  const SlotLayout layout = make_slot_layout(cloud, 1);
  Springs springs = some_springs(cloud, 3000);
  for (int& s : springs.set) s = 0;
  std::vector<Vec3d> position(std::size_t(layout.num_slots));
  std::vector<std::uint8_t> active(3 * position.size(), 0);
  const auto free = [&](std::size_t slot, int c) -> std::uint8_t& { return active[std::size_t(c) * position.size() + slot]; };
  for (std::size_t n = 0; n < cloud.size(); ++n) {
    const std::size_t slot = std::size_t(layout.slot_of_node[n]);
    position[slot] = cloud.nodes[n];
    for (int c = 0; c < 3; ++c) free(slot, c) = cloud.nodes[n].x < 1 && c == 1 ? 0 : 1;  // some components prescribed
  }
  CoarseSpace coarse(position, active, 100, 40);
  coarse.add_springs(springs, layout);
  coarse.assemble({}, {}, std::vector<Vec3d>(position.size()));
  const SpringForces<double> forces(springs, layout);
  NodalField<double> smooth(position.size()), f(position.size()), again(position.size());
  for (std::size_t s = 0; s < position.size(); ++s) {
    const Vec3d linear{1 + 0.02 * position[s].y, 0.03 * position[s].x - 1, 0.5 - 0.02 * position[s].z};
    for (int c = 0; c < 3; ++c) smooth.at(s, c) = free(s, c) * linear[c];
  }
  forces.add_tangent(smooth, f);
  coarse.add_correction(f, again);
  double largest = 0, difference = 0;
  for (std::size_t s = 0; s < position.size(); ++s)
    for (int c = 0; c < 3; ++c) {
      largest = std::max(largest, std::abs(smooth.at(s, c)));
      difference = std::max(difference, std::abs(again.at(s, c) - smooth.at(s, c)));
    }
  EXPECT_LT(difference, 0.01 * largest);  // the inverse is in single precision and slightly shifted
}

/// A cube between plates that are held by constraints or by springs of stiffness k [mN/mm] at every node of theirs.
struct HeldCube {
  Cloud cloud = scenes::lattice_box(box);
  IntegrationPoints points = scenes::box_points(box, scenes::uniform(1));
  Constraints constraints;
  HeldCube() {
    scenes::prescribe(cloud, constraints, "bottom", scenes::below(2, 0), scenes::nowhere);
    scenes::prescribe(cloud, constraints, "top", scenes::above(2, box.length(2)), [](const Vec3d&) { return Vec3d{3, 0, -5}; });
  }
  SolverOptions options(Relaxation relaxation) const {
    SolverOptions o;
    o.relaxation = relaxation, o.tolerance_mm = 2e-4, o.double_precision = true;
    return o;
  }
  // Without coupling of the shape functions, so that both problems have the same fields.
  Solution by_constraints(Relaxation relaxation) const { return solve(ShapeEvaluator(cloud, {}, {}), points, constraints, options(relaxation)); }
  Solution by_springs(Relaxation relaxation, double k) const {
    const ShapeEvaluator field(cloud, {}, {});
    Springs springs;
    springs.set_names = constraints.set_names;
    for (std::size_t b = 0; b < constraints.node.size(); ++b) {
      ShapeFunctions shapes;
      EXPECT_TRUE(field.at(cloud.nodes[std::size_t(constraints.node[b])], shapes));
      springs.add(shapes.node, shapes.value, k, constraints.displacement[b], constraints.set[b]);
    }
    return solve(field, points, {}, options(relaxation), springs);
  }
};

class HeldBySprings : public testing::TestWithParam<Relaxation> {};
INSTANTIATE_TEST_SUITE_P(Relaxations, HeldBySprings, testing::Values(Relaxation::plain, Relaxation::two_level),
                         [](const auto& r) { return r.param == Relaxation::plain ? "plain" : "two_level"; });

TEST_P(HeldBySprings, TheBodyIsHeldByConstraintsInTheStiffLimit) {
  const HeldCube cube;
  const Solution held = cube.by_constraints(GetParam());
  const double k = 2 * modulus_times_spacing;
  const Solution stiff = cube.by_springs(GetParam(), k), stiffer = cube.by_springs(GetParam(), 4 * k);
  ASSERT_TRUE(held.converged && stiff.converged && stiffer.converged);
  // The springs' stretch falls with 1 / k: what is left is of the order 1 / k^2 once that is extrapolated away.
  double error = 0, extrapolated = 0;
  for (std::size_t n = 0; n < held.displacement.size(); ++n) {
    const Vec3d a = stiff.displacement[n], b = stiffer.displacement[n];
    error = std::max(error, norm(b - held.displacement[n]));
    extrapolated = std::max(extrapolated, norm((1.0 / 3) * (4.0 * b - a) - held.displacement[n]));
  }
  EXPECT_GT(error, 0.005);
  EXPECT_LT(extrapolated, 0.1 * error);
  for (const char* set : {"bottom", "top"}) {
    const Vec3d a = stiff.reactions.at(set), b = stiffer.reactions.at(set), limit = (1.0 / 3) * (4.0 * b - a);
    EXPECT_LT(norm(limit - held.reactions.at(set)), 0.01 * norm(held.reactions.at(set))) << set;
  }
  EXPECT_LT(norm(stiffer.reactions.at("top") + stiffer.reactions.at("bottom")), 1e-3 * norm(stiffer.reactions.at("top")));
}

TEST_P(HeldBySprings, IsTheSameBitsForAnyNumberOfThreads) {
  const HeldCube cube;
  const auto parameters = [&](int threads) {
    const ThreadLimit limit(threads);
    return cube.by_springs(GetParam(), modulus_times_spacing).parameter;
  };
  EXPECT_EQ(parameters(1), parameters(2));
}

TEST(Springs, WithoutASetHoldNothing) {
  const HeldCube cube;
  Springs springs;
  springs.add({0, 1}, {1, -1}, 1, {}, -1);
  const std::string message = scenes::error_of([&] { solve(ShapeEvaluator(cube.cloud, {}, {}), cube.points, {}, {}, springs); });
  EXPECT_NE(message.find("no prescribed displacements"), std::string::npos) << message;
}

}  // namespace
}  // namespace mtled
