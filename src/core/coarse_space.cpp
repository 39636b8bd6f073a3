#include "core/coarse_space.hpp"

#include <Eigen/Dense>
#include <Eigen/Sparse>
#include <cmath>
#include <limits>
#include <map>

#include "core/error.hpp"
#include "core/lanes.hpp"
#include "core/point_material.hpp"

namespace mtled {
namespace {

constexpr int functions_per_cell = 27;
constexpr int local_unknowns = 3 * functions_per_cell;
constexpr int padded_unknowns = 84;         ///< a multiple of 4 floats
constexpr std::size_t node_piece = 4096;
constexpr double diagonal_shift = 1e-5;     ///< relative
constexpr double smallest_weight = 0.01;    ///< a function that no node feels more than this is left out: it would make A singular

/// Values (and derivatives) of the three quadratic B-splines that are nonzero at t in [0, 1) of a unit cell.
void quadratic_splines(double t, double* w, double* dw) {
  w[0] = (1 - t) * (1 - t) / 2, w[1] = 0.5 + t - t * t, w[2] = t * t / 2;
  if (dw) dw[0] = t - 1, dw[1] = 1 - 2 * t, dw[2] = t;
}

}  // namespace

struct CoarseSpace::Grid {
  Vec3d origin;
  double spacing = 0;           ///< wanted; along each axis the cells are a little smaller so that they fit the body exactly
  Vec3d cell_size{};            ///< [mm]
  int cells[3] = {};            ///< spline cells; functions per axis: cells + 2
  const std::vector<Vec3d>* position = nullptr;
  const std::vector<std::uint8_t>* active = nullptr;
  std::vector<Node> nodes;
  std::vector<int> used;        ///< function numbers that touch a node
  std::vector<int> unknown_of;  ///< [functions] position in `used`, or -1
  Eigen::SparseMatrix<double> springs;  ///< Z^T K Z of the springs; empty without any
  Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> inverse;

  bool is_active(std::size_t slot, int c) const { return (*active)[std::size_t(c) * position->size() + slot] != 0; }
  int functions(int axis) const { return cells[axis] + 2; }
  int stride_y() const { return functions(0); }
  int stride_z() const { return functions(0) * functions(1); }
  int function_count() const { return stride_z() * functions(2); }

