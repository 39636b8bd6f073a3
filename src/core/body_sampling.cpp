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

/// Sums over samples of one cell.
struct Samples {
  int count = 0, with_modulus = 0;
  Vec3d position{};
  double modulus = 0, bulk_modulus = 0;
  Vec3d centroid() const { return (1.0 / count) * position; }
};

/// The samples of one cell that lie in the body: soft tissue, and the rigid bodies by label.
struct CellSamples {
  Samples soft;
  std::map<int, Samples> rigid;
};

class Sampler {
 public:
  /// `bulk_modulus` may be null.
  Sampler(const Mask& body, const Image& modulus, const Image* bulk_modulus, const LabelImage& labels, const std::map<int, const RigidMotion*>& motion_of)
      : body_(body), modulus_(modulus), bulk_modulus_(bulk_modulus), labels_(labels), motion_of_(motion_of) {}

  bool inside(const Vec3d& x) const { return nearest_value<std::uint8_t>(body_, x, 0) != 0; }
  void add(const Vec3d& x, CellSamples& cell) const {
    if (!inside(x)) return;
    const int label = nearest_value<std::uint16_t>(labels_, x, 0);
    Samples& part = label && motion_of_.count(label) ? cell.rigid[label] : cell.soft;
    ++part.count;
    part.position += x;
    const float m = nearest_value<float>(modulus_, x, 0.0f);
    if (m > 0) {
      ++part.with_modulus, part.modulus += double(m);
      if (bulk_modulus_) part.bulk_modulus += double(nearest_value<float>(*bulk_modulus_, x, 0.0f));
    }
  }

 private:
  const Mask& body_;
  const Image& modulus_;
  const Image* bulk_modulus_;
  const LabelImage& labels_;
  const std::map<int, const RigidMotion*>& motion_of_;
};

/// Where sample s along a lattice axis lies [mm]; samples are numbered from the lattice's origin.
double sample_place(const Lattice& l, int axis, int s) { return l.origin[axis] + l.spacing * (s + 0.5) / samples_per_node[std::size_t(axis)]; }

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
              inside += sampler.inside({sample_place(l, 0, i * samples_per_node[0] + a), sample_place(l, 1, j * samples_per_node[1] + b), sample_place(l, 2, int(k) * samples_per_node[2] + c)});
        part[l.offset(i, j, int(k))] = float(inside / total);
      }
  }, 1);
  return part;
}

/// Nodes at all corners of the cells that are body enough.
Cloud place_nodes(Lattice lattice, const std::vector<float>& part, const SamplingOptions& options) {
  std::vector<std::uint8_t> is_node(lattice.node_at.size(), 0);
  for (int k = 0; k + 1 < lattice.size[2]; ++k)
    for (int j = 0; j + 1 < lattice.size[1]; ++j)
      for (int i = 0; i + 1 < lattice.size[0]; ++i)
        if (part[lattice.offset(i, j, k)] >= float(options.smallest_cell))
          for (int c = 0; c < 8; ++c) is_node[lattice.offset(i + (c & 1), j + (c >> 1 & 1), k + (c >> 2))] = 1;
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

/// Appends the point of a cell's soft tissue, or nothing when there is too little of it.
void append_point(const Samples& soft, int samples, double cell_volume, const SamplingOptions& options, IntegrationPoints& points) {
  if (soft.count < options.smallest_point * samples || soft.count == 0) return;
  const Vec3d x = soft.centroid();
  require(soft.with_modulus > 0, "the shear modulus is not positive around (", x.x, ", ", x.y, ", ", x.z,
          ") mm inside the body; check that the modulus image covers the mask");
  const double mu = soft.modulus / soft.with_modulus;
  points.position.push_back(x);
  points.volume.push_back(cell_volume * soft.count / samples);
  points.shear_modulus.push_back(mu);
  points.bulk_modulus.push_back(soft.bulk_modulus > 0 ? soft.bulk_modulus / soft.with_modulus : bulk_modulus(mu, options.poisson_ratio));
  points.density.push_back(options.density);
}

void append(IntegrationPoints& to, const IntegrationPoints& from) {
  const auto join = [](auto& a, const auto& b) { a.insert(a.end(), b.begin(), b.end()); };
  join(to.position, from.position), join(to.volume, from.volume), join(to.shear_modulus, from.shear_modulus);
  join(to.bulk_modulus, from.bulk_modulus), join(to.density, from.density);
}

/// Part of one cell that is one rigid body.
struct Piece {
  int label;
  Vec3d position;
  double volume;
  double soft_modulus;  ///< of the soft tissue in the same cell [kPa]; 0 when there is none
};

/// Appends the integration points of soft tissue and the pieces of rigid bodies, cell by cell.
void place_points(const Lattice& l, const Sampler& sampler, const SamplingOptions& options, IntegrationPoints& points, std::vector<Piece>& pieces) {
  double cell_volume = 1;
  int cells[3], samples = 1;
  for (std::size_t a = 0; a < 3; ++a) {
    const double edge = double(samples_per_point[a]) / samples_per_node[a];
    cells[a] = int(std::ceil((l.size[a] - 1) / edge));
    samples *= samples_per_point[a];
    cell_volume *= edge * l.spacing;
  }
  std::vector<IntegrationPoints> points_of(static_cast<std::size_t>(cells[2]));
  std::vector<std::vector<Piece>> pieces_of(points_of.size());
  parallel_for(points_of.size(), [&](std::size_t k) {
    for (int j = 0; j < cells[1]; ++j)
      for (int i = 0; i < cells[0]; ++i) {
        CellSamples cell;
        for (int c = 0; c < samples_per_point[2]; ++c)
          for (int b = 0; b < samples_per_point[1]; ++b)
            for (int a = 0; a < samples_per_point[0]; ++a) {
              const int s[3] = {i * samples_per_point[0] + a, j * samples_per_point[1] + b, int(k) * samples_per_point[2] + c};
              bool in_lattice = true;
              for (std::size_t d = 0; d < 3; ++d) in_lattice = in_lattice && s[d] < samples_per_node[d] * (l.size[d] - 1);
              if (in_lattice) sampler.add({sample_place(l, 0, s[0]), sample_place(l, 1, s[1]), sample_place(l, 2, s[2])}, cell);
            }
        append_point(cell.soft, samples, cell_volume, options, points_of[k]);
        for (const auto& [label, part] : cell.rigid)
          pieces_of[k].push_back({label, part.centroid(), cell_volume * part.count / samples, cell.soft.with_modulus > 0 ? cell.soft.modulus / cell.soft.with_modulus : 0});
      }
  }, 1);
  for (const auto& p : points_of) append(points, p);
  for (const auto& p : pieces_of) pieces.insert(pieces.end(), p.begin(), p.end());
}

/// Shear modulus of the soft tissue around each rigid body: the mean over its pieces that share a cell with some [kPa].
std::map<int, double> moduli_around(const std::vector<Piece>& pieces) {
  std::map<int, std::pair<double, int>> sum;
  for (const Piece& p : pieces)
    if (p.soft_modulus > 0) sum[p.label].first += p.soft_modulus, ++sum[p.label].second;
  std::map<int, double> mean;
  for (const Piece& p : pieces) mean[p.label] = sum.count(p.label) ? sum[p.label].first / sum[p.label].second : 1;  // no tissue, no pull: anything holds
  return mean;
}

}  // namespace

