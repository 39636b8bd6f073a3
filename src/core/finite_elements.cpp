#include "core/finite_elements.hpp"

#include <algorithm>
#include <cmath>

#include "core/error.hpp"
#include "core/parallel.hpp"
#include "core/point_tree.hpp"

namespace mtled {
namespace {

constexpr double edge_tolerance = 1e-4;   ///< in natural coordinates: rounding of coordinates in a text file
constexpr double flat = 1e-6;             ///< smallest determinant of a corner's edges, of the longest edge cubed
constexpr int most_newton_steps = 30;     ///< for natural coordinates
constexpr double small_newton_step = 1e-8;  ///< the error after it is about its square
constexpr double far_outside = 10;
constexpr int corner_sign[8][3] = {{-1, -1, -1}, {1, -1, -1}, {1, 1, -1}, {-1, 1, -1}, {-1, -1, 1}, {1, -1, 1}, {1, 1, 1}, {-1, 1, 1}};
constexpr int hourglass_pattern[4][8] = {{1, 1, -1, -1, -1, -1, 1, 1}, {1, -1, -1, 1, -1, 1, 1, -1}, {1, -1, 1, -1, 1, -1, 1, -1}, {-1, 1, -1, 1, 1, -1, 1, -1}};

/// Trilinear functions at natural coordinates xi in [-1, 1]^3 and their derivatives by xi.
void trilinear(const Vec3d& xi, double* value, Vec3d* slope) {
  for (int c = 0; c < 8; ++c) {
    const int* s = corner_sign[c];
    const double f[3] = {1 + s[0] * xi.x, 1 + s[1] * xi.y, 1 + s[2] * xi.z};
    value[c] = f[0] * f[1] * f[2] / 8;
    slope[c] = {s[0] * f[1] * f[2] / 8, f[0] * s[1] * f[2] / 8, f[0] * f[1] * s[2] / 8};
  }
}

/// dx / dxi
Mat3d jacobian(const Vec3d* x, const Vec3d* slope) {
  Mat3d J;
  for (int c = 0; c < 8; ++c)
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) J[i][j] += x[c][i] * slope[c][j];
  return J;
}

}  // namespace

struct FiniteElements::Search {
  explicit Search(const std::vector<Vec3d>& centres) : adaptor{centres}, tree(3, adaptor, nanoflann::KDTreeSingleIndexAdaptorParams(16)) {}
  PointCloudAdaptor adaptor;
  PointTree tree;
  double largest_radius = 0;
};

FiniteElements::FiniteElements(const Cloud& mesh, Elements elements, bool average_pressure)
    : Approximation(mesh, {}), elements_(std::move(elements)), average_pressure_(average_pressure) {
  const std::size_t corners = std::size_t(elements_.corners), count = elements_.size();
  if ((corners != 8 && corners != 4) || elements_.node.size() % corners != 0) fail(Failure::internal, "elements need 8 or 4 nodes each");
  require(count > 0, "there are no elements");
  require(!average_pressure || corners == 4, "pressure is averaged at the nodes of tetrahedra only; hexahedra with one integration point do not lock, leave it out");
  std::vector<bool> used(mesh.size());
  for (std::size_t i = 0; i < elements_.node.size(); ++i) {
    const int n = elements_.node[i];
    require(n >= 0 && std::size_t(n) < mesh.size(), "element ", i / corners, ": node ", n, " does not exist; nodes are numbered 0 to ", mesh.size() - 1);
    used[std::size_t(n)] = true;
  }
  for (std::size_t n = 0; n < mesh.size(); ++n) require(used[n], "node ", n, " belongs to no element; remove it from the nodes");
  centre_.resize(count), volume_.resize(count), radius_.resize(count), gradient_.resize(elements_.node.size());
  for (std::size_t e = 0; e < count; ++e) {
    measure(e);
    if (mesh.lattice) require_lattice_cell(e);
  }
  search_ = std::make_unique<Search>(centre_);
  search_->largest_radius = *std::max_element(radius_.begin(), radius_.end());
  std::vector<int> holder(count);
  parallel_for(count, [&](std::size_t e) {
    double value[8];
    holder[e] = element_at(centre_[e], value);
  }, 1024);
  for (std::size_t e = 0; e < count; ++e)
    require(holder[e] == int(e), "elements ", holder[e], " and ", e, " overlap: both hold (", centre_[e].x, ", ", centre_[e].y, ", ", centre_[e].z,
            ") mm; remove one, or correct its nodes");
}
FiniteElements::~FiniteElements() = default;

