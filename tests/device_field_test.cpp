#include "backends.hpp"
#include "core/body_sampling.hpp"
#include "core/shape_evaluator.hpp"
#include "cuda/field.hpp"
#include "cuda/field_on.hpp"
#include "cuda/serial_device.hpp"
#include "scenes.hpp"

namespace mtled {
namespace {

using backends::Backend;
using scenes::Box;

constexpr double h = 5;
const Box box{{11, 9, 13}, h};  // odd sizes
// Parameters are kept in single precision: 40 mm of them to 2e-6 mm, and shape functions with values below 1. Rounding of the
// moments in double is far below that.
constexpr double float_tolerance_mm = 1e-5;

Vec3d strong(const Vec3d& X) { return {6 * std::sin(X.x / 12), 0.6 * X.x + 3 * std::cos(X.z / 9), 4 * std::sin(X.y / 12)}; }

struct Scene {
  std::string name;
  MlsOptions options;
  friend std::ostream& operator<<(std::ostream& out, const Scene& s) { return out << s.name; }
};
/// A box, whose cells are known or not; one with an empty layer of cells, but for its end; a ragged ball; a slab with a rod one cell thin,
/// whose supports must be enlarged; a box that is coupled with finite elements.
class DeviceField : public testing::TestWithParam<std::tuple<Scene, Backend>> {
 protected:
  void SetUp() override {
    backends::skip_without_device(backend);
    if (IsSkipped()) return;
    const auto in_ball = [](const std::array<int, 3>& c) { return squared_norm(Vec3d{c[0] - 5.0, c[1] - 4.0, c[2] - 6.0}) < 17; };
    const auto beside_slit = [](const std::array<int, 3>& c) { return c[2] != 6 || c[0] < 4; };
    const auto in_rod = [](const std::array<int, 3>& c) { return c[2] < 3 || (c[0] == 5 && c[1] == 4); };
    const auto kept = [&](const std::array<int, 3>& c) { return name == "ball" ? in_ball(c) : name == "slit" ? beside_slit(c) : name == "rod" ? in_rod(c) : true; };
    cloud = scenes::on_lattice(scenes::cell_corners(box, kept), h);
    if (name != "unmarked")
      mark_body_cells(cloud, scenes::box_points(box, scenes::uniform(1), 0.49, scenes::usual_ratio, [&](const std::array<int, 3>& c) {
        return kept(c) ? scenes::CellKind::free : scenes::CellKind::absent;
      }));
    std::vector<std::uint8_t> prescribed;
    if (name == "coupled")
      for (const Vec3d& x : cloud.nodes) prescribed.push_back(x.z < 0.5 * h);
    evaluator.emplace(cloud, prescribed, scene.options);
    for (const Vec3d& x : cloud.nodes) parameter.push_back(strong(x));
    if (backend == Backend::cuda) device = cuda_field(backends::device().ordinal, *evaluator, parameter);
    else device = std::make_unique<FieldOn<SerialDevice>>(SerialDevice(), make_lattice_field(*evaluator, parameter));
    // Voxels beyond the body on all sides, many of them on lattice planes.
    grid.size = {71, 47, 37};
    grid.spacing = {h / 6, h / 4, h / 2.4};
    grid.origin = Vec3d{-h, -h, -h};
  }
  /// As in Deformation.
  bool displacement(const Vec3d& X, Vec3d& u, int& enlargements) const {
    ShapeFunctions shapes;
    if (!evaluator->covers(X) || !evaluator->at(X, shapes, &enlargements)) return false;
    u = {};
    for (std::size_t i = 0; i < shapes.node.size(); ++i) u += shapes.value[i] * parameter[std::size_t(shapes.node[i])];
    return true;
  }
  template <class Work>
  void each_voxel(const Work& work) const {
    for (int k = 0; k < grid.size[2]; ++k)
      for (int j = 0; j < grid.size[1]; ++j)
        for (int i = 0; i < grid.size[0]; ++i) work(grid.point(i, j, k), grid.offset(i, j, k));
  }

