#include <gtest/gtest.h>

#include <numeric>

#include "core/discrete_model.hpp"
#include "core/shape_evaluator.hpp"
#include "scenes.hpp"
#include "step_traffic.hpp"
#include "torso_model.hpp"

namespace mtled {
namespace {

TEST(Torso, HasAboutTheNodesAskedFor) {
  for (const std::size_t wanted : {1000u, 20000u, 100000u}) {
    const SampledBody torso = sample_torso(wanted, CloudKind::lattice);
    EXPECT_NEAR(double(torso.cloud.size()), double(wanted), 0.05 * double(wanted));
  }
}

TEST(Torso, IsTheSameEveryTime) {
  for (const CloudKind kind : {CloudKind::lattice, CloudKind::general}) {
    const SampledBody a = sample_torso(5000, kind), b = sample_torso(5000, kind);
    EXPECT_EQ(a.cloud.nodes, b.cloud.nodes);
    EXPECT_EQ(a.points.position, b.points.position);
    EXPECT_EQ(a.points.shear_modulus, b.points.shear_modulus);
    EXPECT_EQ(a.rigid.displacement, b.rigid.displacement);
  }
}

TEST(Torso, IsMadeOfSoftTissueAndTwelveRigidBodies) {
  const SampledBody torso = sample_torso(20000, CloudKind::lattice);
  const auto [softest, stiffest] = std::minmax_element(torso.points.shear_modulus.begin(), torso.points.shear_modulus.end());
  EXPECT_LT(*softest, 0.6);
  EXPECT_GT(*stiffest, 5.5);
  EXPECT_EQ(torso.rigid.set_names.size(), 12u);
  EXPECT_TRUE(torso.labels_outside.empty());
  const double soft = std::accumulate(torso.points.volume.begin(), torso.points.volume.end(), 0.0);
  EXPECT_GT(soft, 0.95 * torso.body_volume_mm3);  // the skeleton is 3 %
  EXPECT_LT(soft, 0.98 * torso.body_volume_mm3);
}

/// The bones turn as the field does around them: at the end of a rib, 0.2 m in front of the spine and 20 mm below the centre
/// of its vertebra, the field has turned by 0.02 * 7e-4 more, and is 2.5 mm off. A wrong sign would be 20 mm off or more.
TEST(Torso, BonesFollowTheBending) {
  const SampledBody torso = sample_torso(20000, CloudKind::lattice);
  double largest = 0, worst = 0;
  for (std::size_t p = 0; p < torso.rigid.position.size(); ++p) {
    largest = std::max(largest, norm(torso.rigid.displacement[p]));
    worst = std::max(worst, norm(torso.rigid.displacement[p] - torso_bending(torso.rigid.position[p])));
  }
  EXPECT_GT(largest, 20);
  EXPECT_LT(worst, 3);
}

/// J = 1 + (y - y_spine) * curvature.
TEST(Torso, BendingTurnsNothingInsideOut) {
  const SampledBody torso = sample_torso(1000, CloudKind::lattice);
  constexpr double step = 1e-4;
  for (const Vec3d& x : torso.cloud.nodes) {
    Mat3d F = Mat3d::identity();
    for (int c = 0; c < 3; ++c) {
      Vec3d d{};
      d[c] = step;
      const Vec3d change = (0.5 / step) * (torso_bending(x + d) - torso_bending(x - d));
      for (int r = 0; r < 3; ++r) F[r][c] += change[r];
    }
    ASSERT_NEAR(determinant(F), 1 + 7e-4 * (x.y - 55), 1e-6);
    ASSERT_GT(determinant(F), 0.8);
  }
}

TEST(Torso, GeneralCloudSharesNoSupports) {
  const SampledBody torso = sample_torso(5000, CloudKind::general);
  EXPECT_FALSE(torso.cloud.lattice);
  const ShapeEvaluator field(torso.cloud, {}, {});
  const SupportTable supports = build_supports(field, make_slot_layout(torso.cloud, 1), torso.points);
  EXPECT_GE(std::size_t(supports.num_stencils()), torso.points.size());
  EXPECT_LT(double(supports.enlarged + supports.dropped.size()), 0.01 * double(torso.points.size()));
}

/// Every byte of the formula, counted one by one on a cube and on a cloud.
TEST(StepTraffic, CountsWhatAStepMustMove) {
  const scenes::Box box{{4, 4, 4}, 10};
  for (const bool lattice : {true, false}) {
    const Cloud cloud = lattice ? scenes::lattice_box(box) : scenes::jittered_box(box);
    const IntegrationPoints points = scenes::box_points(box, scenes::uniform(1));
    const ShapeEvaluator field(cloud, {}, {});
    DiscreteModel model;
    model.field = &field, model.points = &points;
    model.supports = build_supports(field, make_slot_layout(cloud, 1), points);
    model.springs.add({0, 1, 2}, {0.5, 0.25, 0.25}, 1, {}, 0);
    ASSERT_TRUE(model.supports.dropped.empty());
    double once = 0, in_each_pass = 0, nodes = 0;
    for (int s = 0; s < model.supports.num_stencils(); ++s) in_each_pass += (4 + 4 + 4 + 4) * (model.supports.begin[std::size_t(s) + 1] - model.supports.begin[std::size_t(s)]);
    for (std::size_t p = 0; p < points.size(); ++p) in_each_pass += 4 + 4, once += 4 + 4 + 4;
    for (int entry = 0; entry < 3; ++entry) in_each_pass += 4 + 4;
    once += 4 + 3 * 4;
    for (std::size_t n = 0; n < cloud.size(); ++n) ++nodes;
    const StepTraffic two = step_traffic(model, 4, false, 0), one = step_traffic(model, 4, true, 0), coarse = step_traffic(model, 4, false, 100);
    EXPECT_EQ(two.tables, 2 * in_each_pass + once);
    EXPECT_EQ(one.tables, in_each_pass + once);
    EXPECT_EQ(two.displacement, 12 * nodes);
    EXPECT_EQ(two.stresses, 72 * double(points.size()));
    EXPECT_EQ(one.stresses, 0);
    EXPECT_EQ(two.state, (24 + 24 + 24 + 12 + 1) * nodes);
    EXPECT_EQ(one.state, two.state + 24 * nodes);
    EXPECT_EQ(coarse.total() - two.total(), 24 * nodes + 40000);
    EXPECT_EQ(step_traffic(model, 8, false, 0).stresses, 2 * two.stresses);
  }
}

}  // namespace
}  // namespace mtled
