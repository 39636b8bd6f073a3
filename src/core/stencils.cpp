#include "core/stencils.hpp"

#include <algorithm>
#include <limits>
#include <numeric>
#include <string>
#include <unordered_map>

#include "core/error.hpp"
#include "core/parallel.hpp"

namespace mtled {
namespace {

constexpr double fraction_steps = 1 << 20;  ///< places in a lattice cell that agree to this resolution share a stencil

/// All that the shape functions at a place depend on, relative to its lattice cell: the place in the cell, the cell's
/// phase in the slot layout, which lattice positions around hold nodes, which cells hold body, and which corners are
/// prescribed.
std::string stencil_key(const Approximation& field, const Vec3d& x, const std::array<int, 3>& cell, int reach) {
  const Lattice& l = *field.cloud().lattice;
  std::string key;
  for (int a = 0; a < 3; ++a) {
    const int step = int(std::lround(((x[a] - l.origin[a]) / l.spacing - cell[a]) * fraction_steps));
    key.append(reinterpret_cast<const char*>(&step), sizeof step);
  }
  key.push_back(char((cell[0] + 2 * SlotLayout::period) % SlotLayout::period * SlotLayout::period +
                     (cell[1] + 2 * SlotLayout::period) % SlotLayout::period));
  unsigned char bits = 0;
  int used = 0;
  const auto push = [&](bool bit) {
    bits = static_cast<unsigned char>(bits << 1 | (bit ? 1 : 0));
    if (++used == 8) key.push_back(char(bits)), used = 0, bits = 0;
  };
  for (int k = 1 - reach; k <= reach; ++k)
    for (int j = 1 - reach; j <= reach; ++j)
      for (int i = 1 - reach; i <= reach; ++i) push(l.node(cell[0] + i, cell[1] + j, cell[2] + k) >= 0);
  for (int k = 1 - reach; k < reach && !l.body_cell.empty(); ++k)
    for (int j = 1 - reach; j < reach; ++j)
      for (int i = 1 - reach; i < reach; ++i) push(l.holds_body(cell[0] + i, cell[1] + j, cell[2] + k));
  for (int c = 0; c < 8; ++c) {
    const int n = l.node(cell[0] + (c & 1), cell[1] + (c >> 1 & 1), cell[2] + (c >> 2));
    push(n >= 0 && field.prescribed(n));
  }
  while (used) push(false);
  return key;
}

struct Support {
  std::vector<int> offset;
  std::vector<Vec3d> gradient;
  bool enlarged = false;  ///< depends on nodes that stencil_key() does not know
};

/// Support at x with node slots relative to `base`; empty when there is none.
Support support_at(const Approximation& field, const SlotLayout& layout, const Vec3d& x, int base) {
  ShapeFunctions shapes;
  Support support;
  int enlargements = 0;
  if (!field.at(x, shapes, &enlargements)) return support;
  support.enlarged = enlargements > 0;
  for (int n : shapes.node) support.offset.push_back(layout.slot_of_node[std::size_t(n)] - base);
  support.gradient = std::move(shapes.gradient);
  return support;
}

}  // namespace

SlotLayout make_slot_layout(const Cloud& cloud, int margin) {
  SlotLayout layout;
  layout.slot_of_node.resize(cloud.size());
  layout.lattice = cloud.lattice.has_value();
  if (layout.lattice) {
    constexpr int period = SlotLayout::period;
    layout.margin = (margin + period - 1) / period * period;  // keeps cell phases those of the lattice
    const auto& size = cloud.lattice->size;
    const auto blocks = [&](int n) { return (n + 2 * layout.margin + period - 1) / period; };
    layout.blocks_x = blocks(size[0]);
    layout.blocks = layout.blocks_x * blocks(size[1]);
    layout.planes = size[2] + 2 * layout.margin;
    const double slots = double(layout.planes) * period * period * layout.blocks;
    require(slots < 2e9, "the node lattice has ", slots, " positions, more than can be numbered; use a larger spacing");
    layout.num_slots = layout.planes * period * period * layout.blocks;
    for (std::size_t n = 0; n < cloud.size(); ++n) {
      const auto& c = cloud.lattice_ijk[n];
      layout.slot_of_node[n] = layout.lattice_slot(c[0] + layout.margin, c[1] + layout.margin, c[2] + layout.margin);
    }
    return layout;
  }
  layout.num_slots = int(cloud.size());
  Vec3d low = cloud.nodes[0], high = low;
  for (const Vec3d& x : cloud.nodes)
    for (int a = 0; a < 3; ++a) low[a] = std::min(low[a], x[a]), high[a] = std::max(high[a], x[a]);
  int axis = 0;
  for (int a = 1; a < 3; ++a)
    if (high[a] - low[a] > high[axis] - low[axis]) axis = a;
  std::vector<int> order(cloud.size());
  std::iota(order.begin(), order.end(), 0);
  std::sort(order.begin(), order.end(), [&](int a, int b) {
    const double xa = cloud.nodes[std::size_t(a)][axis], xb = cloud.nodes[std::size_t(b)][axis];
    return xa != xb ? xa < xb : a < b;
  });
  for (std::size_t s = 0; s < order.size(); ++s) layout.slot_of_node[std::size_t(order[s])] = int(s);
  return layout;
}

SupportTable build_supports(const Approximation& field, const SlotLayout& layout, const IntegrationPoints& points) {
  SupportTable table;
  const std::size_t n = points.size();
  table.base.assign(n, 0);
  table.stencil.assign(n, -1);
  std::vector<std::uint32_t> representative;  // a point for each stencil
  if (layout.lattice) {
    const int reach = field.reach();
    std::vector<std::string> key(n);
    parallel_for(n, [&](std::size_t p) {
      const auto cell = cell_of(*field.cloud().lattice, points.position[p]);
      table.base[p] = layout.lattice_slot(cell[0] + layout.margin, cell[1] + layout.margin, cell[2] + layout.margin);
      key[p] = stencil_key(field, points.position[p], cell, reach);
    });
    std::unordered_map<std::string, int> number;
    for (std::size_t p = 0; p < n; ++p) {
      const auto [it, is_new] = number.emplace(std::move(key[p]), int(representative.size()));
      if (is_new) representative.push_back(std::uint32_t(p));
      table.stencil[p] = it->second;
    }
  } else {
    representative.resize(n);
    std::iota(representative.begin(), representative.end(), 0u);
    std::iota(table.stencil.begin(), table.stencil.end(), 0);
  }
  std::vector<Support> supports;
  const auto compute_from = [&](std::size_t first) {
    supports.resize(representative.size());
    parallel_for(
        representative.size() - first,
        [&](std::size_t s) {
          const std::uint32_t p = representative[first + s];
          supports[first + s] = support_at(field, layout, points.position[p], table.base[p]);
        },
        256);
  };
  compute_from(0);
  // A support that was enlarged, or failed, is nobody else's.
  const std::size_t shared = representative.size();
  for (std::size_t p = 0; p < n; ++p) {
    const Support& support = supports[std::size_t(table.stencil[p])];
    if ((!support.enlarged && !support.offset.empty()) || representative[std::size_t(table.stencil[p])] == p) continue;
    table.stencil[p] = int(representative.size());
    representative.push_back(std::uint32_t(p));
  }
  compute_from(shared);
  for (const Support& s : supports) table.enlarged += s.enlarged;
  std::size_t entries = 0;
  for (const Support& s : supports) entries += s.offset.size();
  require(entries < std::size_t(std::numeric_limits<int>::max()), "the supports have ", entries, " entries, more than can be numbered; use a lattice, a larger spacing, or smaller supports");
  table.begin.assign(1, 0);
  for (const Support& s : supports) {
    table.offset.insert(table.offset.end(), s.offset.begin(), s.offset.end());
    table.gradient.insert(table.gradient.end(), s.gradient.begin(), s.gradient.end());
    table.begin.push_back(int(table.offset.size()));
  }
  for (std::size_t p = 0; p < n; ++p)
    if (supports[std::size_t(table.stencil[p])].offset.empty()) table.stencil[p] = -1, table.dropped.push_back(std::uint32_t(p));
  return table;
}

}  // namespace mtled
