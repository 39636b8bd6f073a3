// The functors of the CUDA backend, run by the serial launcher: against the CPU backend or plain loops, without a GPU.
#include <gtest/gtest.h>

#include <cstring>
#include <limits>
#include <random>

#include "core/coarse_space.hpp"
#include "core/constraint_operator.hpp"
#include "core/cpu_forces.hpp"
#include "core/point_material.hpp"
#include "cuda/advance.hpp"
#include "cuda/constraints.hpp"
#include "cuda/dense_rows.hpp"
#include "cuda/field_rows.hpp"
#include "cuda/nodal_force.hpp"
#include "cuda/serial_device.hpp"
#include "cuda/springs.hpp"
#include "cuda/stress.hpp"
#include "cuda/uploaded.hpp"
#include "cuda/vectors.hpp"
#include "scenes.hpp"

namespace mtled {
namespace {

using scenes::Box;

constexpr double h = 5;
const Box box{{7, 5, 6}, h};  // nothing is a multiple of a warp, a block or a period of the layout
const double not_a_number = std::numeric_limits<double>::quiet_NaN();

// As in forces_test.cpp: sums of some 40 points * 40 terms, and k / mu = 50 amplifies rounding of J.
template <class Real>
constexpr double force_rounding = 3000 * double(std::numeric_limits<Real>::epsilon());
// A short sum in another order.
template <class Real>
constexpr double sum_rounding = 100 * double(std::numeric_limits<Real>::epsilon());

template <class Real>
using Field = std::vector<Vec4<Real>>;
template <class T>
using Buffer = SerialDevice::Buffer<T>;

template <class T>
std::vector<T> downloaded(const Buffer<T>& b) {
  std::vector<T> values(b.size());
  b.download(values.data(), values.size());
  return values;
}
template <class T>
bool same_bits(const std::vector<T>& a, const std::vector<T>& b) {
  return a.size() == b.size() && std::memcmp(a.data(), b.data(), a.size() * sizeof(T)) == 0;
}
template <class Real>
Real component(const Vec4<Real>& a, int c) { return c == 0 ? a.x : c == 1 ? a.y : a.z; }
template <class Real>
Field<Real> field_of(const NodalField<Real>& u) {
  Field<Real> field(u.slots());
  for (std::size_t s = 0; s < u.slots(); ++s) field[s] = {u.at(s, 0), u.at(s, 1), u.at(s, 2), Real(0)};
  return field;
}
template <class Real>
NodalField<Real> rough_field(std::size_t slots, unsigned seed, double size = 1) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> noise(-size, size);
  NodalField<Real> u(slots);
  for (std::size_t s = 0; s < slots; ++s)
    for (int c = 0; c < 3; ++c) u.at(s, c) = Real(noise(random));
  return u;
}
/// Largest difference of components, relative to the largest component of `expected`.
template <class Real>
double relative_difference(const Field<Real>& a, const NodalField<Real>& expected) {
  double top = 0, difference = 0;
  for (std::size_t s = 0; s < a.size(); ++s)
    for (int c = 0; c < 3; ++c) {
      top = std::max(top, std::abs(double(expected.at(s, c))));
      const double d = std::abs(double(component(a[s], c)) - double(expected.at(s, c)));
      difference = d > difference || std::isnan(d) ? d : difference;
    }
  EXPECT_GT(top, 0);
  return difference / top;
}

/// Rows of (index, gradient) as a table: with a stencil, if given, in the shared part, the others in the own part.
struct Row {
  int to = -1, stencil = -1, base = 0;
  std::vector<std::pair<int, Vec3d>> terms;  ///< absolute indices
};
template <class Real>
GatherTable<Real> table_of(const std::vector<Row>& rows, std::vector<std::size_t>& row_of_thread) {
  GatherTable<Real> table;
  const auto entry = [](int index, const Vec3d& g) { return GatherEntry<Real>{Real(g.x), Real(g.y), Real(g.z), index}; };
  std::vector<std::size_t> shared, own;
  for (std::size_t r = 0; r < rows.size(); ++r) (rows[r].stencil >= 0 ? shared : own).push_back(r);
  std::stable_sort(shared.begin(), shared.end(), [&](std::size_t a, std::size_t b) { return std::pair(rows[a].stencil, rows[a].base) < std::pair(rows[b].stencil, rows[b].base); });
  constexpr std::size_t none = std::size_t(-1), slice = GatherTableView<Real>::slice;
  row_of_thread.clear();
  for (std::size_t r : shared) {
    if (row_of_thread.empty() || rows[row_of_thread.back()].stencil != rows[r].stencil) {
      for (const auto& [index, g] : rows[r].terms) table.stencil_entry.push_back(entry(index - rows[r].base, g));
      table.stencil_begin.push_back(std::uint32_t(table.stencil_entry.size()));
    }
    row_of_thread.push_back(r);
    table.base.push_back(rows[r].base), table.stencil.push_back(std::int32_t(table.stencil_begin.size()) - 2);
  }
  while (row_of_thread.size() % slice) row_of_thread.push_back(none), table.base.push_back(0), table.stencil.push_back(0);
  table.shared_threads = int(row_of_thread.size());
  row_of_thread.insert(row_of_thread.end(), own.begin(), own.end());
  while (row_of_thread.size() % slice) row_of_thread.push_back(none);
  table.threads = int(row_of_thread.size());
  for (std::size_t first = std::size_t(table.shared_threads); first < row_of_thread.size(); first += slice) {
    std::size_t longest = 0;
    for (std::size_t t = first; t < first + slice; ++t)
      if (row_of_thread[t] != none) longest = std::max(longest, rows[row_of_thread[t]].terms.size());
    for (std::size_t e = 0; e < longest; ++e)
      for (std::size_t t = first; t < first + slice; ++t) {
        const bool used = row_of_thread[t] != none && e < rows[row_of_thread[t]].terms.size();
        table.own.push_back(used ? entry(rows[row_of_thread[t]].terms[e].first, rows[row_of_thread[t]].terms[e].second) : entry(0, {}));
      }
    table.slice_begin.push_back(table.own.size());
  }
  for (std::size_t r : row_of_thread) table.row.push_back(r == none ? -1 : rows[r].to);
  return table;
}

/// A body of one kind and material, and its tables.
struct Scene {
  Cloud cloud;
  IntegrationPoints points;
  std::unique_ptr<ShapeEvaluator> evaluator;
  SlotLayout layout;
  SupportTable supports;
  std::size_t slots() const { return std::size_t(layout.num_slots); }

