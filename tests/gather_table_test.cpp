#include "core/gather_table.hpp"

#include <gtest/gtest.h>

#include <limits>
#include <map>
#include <random>
#include <set>
#include <tuple>

#include "core/cpu_forces.hpp"
#include "core/parallel.hpp"
#include "scenes.hpp"

namespace mtled {
namespace {

using scenes::Box;
using KeptCells = std::function<bool(const std::array<int, 3>&)>;

const double h = 5;

/// A body with its supports.
struct Body {
  Box box;
  KeptCells kept;
  Cloud cloud;
  IntegrationPoints points;
  SlotLayout layout;
  SupportTable supports;
};

Body body_of(const std::string& kind) {
  Body body;
  body.kept = scenes::every_cell;
  if (kind == "torso") {  // blunt ends, as where an image ends
    body.box = {{45, 33, 38}, h};
    body.kept = [](const std::array<int, 3>& c) {
      const double x = (c[0] - 22) / 22.6, y = (c[1] - 16) / 16.4, z = (c[2] - 18.5) / 21;
      return x * x + y * y + z * z * z * z < 1;
    };
  } else if (kind == "gap") {
    body.box = {{25, 14, 19}, h};
    body.kept = [](const std::array<int, 3>& c) { return c[0] < 12 || c[0] > 13 || c[2] < 4; };
  } else {
    body.box = {{9, 8, 11}, h};
  }
  body.cloud = kind == "jittered" ? scenes::jittered_box(body.box) : scenes::on_lattice(scenes::cell_corners(body.box, body.kept), h);
  const auto modulus = [](const Vec3d& x) { return 2 + std::sin(x.x) * std::cos(x.y + x.z); };
  body.points = scenes::box_points(body.box, modulus, 0.49, scenes::usual_ratio,
                                   [&](const std::array<int, 3>& c) { return body.kept(c) ? scenes::CellKind::free : scenes::CellKind::absent; });
  const Vec3d twice = body.points.position[body.points.size() / 2];  // two points in one position
  scenes::add_point(body.points, twice, 1, 3, 0.49);
  if (kind == "gap") mark_body_cells(body.cloud, body.points);
  body.layout = make_slot_layout(body.cloud, 1);
  body.supports = build_supports(ShapeEvaluator(body.cloud, {}, {}), body.layout, body.points);
  return body;
}

template <class Real>
using Terms = std::vector<std::tuple<int, int, Real, Real, Real>>;  ///< point, slot, gradient

/// All terms of the supports, sorted.
template <class Real>
Terms<Real> terms_of(const SupportTable& t) {
  Terms<Real> terms;
  for (std::size_t p = 0; p < t.stencil.size(); ++p) {
    if (t.stencil[p] < 0) continue;
    for (int e = t.begin[std::size_t(t.stencil[p])]; e < t.begin[std::size_t(t.stencil[p]) + 1]; ++e) {
      const Vec3d& g = t.gradient[std::size_t(e)];
      terms.emplace_back(int(p), t.base[p] + t.offset[std::size_t(e)], Real(g.x), Real(g.y), Real(g.z));
    }
  }
  std::sort(terms.begin(), terms.end());
  return terms;
}

/// All terms of a table, sorted; point_and_slot(row, index). Indices must rise, and idle threads have none.
template <class Real, class PointAndSlot>
Terms<Real> terms_of(const GatherTable<Real>& table, const PointAndSlot& point_and_slot) {
  const GatherTableView<Real> view = table.view();
  EXPECT_EQ(view.threads % 32, 0);
  EXPECT_EQ(view.shared_threads % 32, 0);
  Terms<Real> terms;
  for (int thread = 0; thread < view.threads; ++thread) {
    std::int32_t last = -1;
    view.each(thread, [&](std::int32_t index, const GatherEntry<Real>& g) {
      if (index == last) {  // the end of a short row
        EXPECT_TRUE(g.x == 0 && g.y == 0 && g.z == 0);
        return;
      }
      EXPECT_GT(index, last);
      last = index;
      const auto [point, slot] = point_and_slot(view.row[thread], index);
      terms.emplace_back(point, slot, g.x, g.y, g.z);
    });
    EXPECT_EQ(last < 0, view.row[thread] < 0);
  }
  EXPECT_EQ(table.terms, terms.size());
  std::sort(terms.begin(), terms.end());
  return terms;
}

/// [places] the point at each, -1 where there is none.
template <class Real>
std::vector<int> points_at_places(const GatherTables<Real>& tables) {
  std::vector<int> at(std::size_t(tables.places), -1);
  EXPECT_EQ(tables.point.size(), std::size_t(tables.of_points.threads));
  for (std::size_t thread = 0; thread < tables.point.size(); ++thread) {
    const int place = tables.of_points.row[thread];
    EXPECT_EQ(place < 0, tables.point[thread] < 0);
    if (place < 0) continue;
    EXPECT_EQ(at[std::size_t(place)], -1);  // one point to a place
    at[std::size_t(place)] = tables.point[thread];
  }
  return at;
}

class GatherTablesOf : public testing::TestWithParam<const char*> {
 protected:
  Body body = body_of(GetParam());

