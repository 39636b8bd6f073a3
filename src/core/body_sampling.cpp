#include "core/body_sampling.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>

#include "core/error.hpp"
#include "core/material.hpp"
#include "core/parallel.hpp"

namespace mtled {
namespace {

constexpr std::array<int, 3> samples_per_node{5, 5, 4};    ///< along each axis of a lattice cell
constexpr std::array<int, 3> samples_per_point{4, 4, 3};   ///< of an integration cell: 4/5, 4/5, 3/4 of the spacing
constexpr int samples_per_subcell = 4;                     ///< along each axis of an eighth of a coupled cell

/// Sums over the samples of one cell that lie in the body.
struct CellSum {
  int inside = 0, with_modulus = 0;
  Vec3d position{};
  double modulus = 0, bulk_modulus = 0;
};

class Sampler {
 public:
  /// `bulk_modulus` may be null.
  Sampler(const Mask& body, const Image& modulus, const Lattice& lattice, const Image* bulk_modulus = nullptr) : body_(body), modulus_(modulus), bulk_modulus_(bulk_modulus), lattice_(lattice) {}

  bool inside(const Vec3d& x) const { return nearest_value<std::uint8_t>(body_, x, 0) != 0; }
  void add(const Vec3d& x, CellSum& sum) const {
    if (!inside(x)) return;
    ++sum.inside;
    sum.position += x;
    const float m = nearest_value<float>(modulus_, x, 0.0f);
    if (m > 0) {
      ++sum.with_modulus, sum.modulus += double(m);
      if (bulk_modulus_) sum.bulk_modulus += double(nearest_value<float>(*bulk_modulus_, x, 0.0f));
    }
  }
  /// Position of sample s of n along a cell that starts at c (lattice coordinates) and has edge e.
  double along(int axis, double c, double e, int s, int n) const { return lattice_.origin[axis] + lattice_.spacing * (c + e * (s + 0.5) / n); }