/// Centre, size, volume and gradients of element e.
void FiniteElements::measure(std::size_t e) {
  const std::size_t corners = std::size_t(elements_.corners);
  Vec3d x[8], centre{};
  for (std::size_t c = 0; c < corners; ++c) x[c] = corner(e, int(c)), centre += (1.0 / double(corners)) * x[c];
  double longest = 0;  // between any two corners
  for (std::size_t c = 0; c < corners; ++c) {
    radius_[e] = std::max(radius_[e], norm(x[c] - centre));
    for (std::size_t d = 0; d < c; ++d) longest = std::max(longest, norm(x[c] - x[d]));
  }
  centre_[e] = centre;
  Vec3d* gradient = &gradient_[e * corners];
  double smallest = 0;  // determinant of the three edges at a corner
  if (corners == 4) {
    Mat3d edges;
    for (int c = 0; c < 3; ++c)
      for (int i = 0; i < 3; ++i) edges[i][c] = x[c + 1][i] - x[0][i];
    smallest = determinant(edges);
    volume_[e] = smallest / 6;
    const Mat3d back = inverse(edges);  // rows: gradients of the corners 1 to 3
    gradient[0] = {};
    for (int c = 0; c < 3; ++c) gradient[c + 1] = {back[c][0], back[c][1], back[c][2]}, gradient[0] -= gradient[c + 1];
  } else {
    // integral of grad N = sum over Gauss points of det(J) J^-T dN/dxi, with two points per axis exactly.
    double value[8];
    Vec3d slope[8];
    for (int c = 0; c < 8; ++c) {
      const int* s = corner_sign[c];
      trilinear({double(s[0]), double(s[1]), double(s[2])}, value, slope);
      const double determinant_here = 8 * determinant(jacobian(x, slope));
      smallest = c == 0 ? determinant_here : std::min(smallest, determinant_here);
    }
    for (const auto& s : corner_sign) {
      const double g = 1 / std::sqrt(3.0);
      trilinear({g * s[0], g * s[1], g * s[2]}, value, slope);
      const Mat3d J = jacobian(x, slope), cof = cofactors(J);
      volume_[e] += determinant(J);
      for (int c = 0; c < 8; ++c) gradient[c] += cof * slope[c];
    }
    for (int c = 0; c < 8; ++c) gradient[c] = (1 / volume_[e]) * gradient[c];
  }
  require(smallest > flat * longest * longest * longest, "element ", e, " at (", centre.x, ", ", centre.y, ", ", centre.z, ") mm is ",
          smallest < 0 ? "inside out" : "flat", "; ", smallest < 0 ? "number its nodes the other way round (as in VTK), or correct them" : "correct its nodes");
}

void FiniteElements::require_lattice_cell(std::size_t e) const {
  std::array<int, 3> low = cloud().lattice_ijk[std::size_t(elements_.node[e * std::size_t(elements_.corners)])], high = low;
  for (int c = 1; c < elements_.corners; ++c)
    for (std::size_t a = 0; a < 3; ++a) {
      const int i = cloud().lattice_ijk[std::size_t(elements_.node[e * std::size_t(elements_.corners) + std::size_t(c)])][a];
      low[a] = std::min(low[a], i), high[a] = std::max(high[a], i);
    }
  bool cell = elements_.corners == 8;
  for (std::size_t a = 0; a < 3; ++a) cell = cell && high[a] - low[a] == 1;
  require(cell, "element ", e, " is no cell of the node lattice; leave `lattice` out");
}

