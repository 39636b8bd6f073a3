#include "core/solver.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>

#include "core/error.hpp"
#include "core/point_material.hpp"
#include "core/relaxation.hpp"
#include "core/stabilisation.hpp"

namespace mtled {
namespace {

class Stopwatch {
 public:
  explicit Stopwatch(std::map<std::string, double>& seconds) : seconds_(seconds) {}
  /// Books the time since the last call under `stage`.
  void lap(const std::string& stage) {
    const auto now = std::chrono::steady_clock::now();
    seconds_[stage] += std::chrono::duration<double>(now - last_).count();
    last_ = now;
  }

 private:
  std::map<std::string, double>& seconds_;
  std::chrono::steady_clock::time_point last_ = std::chrono::steady_clock::now();
};

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

template <class Real>
void require_held(const SlotModel<Real>& model, const Cloud& cloud, const Constraints& constraints, const Springs& springs) {
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

template <class Real>
SlotModel<Real> build_base_model(const Approximation& field, IntegrationPoints& points) {
  const Cloud& cloud = field.cloud();
  SlotModel<Real> model;
  model.layout = make_slot_layout(cloud, 1);
  model.supports = build_supports(field, model.layout, points);
  hand_over_dropped_volume(model.supports, points);
  model.points = &points;
  model.position.resize(std::size_t(model.layout.num_slots));
  for (std::size_t n = 0; n < cloud.size(); ++n) model.position[std::size_t(model.layout.slot_of_node[n])] = cloud.nodes[n];
  if (field.averages_pressure()) model.nodal_pressure = std::make_unique<NodalPressure<Real>>(model.supports, points);
  model.forces = std::make_unique<CpuForces<Real>>(model.supports, model.layout, points);
  return model;
}
template SlotModel<double> build_base_model<double>(const Approximation&, IntegrationPoints&);

namespace {

template <class Real>
SlotModel<Real> build_model(const Approximation& field, IntegrationPoints& points, const Constraints& constraints, Springs springs, const Loads& loads, const SolverOptions& options, Solution& solution) {
  const Cloud& cloud = field.cloud();
  Stopwatch watch(solution.seconds);
  SlotModel<Real> model = build_base_model<Real>(field, points);
  const std::size_t slots = model.position.size();
  solution.points_per_node = points_per_node(model.supports, model.layout, points);
  if (options.stabilisation > 0) add_stabilisation(field, model.supports, model.layout, points, solution.points_per_node, options.stabilisation, springs);
  watch.lap("shape functions");
  require_held(model, cloud, constraints, springs);
  if (springs.size() > 0) model.springs = std::make_unique<SpringForces<Real>>(springs, model.layout);
  model.constraints = std::make_unique<ConstraintOperator<Real>>(field, model.layout, constraints);

  // Diagonal of K at rest (two-level) or the fictitious mass sum w (k + 4 mu / 3) / n (plain), and which nodes carry anything.
  std::vector<double> diagonal(3 * slots, 0.0), inside(slots, 0.0);
  const SupportTable& t = model.supports;
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
        diagonal[std::size_t(c) * slots + slot] += options.relaxation == Relaxation::two_level
                                                       ? volume * ((k + mu / 3) * g[c] * g[c] + mu * squared_norm(g) + 4 * eta * std::pow(fibre[c] * dot(fibre, g) - g[c] / 3, 2))
                                                       : volume * (k + 4 * mu / 3 + 16 * eta / 9) / (e - b);
    }
  }
  if (model.springs)
    model.springs->each_diagonal_term([&](std::size_t slot, double k) {
      for (int c = 0; c < 3; ++c) diagonal[std::size_t(c) * slots + slot] += k;
    });
  model.active = NodalField<Real>(slots);
  model.inverse_diagonal = NodalField<Real>(slots);
  for (std::size_t s = 0; s < slots; ++s)
    for (int c = 0; c < 3; ++c)
      if (diagonal[std::size_t(c) * slots + s] > 0) model.active.at(s, c) = 1;
  model.constraints->each_dependent(false, [&](int slot, int c) { model.active.at(std::size_t(slot), c) = 0; });
  for (std::size_t s = 0; s < slots; ++s)
    for (int c = 0; c < 3; ++c)
      if (model.active.at(s, c) != 0) model.inverse_diagonal.at(s, c) = Real(1 / diagonal[std::size_t(c) * slots + s]);

  bool any_active = false;
  for (std::size_t s = 0; s < slots && !any_active; ++s)
    for (int c = 0; c < 3; ++c) any_active = any_active || model.active.at(s, c) != 0;
  require(any_active, "no node is free to move: every node has a prescribed displacement; leave some nodes free");

  // Nodes just outside the body keep soft modes that the field hardly sees: only those with a fair share of volume are watched.
  std::vector<double> sorted;
  for (double v : inside)
    if (v > 0) sorted.push_back(v);
  std::nth_element(sorted.begin(), sorted.begin() + std::ptrdiff_t(sorted.size() / 2), sorted.end());
  const double fair = 0.25 * sorted[sorted.size() / 2];
  model.watched.resize(slots);
  for (std::size_t s = 0; s < slots; ++s) model.watched[s] = inside[s] >= fair;

  if (loads.any()) {
    model.external = NodalField<Real>(slots);
    for (const auto& [name, force] : nodal_forces(field, loads, lumped_mass(field, points)))
      for (std::size_t n = 0; n < cloud.size(); ++n)
        for (int c = 0; c < 3; ++c) model.external.at(std::size_t(model.layout.slot_of_node[n]), c) += Real(force[n][c]);
  }
  watch.lap("model");
  const double spacing = std::cbrt([&] { double v = 0; for (double w : points.volume) v += w; return v; }() / double(cloud.size()));
  std::vector<Vec3d> held;
  for (int n : constraints.node) held.push_back(cloud.nodes[std::size_t(n)]);
  for (const auto& [r, place] : held_places(springs, cloud)) held.push_back(place);
  double largest = 0;  // distance to what is held, by a coarse sweep over the nodes
  for (std::size_t n = 0; n < cloud.size(); n += std::max<std::size_t>(1, cloud.size() / 2000)) {
    double nearest = 1e300;
    for (std::size_t b = 0; b < held.size(); b += std::max<std::size_t>(1, held.size() / 500)) nearest = std::min(nearest, squared_norm(cloud.nodes[n] - held[b]));
    largest = std::max(largest, nearest);
  }
  model.largest_distance = std::sqrt(largest) / spacing;
  double size = 0;
  for (const Vec3d& d : constraints.displacement) size = std::max(size, norm(d));
  for (const Vec3d& d : springs.target) size = std::max(size, norm(d));
  model.largest_increment = 100 * (size + spacing);
  if (options.relaxation == Relaxation::two_level) {
    model.coarse_active = NodalField<Real>(slots);
    model.coarse_active.copy_from(model.active);
    model.constraints->each_dependent(true, [&](int slot, int c) { model.coarse_active.at(std::size_t(slot), c) = 0; });
    model.coarse = std::make_unique<CoarseSpace<Real>>(model.position, model.coarse_active, options.coarse_unknowns, 5 * spacing);
    if (springs.size() > 0) model.coarse->add_springs(springs, model.layout);
    solution.coarse_unknowns = std::size_t(model.coarse->unknowns());
  }
  return model;
}

}  // namespace

template <class Real>
void measure_state(const SlotModel<Real>& model, const NodalField<Real>& u, Solution& solution, Vec3d& worst_place) {
  const SupportTable& t = model.supports;
  const IntegrationPoints& points = *model.points;
  std::vector<double> ratio(points.size(), 1e30);
  solution.strain_energy = parallel_sum(points.size(), [&](std::size_t begin, std::size_t end) {
    double energy = 0;
    for (std::size_t p = begin; p < end; ++p) {
      if (t.stencil[p] < 0) continue;
      Mat3d F = Mat3d::identity();
      for (int s = t.begin[std::size_t(t.stencil[p])]; s < t.begin[std::size_t(t.stencil[p]) + 1]; ++s)
        for (int i = 0; i < 3; ++i)
          for (int k = 0; k < 3; ++k)
            F[i][k] += double(u.at(std::size_t(t.base[p] + t.offset[std::size_t(s)]), i)) * t.gradient[std::size_t(s)][k];
      energy += points.volume[p] * with_material<double>(points, p, [&](const auto& material) { return material.energy(F); });
      ratio[p] = determinant(F);
      if (std::isnan(ratio[p])) ratio[p] = -std::numeric_limits<double>::infinity();  // of a state that grew without bound
    }
    return energy;
  });
  const std::size_t worst = std::size_t(std::min_element(ratio.begin(), ratio.end()) - ratio.begin());
  solution.smallest_volume_ratio = ratio[worst];
  worst_place = points.position[worst];
  solution.inverted_points = std::size_t(std::count_if(ratio.begin(), ratio.end(), [](double r) { return r <= 0; }));
}

template void measure_state<double>(const SlotModel<double>&, const NodalField<double>&, Solution&, Vec3d&);

namespace {

/// Where the body is compressed most, for messages.
template <class Real>
std::string at_worst_place(const SlotModel<Real>& model, const NodalField<Real>& u) {
  Solution state;
  Vec3d x;
  measure_state(model, u, state, x);
  return concatenate("(smallest volume ratio ", state.smallest_volume_ratio, " at (", x.x, ", ", x.y, ", ", x.z, ") mm)");
}

/// Linear-elastic start in `fewest_increments` load increments, and more, each linearised about the last, when one leaves points (nearly)
/// inside out. The coarse matrix is left assembled at the start. Returns the products with the stiffness matrix.
template <class Real>
int start_two_level(SlotModel<Real>& model, const SolverOptions& options, int fewest_increments, Solution& solution, NodalField<Real>& u) {
  constexpr double start_residual = 2e-3;   // relative; the relaxation does the rest
  constexpr double smallest_ratio = 0.1;    // volume ratio of a usable start
  constexpr int most_increments = 16;
  NodalField<Real> f(u.slots());
  int products = 0;
  for (int increments = fewest_increments;; increments *= 2) {
    NodalField<Real> state(u.slots());
    VolumeRatioStatistics ratio;
    for (int i = 1; i <= increments; ++i) {
      if (options.progress) options.progress({"start", i, std::nan(""), 0, std::nan("")});
      model.coarse->assemble(model.supports, *model.points, state);
      products += advance_load(model, double(i) / increments, start_residual, state);
      ratio = model.force(state, double(i) / increments, f);
      ++products;
      if (ratio.smallest < smallest_ratio) break;
    }
    if (ratio.smallest >= smallest_ratio || increments >= most_increments) {
      solution.load_increments = increments;
      u.swap(state);
      if (ratio.inverted > 0)
        fail(Failure::numerical, "the prescribed motions turn ", ratio.inverted, " integration points inside out even when applied in ", increments,
             " increments ", at_worst_place(model, u), ": they ask for more than the tissue between the rigid bodies can follow; check the motions there (do two bodies run into each other?), or use a smaller node spacing");
      model.coarse->assemble(model.supports, *model.points, u);
      return products;
    }
  }
}

/// The field's values at the watched nodes, from shape functions that are computed once.
template <class Real>
class FieldAtNodes {
 public:
  FieldAtNodes(const Approximation& field, const SlotModel<Real>& model) {
    const std::vector<int>& slot_of = model.layout.slot_of_node;
    for (std::size_t n = 0; n < slot_of.size(); ++n)
      if (model.watched[std::size_t(slot_of[n])]) rows_.push_back({int(n), {}});
    parallel_for(rows_.size(), [&](std::size_t r) {
      ShapeFunctions shapes;
      if (!field.at(field.cloud().nodes[std::size_t(rows_[r].node)], shapes)) shapes.add(rows_[r].node, 1, {});
      for (std::size_t i = 0; i < shapes.node.size(); ++i) rows_[r].terms.emplace_back(slot_of[std::size_t(shapes.node[i])], float(shapes.value[i]));
    }, 1024);
  }
  /// Largest component of the field with parameters x [mm].
  double largest(const NodalField<Real>& x) const {
    constexpr std::size_t piece = 4096;
    std::vector<double> top((rows_.size() + piece - 1) / piece, 0.0);
    parallel_pieces(rows_.size(), piece, [&](std::size_t begin, std::size_t end) {
      for (std::size_t r = begin; r < end; ++r) {
        double u[3] = {};
        for (const auto& [slot, value] : rows_[r].terms)
          for (int c = 0; c < 3; ++c) u[c] += double(value) * double(x.at(std::size_t(slot), c));
        for (double component : u) top[begin / piece] = std::max(top[begin / piece], std::abs(component));
      }
    });
    return *std::max_element(top.begin(), top.end());
  }

