#include <algorithm>
#include <cmath>
#include <limits>

#include "core/error.hpp"
#include "imaging/percentile.hpp"
#include "imaging/same_grid.hpp"
#include "imaging/voxel_loop.hpp"
#include "imaging/warp.hpp"

namespace mtled {
namespace {

/// det(I + du/dX) at one voxel by central differences.
class DeterminantAtVoxel {
 public:
  DeterminantAtVoxel(const VectorImage& displacement, const Mask& where) : field_(displacement), where_(where) {}

  /// False where the derivative along an axis is unknown: no neighbour inside the mask on either side.
  bool operator()(int i, int j, int k, std::size_t voxel, double& determinant_value) const {
    const Grid& grid = field_.grid;
    const int index[3] = {i, j, k};
    const std::size_t stride[3] = {1, grid.offset(0, 1, 0), grid.offset(0, 0, 1)};
    Mat3d F = Mat3d::identity();
    for (int a = 0; a < 3; ++a) {
      if (grid.size[a] == 1) continue;
      const bool below = index[a] > 0 && where_.data[voxel - stride[a]];
      const bool above = index[a] + 1 < grid.size[a] && where_.data[voxel + stride[a]];
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
  const Mask& where_;
};

/// Standard deviation (over n) of f(value) where `counts(value)`; NaN where none does.
template <class Function, class Counts>
double deviation_of(const std::vector<float>& values, const Function& f, const Counts& counts) {
  double sum = 0, squares = 0;
  std::size_t n = 0;
  for (const float v : values)
    if (counts(v)) sum += f(v), ++n;
  if (n == 0) return std::numeric_limits<double>::quiet_NaN();
  for (const float v : values)
    if (counts(v)) squares += (f(v) - sum / double(n)) * (f(v) - sum / double(n));
  return std::sqrt(squares / double(n));
}

/// See JacobianStatistics.
double sd_log_of_learn2reg(const VectorImage& displacement, const Mask& where) {
  constexpr int border = 2;
  const Mask everywhere(where.grid, 1);
  const DeterminantAtVoxel determinant_at(displacement, everywhere);
  const auto& n = where.grid.size;
  std::vector<float> values;
  for (int k = border; k < n[2] - border; ++k)
    for (int j = border; j < n[1] - border; ++j)
      for (int i = border; i < n[0] - border; ++i) {
        double value;
        if (where.at(i, j, k) && determinant_at(i, j, k, where.grid.offset(i, j, k), value)) values.push_back(float(value));
      }
  return deviation_of(values, [](double v) { return std::log(std::clamp(v + 3, 1e-9, 1e9)); }, [](float) { return true; });
}

}  // namespace

JacobianStatistics jacobian_statistics(const VectorImage& displacement, const Mask& where) {
  require(same_grid(displacement.grid, where.grid),
          "the displacement and the mask lie on different grids; compute both "
          "on the same grid");
  const DeterminantAtVoxel determinant_at(displacement, where);
  Mask counted(where.grid);
  std::vector<float> values(where.data.size());
  for_each_voxel(where.grid, [&](int i, int j, int k, std::size_t voxel) {
    double value;
    if (!where.data[voxel] || !determinant_at(i, j, k, voxel, value)) return;
    values[voxel] = float(value);
    counted.data[voxel] = 1;
  });
  std::size_t kept = 0;
  for (std::size_t voxel = 0; voxel < values.size(); ++voxel)
    if (counted.data[voxel]) values[kept++] = values[voxel];
  values.resize(kept);
  require(kept > 0,
          "no voxel of the mask has neighbours in it, so the volume change cannot be computed; give a mask of "
          "the body");

  JacobianStatistics result;
  result.voxels = kept;
  result.folded = std::size_t(std::count_if(values.begin(), values.end(), [](float value) { return value <= 0; }));
  const auto [minimum, maximum] = std::minmax_element(values.begin(), values.end());
  result.minimum = *minimum;
  result.maximum = *maximum;
  result.percentile_1 = percentile(values, 1);
  result.median = percentile(values, 50);
  result.percentile_99 = percentile(values, 99);
  result.sd_log = deviation_of(values, [](double v) { return std::log(v); }, [](float v) { return v > 0; });
  result.sd_log_learn2reg = sd_log_of_learn2reg(displacement, where);
  return result;
}

Image volume_ratio(const VectorImage& displacement, const Mask& where) {
  require(same_grid(displacement.grid, where.grid), "the displacement and the mask lie on different grids; compute both on the same grid");
  const DeterminantAtVoxel determinant_at(displacement, where);
  Image ratio(where.grid, std::numeric_limits<float>::quiet_NaN());
  for_each_voxel(where.grid, [&](int i, int j, int k, std::size_t voxel) {
    double value;
    if (where.data[voxel] && determinant_at(i, j, k, voxel, value)) ratio.data[voxel] = float(value);
  });
  return ratio;
}

Mask folded_voxels(const VectorImage& displacement, const Mask& where) {
  const DeterminantAtVoxel determinant_at(displacement, where);
  Mask folded(where.grid);
  for_each_voxel(where.grid, [&](int i, int j, int k, std::size_t voxel) {
    double value;
    folded.data[voxel] = where.data[voxel] && determinant_at(i, j, k, voxel, value) && value <= 0;
  });
  return folded;
}

}  // namespace mtled
