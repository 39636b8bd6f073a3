#include <gtest/gtest.h>

#include <Eigen/Dense>

#include "core/discrete_model.hpp"
#include "core/relaxation.hpp"
#include "scenes.hpp"

namespace mtled {
namespace {

using scenes::Box;
using scenes::Scene;

SolverOptions plain_in_double() {
  SolverOptions o;
  o.relaxation = Relaxation::plain, o.double_precision = true, o.tolerance_mm = 1e-4, o.max_steps = 20000;
  return o;
}

/// The plain problem of a scene in double: small enough for dense matrices.
struct PlainModel {
  Scene scene;
  ShapeEvaluator evaluator;
  std::vector<double> points_of_nodes;
  DiscreteModel model;
  std::unique_ptr<Mechanics> mechanics;

  explicit PlainModel(Scene s)
      : scene(std::move(s)), evaluator(scene.evaluator()), model(make_static_model(evaluator, scene.points, scene.constraints, {}, {}, plain_in_double(), points_of_nodes)),
        mechanics(make_cpu_mechanics(model, plain_in_double())) {}

  /// Largest eigenvalue of P K at rest from the dense matrix.
  double true_eigenvalue() const {
    const std::size_t slots = model.slots();
    std::vector<std::pair<std::size_t, int>> free;
    for (std::size_t i = 0; i < slots; ++i)
      for (int c = 0; c < 3; ++c)
        if (model.active[std::size_t(c) * slots + i]) free.push_back({i, c});
    const VectorPointer rest = mechanics->vector(), e = mechanics->vector(), f = mechanics->vector();
    Eigen::MatrixXd A(free.size(), free.size());
    const auto root = [&](std::size_t r) { return std::sqrt(1 / model.diagonal[std::size_t(free[r].second) * slots + free[r].first]); };
    for (std::size_t r = 0; r < free.size(); ++r) {
      std::vector<Vec3d> unit(slots);
      unit[free[r].first][free[r].second] = root(r);
      mechanics->upload(unit, *e);
      mechanics->impose(*e, 0);
      mechanics->tangent(*rest, *e, *f);
      mechanics->reduce(*f);
      const std::vector<Vec3d> force = mechanics->download(*f);
      for (std::size_t q = 0; q < free.size(); ++q) A(Eigen::Index(q), Eigen::Index(r)) = root(q) * force[free[q].first][free[q].second];
    }
    EXPECT_LT((A - A.transpose()).norm(), 1e-10 * A.norm());
    return Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd>(A, Eigen::EigenvaluesOnly).eigenvalues().maxCoeff();
  }
  RelaxationResult run(double largest_eigenvalue) const {
    SolverOptions o = plain_in_double();
    o.largest_eigenvalue = largest_eigenvalue;
    const VectorPointer u = mechanics->vector();
    return relax(model, *mechanics, o, 1, *u);
  }
};

enum class Kind { lattice, jittered, cut };
/// A cube of 5 x 5 x 5 cells that is shortened by 1 %, so that its eigenvalues stay those at rest to about that; `cut`: a
/// ball's boundary cuts its lattice cells, and some carry only a tenth of their volume.
std::unique_ptr<PlainModel> small_body(Kind kind) {
  const Box box{{5, 5, 5}, 10};
  Scene scene;
  scene.cloud = kind == Kind::jittered ? scenes::jittered_box(box) : scenes::lattice_box(box);
  scenes::prescribe(scene.cloud, scene.constraints, "bottom", scenes::below(2, 0), scenes::nowhere);
  scenes::prescribe(scene.cloud, scene.constraints, "top", scenes::above(2, box.length(2)), [](const Vec3d&) { return Vec3d{0, 0, -0.5}; });
  scene.points = kind == Kind::jittered ? scenes::box_points(box, scenes::uniform(1)) : scenes::coupled_box_points(box, scene.cloud, scene.constraints, scenes::uniform(1));
  if (kind == Kind::cut)
    for (std::size_t p = 0; p < scene.points.size(); ++p)
      if (norm(scene.points.position[p] - Vec3d{25, 25, 25}) > 27) scene.points.volume[p] *= 0.1;
  return std::make_unique<PlainModel>(std::move(scene));
}

class StableStep : public testing::TestWithParam<Kind> {};
INSTANTIATE_TEST_SUITE_P(Clouds, StableStep, testing::Values(Kind::lattice, Kind::jittered, Kind::cut),
                         [](const auto& k) { return k.param == Kind::lattice ? "lattice" : k.param == Kind::jittered ? "jittered" : "cut"; });

// The limit of the step is proportional to 1 / sqrt(lambda_max).
TEST_P(StableStep, EstimateIsBelowTheLimitAndWithinAThird) {
  const auto body = small_body(GetParam());
  const double truth = body->true_eigenvalue();
  const RelaxationResult result = body->run(0);
  EXPECT_TRUE(result.converged);
  EXPECT_GE(result.largest_eigenvalue, truth);
  EXPECT_LT(std::sqrt(result.largest_eigenvalue / truth), 1.3);
}

TEST_P(StableStep, JustBelowTheLimitConvergesAndJustAboveIsReportedAsDivergence) {
  const auto body = small_body(GetParam());
  const double truth = body->true_eigenvalue();
  const RelaxationResult below = body->run(truth / (0.99 * 0.99)), above = body->run(truth / (1.05 * 1.05));
  EXPECT_TRUE(below.converged && !below.diverged);
  EXPECT_TRUE(above.diverged && !above.converged);
}

}  // namespace
}  // namespace mtled