  template <class Real>
  void expect_every_term_once() {
    for (std::size_t p = 0; p < body.points.size(); p += 7) body.supports.stencil[p] = -1;  // as dropped points
    const GatherTables<Real> tables = make_gather_tables<Real>(body.supports, body.layout);
    const std::vector<int> at = points_at_places(tables);
    const Terms<Real> expected = terms_of<Real>(body.supports);
    EXPECT_TRUE(expected == terms_of(tables.of_points, [&](int place, int slot) { return std::pair(at[std::size_t(place)], slot); }));
    EXPECT_TRUE(expected == terms_of(tables.of_nodes, [&](int slot, int place) { return std::pair(at[std::size_t(place)], slot); }));
  }
};
INSTANTIATE_TEST_SUITE_P(Bodies, GatherTablesOf, testing::Values("torso", "gap", "box", "jittered"), [](const auto& kind) { return std::string(kind.param); });

TEST_P(GatherTablesOf, HoldEveryTermOnceInFloat) { expect_every_term_once<float>(); }
TEST_P(GatherTablesOf, HoldEveryTermOnceInDouble) { expect_every_term_once<double>(); }

bool same(const GatherTable<float>& a, const GatherTable<float>& b) {
  const auto entries = [](const std::vector<GatherEntry<float>>& x, const std::vector<GatherEntry<float>>& y) {
    return std::equal(x.begin(), x.end(), y.begin(), y.end(),
                      [](const auto& p, const auto& q) { return p.x == q.x && p.y == q.y && p.z == q.z && p.index == q.index; });
  };
  return a.threads == b.threads && a.shared_threads == b.shared_threads && a.row == b.row && a.base == b.base && a.stencil == b.stencil &&
         a.stencil_begin == b.stencil_begin && a.slice_begin == b.slice_begin && entries(a.stencil_entry, b.stencil_entry) && entries(a.own, b.own);
}

TEST_P(GatherTablesOf, DoNotDependOnTheNumberOfThreads) {
  GatherTables<float> tables[2];
  for (int threads : {1, 2}) {
    const ThreadLimit limit(threads);
    tables[threads - 1] = make_gather_tables<float>(body.supports, body.layout);
  }
  EXPECT_TRUE(same(tables[0].of_points, tables[1].of_points));
  EXPECT_TRUE(same(tables[0].of_nodes, tables[1].of_nodes));
  EXPECT_EQ(tables[0].point, tables[1].point);
  EXPECT_EQ(tables[0].places, tables[1].places);
}

TEST_P(GatherTablesOf, GiveTheForcesOfTheCpu) {
  // Both passes in double: displacements into points, stresses into nodes.
  std::mt19937 random(5);
  std::uniform_real_distribution<double> noise(-0.02 * h, 0.02 * h);
  const std::size_t slots = std::size_t(body.layout.num_slots);
  std::vector<Vec3d> u(slots);
  NodalField<double> field(slots), expected(slots);
  for (std::size_t n = 0; n < body.cloud.size(); ++n) {
    const Vec3d& x = body.cloud.nodes[n];
    const std::size_t slot = std::size_t(body.layout.slot_of_node[n]);
    u[slot] = {3 * std::sin(0.05 * x.y) + noise(random), 2 * std::cos(0.05 * x.z) + noise(random), 0.1 * x.z + 2 * std::sin(0.05 * x.x) + noise(random)};
    for (int c = 0; c < 3; ++c) field.at(slot, c) = u[slot][c];
  }
  CpuForces<double>(body.supports, body.layout, body.points).force(field, expected);

  const GatherTables<double> tables = make_gather_tables<double>(body.supports, body.layout);
  std::vector<Mat3d> stress(std::size_t(tables.places));
  const GatherTableView<double> of_points = tables.of_points.view(), of_nodes = tables.of_nodes.view();
  for (int thread = 0; thread < of_points.threads; ++thread) {
    if (of_points.row[thread] < 0) continue;
    Mat3d F = Mat3d::identity();
    of_points.each(thread, [&](std::int32_t slot, const GatherEntry<double>& g) {
      for (int a = 0; a < 3; ++a) F[a][0] += u[std::size_t(slot)][a] * g.x, F[a][1] += u[std::size_t(slot)][a] * g.y, F[a][2] += u[std::size_t(slot)][a] * g.z;
    });
    const std::size_t p = std::size_t(tables.point[std::size_t(thread)]);
    double J;
    stress[std::size_t(of_points.row[thread])] = scaled(body.points.volume[p], NeoHookean<double>{body.points.shear_modulus[p], body.points.bulk_modulus[p]}.stress(F, J));
  }
  std::vector<Vec3d> force(slots);
  for (int thread = 0; thread < of_nodes.threads; ++thread)
    of_nodes.each(thread, [&](std::int32_t place, const GatherEntry<double>& g) { force[std::size_t(of_nodes.row[thread])] += stress[std::size_t(place)] * Vec3d{g.x, g.y, g.z}; });

  double largest = 0, difference = 0;
  for (std::size_t s = 0; s < slots; ++s) {
    const Vec3d cpu{expected.at(s, 0), expected.at(s, 1), expected.at(s, 2)};
    largest = std::max(largest, norm(cpu)), difference = std::max(difference, norm(cpu - force[s]));
  }
  EXPECT_GT(largest, 1);
  // Sums of some 40 points * 40 terms of the size of the largest nodal force's parts; k / mu = 50 amplifies rounding of J.
  EXPECT_LT(difference, 3000 * std::numeric_limits<double>::epsilon() * largest);
}

/// Rows with a stencil.
template <class Real>
std::size_t shared_rows(const GatherTable<Real>& table) {
  return std::size_t(std::count_if(table.row.begin(), table.row.begin() + table.shared_threads, [](int row) { return row >= 0; }));
}

/// Nodes whose row must have a stencil: all cells within three of them are body, so that no point that they support has a surface in
/// its stencil (points are within two cells, and the stencil knows the nodes within two of the point's cell); rows then
/// repeat every 4, 4 and 3 nodes, and there are many such.
std::size_t interior_nodes(const Body& body) {
  std::map<std::array<int, 3>, std::size_t> phases;
  for (const Vec3d& x : body.cloud.nodes) {
    const std::array<int, 3> at{int(std::lround(x.x / h)), int(std::lround(x.y / h)), int(std::lround(x.z / h))};
    bool inside = true;
    for (int c = 0; c < 216; ++c) {
      const std::array<int, 3> cell{at[0] - 3 + c % 6, at[1] - 3 + c / 6 % 6, at[2] - 3 + c / 36};
      for (std::size_t a = 0; a < 3; ++a) inside = inside && cell[a] >= 0 && cell[a] < body.box.cells[a];
      inside = inside && body.kept(cell);
    }
    if (inside) ++phases[{at[0] % 4, at[1] % 4, at[2] % 3}];
  }
  EXPECT_EQ(phases.size(), 48u);
  std::size_t nodes = 0;
  for (const auto& [phase, count] : phases) {
    EXPECT_GE(count, 16u);
    nodes += count;
  }
  return nodes;
}

TEST(GatherTablesOfATorso, ShareStencilsInside) {
  const Body body = body_of("torso");
  const GatherTables<float> tables = make_gather_tables<float>(body.supports, body.layout);
  const std::size_t inside = interior_nodes(body), nodes = body.cloud.size();
  EXPECT_GT(inside, nodes / 2);
  const std::size_t shared = shared_rows(tables.of_nodes);
  RecordProperty("nodes", int(nodes)), RecordProperty("interior", int(inside)), RecordProperty("shared", int(shared));
  EXPECT_GE(shared, inside);
  std::map<int, std::size_t> sharing;
  for (int s : body.supports.stencil) ++sharing[s];
  std::size_t points = 0;
  for (const auto& [stencil, count] : sharing) points += count >= 16 ? count : 0;
  EXPECT_EQ(shared_rows(tables.of_points), points);
}

TEST(GatherTablesOfABlock, AreASmallPartOfPlainRows) {
  // Measured: 5.2 %; what is left are the rows at edges and corners. A body with a round surface of 10^6 nodes has 12 %.
  Body body;
  body.box = {{40, 40, 40}, h};
  body.cloud = scenes::lattice_box(body.box);
  body.points = scenes::box_points(body.box, scenes::uniform(1));
  body.layout = make_slot_layout(body.cloud, 1);
  const GatherTables<float> tables = make_gather_tables<float>(build_supports(ShapeEvaluator(body.cloud, {}, {}), body.layout, body.points), body.layout);
  EXPECT_LT(tables.of_points.bytes() + tables.of_nodes.bytes(), (tables.of_points.terms + tables.of_nodes.terms) * sizeof(GatherEntry<float>) / 10);
}

TEST(GatherTablesOfAJitteredBox, HaveLittlePadding) {
  // Measured, points and nodes: 5.4 and 10.3 %; without sorting rows by length 25 and 54 %.
  const Body body = body_of("jittered");
  const GatherTables<float> tables = make_gather_tables<float>(body.supports, body.layout);
  for (const GatherTable<float>* table : {&tables.of_points, &tables.of_nodes}) {
    EXPECT_EQ(table->shared_threads, 0);
    EXPECT_LT(double(table->own.size()), 1.15 * double(table->terms));
    RecordProperty(table == &tables.of_nodes ? "nodes" : "points", std::to_string(double(table->own.size()) / double(table->terms)));
  }
}

}  // namespace
}  // namespace mtled
