#include "core/stabilisation.hpp"

#include <algorithm>
#include <cmath>

#include "core/parallel.hpp"

namespace mtled {
namespace {

/// What the integration points tell about the slots.
struct Share {
  std::vector<double> points, seen_volume;  ///< [num_slots] number and volume [mm^3] of the points that see a slot
  std::vector<double> volume;               ///< [num_slots] volume that belongs to it [mm^3]
  std::vector<double> largest;              ///< [num_slots] largest mean of such volumes over a support that holds it [mm^3]
  std::vector<double> shear_modulus;        ///< [num_slots] mean [kPa]
};

Share share_of(const SupportTable& t, const SlotLayout& layout, const IntegrationPoints& points) {
  const std::size_t n = std::size_t(layout.num_slots);
  Share share{std::vector<double>(n), std::vector<double>(n), std::vector<double>(n), std::vector<double>(n), std::vector<double>(n)};
  const auto each_entry = [&](auto&& body) {
    for (std::size_t p = 0; p < points.size(); ++p) {
      if (t.stencil[p] < 0) continue;
      const int begin = t.begin[std::size_t(t.stencil[p])], end = t.begin[std::size_t(t.stencil[p]) + 1];
      body(p, end - begin, [&](auto&& visit) {
        for (int s = begin; s < end; ++s) visit(std::size_t(t.base[p] + t.offset[std::size_t(s)]));
      });
    }
  };
  each_entry([&](std::size_t p, int nodes, auto&& slots) {
    slots([&](std::size_t s) {
      share.points[s] += 1, share.seen_volume[s] += points.volume[p], share.volume[s] += points.volume[p] / nodes;
      share.shear_modulus[s] += points.volume[p] * points.shear_modulus[p];
    });
  });
  each_entry([&](std::size_t, int, auto&& slots) {
    double sum = 0, squares = 0;  // the mean weighted by volume: nodes at a surface count little
    slots([&](std::size_t s) { sum += share.volume[s], squares += share.volume[s] * share.volume[s]; });
    slots([&](std::size_t s) { share.largest[s] = std::max(share.largest[s], squares / sum); });
  });
  for (std::size_t s = 0; s < n; ++s)
    if (share.points[s] > 0) share.shear_modulus[s] /= share.seen_volume[s];
  return share;
}

}  // namespace

std::vector<double> points_per_node(const SupportTable& supports, const SlotLayout& layout, const IntegrationPoints& points) {
  const Share share = share_of(supports, layout, points);
  std::vector<double> result(layout.slot_of_node.size(), 0.0);
  for (std::size_t n = 0; n < result.size(); ++n) {
    const std::size_t s = std::size_t(layout.slot_of_node[n]);
    if (share.points[s] > 0) result[n] = share.points[s] / share.seen_volume[s] * share.largest[s];
  }
  return result;
}

void add_stabilisation(const Approximation& field, const SupportTable& supports, const SlotLayout& layout, const IntegrationPoints& points,
                       const std::vector<double>& per_node, double strength, Springs& springs) {
  constexpr double interpolated = 1e-9;  // largest coefficient of a node whose parameter is the field: nothing to tie
  constexpr double without_defect = 2;   // points per node
  const Share share = share_of(supports, layout, points);
  std::vector<ShapeFunctions> rows(per_node.size());
  parallel_for(rows.size(), [&](std::size_t n) {
    if (per_node[n] > 0 && per_node[n] < enough_points_per_node) field.at(field.cloud().nodes[n], rows[n]);
  }, 256);
  for (std::size_t n = 0; n < rows.size(); ++n) {
    ShapeFunctions& row = rows[n];
    double largest = 0;
    for (std::size_t i = 0; i < row.node.size(); ++i) {
      row.value[i] = (row.node[i] == int(n) ? 1 : 0) - row.value[i];
      largest = std::max(largest, std::abs(row.value[i]));
    }
    if (largest < interpolated) continue;
    const std::size_t s = std::size_t(layout.slot_of_node[n]);
    const double h = std::cbrt(share.largest[s]), lack = without_defect / per_node[n] - 1;
    springs.add(row.node, row.value, strength * lack * lack * share.shear_modulus[s] * share.volume[s] / (h * h), {}, -1);
  }
}

}  // namespace mtled