double FiniteElements::outside(std::size_t e, const Vec3d& x, double* value) const {
  if (elements_.corners == 4) {
    double least = 1;
    for (std::size_t c = 0; c < 4; ++c) {
      value[c] = 0.25 + dot(gradient_[4 * e + c], x - centre_[e]);
      least = std::min(least, value[c]);
    }
    return std::max(0.0, -least);
  }
  Vec3d corners[8], slope[8], xi{};
  for (int c = 0; c < 8; ++c) corners[c] = corner(e, c);
  double step_size = 1;
  for (int i = 0; i < most_newton_steps && step_size > small_newton_step && norm(xi) < far_outside; ++i) {
    trilinear(xi, value, slope);
    Vec3d miss = x;
    for (int c = 0; c < 8; ++c) miss -= value[c] * corners[c];
    const Vec3d step = inverse(jacobian(corners, slope)) * miss;
    xi += step, step_size = norm(step);
  }
  if (!(step_size <= small_newton_step)) return far_outside;
  trilinear(xi, value, slope);
  return std::max({0.0, std::abs(xi.x) - 1, std::abs(xi.y) - 1, std::abs(xi.z) - 1});
}

int FiniteElements::element_at(const Vec3d& x, double* value) const {
  thread_local std::vector<std::pair<std::uint32_t, double>> near;
  const double margin = 1 + 2 * edge_tolerance, reach = margin * search_->largest_radius;
  near.clear();
  search_->tree.radiusSearch(&x.x, reach * reach, near, nanoflann::SearchParams(32, 0, false));
  std::sort(near.begin(), near.end());  // where elements meet, the one with the lowest number
  int found = -1;
  double least = edge_tolerance, here[8];
  for (const auto& [e, squared] : near) {
    if (squared > margin * margin * radius_[e] * radius_[e]) continue;
    const double d = outside(e, x, here);
    if (found >= 0 ? d >= least : d > least) continue;
    found = int(e), least = d;
    std::copy(here, here + elements_.corners, value);
    if (d == 0) break;
  }
  return found;
}

bool FiniteElements::at(const Vec3d& x, ShapeFunctions& shapes, int* enlargements) const {
  if (enlargements) *enlargements = 0;
  shapes.clear();
  double value[8];
  const int e = element_at(x, value);
  if (e < 0) return false;
  const std::size_t corners = std::size_t(elements_.corners), first = std::size_t(e) * corners;
  for (std::size_t c = 0; c < corners; ++c) shapes.add(elements_.node[first + c], value[c], gradient_[first + c]);
  return true;
}

bool FiniteElements::touches(const Vec3d& x) const {
  double value[8];
  return element_at(x, value) >= 0;
}

Springs FiniteElements::hourglass_springs(double kappa, const IntegrationPoints& points) const {
  if (elements_.corners != 8) fail(Failure::internal, "tetrahedra have no hourglass modes");
  Springs springs;
  for (std::size_t e = 0; e < size(); ++e) {
    const Vec3d* b = &gradient_[8 * e];
    double squares = 0;
    for (int c = 0; c < 8; ++c) squares += squared_norm(b[c]);
    const double stiffness = kappa * volume_[e] * (points.bulk_modulus[e] + 4 * points.shear_modulus[e] / 3) * squares / 8;
    const std::vector<int> nodes(elements_.node.begin() + std::ptrdiff_t(8 * e), elements_.node.begin() + std::ptrdiff_t(8 * e + 8));
    for (const auto& pattern : hourglass_pattern) {
      Vec3d linear{};  // the pattern's linear part: sum_J x_J h_J
      for (int c = 0; c < 8; ++c) linear += double(pattern[c]) * (corner(e, c) - centre_[e]);
      std::vector<double> gamma(8);
      for (int c = 0; c < 8; ++c) gamma[std::size_t(c)] = pattern[c] - dot(b[c], linear);
      springs.add(nodes, gamma, stiffness, {}, -1);
    }
  }
  return springs;
}

}  // namespace mtled