 private:
  const Mask& body_;
  const Image& modulus_;
  const Image* bulk_modulus_;
  const Lattice& lattice_;
};

Lattice lattice_around(const Mask& body, double spacing) {
  constexpr double inf = std::numeric_limits<double>::infinity();
  Vec3d low{inf, inf, inf}, high{-inf, -inf, -inf};
  const auto& n = body.grid.size;
  std::size_t count = 0;
  for (int k = 0; k < n[2]; ++k)
    for (int j = 0; j < n[1]; ++j)
      for (int i = 0; i < n[0]; ++i) {
        if (!body.at(i, j, k)) continue;
        ++count;
        const Vec3d x = body.grid.point(i, j, k);
        for (int a = 0; a < 3; ++a) low[a] = std::min(low[a], x[a]), high[a] = std::max(high[a], x[a]);
      }
  require(count > 0, "the body mask is empty");
  Lattice lattice;
  lattice.spacing = spacing;
  const double margin = norm(body.grid.spacing) / 2;
  double positions = 1;
  for (int a = 0; a < 3; ++a) {
    // Anchored at the image's lowest corner: neither the mask nor the order of the voxels moves the nodes.
    double anchor = inf;
    for (int c = 0; c < 8; ++c) anchor = std::min(anchor, body.grid.point(c & 1 ? n[0] - 1 : 0, c & 2 ? n[1] - 1 : 0, c & 4 ? n[2] - 1 : 0)[a]);
    lattice.origin[a] = anchor + spacing * std::floor((low[a] - margin - anchor) / spacing);
    lattice.size[a] = int(std::ceil((high[a] + margin - lattice.origin[a]) / spacing)) + 1;
    positions *= lattice.size[a];
  }
  require(positions < 5e8, "a node spacing of ", spacing, " mm gives ", positions, " lattice positions for this body; use a larger spacing");
  lattice.node_at.assign(std::size_t(positions), -1);
  return lattice;
}

/// Part of each lattice cell that is body; cell (i, j, k) at the offset of its lowest corner.
std::vector<float> body_parts(const Lattice& l, const Sampler& sampler) {
  std::vector<float> part(l.node_at.size(), 0.0f);
  constexpr double total = samples_per_node[0] * samples_per_node[1] * samples_per_node[2];
  parallel_for(std::size_t(l.size[2] - 1), [&](std::size_t k) {
    for (int j = 0; j + 1 < l.size[1]; ++j)
      for (int i = 0; i + 1 < l.size[0]; ++i) {
        int inside = 0;
        for (int c = 0; c < samples_per_node[2]; ++c)
          for (int b = 0; b < samples_per_node[1]; ++b)
            for (int a = 0; a < samples_per_node[0]; ++a)
              inside += sampler.inside({sampler.along(0, i, 1, a, samples_per_node[0]), sampler.along(1, j, 1, b, samples_per_node[1]), sampler.along(2, double(k), 1, c, samples_per_node[2])});
        part[l.offset(i, j, int(k))] = float(inside / total);
      }
  }, 1);
  return part;
}

template <class Body>
void each_cell_corner(const Lattice& l, int i, int j, int k, Body&& body) {
  for (int c = 0; c < 8; ++c) body(l.offset(i + (c & 1), j + (c >> 1 & 1), k + (c >> 2)));
}

/// Nodes at all corners of the chosen cells, and at those of the cells around prescribed nodes that hold any body.
Cloud place_nodes(Lattice lattice, const std::vector<float>& part, const std::vector<std::uint16_t>& label, const SamplingOptions& options) {
  std::vector<std::uint8_t> is_node(lattice.node_at.size(), 0);
  const auto each_cell = [&](auto&& body) {
    for (int k = 0; k + 1 < lattice.size[2]; ++k)
      for (int j = 0; j + 1 < lattice.size[1]; ++j)
        for (int i = 0; i + 1 < lattice.size[0]; ++i) body(i, j, k, part[lattice.offset(i, j, k)]);
  };
  each_cell([&](int i, int j, int k, float p) {
    if (p >= float(options.smallest_cell)) each_cell_corner(lattice, i, j, k, [&](std::size_t n) { is_node[n] = 1; });
  });
  const std::vector<std::uint8_t> before = is_node;
  each_cell([&](int i, int j, int k, float p) {
    if (p <= 0) return;
    bool rigid = false;
    each_cell_corner(lattice, i, j, k, [&](std::size_t n) { rigid = rigid || (before[n] && label[n]); });
    if (rigid) each_cell_corner(lattice, i, j, k, [&](std::size_t n) { is_node[n] = 1; });
  });
  lattice.body_cell.resize(part.size());
  for (std::size_t c = 0; c < part.size(); ++c) lattice.body_cell[c] = part[c] > 0;
  Cloud cloud;
  for (int k = 0; k < lattice.size[2]; ++k)
    for (int j = 0; j < lattice.size[1]; ++j)
      for (int i = 0; i < lattice.size[0]; ++i) {
        const std::size_t n = lattice.offset(i, j, k);
        if (!is_node[n]) continue;
        lattice.node_at[n] = int(cloud.size());
        cloud.nodes.push_back(lattice.origin + lattice.spacing * Vec3d{double(i), double(j), double(k)});
        cloud.lattice_ijk.push_back({i, j, k});
      }
  cloud.lattice = std::move(lattice);
  return cloud;
}

/// Appends the point of a cell, or nothing when too little of it is body.
void append_point(const CellSum& sum, int samples, double cell_volume, const SamplingOptions& options, IntegrationPoints& points) {
  if (sum.inside < options.smallest_point * samples || sum.inside == 0) return;
  const Vec3d x = (1.0 / sum.inside) * sum.position;
  require(sum.with_modulus > 0, "the shear modulus is not positive around (", x.x, ", ", x.y, ", ", x.z,
          ") mm inside the body; check that the modulus image covers the mask");
  const double mu = sum.modulus / sum.with_modulus;
  points.position.push_back(x);
  points.volume.push_back(cell_volume * sum.inside / samples);
  points.shear_modulus.push_back(mu);
  points.bulk_modulus.push_back(sum.bulk_modulus > 0 ? sum.bulk_modulus / sum.with_modulus : bulk_modulus(mu, options.poisson_ratio));
  points.density.push_back(options.density);
}

void append(IntegrationPoints& to, const IntegrationPoints& from) {
  const auto join = [](auto& a, const auto& b) { a.insert(a.end(), b.begin(), b.end()); };
  join(to.position, from.position), join(to.volume, from.volume), join(to.shear_modulus, from.shear_modulus);
  join(to.bulk_modulus, from.bulk_modulus), join(to.density, from.density);
}

enum class Cell : std::uint8_t { free, coupled, rigid };

/// What a lattice cell needs: coupled when all corners are nodes and one is prescribed, rigid when one body has them all.
std::vector<Cell> classify_cells(const Cloud& cloud, const std::vector<std::uint16_t>& label) {
  const Lattice& l = *cloud.lattice;
  std::vector<Cell> kind(l.node_at.size(), Cell::free);
  for (int k = 0; k + 1 < l.size[2]; ++k)
    for (int j = 0; j + 1 < l.size[1]; ++j)
      for (int i = 0; i + 1 < l.size[0]; ++i) {
        int nodes = 0, prescribed = 0, same = 0;
        const std::uint16_t first = label[l.offset(i, j, k)];
        each_cell_corner(l, i, j, k, [&](std::size_t n) { nodes += l.node_at[n] >= 0, prescribed += label[n] != 0, same += label[n] == first; });
        if (nodes < 8 || prescribed == 0) continue;
        kind[l.offset(i, j, k)] = prescribed == 8 && same == 8 ? Cell::rigid : Cell::coupled;
      }
  return kind;
}

IntegrationPoints place_points(const Cloud& cloud, const std::vector<Cell>& kind, const Sampler& sampler, const SamplingOptions& options) {
  const Lattice& l = *cloud.lattice;
  const double h = l.spacing;
  double edge[3];
  int cells[3];
  for (int a = 0; a < 3; ++a) {
    edge[a] = double(samples_per_point[std::size_t(a)]) / samples_per_node[std::size_t(a)];
    cells[a] = int(std::ceil((l.size[std::size_t(a)] - 1) / edge[a]));
  }
  constexpr int point_samples = samples_per_point[0] * samples_per_point[1] * samples_per_point[2];
  std::vector<IntegrationPoints> layer(static_cast<std::size_t>(cells[2]));
  parallel_for(layer.size(), [&](std::size_t k) {
    for (int j = 0; j < cells[1]; ++j)
      for (int i = 0; i < cells[0]; ++i) {
        CellSum sum;
        for (int c = 0; c < samples_per_point[2]; ++c)
          for (int b = 0; b < samples_per_point[1]; ++b)
            for (int a = 0; a < samples_per_point[0]; ++a) {
              // Samples are numbered along the lattice, so that their lattice cell follows without rounding.
              const int s[3] = {i * samples_per_point[0] + a, j * samples_per_point[1] + b, int(k) * samples_per_point[2] + c};
              int cell[3];
              Vec3d x;
              bool in_lattice = true;
              for (int d = 0; d < 3; ++d) {
                const int per_node = samples_per_node[std::size_t(d)];
                cell[d] = s[d] / per_node;
                in_lattice = in_lattice && cell[d] + 1 < l.size[std::size_t(d)];
                x[d] = l.origin[d] + h * (s[d] + 0.5) / per_node;
              }
              if (in_lattice && kind[l.offset(cell[0], cell[1], cell[2])] == Cell::free) sampler.add(x, sum);
            }
        append_point(sum, point_samples, edge[0] * edge[1] * edge[2] * h * h * h, options, layer[k]);
      }
  }, 1);
  std::vector<IntegrationPoints> coupled(static_cast<std::size_t>(l.size[2]));
  parallel_for(coupled.size() - 1, [&](std::size_t k) {
    for (int j = 0; j + 1 < l.size[1]; ++j)
      for (int i = 0; i + 1 < l.size[0]; ++i) {
        if (kind[l.offset(i, j, int(k))] != Cell::coupled) continue;
        for (int eighth = 0; eighth < 8; ++eighth) {
          const double low[3] = {i + 0.5 * (eighth & 1), j + 0.5 * (eighth >> 1 & 1), double(k) + 0.5 * (eighth >> 2)};
          CellSum sum;
          constexpr int n = samples_per_subcell;
          for (int c = 0; c < n; ++c)
            for (int b = 0; b < n; ++b)
              for (int a = 0; a < n; ++a)
                sampler.add({sampler.along(0, low[0], 0.5, a, n), sampler.along(1, low[1], 0.5, b, n), sampler.along(2, low[2], 0.5, c, n)}, sum);
          append_point(sum, n * n * n, h * h * h / 8, options, coupled[k]);
        }
      }
  }, 1);
  IntegrationPoints points;
  for (const auto& p : layer) append(points, p);
  for (const auto& p : coupled) append(points, p);
  return points;
}

}  // namespace

SampledBody sample_body(const Mask& body, const Image& shear_modulus, const LabelImage& labels, const std::vector<LabelMotion>& motions, const SamplingOptions& options, const Image* bulk_modulus) {
  require(options.node_spacing_mm > 0, "the node spacing is ", options.node_spacing_mm, " mm; it must be positive");
  require(options.poisson_ratio >= 0 && options.poisson_ratio < 0.5, "the Poisson ratio is ", options.poisson_ratio, "; it must be at least 0 and below 0.5");
  std::map<int, const RigidMotion*> motion_of;
  for (const LabelMotion& m : motions) motion_of[m.label] = &m.motion;

  SampledBody result;
  Lattice lattice = lattice_around(body, options.node_spacing_mm);
  const Sampler sampler(body, shear_modulus, lattice);
  const std::vector<float> part = body_parts(lattice, sampler);
  std::vector<std::uint16_t> label(lattice.node_at.size(), 0);  // of the rigid body at each lattice position
  parallel_for(std::size_t(lattice.size[2]), [&](std::size_t k) {
    for (int j = 0; j < lattice.size[1]; ++j)
      for (int i = 0; i < lattice.size[0]; ++i) {
        const std::uint16_t v = nearest_value<std::uint16_t>(labels, lattice.origin + lattice.spacing * Vec3d{double(i), double(j), double(k)}, 0);
        if (motion_of.count(v)) label[lattice.offset(i, j, int(k))] = v;
      }
  }, 1);
  for (float p : part) result.body_volume_mm3 += double(p);
  result.body_volume_mm3 *= std::pow(options.node_spacing_mm, 3);
  result.cloud = place_nodes(lattice, part, label, options);
  constexpr std::size_t fewest_nodes = 100;
  require(result.cloud.size() >= fewest_nodes, "only ", result.cloud.size(), " nodes fit into the body at a spacing of ", options.node_spacing_mm,
          " mm; use a smaller spacing, or check the body mask (", result.body_volume_mm3 * 1e-6, " litres)");
  const Lattice& placed = *result.cloud.lattice;
  for (std::size_t n = 0; n < label.size(); ++n)
    if (placed.node_at[n] < 0) label[n] = 0;
  result.points = place_points(result.cloud, classify_cells(result.cloud, label), Sampler(body, shear_modulus, placed, bulk_modulus), options);

  std::map<int, int> set_of;
  for (const auto& [value, motion] : motion_of) {
    set_of[value] = int(result.constraints.set_names.size());
    result.constraints.set_names.push_back(concatenate("label ", value));
  }
  std::map<int, std::size_t> nodes_of;
  for (std::size_t n = 0; n < result.cloud.size(); ++n) {
    const auto& c = result.cloud.lattice_ijk[n];
    const int value = label[placed.offset(c[0], c[1], c[2])];
    if (!value) continue;
    ++nodes_of[value];
    result.constraints.node.push_back(int(n));
    result.constraints.displacement.push_back(motion_of[value]->displacement(result.cloud.nodes[n]));
    result.constraints.fixed.push_back({true, true, true});
    result.constraints.set.push_back(set_of[value]);
  }
  for (const auto& [value, motion] : motion_of)
    if (!nodes_of[value]) result.labels_without_nodes.push_back(value);
  return result;
}

}  // namespace mtled
