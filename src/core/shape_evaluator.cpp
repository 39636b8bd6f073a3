#include "core/shape_evaluator.hpp"

#include <algorithm>
#include <map>
#include <numbers>

#include "core/parallel.hpp"
#include "core/point_tree.hpp"

namespace mtled {
namespace {

constexpr double enlargement = 1.12;
constexpr int most_enlargements = 8;
constexpr std::size_t node_spacing_neighbours = 8;  ///< and around its nodes: few, so that nodes at a surface look no sparser
constexpr std::size_t spacing_neighbours = 20;  ///< nodes that define the local spacing at a place of a general cloud
constexpr double edge_tolerance = 1e-6;         ///< of a spacing: places on the upper face of a cell belong to it

/// Ball that holds `count` nodes of even density, from the mean of their distances (3/4 of its radius) [mm].
double ball_radius(const double* squared, std::size_t count) {
  double sum = 0;
  for (std::size_t i = 0; i < count; ++i) sum += std::sqrt(squared[i]);
  return 4 * sum / (3 * double(count));
}

}  // namespace

/// Finds nodes around a place: by lattice position, or in a k-d tree.
struct ShapeEvaluator::Neighbours {
  Neighbours(const Cloud& c, const MlsOptions& options) : cloud(c), adaptor{c.nodes} {
    if (c.lattice) return;
    tree = std::make_unique<PointTree>(3, adaptor, nanoflann::KDTreeSingleIndexAdaptorParams(16));
    const std::size_t wanted = std::min(c.size(), options.count > 0 ? std::size_t(options.count) : node_spacing_neighbours);
    node_radius.resize(c.size());
    parallel_for(c.size(), [&](std::size_t n) {
      std::vector<std::uint32_t> index(wanted);
      std::vector<double> squared(wanted);
      const double ball = ball_radius(squared.data(), tree->knnSearch(&c.nodes[n].x, wanted, index.data(), squared.data()));
      node_radius[n] = options.count > 0 ? ball : options.dilatation * ball * std::cbrt(4 * std::numbers::pi / (3.0 * double(wanted)));
    }, 1024);
    // Nodes in groups of radii that differ by less than a factor of two: a search need not look at many nodes in vain.
    std::map<int, std::vector<int>> groups;
    for (std::size_t n = 0; n < c.size(); ++n) groups[std::ilogb(node_radius[n])].push_back(int(n));
    for (auto& [exponent, nodes] : groups) levels.push_back(std::make_unique<Level>(c, std::move(nodes), std::ldexp(1.0, exponent + 1)));
  }
  /// Edge of a cube that one node fills, from the ball that holds the nearest nodes [mm].
  double local_spacing(const Vec3d& x) const {
    const std::size_t wanted = std::min(spacing_neighbours, cloud.size());
    std::vector<std::uint32_t> index(wanted);
    std::vector<double> squared(wanted);
    const std::size_t found = tree->knnSearch(&x.x, wanted, index.data(), squared.data());
    return std::sqrt(squared[found - 1]) * std::cbrt(4 * std::numbers::pi / (3.0 * double(found)));
  }
  /// General cloud: the nodes whose own radii, times `scale`, reach x; returns a mean radius.
  double reaching(const Vec3d& x, double scale, std::vector<int>& nodes, std::vector<Vec3d>& relative, std::vector<double>& radius) const {
    nodes.clear(), relative.clear(), radius.clear();
    std::vector<std::pair<std::uint32_t, double>> found;
    for (const auto& level : levels) {
      const double largest = scale * level->largest_radius;
      level->tree.radiusSearch(&x.x, largest * largest, found, nanoflann::SearchParams(32, 0, false));
      for (const auto& f : found)
        if (const int n = level->node[f.first]; std::sqrt(f.second) < scale * node_radius[std::size_t(n)]) nodes.push_back(n);
    }
    std::sort(nodes.begin(), nodes.end());
    double weights = 0, sum = 0;
    for (int n : nodes) {
      relative.push_back(cloud.nodes[std::size_t(n)] - x), radius.push_back(scale * node_radius[std::size_t(n)]);
      const double weight = 1 - squared_norm(relative.back()) / (radius.back() * radius.back());
      weights += weight, sum += weight * radius.back();
    }
    return sum / weights;
  }
  /// Lattice: the nodes within `radius` of x.
  void within(const Vec3d& x, double radius, std::vector<int>& nodes, std::vector<Vec3d>& relative) const {
    nodes.clear(), relative.clear();
    const Lattice& l = *cloud.lattice;
    int low[3], high[3];
    for (int a = 0; a < 3; ++a) {
      low[a] = std::max(0, int(std::ceil((x[a] - radius - l.origin[a]) / l.spacing)));
      high[a] = std::min(l.size[a] - 1, int(std::floor((x[a] + radius - l.origin[a]) / l.spacing)));
    }
    for (int k = low[2]; k <= high[2]; ++k)
      for (int j = low[1]; j <= high[1]; ++j)
        for (int i = low[0]; i <= high[0]; ++i) {
          const int n = l.node_at[l.offset(i, j, k)];
          if (n < 0) continue;
          const Vec3d d = l.origin + l.spacing * Vec3d{double(i), double(j), double(k)} - x;
          if (squared_norm(d) < radius * radius) nodes.push_back(n), relative.push_back(d);
        }
    keep_reachable(x, radius, nodes, relative);
  }
  /// Lattice: drops the nodes that are near only through a gap. Kept are the corners of those cells that a walk from the cell
  /// of x reaches, from face to face through cells that hold body, without leaving the ball.
  void keep_reachable(const Vec3d& x, double radius, std::vector<int>& nodes, std::vector<Vec3d>& relative) const {
    const Lattice& l = *cloud.lattice;
    const int reach = int(std::ceil(radius / l.spacing)), width = 2 * reach - 1;
    const std::array<int, 3> first = [&] {
      std::array<int, 3> c = cell_of(l, x);
      for (int& i : c) i -= reach - 1;
      return c;
    }();
    const auto number = [&](int i, int j, int k) { return std::size_t(i + width * (j + width * k)); };
    thread_local std::vector<std::uint8_t> open;  // 0 closed, 1 open, 2 reached
    open.assign(number(0, 0, width), 0);
    bool gap = false;
    for (int k = 0; k < width; ++k)
      for (int j = 0; j < width; ++j)
        for (int i = 0; i < width; ++i) {
          double squared = 0;  // distance of the cell [spacings]
          const int cell[3] = {first[0] + i, first[1] + j, first[2] + k};
          for (int a = 0; a < 3; ++a) {
            const double c = (x[a] - l.origin[a]) / l.spacing, d = std::max({0.0, cell[a] - c, c - cell[a] - 1});
            squared += d * d;
          }
          const bool body = l.holds_body(cell[0], cell[1], cell[2]);
          open[number(i, j, k)] = body && squared * l.spacing * l.spacing < radius * radius;
          gap = gap || !body;
        }
    if (!gap) return;
    thread_local std::vector<std::array<int, 3>> front;
    front.assign(1, {reach - 1, reach - 1, reach - 1});
    open[number(reach - 1, reach - 1, reach - 1)] = 2;
    while (!front.empty()) {
      const std::array<int, 3> from = front.back();
      front.pop_back();
      for (int face = 0; face < 6; ++face) {
        std::array<int, 3> to = from;
        to[std::size_t(face / 2)] += face % 2 ? 1 : -1;
        if (std::min({to[0], to[1], to[2]}) < 0 || std::max({to[0], to[1], to[2]}) >= width || open[number(to[0], to[1], to[2])] != 1) continue;
        open[number(to[0], to[1], to[2])] = 2;
        front.push_back(to);
      }
    }
    std::size_t kept = 0;
    for (std::size_t n = 0; n < nodes.size(); ++n) {
      const std::array<int, 3>& ijk = cloud.lattice_ijk[std::size_t(nodes[n])];
      bool reached = false;
      for (int c = 0; c < 8; ++c) {
        const int i = ijk[0] - first[0] - (c & 1), j = ijk[1] - first[1] - (c >> 1 & 1), k = ijk[2] - first[2] - (c >> 2);
        reached = reached || (std::min({i, j, k}) >= 0 && std::max({i, j, k}) < width && open[number(i, j, k)] == 2);
      }
      if (reached) nodes[kept] = nodes[n], relative[kept] = relative[n], ++kept;
    }
    nodes.resize(kept), relative.resize(kept);
  }
  double nearest_distance(const Vec3d& x) const {
    std::uint32_t index;
    double squared;
    tree->knnSearch(&x.x, 1, &index, &squared);
    return std::sqrt(squared);
  }