  const Scene scene = std::get<0>(GetParam());
  const Backend backend = std::get<1>(GetParam());
  const std::string& name = scene.name;
  Cloud cloud;
  std::optional<ShapeEvaluator> evaluator;
  std::vector<Vec3d> parameter;
  std::unique_ptr<FieldBackend> device;
  Grid grid;
};
std::vector<Scene> every_scene() {
  std::vector<Scene> scenes;
  for (const char* name : {"box", "unmarked", "slit", "ball", "coupled"})
    for (const MlsOptions& o : {MlsOptions{Basis::linear, 1.75}, MlsOptions{Basis::modified_quadratic, 2.25}}) scenes.push_back({name, o});
  scenes.push_back({"rod", {Basis::linear, 1.2}});
  scenes.push_back({"rod", {Basis::modified_quadratic, 2.25}});
  scenes.push_back({"slit", {Basis::quadratic, 2.5}});
  scenes.push_back({"box", {Basis::linear, 3.2}});
  return scenes;
}
std::string name_of(const testing::TestParamInfo<DeviceField::ParamType>& info) {
  const auto& [scene, backend] = info.param;
  const MlsOptions& o = scene.options;
  return scene.name + (o.basis == Basis::linear ? o.dilatation > 2 ? "LinearWide" : "Linear" : o.basis == Basis::quadratic ? "Quadratic" : "Modified") + "_" + backends::name(backend);
}
INSTANTIATE_TEST_SUITE_P(All, DeviceField, testing::Combine(testing::ValuesIn(every_scene()), backends::device_backends), name_of);

TEST_P(DeviceField, IsTheShapeEvaluatorsWhereItDecides) {
  VectorImage u(grid);
  Volume<Coverage> coverage(grid, Coverage::unresolved);
  device->forward(u, coverage);
  const bool walks = evaluator->reach() <= LatticeFieldView::longest_walk;
  std::size_t covered = 0, needed = 0, needless = 0;
  double largest = 0;
  each_voxel([&](const Vec3d& X, std::size_t voxel) {
    Vec3d exact;
    int enlargements = 0;
    const bool there = displacement(X, exact, enlargements);
    const bool plain = there && enlargements == 0 && !evaluator->coupled(cell_of(*cloud.lattice, X));
    switch (coverage.data[voxel]) {
      case Coverage::covered: {
        ++covered;
        ASSERT_TRUE(plain);
        const Vec3f& v = u.data[voxel];
        largest = std::max(largest, norm(Vec3d{v.x, v.y, v.z} - exact));
        break;
      }
      case Coverage::outside: ASSERT_FALSE(evaluator->covers(X)); break;
      case Coverage::undecided:
        ASSERT_TRUE(evaluator->covers(X));
        ++(plain ? needless : needed);
        break;
      default: FAIL();
    }
  });
  EXPECT_LT(largest, float_tolerance_mm);
  EXPECT_GT(covered, 0u);
  EXPECT_EQ(needed > 0, name == "rod" || name == "coupled");
  // The bound of the condition is good enough for the usual supports.
  EXPECT_EQ(needless > 0, !walks || scene.options.dilatation < 1.5) << needless << " of " << covered;
}

TEST_P(DeviceField, InverseMeetsItsToleranceAndLeavesTheRest) {
  constexpr double tolerance_mm = 0.01;
  VectorImage u(grid), v(grid);
  Volume<Coverage> forward_coverage(grid, Coverage::unresolved), coverage(grid, Coverage::unresolved);
  device->forward(u, forward_coverage);
  // The same start for both, without the body's smooth extension: zero outside.
  const double largest_residual = device->inverse(u, tolerance_mm, v, coverage);
  EXPECT_LE(largest_residual, tolerance_mm);
  EXPECT_GT(largest_residual, 0);
  const auto exact = [&](const Vec3d& X, Vec3d& value) {
    int enlargements;
    return displacement(X, value, enlargements) ? Coverage::covered : Coverage::outside;
  };
  const SolveForRestPosition solve(view_of(u), exact, tolerance_mm);
  std::size_t covered = 0;
  each_voxel([&](const Vec3d& y, std::size_t voxel) {
    if (coverage.data[voxel] == Coverage::undecided) return;
    Vec3d X;
    double residual;
    ASSERT_EQ(coverage.data[voxel], solve(y, X, residual)) << y.x << ' ' << y.y << ' ' << y.z;
    if (coverage.data[voxel] != Coverage::covered) return;
    ++covered;
    const Vec3f& d = v.data[voxel];
    const Vec3d there = y + Vec3d{d.x, d.y, d.z};
    Vec3d value;
    ASSERT_EQ(exact(there, value), Coverage::covered);
    ASSERT_LE(norm(there + value - y), tolerance_mm + 3 * float_tolerance_mm);
  });
  EXPECT_GT(covered, 0u);
}

TEST(LatticeField, NeedsALattice) {
  const Cloud cloud = scenes::jittered_box(box);
  Failure failure{};
  const std::string message = scenes::error_of([&] { make_lattice_field(ShapeEvaluator(cloud, {}, {}), std::vector<Vec3d>(cloud.size())); }, &failure);
  EXPECT_EQ(failure, Failure::input);
  EXPECT_NE(message.find("no lattice"), std::string::npos) << message;
}

}  // namespace
}  // namespace mtled