  /// First function, weights and (optional) derivatives at x.
  int locate(const Vec3d& x, double w[3][3], double dw[3][3]) const {
    int first[3];
    for (int a = 0; a < 3; ++a) {
      const double c = (x[a] - origin[a]) / cell_size[a];
      first[a] = std::clamp(int(std::floor(c)), 0, cells[a] - 1);
      quadratic_splines(c - first[a], w[a], dw ? dw[a] : nullptr);
      if (dw)
        for (int i = 0; i < 3; ++i) dw[a][i] /= cell_size[a];
    }
    return first[0] + stride_y() * first[1] + stride_z() * first[2];
  }
  int function(int first, int i, int j, int k) const { return first + i + stride_y() * j + stride_z() * k; }
};

CoarseSpace::CoarseSpace(const std::vector<Vec3d>& position, const std::vector<std::uint8_t>& active, int unknowns, double smallest_spacing)
    : grid_(new Grid) {
  Grid& g = *grid_;
  g.position = &position, g.active = &active;
  const auto is_active = [&](std::size_t s) { return g.is_active(s, 0) || g.is_active(s, 1) || g.is_active(s, 2); };
  constexpr double inf = std::numeric_limits<double>::infinity();
  Vec3d low{inf, inf, inf}, high{-inf, -inf, -inf};
  for (std::size_t s = 0; s < position.size(); ++s)
    if (is_active(s))
      for (int a = 0; a < 3; ++a) low[a] = std::min(low[a], position[s][a]), high[a] = std::max(high[a], position[s][a]);
  if (low.x > high.x) return;  // nothing to correct
  g.spacing = smallest_spacing;
  for (int count = unknowns + 1; count > unknowns; g.spacing *= 1.05) {
    count = 3;
    for (int a = 0; a < 3; ++a) g.cells[a] = std::max(1, int(std::ceil((high[a] - low[a]) / g.spacing + 1e-9))), count *= g.functions(a);
    if (count <= unknowns || g.cells[0] * g.cells[1] * g.cells[2] == 1) break;
  }
  g.origin = low;
  for (int a = 0; a < 3; ++a) g.cell_size[a] = std::max(high[a] - low[a], 1e-6 * g.spacing) / g.cells[a];
  std::vector<int> touched(std::size_t(g.function_count()), 0);
  for (std::size_t s = 0; s < position.size(); ++s) {
    if (!is_active(s)) continue;
    double w[3][3];
    Node node{int(s), g.locate(position[s], w, nullptr), {}, {}};
    for (int a = 0; a < 3; ++a) {
      node.active[a] = g.is_active(s, a);
      for (int i = 0; i < 3; ++i) node.weight[3 * a + i] = float(w[a][i]);
    }
    g.nodes.push_back(node);
    for (int k = 0; k < 3; ++k)
      for (int j = 0; j < 3; ++j)
        for (int i = 0; i < 3; ++i) touched[std::size_t(g.function(node.first, i, j, k))] |= w[0][i] * w[1][j] * w[2][k] > smallest_weight;
  }
  g.unknown_of.assign(touched.size(), -1);
  for (std::size_t f = 0; f < touched.size(); ++f)
    if (touched[f]) g.unknown_of[f] = int(g.used.size()), g.used.push_back(int(f));
}

CoarseSpace::~CoarseSpace() = default;
int CoarseSpace::unknowns() const { return 3 * int(grid_->used.size()); }
const std::vector<CoarseSpace::Node>& CoarseSpace::nodes() const { return grid_->nodes; }
std::array<int, 3> CoarseSpace::functions() const { return {grid_->functions(0), grid_->functions(1), grid_->functions(2)}; }
const std::vector<int>& CoarseSpace::used_functions() const { return grid_->used; }
const float* CoarseSpace::inverse() const { return grid_->inverse.data(); }
std::size_t CoarseSpace::bytes() const {
  return grid_->nodes.size() * sizeof(Node) + std::size_t(unknowns()) * std::size_t(unknowns()) * sizeof(float);
}

void CoarseSpace::add_springs(const Springs& springs, const SlotLayout& layout) {
  Grid& g = *grid_;
  if (g.used.empty()) return;
  // Rows of sqrt(stiffness) times the springs' stretch per unknown.
  std::vector<Eigen::Triplet<double>> entries;
  for (std::size_t r = 0; r < springs.size(); ++r) {
    if (springs.set[r] < 0) continue;
    std::map<int, Vec3d> stretch;
    for (std::size_t e = springs.begin[r]; e < springs.begin[r + 1]; ++e) {
      const std::size_t slot = std::size_t(layout.slot_of_node[std::size_t(springs.node[e])]);
      double w[3][3];
      const int first = g.locate((*g.position)[slot], w, nullptr);
      for (int k = 0; k < 3; ++k)
        for (int j = 0; j < 3; ++j)
          for (int i = 0; i < 3; ++i) {
            const int unknown = g.unknown_of[std::size_t(g.function(first, i, j, k))];
            if (unknown < 0) continue;
            for (int c = 0; c < 3; ++c) stretch[unknown][c] += springs.coefficient[e] * double(g.is_active(slot, c)) * w[0][i] * w[1][j] * w[2][k];
          }
    }
    for (const auto& [unknown, s] : stretch)
      for (int c = 0; c < 3; ++c) entries.emplace_back(int(3 * r) + c, 3 * unknown + c, std::sqrt(springs.stiffness[r]) * s[c]);
  }
  Eigen::SparseMatrix<double> rows(Eigen::Index(3 * springs.size()), unknowns());
  rows.setFromTriplets(entries.begin(), entries.end());
  g.springs = rows.transpose() * rows;
}

namespace {

/// What the coarse matrix needs of one integration point.
struct PointTerms {
  float gradient[3][functions_per_cell][3];  ///< of the functions, per displacement component [1/mm]
  float tangent[9][9];                       ///< volume * dP/dF, row-major pairs (i, k) [mN mm]
};

/// matrix[(a, i)][(b, j)] += sum_kl gradient_i[a][k] tangent[ik][jl] gradient_j[b][l]
void add_point(const PointTerms& p, float* matrix) {
  alignas(64) float T[9][padded_unknowns] = {};
  for (int m = 0; m < 9; ++m)
    for (int b = 0; b < functions_per_cell; ++b)
      for (int j = 0; j < 3; ++j)
        T[m][3 * b + j] = p.tangent[m][3 * j] * p.gradient[j][b][0] + p.tangent[m][3 * j + 1] * p.gradient[j][b][1] + p.tangent[m][3 * j + 2] * p.gradient[j][b][2];
  for (int a = 0; a < functions_per_cell; ++a)
    for (int i = 0; i < 3; ++i) {
      const float g0 = p.gradient[i][a][0], g1 = p.gradient[i][a][1], g2 = p.gradient[i][a][2];
      float* row = matrix + (3 * a + i) * padded_unknowns;
      const float *t0 = T[3 * i], *t1 = T[3 * i + 1], *t2 = T[3 * i + 2];
      for (int c = 0; c < padded_unknowns; ++c) row[c] += g0 * t0[c] + g1 * t1[c] + g2 * t2[c];
    }
}

}  // namespace

void CoarseSpace::assemble(const SupportTable& supports, const IntegrationPoints& points, const std::vector<Vec3d>& u) {
  Grid& g = *grid_;
  if (g.used.empty()) return;
  // Points by spline cell, so that each cell's block is summed by one thread in a fixed order.
  std::vector<std::vector<std::uint32_t>> points_of(std::size_t(g.function_count()));
  double w[3][3];
  for (std::size_t p = 0; p < points.size(); ++p)
    if (supports.stencil[p] >= 0) points_of[std::size_t(g.locate(points.position[p], w, nullptr))].push_back(std::uint32_t(p));
  std::vector<int> cells;
  for (std::size_t c = 0; c < points_of.size(); ++c)
    if (!points_of[c].empty()) cells.push_back(int(c));

  const auto point_terms = [&](std::uint32_t p, PointTerms& terms) {
    const Vec3d& x = points.position[p];
    double v[3][3], dv[3][3];
    g.locate(x, v, dv);
    // Share of the free nodes in the interpolation: m = sum phi, here only its gradient, and M = sum (x_I - x) ⊗ grad phi.
    Mat3<float> F = Mat3<float>::identity();
    Vec3d dm[3] = {};
    Mat3d M[3];
    bool all_active = true;
    for (int s = supports.begin[std::size_t(supports.stencil[p])]; s < supports.begin[std::size_t(supports.stencil[p]) + 1]; ++s) {
      const std::size_t slot = std::size_t(supports.base[p] + supports.offset[std::size_t(s)]);
      const Vec3d& grad = supports.gradient[std::size_t(s)];
      for (int i = 0; i < 3; ++i) {
        for (int k = 0; k < 3; ++k) F[i][k] += float(u[slot][i]) * float(grad[k]);
        if (!g.is_active(slot, i)) {
          all_active = false;
          continue;
        }
        dm[i] += grad;
        const Vec3d d = (*g.position)[slot] - x;
        for (int l = 0; l < 3; ++l)
          for (int k = 0; k < 3; ++k) M[i][l][k] += d[l] * grad[k];
      }
    }
    int a = 0;
    for (int k = 0; k < 3; ++k)
      for (int j = 0; j < 3; ++j)
        for (int i = 0; i < 3; ++i, ++a) {
          const double z = v[0][i] * v[1][j] * v[2][k];
          const Vec3d dz{dv[0][i] * v[1][j] * v[2][k], v[0][i] * dv[1][j] * v[2][k], v[0][i] * v[1][j] * dv[2][k]};
          for (int c = 0; c < 3; ++c)
            for (int d = 0; d < 3; ++d)
              terms.gradient[c][a][d] = float(all_active ? dz[d] : z * dm[c][d] + dz.x * M[c][0][d] + dz.y * M[c][1][d] + dz.z * M[c][2][d]);
        }
    const float volume = float(points.volume[p]);
    with_material<float>(points, p, [&](const auto& material) {
      for (int n = 0; n < 9; ++n) {
        Mat3<float> dF;
        dF[n / 3][n % 3] = 1;
        const Mat3<float> dP = stress_derivative(material, F, dF);
        for (int m = 0; m < 9; ++m) terms.tangent[m][n] = volume * dP[m / 3][m % 3];
      }
    });
  };

  const int count = unknowns();
  Eigen::MatrixXd A = Eigen::MatrixXd::Zero(count, count);
  constexpr std::size_t batch = 64;  // blocks in memory at a time
  std::vector<std::vector<float>> block(batch);
  for (std::size_t first = 0; first < cells.size(); first += batch) {
    const std::size_t here = std::min(batch, cells.size() - first);
    parallel_pieces(here, 1, [&](std::size_t b, std::size_t) {
      block[b].assign(local_unknowns * padded_unknowns, 0);
      PointTerms terms;
      for (std::uint32_t p : points_of[std::size_t(cells[first + b])]) point_terms(p, terms), add_point(terms, block[b].data());
    });
    for (std::size_t b = 0; b < here; ++b) {
      int unknown[functions_per_cell];
      for (int a = 0; a < functions_per_cell; ++a) unknown[a] = g.unknown_of[std::size_t(g.function(cells[first + b], a % 3, a / 3 % 3, a / 9))];
      for (int r = 0; r < local_unknowns; ++r)
        for (int c = 0; c < local_unknowns; ++c)
          if (unknown[r / 3] >= 0 && unknown[c / 3] >= 0)
            A(3 * unknown[c / 3] + c % 3, 3 * unknown[r / 3] + r % 3) += double(block[b][std::size_t(r * padded_unknowns + c)]);
    }
  }

  if (g.springs.nonZeros() > 0) A += g.springs;
  // Scaled to a unit diagonal; the shift keeps functions that barely touch the body, and a softened state, positive.
  Eigen::VectorXd scale(count);
  const double floor = 1e-9 * A.diagonal().maxCoeff();
  for (int i = 0; i < count; ++i) scale[i] = 1 / std::sqrt(std::max(A(i, i), floor));
  A = scale.asDiagonal() * A * scale.asDiagonal();
  Eigen::LLT<Eigen::MatrixXd> factor;
  double shift = diagonal_shift;
  for (;; shift *= 10) {
    Eigen::MatrixXd shifted = A;
    shifted.diagonal().array() += shift;
    factor.compute(shifted);
    if (factor.info() == Eigen::Success) break;
    if (shift > 1) fail(Failure::numerical, "the coarse stiffness matrix is not positive: the body is inverted or has no stiffness");
  }
  g.inverse.resize(count, count);
  parallel_pieces(std::size_t(count), 128, [&](std::size_t b, std::size_t e) {
    Eigen::MatrixXd columns = Eigen::MatrixXd::Zero(count, Eigen::Index(e - b));
    for (std::size_t c = b; c < e; ++c) columns(Eigen::Index(c), Eigen::Index(c - b)) = scale[Eigen::Index(c)];
    factor.solveInPlace(columns);
    columns = scale.asDiagonal() * columns;
    for (std::size_t c = b; c < e; ++c) g.inverse.row(Eigen::Index(c)) = columns.col(Eigen::Index(c - b)).transpose().template cast<float>();
  });
}

template <class Real>
void CoarseSpace::add_correction(const NodalField<Real>& f, NodalField<Real>& out) const {
  const Grid& g = *grid_;
  if (g.used.empty()) return;
  using Quad = typename LaneTraits<Real>::Quad;
  const std::size_t functions = std::size_t(g.function_count());
  const std::size_t pieces = (g.nodes.size() + node_piece - 1) / node_piece;
  const Real *fx = f.component(0), *fy = f.component(1), *fz = f.component(2);
  std::vector<std::vector<Quad>> part(pieces);
  parallel_pieces(g.nodes.size(), node_piece, [&](std::size_t begin, std::size_t end) {
    std::vector<Quad>& sum = part[begin / node_piece];
    sum.assign(functions, Quad{});
    for (std::size_t n = begin; n < end; ++n) {
      const auto& node = g.nodes[n];
      const Quad force{node.active[0] * fx[node.slot], node.active[1] * fy[node.slot], node.active[2] * fz[node.slot], Real(0)};
      for (int k = 0; k < 3; ++k)
        for (int j = 0; j < 3; ++j) {
          const Quad row = force * Real(node.weight[6 + k] * node.weight[3 + j]);
          Quad* to = sum.data() + node.first + g.stride_z() * k + g.stride_y() * j;
          for (int i = 0; i < 3; ++i) to[i] += row * Real(node.weight[i]);
        }
    }
  });
  Eigen::VectorXf right(unknowns()), y(unknowns());
  parallel_for(g.used.size(), [&](std::size_t v) {
    double sum[3] = {};
    for (const auto& p : part)
      for (int c = 0; c < 3; ++c) sum[c] += double(p[std::size_t(g.used[v])][c]);
    for (int c = 0; c < 3; ++c) right[Eigen::Index(3 * v) + c] = float(sum[c]);
  }, 64);
  parallel_pieces(std::size_t(unknowns()), 64, [&](std::size_t b, std::size_t e) {
    for (std::size_t r = b; r < e; ++r) y[Eigen::Index(r)] = g.inverse.row(Eigen::Index(r)).dot(right.transpose());
  });
  std::vector<Quad> coarse(functions, Quad{});
  for (std::size_t v = 0; v < g.used.size(); ++v)
    for (int c = 0; c < 3; ++c) coarse[std::size_t(g.used[v])][c] = Real(y[Eigen::Index(3 * v) + c]);
  Real *gx = out.component(0), *gy = out.component(1), *gz = out.component(2);
  parallel_pieces(g.nodes.size(), node_piece, [&](std::size_t begin, std::size_t end) {
    for (std::size_t n = begin; n < end; ++n) {
      const auto& node = g.nodes[n];
      Quad sum{};
      for (int k = 0; k < 3; ++k)
        for (int j = 0; j < 3; ++j) {
          const Quad* from = coarse.data() + node.first + g.stride_z() * k + g.stride_y() * j;
          sum += (from[0] * Real(node.weight[0]) + from[1] * Real(node.weight[1]) + from[2] * Real(node.weight[2])) * Real(node.weight[6 + k] * node.weight[3 + j]);
        }
      gx[node.slot] += node.active[0] * sum[0], gy[node.slot] += node.active[1] * sum[1], gz[node.slot] += node.active[2] * sum[2];
    }
  });
}

template void CoarseSpace::add_correction(const NodalField<float>&, NodalField<float>&) const;
template void CoarseSpace::add_correction(const NodalField<double>&, NodalField<double>&) const;

}  // namespace mtled
