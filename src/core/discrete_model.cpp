#include "core/discrete_model.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>

#include "core/error.hpp"
#include "core/parallel.hpp"
#include "core/point_material.hpp"
#include "core/stabilisation.hpp"

namespace mtled {
namespace {

/// Points without a usable support give their volume to the nearest one that has it.
void hand_over_dropped_volume(const SupportTable& supports, IntegrationPoints& points) {
  for (std::uint32_t d : supports.dropped) {
    std::size_t nearest = points.size();
    double best = 0;
    for (std::size_t p = 0; p < points.size(); ++p) {
      if (supports.stencil[p] < 0) continue;
      const double squared = squared_norm(points.position[p] - points.position[d]);
      if (nearest == points.size() || squared < best) nearest = p, best = squared;
    }
    require(nearest < points.size(), "no integration point has enough nodes around it; use a smaller node spacing or a larger dilatation");
    points.volume[nearest] += points.volume[d];
  }
}

/// Slots joined by supports; every connected piece must be held by constraints.
class Pieces {
 public:
  explicit Pieces(std::size_t n) : parent_(n) {
    for (std::size_t i = 0; i < n; ++i) parent_[i] = int(i);
  }
  int root(int i) {
    while (parent_[std::size_t(i)] != i) i = parent_[std::size_t(i)] = parent_[std::size_t(parent_[std::size_t(i)])];
    return i;
  }
  void join(int a, int b) { parent_[std::size_t(root(a))] = root(b); }