  explicit Scene(bool lattice, MaterialModel model = MaterialModel::neo_hookean)
      : cloud(lattice ? scenes::lattice_box(box) : scenes::jittered_box(box)),
        points(scenes::box_points(box, [](const Vec3d& x) { return 2 + std::sin(x.x) * std::cos(x.y + x.z); })), evaluator(std::make_unique<ShapeEvaluator>(cloud, std::vector<std::uint8_t>{}, MlsOptions{})),
        layout(make_slot_layout(cloud, 1)) {
    points.model = model;
    const std::vector<double> further[number_of_material_models] = {{}, {0.4}, {0.3, 0.1}, {-4.7}, {3, 0, 0.6, 0.8}};
    for (std::size_t p = 0; p < points.size(); ++p) points.further.insert(points.further.end(), further[int(model)].begin(), further[int(model)].end());
    supports = build_supports(*evaluator, layout, points);
  }

  /// Smooth, with some ten percent of strain and a little noise.
  template <class Real>
  NodalField<Real> displacement(unsigned seed = 5) const {
    NodalField<Real> u = rough_field<Real>(slots(), seed, 0.02 * h);
    for (std::size_t n = 0; n < cloud.size(); ++n) {
      const Vec3d& x = cloud.nodes[n];
      const Vec3d smooth{3 * std::sin(0.05 * x.y), 2 * std::cos(0.05 * x.z), -0.1 * x.z + 2 * std::sin(0.05 * x.x)};
      for (int c = 0; c < 3; ++c) u.at(std::size_t(layout.slot_of_node[n]), c) += Real(smooth[c]);
    }
    return u;
  }
  template <class Real>
  GatherTables<Real> tables() const {
    GatherTables<Real> tables;
    std::vector<Row> of_points, of_nodes(slots());
    std::vector<std::size_t> point_of_row, of_thread;
    for (std::size_t p = 0; p < points.size(); ++p) {
      if (supports.stencil[p] < 0) continue;
      Row row;
      row.to = tables.places = tables.places + 1;  // place 0 stays empty
      const int s = supports.stencil[p];
      if (layout.lattice && s % 3 != 0) row.stencil = s, row.base = supports.base[p];  // some of both kinds
      for (int e = supports.begin[std::size_t(s)]; e < supports.begin[std::size_t(s) + 1]; ++e) {
        const int slot = supports.base[p] + supports.offset[std::size_t(e)];
        row.terms.push_back({slot, supports.gradient[std::size_t(e)]});
        of_nodes[std::size_t(slot)].to = slot;
        of_nodes[std::size_t(slot)].terms.push_back({row.to, supports.gradient[std::size_t(e)]});
      }
      of_points.push_back(row), point_of_row.push_back(p);
    }
    ++tables.places;
    std::erase_if(of_nodes, [](const Row& r) { return r.to < 0; });
    tables.of_points = table_of<Real>(of_points, of_thread);
    for (std::size_t r : of_thread) tables.point.push_back(r == std::size_t(-1) ? -1 : std::int32_t(point_of_row[r]));
    tables.of_nodes = table_of<Real>(of_nodes, of_thread);
    return tables;
  }
  /// Stabilising springs and springs with targets; the last node has springs only.
  Springs springs() const {
    Springs all;
    all.set_names = {"plate"};
    std::mt19937 random(3);
    std::uniform_real_distribution<double> along(0, 1);
    for (int r = 0; r < 77; ++r) {
      ShapeFunctions s;
      if (!evaluator->at({along(random) * box.length(0), along(random) * box.length(1), along(random) * box.length(2)}, s)) continue;
      all.add(s.node, s.value, 100 * (1 + along(random)), {5 * along(random), -3, along(random)}, r % 3 - 1 > 0 ? 0 : -1);
    }
    return all;
  }
};

template <class Real>
std::vector<Real> parameters_of(const GatherTables<Real>& tables, const IntegrationPoints& points) {
  const int count = 3 + further_parameters(points.model);
  const std::size_t threads = tables.point.size();
  std::vector<Real> parameter(std::size_t(count) * threads);
  for (std::size_t t = 0; t < threads; ++t)
    for (int c = 0; c < count && tables.point[t] >= 0; ++c) {
      const std::size_t p = std::size_t(tables.point[t]);
      parameter[std::size_t(c) * threads + t] = Real(c == 0 ? points.volume[p] : material_parameter(points, p, c - 1));
    }
  return parameter;
}

/// The two passes on the serial device.
template <class Real>
struct Passes {
  explicit Passes(const Scene& scene, bool descending = false)
      : device(descending), model(scene.points.model), tables(scene.tables<Real>()), of_points(device, tables.of_points), of_nodes(device, tables.of_nodes),
        parameter(uploaded(device, parameters_of(tables, scene.points))), f(device, scene.slots()), row{{device, places()}, {device, places()}, {device, places()}},
        ratio(device, std::size_t(blocks())), energy(device, std::size_t(blocks())) {}
  std::size_t places() const { return std::size_t(tables.places); }
  int blocks() const { return blocks_for(tables.of_points.threads); }
  StressRows<Real> stress() { return {{row[0].data(), row[1].data(), row[2].data()}}; }

