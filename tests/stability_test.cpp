#include <gtest/gtest.h>

#include <Eigen/Dense>

#include "core/relaxation.hpp"
#include "scenes.hpp"

namespace mtled {
namespace {

using scenes::Box;
using scenes::Scene;

/// The plain problem of a scene in double, with the fictitious mass of docs/method.md: small enough for dense matrices.
struct PlainModel {
  Scene scene;
  ShapeEvaluator evaluator;
  SlotModel<double> model;

  explicit PlainModel(Scene s) : scene(std::move(s)), evaluator(scene.evaluator()) {
    model.layout = make_slot_layout(scene.cloud, 1);
    model.supports = build_supports(evaluator, model.layout, scene.points);
    model.points = &scene.points;
    const std::size_t slots = std::size_t(model.layout.num_slots);
    model.position.resize(slots);
    model.watched.assign(slots, 1);
    model.constraints = std::make_unique<ConstraintOperator<double>>(evaluator, model.layout, scene.constraints);
    model.forces = std::make_unique<CpuForces<double>>(model.supports, model.layout, scene.points);
    model.strain_energy = [](const NodalField<double>&) { return 0.0; };
    model.largest_displacement = [](const NodalField<double>& u) {
      double top = 0;
      for (std::size_t slot = 0; slot < u.slots(); ++slot)
        for (int c = 0; c < 3; ++c) top = std::max(top, std::abs(u.at(slot, c)));
      return top;
    };
    model.largest_increment = 1000, model.largest_distance = 10;
    model.active = NodalField<double>(slots), model.inverse_diagonal = NodalField<double>(slots);
    std::vector<double> mass(slots, 0.0);
    const SupportTable& t = model.supports;
    for (std::size_t p = 0; p < scene.points.size(); ++p) {
      const int b = t.begin[std::size_t(t.stencil[p])], e = t.begin[std::size_t(t.stencil[p]) + 1];
      for (int i = b; i < e; ++i)
        mass[std::size_t(t.base[p] + t.offset[std::size_t(i)])] += scene.points.volume[p] * (scene.points.bulk_modulus[p] + 4 * scene.points.shear_modulus[p] / 3) / (e - b);
    }
    for (std::size_t i = 0; i < slots; ++i)
      for (int c = 0; c < 3; ++c)
        if (mass[i] > 0) model.active.at(i, c) = 1, model.inverse_diagonal.at(i, c) = 1 / mass[i];
    model.constraints->each_dependent(false, [&](int slot, int c) { model.active.at(std::size_t(slot), c) = 0, model.inverse_diagonal.at(std::size_t(slot), c) = 0; });
  }

  /// Largest eigenvalue of P K at rest from the dense matrix.
  double true_eigenvalue() const {
    const std::size_t slots = model.position.size();
    std::vector<std::pair<std::size_t, int>> free;
    for (std::size_t i = 0; i < slots; ++i)
      for (int c = 0; c < 3; ++c)
        if (model.active.at(i, c) != 0) free.push_back({i, c});
    NodalField<double> rest(slots), e(slots), f(slots);
    Eigen::MatrixXd A(free.size(), free.size());
    const auto root = [&](std::size_t r) { return std::sqrt(model.inverse_diagonal.at(free[r].first, free[r].second)); };
    for (std::size_t r = 0; r < free.size(); ++r) {
      e.clear();
      e.at(free[r].first, free[r].second) = root(r);
      model.constraints->impose(e, 0);
      model.tangent(rest, e, f);
      model.constraints->reduce(f);
      for (std::size_t q = 0; q < free.size(); ++q) A(Eigen::Index(q), Eigen::Index(r)) = root(q) * f.at(free[q].first, free[q].second);
    }
    EXPECT_LT((A - A.transpose()).norm(), 1e-10 * A.norm());
    return Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd>(A, Eigen::EigenvaluesOnly).eigenvalues().maxCoeff();
  }
  RelaxationResult run(double largest_eigenvalue) const {
    SolverOptions o;
    o.largest_eigenvalue = largest_eigenvalue, o.relaxation = Relaxation::plain, o.double_precision = true, o.tolerance_mm = 1e-4, o.max_steps = 20000;
    NodalField<double> u(model.position.size());
    return relax(model, o, 1, u);
  }
};

enum class Kind { lattice, jittered, cut };
/// A cube of 5 x 5 x 5 cells that is shortened by 1 %, so that its eigenvalues stay those at rest to about that; `cut`: a
/// ball's boundary cuts its lattice cells, and some carry only a tenth of their volume.
PlainModel small_body(Kind kind) {
  const Box box{{5, 5, 5}, 10};
  Scene scene;
  scene.cloud = kind == Kind::jittered ? scenes::jittered_box(box) : scenes::lattice_box(box);
  scenes::prescribe(scene.cloud, scene.constraints, "bottom", scenes::below(2, 0), scenes::nowhere);
  scenes::prescribe(scene.cloud, scene.constraints, "top", scenes::above(2, box.length(2)), [](const Vec3d&) { return Vec3d{0, 0, -0.5}; });
  scene.points = kind == Kind::jittered ? scenes::box_points(box, scenes::uniform(1)) : scenes::coupled_box_points(box, scene.cloud, scene.constraints, scenes::uniform(1));
  if (kind == Kind::cut)
    for (std::size_t p = 0; p < scene.points.size(); ++p)
      if (norm(scene.points.position[p] - Vec3d{25, 25, 25}) > 27) scene.points.volume[p] *= 0.1;
  return PlainModel(std::move(scene));
}

class StableStep : public testing::TestWithParam<Kind> {};
INSTANTIATE_TEST_SUITE_P(Clouds, StableStep, testing::Values(Kind::lattice, Kind::jittered, Kind::cut),
                         [](const auto& k) { return k.param == Kind::lattice ? "lattice" : k.param == Kind::jittered ? "jittered" : "cut"; });

// The limit of the step is proportional to 1 / sqrt(lambda_max).
TEST_P(StableStep, EstimateIsBelowTheLimitAndWithinAThird) {
  const PlainModel body = small_body(GetParam());
  const double truth = body.true_eigenvalue();
  const RelaxationResult result = body.run(0);
  EXPECT_TRUE(result.converged);
  EXPECT_GE(result.largest_eigenvalue, truth);
  EXPECT_LT(std::sqrt(result.largest_eigenvalue / truth), 1.3);
}

TEST_P(StableStep, JustBelowTheLimitConvergesAndJustAboveIsReportedAsDivergence) {
  const PlainModel body = small_body(GetParam());
  const double truth = body.true_eigenvalue();
  const RelaxationResult below = body.run(truth / (0.99 * 0.99)), above = body.run(truth / (1.05 * 1.05));
  EXPECT_TRUE(below.converged && !below.diverged);
  EXPECT_TRUE(above.diverged && !above.converged);
}

}  // namespace
}  // namespace mtled
