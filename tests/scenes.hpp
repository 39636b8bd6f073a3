#pragma once
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <functional>
#include <optional>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include "core/cloud.hpp"
#include "core/error.hpp"
#include "core/material.hpp"
#include "core/shape_evaluator.hpp"
#include "core/solver.hpp"

/// Bodies that several tests share: boxes with one corner at the origin, as lattices and as general clouds.
namespace mtled::scenes {

/// cells[a] lattice cells of `spacing` [mm] along each axis.
struct Box {
  std::array<int, 3> cells;
  double spacing;
  double length(int a) const { return cells[std::size_t(a)] * spacing; }
  double volume() const { return length(0) * length(1) * length(2); }
  bool on_surface(const Vec3d& x) const {
    for (int a = 0; a < 3; ++a)
      if (x[a] < 1e-6 * spacing || x[a] > length(a) - 1e-6 * spacing) return true;
    return false;
  }
};

/// Nodes at the corners of the lattice cells for which `kept` holds.
inline std::vector<Vec3d> cell_corners(const Box& box, const std::function<bool(const std::array<int, 3>&)>& kept) {
  std::vector<Vec3d> nodes;
  for (int k = 0; k <= box.cells[2]; ++k)
    for (int j = 0; j <= box.cells[1]; ++j)
      for (int i = 0; i <= box.cells[0]; ++i) {
        bool used = false;
        for (int c = 0; c < 8; ++c) {
          const std::array<int, 3> cell{i - (c & 1), j - (c >> 1 & 1), k - (c >> 2)};
          bool inside = true;
          for (std::size_t a = 0; a < 3; ++a) inside = inside && cell[a] >= 0 && cell[a] < box.cells[a];
          used = used || (inside && kept(cell));
        }
        if (used) nodes.push_back(box.spacing * Vec3d{double(i), double(j), double(k)});
      }
  return nodes;
}

inline Cloud on_lattice(std::vector<Vec3d> nodes, double spacing) {
  Lattice promise;
  promise.spacing = spacing;
  return make_cloud(std::move(nodes), promise);
}

inline bool every_cell(const std::array<int, 3>&) { return true; }
inline Cloud lattice_box(const Box& box) { return on_lattice(cell_corners(box, every_cell), box.spacing); }

/// The same box as a general cloud: nodes inside are moved by up to `jitter` spacings along each axis, those on the
/// surface stay. The order is shuffled, so that nothing can rely on it.
inline Cloud jittered_box(const Box& box, double jitter = 0.3) {
  std::mt19937 random(7);
  std::uniform_real_distribution<double> move(-jitter * box.spacing, jitter * box.spacing);
  std::vector<Vec3d> nodes = cell_corners(box, every_cell);
  for (Vec3d& x : nodes)
    if (!box.on_surface(x)) x += Vec3d{move(random), move(random), move(random)};
  std::shuffle(nodes.begin(), nodes.end(), random);
  return make_cloud(std::move(nodes), std::nullopt);
}

/// Shear modulus [kPa] at a place.
using ModulusField = std::function<double(const Vec3d&)>;
inline ModulusField uniform(double shear_modulus) {
  return [=](const Vec3d&) { return shear_modulus; };
}
inline void add_point(IntegrationPoints& points, const Vec3d& x, double volume, double shear_modulus, double poisson_ratio) {
  points.position.push_back(x);
  points.volume.push_back(volume);
  points.shear_modulus.push_back(shear_modulus);
  points.bulk_modulus.push_back(bulk_modulus(shear_modulus, poisson_ratio));
  points.density.push_back(1e-6);
}

constexpr std::array<double, 3> usual_ratio{4.0 / 5, 4.0 / 5, 3.0 / 4};  ///< integration cell / node spacing
enum class CellKind { free, coupled, absent };

/// One point per background cell of ratio * spacing, at the centroid of its part in free lattice cells; 2 x 2 x 2 points
/// in coupled lattice cells, as sample_body() does; none in absent cells. Volumes are exact.
inline IntegrationPoints box_points(const Box& box, const ModulusField& shear_modulus, double poisson_ratio = 0.49,
                                    const std::array<double, 3>& ratio = usual_ratio,
                                    const std::function<CellKind(const std::array<int, 3>&)>& kind = nullptr) {
  const auto kind_of = [&](const std::array<int, 3>& cell) { return kind ? kind(cell) : CellKind::free; };
  IntegrationPoints points;
  const double h = box.spacing;
  int count[3];
  for (int a = 0; a < 3; ++a) count[a] = int(std::ceil(box.cells[std::size_t(a)] / ratio[std::size_t(a)] - 1e-9));
  for (int k = 0; k < count[2]; ++k)
    for (int j = 0; j < count[1]; ++j)
      for (int i = 0; i < count[0]; ++i) {
        double low[3], high[3];  // in spacings
        const int ijk[3] = {i, j, k};
        for (std::size_t a = 0; a < 3; ++a)
          low[a] = ijk[a] * ratio[a], high[a] = std::min(double(box.cells[a]), (ijk[a] + 1) * ratio[a]);
        double volume = 0;
        Vec3d first_moment{};
        for (int c = int(low[2] + 1e-9); c < high[2] - 1e-9; ++c)
          for (int b = int(low[1] + 1e-9); b < high[1] - 1e-9; ++b)
            for (int a = int(low[0] + 1e-9); a < high[0] - 1e-9; ++a) {
              if (kind_of({a, b, c}) != CellKind::free) continue;
              const int cell[3] = {a, b, c};
              double piece = 1;
              Vec3d centre;
              for (int d = 0; d < 3; ++d) {
                const double from = std::max(low[d], double(cell[d])), to = std::min(high[d], cell[d] + 1.0);
                piece *= h * (to - from), centre[d] = h * (from + to) / 2;
              }
              volume += piece, first_moment += piece * centre;
            }
        if (volume < 0.02 * h * h * h * ratio[0] * ratio[1] * ratio[2]) continue;
        const Vec3d x = (1 / volume) * first_moment;
        add_point(points, x, volume, shear_modulus(x), poisson_ratio);
      }
  for (int k = 0; k < box.cells[2]; ++k)
    for (int j = 0; j < box.cells[1]; ++j)
      for (int i = 0; i < box.cells[0]; ++i)
        for (int e = 0; e < 8; ++e) {
          if (kind_of({i, j, k}) != CellKind::coupled) continue;
          const Vec3d x = h * Vec3d{i + 0.25 + 0.5 * (e & 1), j + 0.25 + 0.5 * (e >> 1 & 1), k + 0.25 + 0.5 * (e >> 2)};
          add_point(points, x, h * h * h / 8, shear_modulus(x), poisson_ratio);
        }
  return points;
}

using Region = std::function<bool(const Vec3d&)>;
using Displacement = std::function<Vec3d(const Vec3d&)>;

/// Prescribes `fixed` components of the nodes in `where`; components of a node that is prescribed already are added.
inline void prescribe(const Cloud& cloud, Constraints& constraints, const std::string& set, const Region& where, const Displacement& displacement,
                      std::array<bool, 3> fixed = {true, true, true}) {
  const int number = int(constraints.set_names.size());
  constraints.set_names.push_back(set);
  std::vector<int> row(cloud.size(), -1);
  for (std::size_t r = 0; r < constraints.node.size(); ++r) row[std::size_t(constraints.node[r])] = int(r);
  for (std::size_t n = 0; n < cloud.size(); ++n) {
    if (!where(cloud.nodes[n])) continue;
    if (row[n] < 0) {
      row[n] = int(constraints.node.size());
      constraints.node.push_back(int(n)), constraints.displacement.push_back({}), constraints.fixed.push_back({false, false, false});
      constraints.set.push_back(number);
    }
    const std::size_t r = std::size_t(row[n]);
    for (int c = 0; c < 3; ++c) {
      if (!fixed[std::size_t(c)] || constraints.fixed[r][std::size_t(c)]) continue;
      constraints.fixed[r][std::size_t(c)] = true, constraints.displacement[r][c] = displacement(cloud.nodes[n])[c];
    }
  }
}

inline std::vector<std::uint8_t> prescribed_flags(const Cloud& cloud, const Constraints& constraints) {
  std::vector<std::uint8_t> flags(cloud.size(), 0);
  for (int n : constraints.node) flags[std::size_t(n)] = 1;
  return flags;
}

/// A problem for the solver. Keep it where it is: the evaluator refers to the cloud.
struct Scene {
  Cloud cloud;
  Constraints constraints;
  IntegrationPoints points;
  ShapeEvaluator evaluator(const MlsOptions& options = {}) const { return {cloud, prescribed_flags(cloud, constraints), options}; }
  Solution solve(const SolverOptions& options = {}, const MakeMechanics& make_mechanics = {}) const { return mtled::solve(evaluator(), points, constraints, options, {}, {}, make_mechanics); }
};

/// Background cells with sub-cells where the lattice is coupled with prescribed nodes.
inline IntegrationPoints coupled_box_points(const Box& box, const Cloud& cloud, const Constraints& constraints, const ModulusField& shear_modulus,
                                            double poisson_ratio = 0.49, const std::array<double, 3>& ratio = usual_ratio) {
  const ShapeEvaluator evaluator(cloud, prescribed_flags(cloud, constraints), {});
  return box_points(box, shear_modulus, poisson_ratio, ratio,
                    [&](const std::array<int, 3>& cell) { return evaluator.coupled(cell) ? CellKind::coupled : CellKind::free; });
}

inline Vec3d nowhere(const Vec3d&) { return {}; }
inline Region all_of_it() {
  return [](const Vec3d&) { return true; };
}
inline Region below(int axis, double at) {
  return [=](const Vec3d& x) { return x[axis] < at + 1e-6; };
}
inline Region above(int axis, double at) {
  return [=](const Vec3d& x) { return x[axis] > at - 1e-6; };
}

/// Message of the Error that `work` throws, or "" when it throws none; `failure` receives its kind.
template <class Work>
std::string error_of(Work&& work, Failure* failure = nullptr) {
  try {
    work();
  } catch (const Error& error) {
    if (failure) *failure = error.failure();
    return error.what();
  }
  return {};
}

}  // namespace mtled::scenes