 private:
  std::vector<int> parent_;
};

/// Rank of the rigid motions that prescribed components take away: 6 holds the piece.
int held_motions(const std::vector<std::pair<Vec3d, std::array<bool, 3>>>& fixed) {
  Vec3d centre{};
  for (const auto& f : fixed) centre += (1.0 / double(fixed.size())) * f.first;
  double size = 1e-9;
  for (const auto& f : fixed) size = std::max(size, norm(f.first - centre));
  std::vector<std::array<double, 6>> basis;
  for (const auto& [x, components] : fixed) {
    const Vec3d d = (1 / size) * (x - centre);
    for (int c = 0; c < 3 && basis.size() < 6; ++c) {
      if (!components[std::size_t(c)]) continue;
      Vec3d e{};
      e[c] = 1;
      const Vec3d turn = cross(d, e);  // virtual work of a unit force along c
      std::array<double, 6> row{e.x, e.y, e.z, turn.x, turn.y, turn.z};
      for (const auto& b : basis) {
        double along = 0;
        for (int i = 0; i < 6; ++i) along += b[std::size_t(i)] * row[std::size_t(i)];
        for (int i = 0; i < 6; ++i) row[std::size_t(i)] -= along * b[std::size_t(i)];
      }
      double length = 0;
      for (double r : row) length += r * r;
      length = std::sqrt(length);
      if (length < 1e-3) continue;
      for (double& r : row) r /= length;
      basis.push_back(row);
    }
    if (basis.size() == 6) break;
  }
  return int(basis.size());
}

/// Where the springs of a set hold the body [mm].
std::vector<std::pair<std::size_t, Vec3d>> held_places(const Springs& springs, const Cloud& cloud) {
  std::vector<std::pair<std::size_t, Vec3d>> places;
  for (std::size_t r = 0; r < springs.size(); ++r) {
    if (springs.set[r] < 0) continue;
    Vec3d place{};
    for (std::size_t e = springs.begin[r]; e < springs.begin[r + 1]; ++e) place += springs.coefficient[e] * cloud.nodes[std::size_t(springs.node[e])];
    places.push_back({r, place});
  }
  return places;
}
void require_held(const DiscreteModel& model, const Constraints& constraints) {
  const Cloud& cloud = model.field->cloud();
  const Springs& springs = model.springs;
  const SupportTable& t = model.supports;
  Pieces pieces(model.position.size());
  for (std::size_t p = 0; p < t.stencil.size(); ++p) {
    if (t.stencil[p] < 0) continue;
    const int b = t.begin[std::size_t(t.stencil[p])], e = t.begin[std::size_t(t.stencil[p]) + 1];
    for (int s = b + 1; s < e; ++s) pieces.join(t.base[p] + t.offset[std::size_t(b)], t.base[p] + t.offset[std::size_t(s)]);
  }
  for (std::size_t r = 0; r < springs.size(); ++r)
    for (std::size_t e = springs.begin[r] + 1; e < springs.begin[r + 1]; ++e)
      pieces.join(model.layout.slot_of_node[std::size_t(springs.node[springs.begin[r]])], model.layout.slot_of_node[std::size_t(springs.node[e])]);
  std::map<int, std::vector<std::pair<Vec3d, std::array<bool, 3>>>> fixed;
  for (const auto& [r, place] : held_places(springs, cloud))
    fixed[pieces.root(model.layout.slot_of_node[std::size_t(springs.node[springs.begin[r]])])].push_back({place, {true, true, true}});
  for (std::size_t b = 0; b < constraints.node.size(); ++b) {
    const std::size_t n = std::size_t(constraints.node[b]);
    fixed[pieces.root(model.layout.slot_of_node[n])].push_back({cloud.nodes[n], constraints.fixed[b]});
  }
  std::map<int, std::pair<std::size_t, Vec3d>> with_points;  // number of points and the place of one
  for (std::size_t p = 0; p < t.stencil.size(); ++p) {
    if (t.stencil[p] < 0) continue;
    auto& [count, place] = with_points[pieces.root(t.base[p] + t.offset[std::size_t(t.begin[std::size_t(t.stencil[p])])])];
    ++count, place = model.points->position[p];
  }
  for (const auto& [root, piece] : with_points) {
    const auto& [count, place] = piece;
    const std::string where = concatenate("(a part of ", count, " integration points, around (", place.x, ", ", place.y, ", ", place.z, ") mm)");
    require(fixed.count(root), "part of the body ", where, " is connected to no prescribed displacement and could float away; leave it out of the body (the mask), or prescribe its motion");
    const int held = held_motions(fixed[root]);
    require(held == 6, "the prescribed displacements leave ", 6 - held, " rigid motions of the body free ", where,
            "; prescribe three components at three nodes that are not on one line, or the like");
  }
}

}  // namespace

DiscreteModel make_discrete_model(const Approximation& field, IntegrationPoints& points) {
  const Cloud& cloud = field.cloud();
  DiscreteModel model;
  model.field = &field, model.points = &points;
  model.layout = make_slot_layout(cloud, 1);
  model.supports = build_supports(field, model.layout, points);
  hand_over_dropped_volume(model.supports, points);
  model.position.resize(std::size_t(model.layout.num_slots));
  for (std::size_t n = 0; n < cloud.size(); ++n) model.position[std::size_t(model.layout.slot_of_node[n])] = cloud.nodes[n];
  return model;
}

namespace {

/// Diagonal of K at rest (two-level) or the fictitious mass sum w (k + 4 mu / 3) / n (plain), and the volume around each slot.
std::vector<double> stiffness_diagonal(const DiscreteModel& model, Relaxation relaxation, std::vector<double>& inside) {
  const std::size_t slots = model.slots();
  const SupportTable& t = model.supports;
  const IntegrationPoints& points = *model.points;
  std::vector<double> diagonal(3 * slots, 0.0);
  inside.assign(slots, 0.0);
  for (std::size_t p = 0; p < points.size(); ++p) {
    if (t.stencil[p] < 0) continue;
    const int b = t.begin[std::size_t(t.stencil[p])], e = t.begin[std::size_t(t.stencil[p]) + 1];
    const double mu = points.shear_modulus[p], k = points.bulk_modulus[p], volume = points.volume[p];
    const bool fibres = points.model == MaterialModel::transversely_isotropic;
    const double eta = fibres ? material_parameter(points, p, 2) : 0;
    const Vec3d fibre = fibres ? Vec3d{material_parameter(points, p, 3), material_parameter(points, p, 4), material_parameter(points, p, 5)} : Vec3d{};
    for (int s = b; s < e; ++s) {
      const std::size_t slot = std::size_t(t.base[p] + t.offset[std::size_t(s)]);
      const Vec3d& g = t.gradient[std::size_t(s)];
      inside[slot] += volume;
      for (int c = 0; c < 3; ++c)
        // Fibres add 4 eta (a (x) a - I/3) (x) (a (x) a - I/3) to the tangent at rest, 16/9 eta along a.
        diagonal[std::size_t(c) * slots + slot] += relaxation == Relaxation::two_level
                                                       ? volume * ((k + mu / 3) * g[c] * g[c] + mu * squared_norm(g) + 4 * eta * std::pow(fibre[c] * dot(fibre, g) - g[c] / 3, 2))
                                                       : volume * (k + 4 * mu / 3 + 16 * eta / 9) / (e - b);
    }
  }
  const Springs& springs = model.springs;
  for (std::size_t r = 0; r < springs.size(); ++r)
    for (std::size_t e = springs.begin[r]; e < springs.begin[r + 1]; ++e)
      for (std::size_t c = 0; c < 3; ++c)
        diagonal[c * slots + std::size_t(model.layout.slot_of_node[std::size_t(springs.node[e])])] += springs.stiffness[r] * springs.coefficient[e] * springs.coefficient[e];
  return diagonal;
}

/// Nodes just outside the body keep soft modes that the field hardly sees: only those with a fair share of volume are watched.
std::vector<std::uint8_t> with_a_fair_share(const std::vector<double>& inside) {
  std::vector<double> sorted;
  for (double v : inside)
    if (v > 0) sorted.push_back(v);
  std::nth_element(sorted.begin(), sorted.begin() + std::ptrdiff_t(sorted.size() / 2), sorted.end());
  const double fair = 0.25 * sorted[sorted.size() / 2];
  std::vector<std::uint8_t> watched(inside.size());
  for (std::size_t s = 0; s < inside.size(); ++s) watched[s] = inside[s] >= fair;
  return watched;
}

}  // namespace

DiscreteModel make_static_model(const Approximation& field, IntegrationPoints& points, const Constraints& constraints, Springs springs, const Loads& loads, const SolverOptions& options,
                                 std::vector<double>& points_of_nodes) {
  const Cloud& cloud = field.cloud();
  DiscreteModel model = make_discrete_model(field, points);
  const std::size_t slots = model.slots();
  points_of_nodes = points_per_node(model.supports, model.layout, points);
  if (options.stabilisation > 0) add_stabilisation(field, model.supports, model.layout, points, points_of_nodes, options.stabilisation, springs);
  model.springs = std::move(springs);
  require_held(model, constraints);
  model.constraints = std::make_unique<ConstraintOperator>(field, model.layout, constraints);

  std::vector<double> inside;
  model.diagonal = stiffness_diagonal(model, options.relaxation, inside);
  model.active.resize(3 * slots);
  for (std::size_t i = 0; i < model.active.size(); ++i) model.active[i] = model.diagonal[i] > 0;
  const auto index = [&](int slot, int c) { return std::size_t(c) * slots + std::size_t(slot); };
  model.constraints->each_dependent(false, [&](int slot, int c) { model.active[index(slot, c)] = 0; });
  model.coarse_active = model.active;
  model.constraints->each_dependent(true, [&](int slot, int c) { model.coarse_active[index(slot, c)] = 0; });
  require(std::find(model.active.begin(), model.active.end(), 1) != model.active.end(),
          "no node is free to move: every node has a prescribed displacement; leave some nodes free");
  model.watched = with_a_fair_share(inside);

  if (loads.any()) {
    model.external.assign(slots, Vec3d{});
    for (const auto& [name, force] : nodal_forces(field, loads, lumped_mass(field, points)))
      for (std::size_t n = 0; n < cloud.size(); ++n) model.external[std::size_t(model.layout.slot_of_node[n])] += force[n];
  }
  double volume = 0;
  for (double w : points.volume) volume += w;
  model.spacing = std::cbrt(volume / double(cloud.size()));
  std::vector<Vec3d> held;
  for (int n : constraints.node) held.push_back(cloud.nodes[std::size_t(n)]);
  for (const auto& [r, place] : held_places(model.springs, cloud)) held.push_back(place);
  double largest = 0;  // distance to what is held, by a coarse sweep over the nodes
  for (std::size_t n = 0; n < cloud.size(); n += std::max<std::size_t>(1, cloud.size() / 2000)) {
    double nearest = 1e300;
    for (std::size_t b = 0; b < held.size(); b += std::max<std::size_t>(1, held.size() / 500)) nearest = std::min(nearest, squared_norm(cloud.nodes[n] - held[b]));
    largest = std::max(largest, nearest);
  }
  model.largest_distance = std::sqrt(largest) / model.spacing;
  double size = 0;
  for (const Vec3d& d : constraints.displacement) size = std::max(size, norm(d));
  for (const Vec3d& d : model.springs.target) size = std::max(size, norm(d));
  model.largest_increment = 100 * (size + model.spacing);
  return model;
}

StateOfPoints measure_points(const DiscreteModel& model, const std::vector<Vec3d>& u) {
  const SupportTable& t = model.supports;
  const IntegrationPoints& points = *model.points;
  std::vector<double> ratio(points.size(), 1e30);
  StateOfPoints state;
  state.strain_energy = parallel_sum(points.size(), [&](std::size_t begin, std::size_t end) {
    double energy = 0;
    for (std::size_t p = begin; p < end; ++p) {
      if (t.stencil[p] < 0) continue;
      Mat3d F = Mat3d::identity();
      for (int s = t.begin[std::size_t(t.stencil[p])]; s < t.begin[std::size_t(t.stencil[p]) + 1]; ++s) {
        const Vec3d &at = u[std::size_t(t.base[p] + t.offset[std::size_t(s)])], &g = t.gradient[std::size_t(s)];
        for (int i = 0; i < 3; ++i)
          for (int k = 0; k < 3; ++k) F[i][k] += at[i] * g[k];
      }
      energy += points.volume[p] * with_material<double>(points, p, [&](const auto& material) { return material.energy(F); });
      ratio[p] = determinant(F);
      if (std::isnan(ratio[p])) ratio[p] = -std::numeric_limits<double>::infinity();  // of a state that grew without bound
    }
    return energy;
  });
  const std::size_t worst = std::size_t(std::min_element(ratio.begin(), ratio.end()) - ratio.begin());
  state.smallest_volume_ratio = ratio[worst];
  state.worst_place = points.position[worst];
  state.inverted = std::size_t(std::count_if(ratio.begin(), ratio.end(), [](double r) { return r <= 0; }));
  return state;
}

FieldRows field_at_watched_nodes(const DiscreteModel& model) {
  const Cloud& cloud = model.field->cloud();
  const std::vector<int>& slot_of = model.layout.slot_of_node;
  std::vector<int> watched;
  for (std::size_t n = 0; n < slot_of.size(); ++n)
    if (model.watched[std::size_t(slot_of[n])]) watched.push_back(int(n));
  FieldRows rows;
  constexpr std::size_t block = 16384;  // shape functions that are kept at a time
  std::vector<ShapeFunctions> shapes(std::min(block, watched.size()));
  for (std::size_t first = 0; first < watched.size(); first += block) {
    const std::size_t count = std::min(block, watched.size() - first);
    parallel_for(count, [&](std::size_t r) {
      const int n = watched[first + r];
      if (!model.field->at(cloud.nodes[std::size_t(n)], shapes[r])) shapes[r].clear(), shapes[r].add(n, 1, {});
    }, 256);
    for (std::size_t r = 0; r < count; ++r) {
      for (std::size_t i = 0; i < shapes[r].node.size(); ++i) rows.slot.push_back(slot_of[std::size_t(shapes[r].node[i])]), rows.value.push_back(float(shapes[r].value[i]));
      rows.begin.push_back(rows.slot.size());
    }
  }
  return rows;
}

}  // namespace mtled