  const Cloud& cloud;
  PointCloudAdaptor adaptor;
  std::unique_ptr<PointTree> tree;
  std::vector<double> node_radius;  ///< [num_nodes] general cloud [mm]
  struct Level {
    Level(const Cloud& c, std::vector<int> nodes, double largest)
        : node(std::move(nodes)), position(positions(c, node)), largest_radius(largest), adaptor{position}, tree(3, adaptor, nanoflann::KDTreeSingleIndexAdaptorParams(16)) {}
    static std::vector<Vec3d> positions(const Cloud& c, const std::vector<int>& nodes) {
      std::vector<Vec3d> x;
      for (int n : nodes) x.push_back(c.nodes[std::size_t(n)]);
      return x;
    }
    std::vector<int> node;
    std::vector<Vec3d> position;
    double largest_radius;
    PointCloudAdaptor adaptor;
    PointTree tree;
  };
  std::vector<std::unique_ptr<Level>> levels;
};

ShapeEvaluator::ShapeEvaluator(const Cloud& cloud, std::vector<std::uint8_t> prescribed, const MlsOptions& options)
    : Approximation(cloud, std::move(prescribed)), options_(options), neighbours_(std::make_unique<Neighbours>(cloud, options)) {}
ShapeEvaluator::~ShapeEvaluator() = default;
ShapeEvaluator::ShapeEvaluator(ShapeEvaluator&&) noexcept = default;

/// Fills `shapes` without coupling; returns the number of enlargements, or -1 when all were in vain.
int ShapeEvaluator::support(const Vec3d& x, ShapeFunctions& shapes) const {
  thread_local std::vector<int> nodes;
  thread_local std::vector<Vec3d> relative;
  if (!cloud().lattice) {
    thread_local std::vector<double> own_radius;
    double scale = 1;
    for (int tries = 0; tries <= most_enlargements; ++tries, scale *= enlargement) {
      const double radius = neighbours_->reaching(x, scale, nodes, relative, own_radius);
      if (moving_least_squares(nodes, relative, radius, options_, shapes, &own_radius)) return tries;
    }
    return -1;
  }
  double radius = options_.dilatation * cloud().lattice->spacing;
  for (int tries = 0; tries <= most_enlargements; ++tries, radius *= enlargement) {
    neighbours_->within(x, radius, nodes, relative);
    if (moving_least_squares(nodes, relative, radius, options_, shapes)) return tries;
  }
  return -1;
}

bool ShapeEvaluator::at(const Vec3d& x, ShapeFunctions& shapes, int* enlargements) const {
  const int tries = support(x, shapes);
  if (enlargements) *enlargements = tries;
  if (tries < 0) return false;
  if (cloud().lattice && any_prescribed()) couple(x, shapes);
  return true;
}

namespace {

/// Calls body(corner number, node) for the corners of a cell; false when one is missing.
template <class Body>
bool each_corner(const Lattice& l, const std::array<int, 3>& cell, Body&& body) {
  for (int c = 0; c < 8; ++c) {
    const int n = l.node(cell[0] + (c & 1), cell[1] + (c >> 1 & 1), cell[2] + (c >> 2));
    if (n < 0) return false;
    body(c, n);
  }
  return true;
}

}  // namespace

std::array<int, 3> cell_of(const Lattice& l, const Vec3d& x) {
  std::array<int, 3> cell;
  bool on_plane[3];
  for (int a = 0; a < 3; ++a) {
    const double c = (x[a] - l.origin[a]) / l.spacing;
    cell[a] = int(std::floor(c + edge_tolerance));
    on_plane[a] = c - cell[a] < edge_tolerance;
  }
  // A place on a lattice plane belongs to the cells on both sides: prefer one that has all its nodes, and of these one with body.
  std::optional<std::array<int, 3>> complete;
  for (int side = 0; side < 8; ++side) {
    std::array<int, 3> candidate = cell;
    bool possible = true;
    for (int a = 0; a < 3; ++a)
      if (side >> a & 1) possible = possible && on_plane[a], --candidate[a];
    if (!possible || !each_corner(l, candidate, [](int, int) {})) continue;
    if (l.holds_body(candidate[0], candidate[1], candidate[2])) return candidate;
    if (!complete) complete = candidate;
  }
  return complete.value_or(cell);
}

bool ShapeEvaluator::coupled(const std::array<int, 3>& cell) const {
  bool any = false;
  return each_corner(*cloud().lattice, cell, [&](int, int n) { any = any || prescribed(n); }) && any;
}

void ShapeEvaluator::couple(const Vec3d& x, ShapeFunctions& shapes) const {
  const Lattice& l = *cloud().lattice;
  const std::array<int, 3> cell = cell_of(*cloud().lattice, x);
  if (!coupled(cell)) return;
  // Trilinear functions of the cell and their gradients.
  int corner_node[8];
  double N[8], R = 0;
  Vec3d dN[8], dR{};
  double t[3];
  for (int a = 0; a < 3; ++a) t[a] = (x[a] - l.origin[a]) / l.spacing - cell[a];
  each_corner(l, cell, [&](int c, int n) {
    double f[3], d[3];
    for (int a = 0; a < 3; ++a) {
      const bool upper = c >> a & 1;
      f[a] = upper ? t[a] : 1 - t[a], d[a] = (upper ? 1 : -1) / l.spacing;
    }
    corner_node[c] = n;
    N[c] = f[0] * f[1] * f[2], dN[c] = {d[0] * f[1] * f[2], f[0] * d[1] * f[2], f[0] * f[1] * d[2]};
    if (prescribed(n)) R += N[c], dR += dN[c];
  });
  // phi~ = R N + (1 - R) phi and its gradient R dN + N dR + (1 - R) dphi - phi dR.
  for (std::size_t i = 0; i < shapes.node.size(); ++i) {
    shapes.gradient[i] = (1 - R) * shapes.gradient[i] - shapes.value[i] * dR;
    shapes.value[i] *= 1 - R;
  }
  for (int c = 0; c < 8; ++c) {
    const auto it = std::find(shapes.node.begin(), shapes.node.end(), corner_node[c]);
    const double v = R * N[c];
    const Vec3d g = R * dN[c] + N[c] * dR;
    if (it == shapes.node.end()) {
      shapes.add(corner_node[c], v, g);
    } else {
      const std::size_t i = std::size_t(it - shapes.node.begin());
      shapes.value[i] += v, shapes.gradient[i] += g;
    }
  }
}

int ShapeEvaluator::reach() const { return int(std::ceil(options_.dilatation)); }

bool ShapeEvaluator::covers(const Vec3d& x) const {
  if (cloud().lattice) return each_corner(*cloud().lattice, cell_of(*cloud().lattice, x), [](int, int) {});
  return neighbours_->nearest_distance(x) <= neighbours_->local_spacing(x);
}

bool ShapeEvaluator::touches(const Vec3d& x) const {
  if (!cloud().lattice) return covers(x);
  const std::array<int, 3> cell = cell_of(*cloud().lattice, x);
  for (int c = 0; c < 8; ++c)
    if (cloud().lattice->node(cell[0] + (c & 1), cell[1] + (c >> 1 & 1), cell[2] + (c >> 2)) >= 0) return true;
  return false;
}

}  // namespace mtled