  /// use(a material's StressOfPoints, TangentOfPoints and EnergyOfPoints, unfilled)
  template <class Use>
  void with_functors(const Use& use) {
    const auto of = [&]<template <class> class Material>() { use(StressOfPoints<Material, Real>{}, TangentOfPoints<Material, Real>{}, EnergyOfPoints<Material, Real>{}); };
    switch (model) {
      case MaterialModel::neo_hookean: return of.template operator()<NeoHookean>();
      case MaterialModel::mooney_rivlin: return of.template operator()<MooneyRivlin>();
      case MaterialModel::yeoh: return of.template operator()<Yeoh>();
      case MaterialModel::ogden: return of.template operator()<Ogden>();
      case MaterialModel::transversely_isotropic: return of.template operator()<TransverselyIsotropic>();
    }
  }
  void stress_at(const Vec4<Real>* u, StepLoad step) {
    with_functors([&](auto functor, auto, auto) {
      functor.of_points = of_points.view(), functor.parameter = parameter.data(), functor.u = u, functor.stress = stress(), functor.ratio = ratio.data(), functor.step = step;
      device.for_blocks(blocks(), functor);
    });
  }
  void gather(StepLoad step, const Vec4<Real>* external = nullptr) {
    device.for_each(tables.of_nodes.threads, ForceOfNodes<Real>{of_nodes.view(), {row[0].data(), row[1].data(), row[2].data()}, external, f.data(), step});
  }
  Field<Real> force(const Field<Real>& u) {
    stress_at(uploaded(device, u).data(), {}), gather({});
    return downloaded(f);
  }
  VolumeRatios<Real> ratios() {
    Buffer<VolumeRatios<Real>> worst(device, 1);
    device.for_blocks(1, ReduceValues<VolumeRatios<Real>, Worse>{blocks(), ratio.data(), no_volume_ratios<Real>(), worst.data()});
    return downloaded(worst)[0];
  }
  Field<Real> tangent(const Field<Real>& u, const Field<Real>& v) {
    auto at = uploaded(device, u), along = uploaded(device, v);
    with_functors([&](auto, auto functor, auto) {
      functor.of_points = of_points.view(), functor.parameter = parameter.data(), functor.u = at.data(), functor.v = along.data(), functor.stress = stress();
      device.for_each(tables.of_points.threads, functor);
    });
    gather({});
    return downloaded(f);
  }
  double strain_energy(const Field<Real>& u) {
    auto at = uploaded(device, u);
    with_functors([&](auto, auto, auto functor) {
      functor.of_points = of_points.view(), functor.parameter = parameter.data(), functor.u = at.data(), functor.energy = energy.data();
      device.for_blocks(blocks(), functor);
    });
    Buffer<double> sum(device, 1);
    device.for_blocks(1, ReduceValues<double, Add>{blocks(), energy.data(), 0.0, sum.data()});
    return downloaded(sum)[0];
  }

  SerialDevice device;
  MaterialModel model;
  GatherTables<Real> tables;
  UploadedTable<Real, SerialDevice> of_points, of_nodes;
  Buffer<Real> parameter;
  Buffer<Vec4<Real>> f, row[3];
  Buffer<VolumeRatios<Real>> ratio;
  Buffer<double> energy;
};

struct BodyCase {
  bool lattice;
  MaterialModel model;
};
class PassesOfABody : public testing::TestWithParam<BodyCase> {
 protected:
  Scene scene{GetParam().lattice, GetParam().model};

