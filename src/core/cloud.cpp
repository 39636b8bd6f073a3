#include "core/cloud.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <tuple>

#include "core/error.hpp"

namespace mtled {
namespace {

constexpr double lattice_tolerance = 1e-4;  ///< of the spacing: rounding of coordinates in a text file
constexpr double smallest_body_share = 0.1;  ///< of a lattice cell; cells of the nodes just outside the body have as much
constexpr double cube_margin = 0.9;          ///< what inexact volumes and centroids may add to the edge of a point's cube

/// Numbers the lattice positions from the lowest node on, so that the table covers just the nodes; of a lattice of given
/// size, from its origin on.
void index_nodes(Cloud& cloud) {
  Lattice& lattice = *cloud.lattice;
  require(lattice.spacing > 0, "lattice spacing is ", lattice.spacing, " mm; it must be positive");
  std::array<int, 3> low{std::numeric_limits<int>::max(), std::numeric_limits<int>::max(), std::numeric_limits<int>::max()};
  std::array<int, 3> high{std::numeric_limits<int>::min(), std::numeric_limits<int>::min(), std::numeric_limits<int>::min()};
  const bool size_given = lattice.size != std::array<int, 3>{};
  if (size_given)
    for (std::size_t a = 0; a < 3; ++a) low[a] = 0, high[a] = lattice.size[a] - 1;
  cloud.lattice_ijk.resize(cloud.size());
  for (std::size_t n = 0; n < cloud.size(); ++n) {
    const Vec3d c = (1 / lattice.spacing) * (cloud.nodes[n] - lattice.origin);
    for (int a = 0; a < 3; ++a) {
      require(std::abs(c[a]) < 1e6, "node ", n, " is ", std::abs(c[a]), " spacings from the lattice origin");
      const double nearest = std::round(c[a]);
      require(std::abs(c[a] - nearest) < lattice_tolerance, "node ", n, " at ", cloud.nodes[n][a],
              " mm is not on the promised lattice (it is ", std::abs(c[a] - nearest) * lattice.spacing,
              " mm off); correct origin and spacing, or leave `lattice` out");
      require(!size_given || (nearest >= 0 && nearest < lattice.size[std::size_t(a)]), "node ", n, " at ", cloud.nodes[n][a], " mm lies outside the lattice of ",
              lattice.size[std::size_t(a)], " positions along axis ", a, " from its origin; correct origin and size, or leave `size` out");
      cloud.lattice_ijk[n][a] = int(nearest);
      low[a] = std::min(low[a], int(nearest)), high[a] = std::max(high[a], int(nearest));
    }
  }
  lattice.origin += lattice.spacing * Vec3d{double(low[0]), double(low[1]), double(low[2])};
  std::size_t count = 1;
  for (int a = 0; a < 3; ++a) lattice.size[a] = high[a] - low[a] + 1, count *= std::size_t(lattice.size[a]);
  require(count < 1000 * cloud.size() + 1000000, "the nodes fill only one in ", count / cloud.size(),
          " lattice positions; is the lattice spacing of ", lattice.spacing, " mm right?");
  lattice.node_at.assign(count, -1);
  for (std::size_t n = 0; n < cloud.size(); ++n) {
    for (int a = 0; a < 3; ++a) cloud.lattice_ijk[n][a] -= low[a];
    const auto& ijk = cloud.lattice_ijk[n];
    int& slot = lattice.node_at[lattice.offset(ijk[0], ijk[1], ijk[2])];
    require(slot < 0, "nodes ", slot, " and ", n, " are at the same place; remove one");
    slot = int(n);
  }
}

void require_distinct(const std::vector<Vec3d>& nodes) {
  std::vector<std::size_t> order(nodes.size());
  std::iota(order.begin(), order.end(), std::size_t(0));
  const auto key = [&](std::size_t n) { return std::tuple(nodes[n].x, nodes[n].y, nodes[n].z, n); };
  std::sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) { return key(a) < key(b); });
  for (std::size_t i = 1; i < order.size(); ++i)
    require(!(nodes[order[i]] == nodes[order[i - 1]]), "nodes ", order[i - 1], " and ", order[i], " are at the same place; remove one");
}

}  // namespace

Cloud make_cloud(std::vector<Vec3d> nodes, std::optional<Lattice> promise) {
  require(!nodes.empty(), "there are no nodes");
  Cloud cloud{std::move(nodes), std::move(promise), {}};
  if (cloud.lattice) index_nodes(cloud);
  else require_distinct(cloud.nodes);
  return cloud;
}

PronyTerm total(const std::vector<PronyTerm>& prony) {
  PronyTerm sum{0, 0, 0};
  for (const PronyTerm& term : prony) sum.alpha += term.alpha, sum.alpha_volumetric += term.alpha_volumetric;
  return sum;
}

IntegrationPoints long_term(IntegrationPoints points) {
  const PronyTerm faded = total(points.prony);
  for (double& mu : points.shear_modulus) mu *= 1 - faded.alpha;
  for (double& k : points.bulk_modulus) k *= 1 - faded.alpha_volumetric;
  const std::size_t count = std::size_t(further_parameters(points.model)), moduli = std::size_t(further_moduli(points.model));
  for (std::size_t i = 0; i < points.further.size(); ++i)
    if (i % count < moduli) points.further[i] *= 1 - faded.alpha;
  points.prony.clear();
  return points;
}

void mark_body_cells(Cloud& cloud, const IntegrationPoints& points) {
  if (!cloud.lattice) return;
  Lattice& l = *cloud.lattice;
  std::vector<double> share(l.node_at.size(), 0.0);
  // A point stands for a piece of a background cell, of unknown shape. If a surface cut the cell, the piece is as thick as its
  // part of the cell: a cube of that edge around the centroid does not reach past the surface.
  const double whole = std::cbrt(*std::max_element(points.volume.begin(), points.volume.end()));
  for (std::size_t p = 0; p < points.size(); ++p) {
    const double volume = points.volume[p] / std::pow(l.spacing, 3), half = cube_margin * points.volume[p] / (whole * whole) / (2 * l.spacing);
    const Vec3d c = (1 / l.spacing) * (points.position[p] - l.origin);
    int first[3], last[3];
    for (int a = 0; a < 3; ++a) {
      first[a] = std::max(0, int(std::floor(c[a] - half))), last[a] = std::min(l.size[std::size_t(a)] - 1, int(std::floor(c[a] + half)));
    }
    for (int k = first[2]; k <= last[2]; ++k)
      for (int j = first[1]; j <= last[1]; ++j)
        for (int i = first[0]; i <= last[0]; ++i) {
          const int cell[3] = {i, j, k};
          double overlap = volume / (8 * half * half * half);
          bool here = true;  // a point on a face, edge or corner is in all cells there: it is the centroid of what they hold
          for (int a = 0; a < 3; ++a) {
            overlap *= std::max(0.0, std::min(cell[a] + 1.0, c[a] + half) - std::max(double(cell[a]), c[a] - half));
            here = here && c[a] > cell[a] - lattice_tolerance && c[a] < cell[a] + 1 + lattice_tolerance;
          }
          share[l.offset(i, j, k)] += here ? std::max(overlap, smallest_body_share) : overlap;
        }
  }
  l.body_cell.resize(share.size());
  for (std::size_t n = 0; n < share.size(); ++n) l.body_cell[n] = share[n] >= smallest_body_share;
}

}  // namespace mtled