SampledBody sample_body(const Mask& body, const Image& shear_modulus, const LabelImage& labels, const std::vector<LabelMotion>& motions, const SamplingOptions& options, const Image* bulk_modulus) {
  require(options.node_spacing_mm > 0, "the node spacing is ", options.node_spacing_mm, " mm; it must be positive");
  require(options.poisson_ratio >= 0 && options.poisson_ratio < 0.5, "the Poisson ratio is ", options.poisson_ratio, "; it must be at least 0 and below 0.5");
  std::map<int, const RigidMotion*> motion_of;
  for (const LabelMotion& m : motions) motion_of[m.label] = &m.motion;

  SampledBody result;
  Lattice lattice = lattice_around(body, options.node_spacing_mm);
  const Sampler sampler(body, shear_modulus, bulk_modulus, labels, motion_of);
  const std::vector<float> part = body_parts(lattice, sampler);
  for (float p : part) result.body_volume_mm3 += double(p);
  result.body_volume_mm3 *= std::pow(options.node_spacing_mm, 3);
  result.cloud = place_nodes(std::move(lattice), part, options);
  constexpr std::size_t fewest_nodes = 100;
  require(result.cloud.size() >= fewest_nodes, "only ", result.cloud.size(), " nodes fit into the body at a spacing of ", options.node_spacing_mm,
          " mm; use a smaller spacing, or check the body mask (", result.body_volume_mm3 * 1e-6, " litres)");
  std::vector<Piece> pieces;
  place_points(*result.cloud.lattice, sampler, options, result.points, pieces);
  require(result.points.size() > 0, "the rigid bodies fill the whole body: no soft tissue is left to deform; check the labels and the body mask");

  const std::map<int, double> around = moduli_around(pieces);
  std::map<int, int> set_of;
  for (const auto& [label, motion] : motion_of) {
    set_of[label] = int(result.rigid.set_names.size());
    result.rigid.set_names.push_back(concatenate("label ", label));
    if (!around.count(label)) result.labels_outside.push_back(label);
  }
  for (const Piece& p : pieces) {
    const double mu = p.soft_modulus > 0 ? p.soft_modulus : around.at(p.label);
    result.rigid.position.push_back(p.position);
    result.rigid.displacement.push_back(motion_of[p.label]->displacement(p.position));
    result.rigid.stiffness.push_back(options.rigid_stiffness * (mtled::bulk_modulus(mu, options.poisson_ratio) + 4 * mu / 3) * p.volume / std::pow(options.node_spacing_mm, 2));
    result.rigid.set.push_back(set_of[p.label]);
  }
  return result;
}

}  // namespace mtled