  template <class Real>
  void force_equals_the_cpu() {
    const NodalField<Real> u = scene.displacement<Real>();
    NodalField<Real> expected(u.slots());
    const VolumeRatioStatistics statistics = CpuForces<Real>(scene.supports, scene.layout, scene.points).force(u, expected);
    Passes<Real> passes(scene);
    EXPECT_LT(relative_difference(passes.force(field_of(u)), expected), force_rounding<Real>);
    EXPECT_NEAR(double(passes.ratios().smallest), statistics.smallest, 100 * double(std::numeric_limits<Real>::epsilon()));
    EXPECT_EQ(passes.ratios().inverted, statistics.inverted);
  }
  template <class Real>
  void tangent_equals_the_cpu() {
    const NodalField<Real> u = scene.displacement<Real>(), v = rough_field<Real>(u.slots(), 8);
    NodalField<Real> expected(u.slots());
    CpuForces<Real>(scene.supports, scene.layout, scene.points).tangent(u, v, expected);
    EXPECT_LT(relative_difference(Passes<Real>(scene).tangent(field_of(u), field_of(v)), expected), force_rounding<Real>);
  }
  template <class Real>
  void energy_is_that_of_the_points() {
    const NodalField<Real> u = scene.displacement<Real>();
    double expected = 0;
    const SupportTable& t = scene.supports;
    for (std::size_t p = 0; p < scene.points.size(); ++p) {
      Mat3d F = Mat3d::identity();
      for (int s = t.begin[std::size_t(t.stencil[p])]; s < t.begin[std::size_t(t.stencil[p]) + 1]; ++s)
        for (int i = 0; i < 3; ++i)
          for (int k = 0; k < 3; ++k) F[i][k] += double(u.at(std::size_t(t.base[p] + t.offset[std::size_t(s)]), i)) * t.gradient[std::size_t(s)][k];
      expected += scene.points.volume[p] * with_material<double>(scene.points, p, [&](const auto& material) { return material.energy(F); });
    }
    EXPECT_NEAR(Passes<Real>(scene).strain_energy(field_of(u)), expected, sum_rounding<Real> * expected);  // gradients and parameters are rounded to Real
  }
};
std::vector<BodyCase> body_cases() {
  std::vector<BodyCase> cases;
  for (bool lattice : {true, false})
    for (int m = 0; m < number_of_material_models; ++m) cases.push_back({lattice, MaterialModel(m)});
  return cases;
}
std::string name_of(const testing::TestParamInfo<BodyCase>& info) {
  const char* names[number_of_material_models] = {"neo_hookean", "mooney_rivlin", "yeoh", "ogden", "transversely_isotropic"};
  return std::string(info.param.lattice ? "lattice_" : "cloud_") + names[int(info.param.model)];
}
INSTANTIATE_TEST_SUITE_P(All, PassesOfABody, testing::ValuesIn(body_cases()), name_of);
TEST_P(PassesOfABody, GiveTheForceOfTheCpuInFloat) { force_equals_the_cpu<float>(); }
TEST_P(PassesOfABody, GiveTheForceOfTheCpuInDouble) { force_equals_the_cpu<double>(); }
TEST_P(PassesOfABody, GiveTheTangentOfTheCpuInFloat) { tangent_equals_the_cpu<float>(); }
TEST_P(PassesOfABody, GiveTheTangentOfTheCpuInDouble) { tangent_equals_the_cpu<double>(); }
TEST_P(PassesOfABody, GiveTheStrainEnergyInFloat) { energy_is_that_of_the_points<float>(); }
TEST_P(PassesOfABody, GiveTheStrainEnergyInDouble) { energy_is_that_of_the_points<double>(); }
TEST_P(PassesOfABody, AreTheSameBitsInAnyOrderOfThreads) {
  const Field<float> u = field_of(scene.displacement<float>());
  Passes<float> ascending(scene), descending(scene, true);
  const Field<float> first = ascending.force(u);
  EXPECT_TRUE(same_bits(ascending.force(u), first));
  EXPECT_TRUE(same_bits(descending.force(u), first));
  EXPECT_EQ(ascending.strain_energy(u), descending.strain_energy(u));
}

TEST(VolumeRatiosOfPoints, CountInvertedPointsAndSeeWhatIsNotANumber) {
  const Scene scene(true);
  Passes<float> passes(scene);
  Field<float> u(scene.slots());
  for (std::size_t n = 0; n < scene.cloud.size(); ++n) u[std::size_t(scene.layout.slot_of_node[n])].x = float(-1.5 * scene.cloud.nodes[n].x);  // F_xx = -0.5 everywhere
  passes.force(u);
  EXPECT_EQ(passes.ratios().inverted, int(scene.points.size()));
  EXPECT_NEAR(passes.ratios().smallest, -0.5, 1e-4);
  u[std::size_t(scene.layout.slot_of_node[30])].y = float(not_a_number);
  passes.force(u);
  EXPECT_TRUE(std::isnan(passes.ratios().smallest));
}

TEST(ForceOfNodes, TakesTheExternalForceOffAndLeavesTheRestAlone) {
  const Scene scene(true);
  Passes<double> passes(scene);
  const Field<double> u = field_of(scene.displacement<double>()), internal = passes.force(u);
  auto external = uploaded(passes.device, field_of(rough_field<double>(scene.slots(), 4)));
  StepControl half;
  half.ramp = 7, half.step = 3;
  auto control = uploaded(passes.device, std::vector<StepControl>{half});
  const double load = half.load();
  EXPECT_NEAR(load, 0.5, 0.15);
  const std::vector<std::int32_t> rows = passes.tables.of_nodes.row;
  for (const StepLoad step : {StepLoad{nullptr, 0.3}, StepLoad{control.data(), 0.3}}) {
    const double by = step.control ? load : 0.3;
    passes.gather(step, external.data());
    for (std::size_t s = 0; s < u.size(); ++s) {
      const bool seen = std::find(rows.begin(), rows.end(), std::int32_t(s)) != rows.end();
      for (int c = 0; c < 3; ++c) EXPECT_NEAR(component(passes.f.data()[s], c), component(internal[s], c) - (seen ? by * component(external.data()[s], c) : 0), 1e-12);
    }
  }
  control.data()->verdict = StepControl::calm;
  const Field<double> before = downloaded(passes.f);
  passes.stress_at(uploaded(passes.device, Field<double>(scene.slots())).data(), {control.data(), 1}), passes.gather({control.data(), 1});
  EXPECT_TRUE(same_bits(downloaded(passes.f), before)) << "after the verdict nothing may change";
}

template <class Real>
void springs_equal_the_cpu(bool lattice) {
  const Scene scene(lattice);
  const Springs springs = scene.springs();
  ASSERT_GT(springs.size(), 40u);
  const double load = 0.7;
  const NodalField<Real> u = scene.displacement<Real>();
  NodalField<Real> start = rough_field<Real>(u.slots(), 9), expected(u.slots());
  const NodalField<Real> external = rough_field<Real>(u.slots(), 10);
  // Every fifth slot has no force of points: what is there is replaced by external force and springs.
  std::vector<std::uint8_t> seen(u.slots(), 1);
  for (std::size_t s = 0; s < seen.size(); s += 5) seen[s] = 0;
  const SpringTables<Real> tables(springs, scene.layout, seen);
  std::vector<std::uint8_t> pulled(u.slots(), 0);
  for (int s : tables.slot) pulled[std::size_t(s)] = 1;
  expected.copy_from(start);
  for (std::size_t s = 0; s < seen.size(); s += 5)
    for (int c = 0; c < 3 && pulled[s]; ++c) expected.at(s, c) = -Real(load) * external.at(s, c);
  SpringForces<Real>(springs, scene.layout).add_force(u, load, expected);
  SerialDevice device;
  auto at = uploaded(device, field_of(u)), f = uploaded(device, field_of(start)), dead = uploaded(device, field_of(external));
  auto begin = uploaded(device, tables.begin), of_slot = uploaded(device, tables.of_slot), spring = uploaded(device, tables.spring);
  auto slot = uploaded(device, tables.slot), used_slot = uploaded(device, tables.used_slot);
  auto coefficient = uploaded(device, tables.coefficient), stiffness = uploaded(device, tables.stiffness), coefficient_of = uploaded(device, tables.coefficient_of);
  auto target = uploaded(device, tables.target);
  Buffer<Vec4<Real>> pull(device, springs.size());
  const StepLoad step{nullptr, load};
  device.for_each(int(springs.size()), PullOfSprings<Real>{begin.data(), slot.data(), coefficient.data(), stiffness.data(), target.data(), at.data(), pull.data(), step});
  device.for_each(int(tables.used_slot.size()), ForceOfSprings<Real>{used_slot.data(), of_slot.data(), spring.data(), coefficient_of.data(), pull.data(), dead.data(), f.data(), step});
  EXPECT_LT(relative_difference(downloaded(f), expected), sum_rounding<Real>);
}
TEST(SpringFunctors, EqualTheCpuInFloat) { springs_equal_the_cpu<float>(true); }
TEST(SpringFunctors, EqualTheCpuInDouble) { springs_equal_the_cpu<double>(false); }

/// The coarse correction on the device.
template <class Real>
struct CoarseOnDevice {
  CoarseOnDevice(SerialDevice& d, const CoarseSpace& space, std::size_t slots)
      : device(d), tables(space.nodes(), space.functions(), space.used_functions(), slots), begin(uploaded(device, tables.cell_begin)), slot(uploaded(device, tables.slot)), first(uploaded(device, tables.first)),
        node_of_slot(uploaded(device, tables.node_of_slot)), right_begin(uploaded(device, tables.right_begin)), right_item(uploaded(device, tables.right_item)),
        place(uploaded(device, tables.place)), node(uploaded(device, tables.node)), cell_sum(device, std::size_t(functions_per_cell * tables.cells)),
        right(device, std::size_t(tables.unknowns)), inverse(device, std::size_t(tables.unknowns) * std::size_t(tables.unknowns)), y(device, std::size_t(tables.functions)) {
    inverse.upload(space.inverse(), inverse.size());
  }
  void solve(const Vec4<Real>* f, StepLoad step) {
    device.for_blocks(tables.cells, RestrictToCells<Real>{begin.data(), slot.data(), node.data(), f, cell_sum.data(), step});
    device.for_each(tables.unknowns / 3, RightSide<Real>{right_begin.data(), right_item.data(), cell_sum.data(), right.data(), step});
    const int n = tables.unknowns;
    device.for_blocks(MatrixRows<float, float>::blocks(n), MatrixRows<float, float>{{0, n, n, n}, inverse.data(), right.data(), place.data(), &y.data()->x, step});
  }
  CoarseCorrection<Real> correction() const { return {node_of_slot.data(), first.data(), node.data(), y.data(), tables.stride_y, tables.stride_z}; }

