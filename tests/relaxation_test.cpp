#include <gtest/gtest.h>

#include "slow_scenes.hpp"

namespace mtled {
namespace {

using scenes::SlowProblem;
using scenes::SlowScene;

constexpr double promised_error = 0.1;  ///< [mm] true error at the usual stop, the purpose of the solver

double largest_difference(const std::vector<Vec3d>& a, const std::vector<Vec3d>& b) {
  double top = 0;
  for (std::size_t n = 0; n < a.size(); ++n) top = std::max(top, norm(a[n] - b[n]));
  return top;
}

SolverOptions options(Relaxation relaxation, double tolerance_mm = 0.05, bool double_precision = false) {
  SolverOptions o;
  o.relaxation = relaxation, o.tolerance_mm = tolerance_mm, o.double_precision = double_precision;
  return o;
}

/// The rigid motion where it is the solution, else the same model converged a thousand times further in double.
std::vector<Vec3d> truth(const SlowScene& scene) {
  if (!scene.rigid) return scene.solve(options(Relaxation::two_level, 5e-5, true)).displacement;
  std::vector<Vec3d> u;
  for (const Vec3d& x : scene.cloud.nodes) u.push_back(scene.rigid->displacement(x));
  return u;
}

class SlowMode : public testing::TestWithParam<SlowProblem> {
 protected:
  const SlowScene scene = GetParam().make();
  void expect_true_error(const SolverOptions& o) const {
    const Solution s = scene.solve(o);
    EXPECT_TRUE(s.converged);
    EXPECT_LT(s.error_estimate_mm, o.tolerance_mm);
    EXPECT_LT(largest_difference(s.displacement, truth(scene)), promised_error / 0.05 * o.tolerance_mm)
        << s.steps << " steps, estimate " << s.error_estimate_mm << " mm, " << (o.double_precision ? "double" : "float");
  }
};
INSTANTIATE_TEST_SUITE_P(Problems, SlowMode, testing::ValuesIn(scenes::slow_problems), testing::PrintToStringParamName());

TEST_P(SlowMode, TrueErrorAtTheStopOfTwoLevels) {
  for (const double tolerance : {0.5, 0.05, 0.01})
    for (const bool double_precision : {false, true}) expect_true_error(options(Relaxation::two_level, tolerance, double_precision));
}

TEST_P(SlowMode, TrueErrorAtTheStopOfPlainRelaxation) { expect_true_error(options(Relaxation::plain)); }

// Measured before the stop was checked by a correction: 9.0 mm missing on the long beam where the estimate said 0.04 mm.
TEST_P(SlowMode, TheStartIsNotGoodEnough) {
  SolverOptions one_step = options(Relaxation::two_level);
  one_step.max_steps = 1;
  EXPECT_GT(largest_difference(scene.solve(one_step).displacement, truth(scene)), 2 * promised_error);
}

TEST(History, TellsHowTheSolutionWasReached) {
  const SlowScene scene = scenes::body_on_a_spine();
  const Solution s = scene.solve(options(Relaxation::two_level));
  ASSERT_GT(s.history.size(), 5u);
  for (std::size_t i = 1; i < s.history.size(); ++i) EXPECT_GT(s.history[i].step, s.history[i - 1].step);
  const HistoryEntry &first = s.history.front(), &last = s.history.back();
  EXPECT_EQ(last.step, s.steps);
  EXPECT_DOUBLE_EQ(last.error_estimate_mm, s.error_estimate_mm);
  EXPECT_TRUE(std::isnan(first.error_estimate_mm));  // nothing is known at the start
  EXPECT_GT(first.strain_energy, last.strain_energy);  // the start is no equilibrium
  EXPECT_NEAR(last.strain_energy, s.strain_energy, 1e-5 * s.strain_energy);
  for (const HistoryEntry& h : s.history) EXPECT_TRUE(h.convergence_rate > 0 && h.convergence_rate < 1 && h.largest_increment_mm > 0);
}

}  // namespace
}  // namespace mtled
