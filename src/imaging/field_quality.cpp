#include "imaging/field_quality.hpp"

#include <Eigen/LU>
#include <Eigen/SVD>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>

#include "core/error.hpp"
#include "core/parallel.hpp"
#include "imaging/order_statistics.hpp"
#include "imaging/same_grid.hpp"
#include "imaging/voxel_loop.hpp"

namespace mtled {
namespace {

constexpr double inversion_tolerance_mm = 0.1;

Vec3d to_double(const Vec3f& v) { return {v.x, v.y, v.z}; }

}  // namespace

DenseField sample_displacement(const DisplacementFunction& u, const Grid& grid) {
  DenseField field{VectorImage(grid), Mask(grid)};
  for_each_voxel(grid, [&](int i, int j, int k, std::size_t voxel) {
    Vec3d value;
    if (!u(grid.point(i, j, k), value)) return;
    field.displacement.data[voxel] = {float(value.x), float(value.y), float(value.z)};
    field.covered.data[voxel] = 1;
  });
  return field;
}

DenseField inverted(const DisplacementFunction& u, const Grid& from, const Grid& to) {
  InverseStatistics ignored;
  return inverse_field(to, forward_field(from, u), u, inversion_tolerance_mm, ignored);
}

RigidMotion best_rigid_motion(const std::vector<Vec3d>& x, const std::vector<Vec3d>& y) {
  require(!x.empty() && x.size() == y.size(), "cannot fit a rigid motion to ", x.size(), " and ", y.size(), " points; give pairs");
  Vec3d center, target;
  for (const Vec3d& p : x) center += p;
  for (const Vec3d& p : y) target += p;
  center = (1 / double(x.size())) * center, target = (1 / double(x.size())) * target;
  Eigen::Matrix3d H = Eigen::Matrix3d::Zero();
  for (std::size_t p = 0; p < x.size(); ++p) {
    const Vec3d a = x[p] - center, b = y[p] - target;
    H += Eigen::Vector3d(b.x, b.y, b.z) * Eigen::RowVector3d(a.x, a.y, a.z);
  }
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(H, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Eigen::Vector3d no_reflection(1, 1, (svd.matrixU() * svd.matrixV().transpose()).determinant() < 0 ? -1 : 1);
  const Eigen::Matrix3d R = svd.matrixU() * no_reflection.asDiagonal() * svd.matrixV().transpose();
  RigidMotion motion{center, {}, target - center};
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) motion.rotation[i][j] = R(i, j);
  return motion;
}

std::vector<LabelRigidity> label_rigidity(const LabelImage& labels, const DenseField& field) {
  require(same_grid(labels.grid, field.displacement.grid), "the labels and the displacement field lie on different grids; resample the labels");
  struct Points {
    std::vector<Vec3d> before, after;
  };
  std::map<int, Points> points;
  for (int k = 0; k < labels.grid.size[2]; ++k)
    for (int j = 0; j < labels.grid.size[1]; ++j)
      for (int i = 0; i < labels.grid.size[0]; ++i) {
        const std::size_t voxel = labels.grid.offset(i, j, k);
        if (labels.data[voxel] == 0 || !field.covered.data[voxel]) continue;
        Points& p = points[labels.data[voxel]];
        p.before.push_back(labels.grid.point(i, j, k));
        p.after.push_back(p.before.back() + to_double(field.displacement.data[voxel]));
      }
  std::vector<LabelRigidity> result;
  for (const auto& [label, p] : points) {
    const RigidMotion motion = best_rigid_motion(p.before, p.after);
    LabelRigidity rigidity{label, p.before.size()};
    double squares = 0;
    for (std::size_t n = 0; n < p.before.size(); ++n) {
      const double off = norm(p.after[n] - motion.apply(p.before[n]));
      squares += off * off;
      rigidity.largest_mm = std::max(rigidity.largest_mm, off);
    }
    rigidity.rms_mm = std::sqrt(squares / double(p.before.size()));
    result.push_back(rigidity);
  }
  return result;
}

InverseConsistency inverse_consistency(const DenseField& there, const DisplacementFunction& back, const Mask& where) {
  require(same_grid(where.grid, there.displacement.grid), "the mask and the displacement field lie on different grids; resample the mask");
  const Grid& grid = there.displacement.grid;
  std::vector<float> distance(grid.count(), std::numeric_limits<float>::quiet_NaN());
  for_each_voxel(grid, [&](int i, int j, int k, std::size_t voxel) {
    if (!where.data[voxel] || !there.covered.data[voxel]) return;
    const Vec3d v = to_double(there.displacement.data[voxel]);
    Vec3d u;
    if (back(grid.point(i, j, k) + v, u)) distance[voxel] = float(norm(v + u));
  });
  OrderStatistics order(distance);
  if (order.count() == 0) return {};
  const double sum = parallel_sum(distance.size(), [&](std::size_t begin, std::size_t end) {
    double part = 0;
    for (std::size_t v = begin; v < end; ++v)
      if (!std::isnan(distance[v])) part += distance[v];
    return part;
  });
  return {order.count(), sum / double(order.count()), order.percentile(95), order.percentile(99), order.at(order.count() - 1)};
}

double correlation(const Image& a, const Image& b, const Mask& where) {
  const double count = parallel_sum(where.data.size(), [&](std::size_t begin, std::size_t end) { return double(std::count_if(&where.data[0] + begin, &where.data[0] + end, [](auto in) { return in != 0; })); });
  const auto mean = [&](const auto& value) {
    return parallel_sum(where.data.size(), [&](std::size_t begin, std::size_t end) {
      double sum = 0;
      for (std::size_t v = begin; v < end; ++v)
        if (where.data[v]) sum += value(v);
      return sum;
    }) / count;
  };
  const double mean_a = mean([&](std::size_t v) { return double(a.data[v]); }), mean_b = mean([&](std::size_t v) { return double(b.data[v]); });
  const double aa = mean([&](std::size_t v) { return (a.data[v] - mean_a) * (a.data[v] - mean_a); });
  const double bb = mean([&](std::size_t v) { return (b.data[v] - mean_b) * (b.data[v] - mean_b); });
  const double ab = mean([&](std::size_t v) { return (a.data[v] - mean_a) * (b.data[v] - mean_b); });
  return aa > 0 && bb > 0 ? ab / std::sqrt(aa * bb) : 0;
}

}  // namespace mtled