  SerialDevice& device;
  CoarseTables<Real> tables;
  Buffer<std::int32_t> begin, slot, first, node_of_slot, right_begin, right_item, place;
  Buffer<CoarseNode<Real>> node;
  Buffer<Vec4<Real>> cell_sum;
  Buffer<float> right, inverse;
  Buffer<Vec4<float>> y;
};

/// Nodes of the scene with one side held in two components and some nodes in one: positions and active parameters.
template <class Real>
struct CoarseScene {
  explicit CoarseScene(bool lattice) : scene(lattice), position(scene.slots()), active(3 * scene.slots()), inverse_diagonal(scene.slots()) {
    for (std::size_t n = 0; n < scene.cloud.size(); ++n) {
      const std::size_t s = std::size_t(scene.layout.slot_of_node[n]);
      position[s] = scene.cloud.nodes[n];
      for (int c = 0; c < 3; ++c) {
        const bool free = !((position[s].x < 1 && c != 1) || position[s].z > box.length(2) - 1);
        active[std::size_t(c) * scene.slots() + s] = free, inverse_diagonal.at(s, c) = free ? Real(0.002 + 0.0005 * c) : Real(0);
      }
    }
    space = std::make_unique<CoarseSpace>(position, active, 300, 8);
    const NodalField<double> u = scene.displacement<double>();
    std::vector<Vec3d> values(scene.slots());
    for (std::size_t s = 0; s < values.size(); ++s) values[s] = {u.at(s, 0), u.at(s, 1), u.at(s, 2)};
    space->assemble(scene.supports, scene.points, values);
  }
  /// P f on the CPU.
  void precondition(const NodalField<Real>& f, NodalField<Real>& g) const {
    for (std::size_t s = 0; s < f.slots(); ++s)
      for (int c = 0; c < 3; ++c) g.at(s, c) = inverse_diagonal.at(s, c) * f.at(s, c);
    space->add_correction(f, g);
  }
  Scene scene;
  std::vector<Vec3d> position;
  std::vector<std::uint8_t> active;
  NodalField<Real> inverse_diagonal;
  std::unique_ptr<CoarseSpace> space;
};

template <class Real>
void preconditioner_equals_the_cpu(bool lattice) {
  const CoarseScene<Real> c(lattice);
  ASSERT_GT(c.space->unknowns(), 100);
  const NodalField<Real> f = rough_field<Real>(c.scene.slots(), 4);
  NodalField<Real> expected(f.slots()), diagonal_only(f.slots());
  c.precondition(f, expected);
  const auto result = [&](bool descending, bool with_coarse) {
    SerialDevice device(descending);
    CoarseOnDevice<Real> coarse(device, *c.space, f.slots());
    EXPECT_GT(coarse.tables.cells, 10);
    auto force = uploaded(device, field_of(f)), inverse_diagonal = uploaded(device, field_of(c.inverse_diagonal));
    Buffer<Vec4<Real>> g(device, f.slots());
    coarse.solve(force.data(), {});
    device.for_each(int(f.slots()), PreconditionedForce<Real>{{inverse_diagonal.data(), with_coarse ? coarse.correction() : CoarseCorrection<Real>{}}, force.data(), g.data()});
    return downloaded(g);
  };
  // The inverse is in single precision in both, and its rows are added in another order.
  EXPECT_LT(relative_difference(result(false, true), expected), sum_rounding<float>);
  EXPECT_GT(relative_difference(result(false, false), expected), 0.1) << "the coarse correction must matter here";
  EXPECT_TRUE(same_bits(result(false, true), result(true, true)));
}
TEST(CoarseFunctors, EqualTheCpuInFloat) { preconditioner_equals_the_cpu<float>(true); }
TEST(CoarseFunctors, EqualTheCpuInDouble) { preconditioner_equals_the_cpu<double>(false); }

/// Steps of the heavy-ball iteration: all functors together, against the CPU backend.
template <class Real>
void steps_equal_the_cpu(bool lattice) {
  const CoarseScene<Real> c(lattice);
  const std::size_t slots = c.scene.slots();
  const CpuForces<Real> forces(c.scene.supports, c.scene.layout, c.scene.points);
  const StepSizes sizes{0.85, 15};
  std::vector<std::uint8_t> watched(slots, 0);
  for (std::size_t s = 0; s < slots; ++s) watched[s] = s % 3 != 0 && c.active[s] != 0;
  StepControl control;
  control.largest_increment = 1e3, control.factor = 2, control.impatient_from = 1000;
  constexpr int count = 4;

  NodalField<Real> u = c.scene.template displacement<Real>(), increment = rough_field<Real>(slots, 6, 0.1), change(slots), f(slots), g(slots);
  for (std::size_t s = 0; s < slots; ++s)
    for (int i = 0; i < 3; ++i) increment.at(s, i) *= c.active[std::size_t(i) * slots + s];
  const NodalField<Real> start = c.scene.template displacement<Real>();
  SerialDevice device;
  Passes<Real> passes(c.scene);
  CoarseOnDevice<Real> coarse(device, *c.space, slots);
  auto on_device = uploaded(device, std::vector<StepControl>{control});
  auto factors = uploaded(device, std::vector<StepFactors<Real>>{factors_of<Real>(sizes)});
  auto inverse_diagonal = uploaded(device, field_of(c.inverse_diagonal)), now = uploaded(device, field_of(u)), d = uploaded(device, field_of(increment));
  auto is_watched = uploaded(device, watched);
  Buffer<Vec4<Real>> sum(device, slots);
  Buffer<Real> largest(device, std::size_t(blocks_for(int(slots))));
  const auto step = [&] {
    const StepLoad load{on_device.data(), 1};
    passes.stress_at(now.data(), load), passes.gather(load), coarse.solve(passes.f.data(), load);
    device.for_blocks(blocks_for(int(slots)), AdvanceNodes<Real>{int(slots), {inverse_diagonal.data(), coarse.correction()}, factors.data(), is_watched.data(), passes.f.data(), now.data(),
                                                                 d.data(), sum.data(), largest.data(), load});
    device.for_blocks(1, FinishStep<Real>{blocks_for(int(slots)), passes.blocks(), largest.data(), passes.ratio.data(), on_device.data()});
  };
  double top = 0;
  for (int n = 0; n < count; ++n) {
    const long inverted = forces.force(u, f).inverted;
    c.precondition(f, g);
    top = 0;
    for (std::size_t s = 0; s < slots; ++s)
      for (int i = 0; i < 3; ++i) {
        increment.at(s, i) = Real(sizes.rho * sizes.rho) * increment.at(s, i) - Real((1 + sizes.rho) * (1 + sizes.rho) / sizes.lambda) * g.at(s, i);
        u.at(s, i) += increment.at(s, i), change.at(s, i) += increment.at(s, i);
        if (watched[s]) top = std::max(top, std::abs(double(increment.at(s, i))));
      }
    control.after_step(top, inverted);
    step();
  }
  ASSERT_GT(top, 0.01);
  // Each step magnifies rounding by at most a factor of two: lambda is not below the largest eigenvalue by more.
  const double tolerance = 16 * force_rounding<Real> + (1 << count) * sum_rounding<float>;
  EXPECT_LT(relative_difference(downloaded(d), increment), tolerance);
  EXPECT_LT(relative_difference(downloaded(sum), change), tolerance);
  EXPECT_LT(relative_difference(downloaded(now), u), tolerance);
  EXPECT_EQ(on_device.data()->step, count);
  EXPECT_NEAR(on_device.data()->largest, top, tolerance * top);
  EXPECT_NEAR(on_device.data()->estimate, control.estimate, tolerance * control.estimate);
  EXPECT_EQ(on_device.data()->inverted_for, control.inverted_for);

  on_device.data()->verdict = StepControl::impatient;
  const auto before = downloaded(now);
  step();
  EXPECT_TRUE(same_bits(downloaded(now), before)) << "after the verdict nothing may change";
  EXPECT_EQ(on_device.data()->step, count);
}
TEST(StepFunctors, EqualTheCpuInFloat) { steps_equal_the_cpu<float>(true); }
TEST(StepFunctors, EqualTheCpuInDouble) { steps_equal_the_cpu<double>(false); }

TEST(StepFunctors, AnIncrementThatIsNotANumberIsADivergence) {
  constexpr int slots = 700;
  SerialDevice device;
  Field<float> force(slots);
  force[611].y = float(not_a_number), force[400].x = 1;
  auto f = uploaded(device, force), one = uploaded(device, Field<float>(slots, {1, 1, 1, 0}));
  auto watched = uploaded(device, std::vector<std::uint8_t>(slots, 1));
  auto factors = uploaded(device, std::vector<StepFactors<float>>{{0, 1}});
  auto control = uploaded(device, std::vector<StepControl>(1));
  control.data()->largest_increment = 100;
  Buffer<Vec4<float>> u(device, slots), d(device, slots), sum(device, slots);
  Buffer<float> largest(device, std::size_t(blocks_for(slots)));
  auto ratio = uploaded(device, std::vector<VolumeRatios<float>>{{0.5F, 0}, {0.4F, 0}});
  device.for_blocks(blocks_for(slots), AdvanceNodes<float>{slots, {one.data(), {}}, factors.data(), watched.data(), f.data(), u.data(), d.data(), sum.data(), largest.data(), {control.data(), 1}});
  device.for_blocks(1, FinishStep<float>{blocks_for(slots), 2, largest.data(), ratio.data(), control.data()});
  EXPECT_TRUE(std::isnan(control.data()->largest));
  EXPECT_EQ(control.data()->verdict, StepControl::diverged);
}

class OddSizes : public testing::TestWithParam<int> {};
INSTANTIATE_TEST_SUITE_P(Sizes, OddSizes, testing::Values(1, 31, 256, 257, DotProduct<float>::most_blocks * block_threads + 77));
TEST_P(OddSizes, SumsAndCombinationsAreThoseOfALoop) {
  const std::size_t n = std::size_t(GetParam());
  const Field<float> a = field_of(rough_field<float>(n, 1)), b = field_of(rough_field<float>(n, 2));
  const auto results = [&](bool descending) {
    SerialDevice device(descending);
    auto x = uploaded(device, a), y = uploaded(device, b);
    const int blocks = DotProduct<float>::blocks(int(n));
    Buffer<double> part(device, std::size_t(blocks)), sum(device, 1);
    device.for_blocks(blocks, DotProduct<float>{int(n), x.data(), y.data(), part.data()});
    device.for_blocks(1, ReduceValues<double, Add>{blocks, part.data(), 0.0, sum.data()});
    device.for_each(int(n), Combine<float>{2, -0.5F, x.data(), y.data()});
    return std::pair(downloaded(sum)[0], downloaded(y));
  };
  const auto [sum, y] = results(false);
  double expected = 0, size = 0;
  for (std::size_t s = 0; s < n; ++s)
    for (int c = 0; c < 3; ++c) {
      const double product = double(component(a[s], c)) * double(component(b[s], c));
      expected += product, size += std::abs(product);
      EXPECT_EQ(component(y[s], c), 2 * component(a[s], c) - 0.5F * component(b[s], c));
    }
  EXPECT_NEAR(sum, expected, 1e-14 * size);
  const auto again = results(true);
  EXPECT_EQ(again.first, sum);
  EXPECT_TRUE(same_bits(again.second, y));
}
TEST(Vectors, TheDiagonalIsTheInverseOfItsInverse) {
  SerialDevice device;
  auto inverse = uploaded(device, Field<double>{{0.5, 0, 0.25, 0}, {0, 0, 0, 0}}), d = uploaded(device, Field<double>{{3, 7, 5, 0}, {1, 1, 1, 0}});
  Buffer<Vec4<double>> g(device, 2);
  device.for_each(2, MultiplyByDiagonal<double>{inverse.data(), d.data(), g.data()});
  EXPECT_TRUE(same_bits(downloaded(g), Field<double>{{6, 0, 20, 0}, {0, 0, 0, 0}}));
}

TEST(MatrixRowsOfBlocks, AreThoseOfALoop) {
  for (const std::array<int, 3> size : {std::array{5, 0, 37}, {0, 33, 1}, {64, 0, 0}, {9, 8, 7}}) {
    std::mt19937 random(2);
    std::uniform_real_distribution<float> noise(-1, 1);
    const int n = size[0] + size[1] + size[2];
    std::vector<float> matrix, x;
    for (int i = 0; i < n; ++i) x.push_back(noise(random));
    std::vector<std::int32_t> place;
    for (int i = 0; i < n; ++i) place.push_back(2 * (n - 1 - i));
    std::vector<double> expected(std::size_t(2 * n), 0);
    for (int b = 0, first = 0; b < 3; first += size[std::size_t(b)], ++b)
      for (int r = 0; r < size[std::size_t(b)]; ++r)
        for (int c = 0; c < size[std::size_t(b)]; ++c) {
          matrix.push_back(noise(random));
          expected[std::size_t(place[std::size_t(first + r)])] += double(matrix.back()) * double(x[std::size_t(first + c)]);
        }
    SerialDevice device;
    auto m = uploaded(device, matrix), right = uploaded(device, x);
    auto to = uploaded(device, place);
    Buffer<double> result(device, expected.size());
    device.for_blocks(MatrixRows<float, double>::blocks(n), MatrixRows<float, double>{{0, size[0], size[0] + size[1], n}, m.data(), right.data(), to.data(), result.data(), {}});
    for (std::size_t i = 0; i < expected.size(); ++i) EXPECT_NEAR(result.data()[i], expected[i], sum_rounding<float>) << i << " of " << n;
  }
}

/// Constraints on the device, against the operator of the CPU.
template <class Real>
void constraints_equal_the_cpu(bool lattice) {
  Scene scene(lattice);
  Constraints constraints;
  scenes::prescribe(scene.cloud, constraints, "bottom", scenes::below(2, 0), [](const Vec3d& x) { return Vec3d{0.1 * x.x, 3, -0.2 * x.y}; });
  scenes::prescribe(scene.cloud, constraints, "slide", scenes::above(0, box.length(0)), scenes::nowhere, {true, false, false});
  const ShapeEvaluator field(scene.cloud, scenes::prescribed_flags(scene.cloud, constraints), {});
  const ConstraintOperator expected(field, scene.layout, constraints);
  ASSERT_EQ(expected.direct(), lattice);
  const ConstraintArrays<Real> a({expected.table(0), expected.table(1), expected.table(2)});
  ASSERT_EQ(a.direct, lattice);
  SerialDevice device;
  auto place = uploaded(device, a.place), begin = uploaded(device, a.begin), free_place = uploaded(device, a.free_place), identity = uploaded(device, a.identity);
  auto used_place = uploaded(device, a.used_place), used_begin = uploaded(device, a.used_begin), used_row = uploaded(device, a.used_row);
  auto value = uploaded(device, a.value), free_value = uploaded(device, a.free_value), inverse = uploaded(device, a.inverse), transposed = uploaded(device, a.transposed), used_value = uploaded(device, a.used_value);
  const int rows = int(a.place.size());
  Buffer<Real> right(device, a.place.size()), multiplier(device, a.place.size());
  const int* b = a.block_begin;

  for (const double load : {0.4, 1.0}) {
    NodalField<Real> u = rough_field<Real>(scene.slots(), 11);
    auto x = uploaded(device, field_of(u));
    Real* components = &x.data()->x;
    const StepLoad step{nullptr, load};
    if (a.direct) {
      device.for_each(rows, SetPlaces<Real>{place.data(), value.data(), components, step});
    } else {
      device.for_each(rows, RightOfConstraints<Real>{value.data(), begin.data(), free_place.data(), free_value.data(), components, right.data(), step});
      device.for_blocks(MatrixRows<Real, Real>::blocks(rows), MatrixRows<Real, Real>{{b[0], b[1], b[2], b[3]}, inverse.data(), right.data(), place.data(), components, step});
    }
    expected.impose(u, load);
    EXPECT_LT(relative_difference(downloaded(x), u), sum_rounding<Real>) << "imposed";
  }
  NodalField<Real> f = rough_field<Real>(scene.slots(), 12);
  auto y = uploaded(device, field_of(f));
  Real* components = &y.data()->x;
  if (!a.direct) {
    device.for_each(rows, ForceAtPlaces<Real>{place.data(), components, right.data(), {}});
    device.for_blocks(MatrixRows<Real, Real>::blocks(rows), MatrixRows<Real, Real>{{b[0], b[1], b[2], b[3]}, transposed.data(), right.data(), identity.data(), multiplier.data(), {}});
    device.for_each(int(a.used_place.size()), SubtractMultipliers<Real>{used_place.data(), used_begin.data(), used_row.data(), used_value.data(), multiplier.data(), components, {}});
  }
  device.for_each(rows, ZeroPlaces<Real>{place.data(), components, {}});
  expected.reduce(f);
  EXPECT_LT(relative_difference(downloaded(y), f), sum_rounding<Real>) << "reduced";
}
TEST(ConstraintFunctors, EqualTheCpuWhereTheyAreDirect) { constraints_equal_the_cpu<float>(true), constraints_equal_the_cpu<double>(true); }
TEST(ConstraintFunctors, EqualTheCpuOnAGeneralCloudInFloat) { constraints_equal_the_cpu<float>(false); }
TEST(ConstraintFunctors, EqualTheCpuOnAGeneralCloudInDouble) { constraints_equal_the_cpu<double>(false); }
TEST(ConstraintFunctors, AreNotImposedAfterTheRamp) {
  SerialDevice device;
  auto place = uploaded(device, std::vector<std::int32_t>{5});
  auto value = uploaded(device, std::vector<double>{3});
  auto control = uploaded(device, std::vector<StepControl>(1));
  control.data()->ramp = 2;
  for (int s = 0; s < 5; ++s) {
    Buffer<double> u(device, 8);
    control.data()->step = s;
    device.for_each(1, SetPlaces<double>{place.data(), value.data(), u.data(), {control.data(), 1}});
    EXPECT_EQ(u.data()[5] != 0, s <= 2);
  }
}

TEST(LargestOfRows, IsThatOfALoop) {
  for (const int rows : {1, 255, 700}) {
    const NodalField<double> x = rough_field<double>(50, 3);
    std::mt19937 random(4);
    std::vector<std::uint32_t> begin{0};
    std::vector<std::int32_t> slot;
    std::vector<float> value;
    double expected = 0;
    for (int r = 0; r < rows; ++r) {
      Vec3d sum{};
      for (int e = 0; e < r % 7 + 1; ++e) {
        slot.push_back(std::int32_t(random() % 50)), value.push_back(float(e + 1));
        for (int c = 0; c < 3; ++c) sum[c] += double(value.back()) * x.at(std::size_t(slot.back()), c);
      }
      begin.push_back(std::uint32_t(slot.size()));
      for (int c = 0; c < 3; ++c) expected = std::max(expected, std::abs(sum[c]));
    }
    for (const bool broken : {false, true}) {
      SerialDevice device;
      Field<double> field = field_of(x);
      if (broken) field[std::size_t(slot[0])].z = not_a_number;
      auto b = uploaded(device, begin);
      auto s = uploaded(device, slot);
      auto v = uploaded(device, value);
      auto at = uploaded(device, field);
      Buffer<double> largest(device, std::size_t(blocks_for(rows))), result(device, 1);
      device.for_blocks(blocks_for(rows), LargestOfRows<double>{rows, b.data(), s.data(), v.data(), at.data(), largest.data()});
      device.for_blocks(1, ReduceValues<double, Larger>{blocks_for(rows), largest.data(), 0.0, result.data()});
      if (broken) {
        EXPECT_TRUE(std::isnan(result.data()[0]));
      } else {
        EXPECT_NEAR(result.data()[0], expected, 1e-13 * expected);
      }
    }
  }
}

}  // namespace
}  // namespace mtled