 private:
  struct Row {
    int node;
    std::vector<std::pair<int, float>> terms;
  };
  std::vector<Row> rows_;
};

template <class Real>
Solution solve_with(const Approximation& field, IntegrationPoints& points, const Constraints& constraints, const Springs& springs, const Loads& loads, const SolverOptions& options) {
  Solution solution;
  SlotModel<Real> model = build_model<Real>(field, points, constraints, springs, loads, options, solution);
  solution.points = points.size(), solution.stencils = std::size_t(model.supports.num_stencils());
  solution.enlarged_supports = model.supports.enlarged, solution.dropped_points = model.supports.dropped.size();
  Stopwatch watch(solution.seconds);
  model.strain_energy = [&](const NodalField<Real>& state) {
    Solution scratch;
    Vec3d place;
    measure_state(model, state, scratch, place);
    return scratch.strain_energy;
  };
  std::optional<FieldAtNodes<Real>> field_at_nodes;
  model.largest_displacement = [&](const NodalField<Real>& parameters) {
    if (!field_at_nodes) field_at_nodes.emplace(field, model);
    return field_at_nodes->largest(parameters);
  };
  NodalField<Real> u(model.position.size());
  // Where the start is too far from equilibrium the relaxation diverges or turns points inside out; then again with a finer start and shorter steps.
  RelaxationResult relaxed;
  double safety = 1;
  Vec3d worst{};
  for (int increments : {1, 4, 16}) {
    u.clear();
    if (model.coarse) {
      solution.force_evaluations += start_two_level(model, options, increments, solution, u);
      watch.lap("start");
    }
    relaxed = relax(model, options, safety, u);
    solution.force_evaluations += relaxed.force_evaluations;
    measure_state(model, u, solution, worst);
    if (!relaxed.diverged && !(relaxed.converged && solution.inverted_points > 0)) break;
    safety *= 2;
  }
  if (relaxed.diverged)
    fail(Failure::numerical, "the solution diverged at step ", relaxed.steps, ", also with shorter steps and a finer start, and ", solution.inverted_points, " integration points are inside out ", at_worst_place(model, u),
         ": the prescribed motions deform the body too strongly between some nodes; check the motions there, or use a smaller node spacing");
  watch.lap("relaxation");
  solution.converged = relaxed.converged;
  solution.steps = relaxed.steps;
  solution.error_estimate_mm = relaxed.error_estimate;
  solution.history = relaxed.history;
  NodalField<Real> f(u.slots());
  model.force(u, 1, f);
  const std::vector<Vec3d> reaction = model.constraints->reactions(f);
  for (const std::string& name : constraints.set_names) solution.reactions[name] = {};
  if (model.nodal_pressure) solution.strain_energy += model.nodal_pressure->energy(u);
  if (model.springs) {
    solution.strain_energy += model.springs->energy(u, 1);
    for (const auto& [name, force] : model.springs->reactions(u, 1)) solution.reactions[name] += force;
  }
  for (std::size_t b = 0; b < reaction.size(); ++b) solution.reactions[constraints.set_names[std::size_t(constraints.set[b])]] += reaction[b];
  solution.bytes = double(model.forces->bytes()) + 12.0 * 3 * double(u.slots()) * sizeof(Real) + (model.coarse ? double(model.coarse->bytes()) : 0);

  const Cloud& cloud = field.cloud();
  solution.parameter.resize(cloud.size());
  for (std::size_t n = 0; n < cloud.size(); ++n)
    for (int c = 0; c < 3; ++c) solution.parameter[n][c] = double(u.at(std::size_t(model.layout.slot_of_node[n]), c));
  solution.displacement.resize(cloud.size());
  parallel_for(cloud.size(), [&](std::size_t n) {
    if (!displacement_at(field, solution.parameter, cloud.nodes[n], solution.displacement[n])) solution.displacement[n] = solution.parameter[n];
  }, 256);
  watch.lap("field at nodes");
  if (solution.inverted_points > 0)
    fail(Failure::numerical, solution.inverted_points, " integration points are turned inside out at the end ", at_worst_place(model, u), ": the prescribed motions ask for more than the tissue between them can follow; check the motions there, or use a smaller node spacing");
  return solution;
}

}  // namespace

Solution solve(const Approximation& field, IntegrationPoints points, const Constraints& constraints, const SolverOptions& options, const Springs& springs, const Loads& loads) {
  const bool held_by_springs = std::any_of(springs.set.begin(), springs.set.end(), [](int s) { return s >= 0; });
  require(!constraints.node.empty() || held_by_springs, "there are no prescribed displacements: nothing moves the body; give at least one rigid body or constraint");
  points = long_term(std::move(points));
  return options.double_precision ? solve_with<double>(field, points, constraints, springs, loads, options)
                                  : solve_with<float>(field, points, constraints, springs, loads, options);
}

bool displacement_at(const Approximation& field, const std::vector<Vec3d>& parameter, const Vec3d& x, Vec3d& u) {
  thread_local ShapeFunctions shapes;
  if (!field.at(x, shapes)) return false;
  u = {};
  for (std::size_t i = 0; i < shapes.node.size(); ++i) u += shapes.value[i] * parameter[std::size_t(shapes.node[i])];
  return true;
}

}  // namespace mtled
