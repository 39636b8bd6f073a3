#include <algorithm>
#include <cmath>
#include <limits>

#include "core/error.hpp"
#include "imaging/order_statistics.hpp"
#include "imaging/same_grid.hpp"
#include "imaging/voxel_loop.hpp"
#include "imaging/warp.hpp"

namespace mtled {
namespace {

/// det(I + du/dX) at one voxel by central differences.
class DeterminantAtVoxel {
 public:
  /// `where`: null: everywhere.
  DeterminantAtVoxel(const VectorImage& displacement, const Mask* where) : field_(displacement), where_(where) {}

  /// False where the derivative along an axis is unknown: no neighbour inside the mask on either side.
  bool operator()(int i, int j, int k, std::size_t voxel, double& determinant_value) const {
    const Grid& grid = field_.grid;
    const int index[3] = {i, j, k};
    const std::size_t stride[3] = {1, grid.offset(0, 1, 0), grid.offset(0, 0, 1)};
    Mat3d F = Mat3d::identity();
    for (int a = 0; a < 3; ++a) {
      if (grid.size[a] == 1) continue;
      const bool below = index[a] > 0 && (!where_ || where_->data[voxel - stride[a]]);
      const bool above = index[a] + 1 < grid.size[a] && (!where_ || where_->data[voxel + stride[a]]);
      if (!below && !above) return false;
      const Vec3f& p = field_.data[below ? voxel - stride[a] : voxel];
      const Vec3f& q = field_.data[above ? voxel + stride[a] : voxel];
      const double length = grid.spacing[a] * (int(below) + int(above));
      const Vec3d slope{(double(q.x) - p.x) / length, (double(q.y) - p.y) / length, (double(q.z) - p.z) / length};
      for (int r = 0; r < 3; ++r)
        for (int c = 0; c < 3; ++c) F[r][c] += slope[r] * grid.direction[c][a];
    }
    determinant_value = determinant(F);
    return true;
  }

 private:
  const VectorImage& field_;
  const Mask* where_;
};

/// Standard deviation (over n) of numbers that visit(begin, end, work) gives to work(number) for pieces of [0, count);
/// NaN when there are none.
template <class Visit>
double deviation_of(std::size_t count, std::size_t piece, const Visit& visit) {
  const auto sum = [&](const auto& f) {
    return parallel_sum(
        count,
        [&](std::size_t begin, std::size_t end) {
          double part = 0;
          visit(begin, end, [&](double value) { part += f(value); });
          return part;
        },
        piece);
  };
  const double n = sum([](double) { return 1; });
  if (n == 0) return std::numeric_limits<double>::quiet_NaN();
  const double mean = sum([](double v) { return v; }) / n;
  return std::sqrt(sum([mean](double v) { return (v - mean) * (v - mean); }) / n);
}

/// Of the logarithm of the positive ones.
double sd_log(const std::vector<float>& determinants) {
  return deviation_of(determinants.size(), 16384, [&](std::size_t begin, std::size_t end, const auto& work) {
    for (std::size_t v = begin; v < end; ++v)
      if (determinants[v] > 0) work(std::log(double(determinants[v])));
  });
}

/// See JacobianStatistics. `determinants`: by differences within `where`, which are those that count here where all six
/// neighbours are in it.
double sd_log_of_learn2reg(const VectorImage& displacement, const Mask& where, const std::vector<float>& determinants) {
  constexpr int border = 2;
  const Grid& grid = where.grid;
  const DeterminantAtVoxel determinant_at(displacement, nullptr);
  const std::size_t stride[3] = {1, grid.offset(0, 1, 0), grid.offset(0, 0, 1)};
  const auto has_all_neighbours = [&](std::size_t voxel) {
    bool all = true;
    for (const std::size_t s : stride) all = all && where.data[voxel - s] && where.data[voxel + s];
    return all;
  };
  const int rows = std::max(grid.size[1] - 2 * border, 0), slices = std::max(grid.size[2] - 2 * border, 0);
  return deviation_of(std::size_t(rows) * std::size_t(slices), 16, [&](std::size_t begin, std::size_t end, const auto& work) {
    for (std::size_t r = begin; r < end; ++r) {
      const int j = border + int(r % std::size_t(rows)), k = border + int(r / std::size_t(rows));
      for (int i = border; i < grid.size[0] - border; ++i) {
        const std::size_t voxel = grid.offset(i, j, k);
        if (!where.data[voxel]) continue;
        double value = determinants[voxel];
        if (!has_all_neighbours(voxel)) determinant_at(i, j, k, voxel, value);
        work(std::log(std::clamp(double(float(value)) + 3, 1e-9, 1e9)));
      }
    }
  });
}

}  // namespace

Image volume_ratio(const VectorImage& displacement, const Mask& where) {
  require(same_grid(displacement.grid, where.grid), "the displacement and the mask lie on different grids; compute both on the same grid");
  const DeterminantAtVoxel determinant_at(displacement, &where);
  Image ratio(where.grid, std::numeric_limits<float>::quiet_NaN());
  for_each_voxel(where.grid, [&](int i, int j, int k, std::size_t voxel) {
    double value;
    if (where.data[voxel] && determinant_at(i, j, k, voxel, value)) ratio.data[voxel] = float(value);
  });
  return ratio;
}

JacobianStatistics jacobian_statistics(const VectorImage& displacement, const Mask& where) { return jacobian_statistics(displacement, where, volume_ratio(displacement, where)); }

JacobianStatistics jacobian_statistics(const VectorImage& displacement, const Mask& where, const Image& ratio) {
  const std::vector<float>& values = ratio.data;
  OrderStatistics order(values);
  require(order.count() > 0, "no voxel of the mask has neighbours in it, so the volume change cannot be computed; give a mask of the body");

  JacobianStatistics result;
  result.voxels = order.count();
  result.folded = std::size_t(parallel_sum(values.size(), [&](std::size_t begin, std::size_t end) {
    return double(std::count_if(values.begin() + std::ptrdiff_t(begin), values.begin() + std::ptrdiff_t(end), [](float value) { return value <= 0; }));
  }));
  result.minimum = order.at(0);
  result.maximum = order.at(order.count() - 1);
  result.percentile_1 = order.percentile(1);
  result.median = order.percentile(50);
  result.percentile_99 = order.percentile(99);
  result.sd_log = sd_log(values);
  result.sd_log_learn2reg = sd_log_of_learn2reg(displacement, where, values);
  return result;
}

Mask folded_voxels(const VectorImage& displacement, const Mask& where) { return folded_voxels(volume_ratio(displacement, where)); }

Mask folded_voxels(const Image& ratio) {
  Mask folded(ratio.grid);
  for (std::size_t v = 0; v < folded.data.size(); ++v) folded.data[v] = ratio.data[v] <= 0;
  return folded;
}

}  // namespace mtled
