#pragma once
#include "core/host_device.hpp"
#include "core/tensor.hpp"
#include "core/volume_view.hpp"

namespace mtled {

/// What is known of a voxel of a dense field.
enum class Coverage : std::uint8_t {
  outside,     ///< not in the body
  covered,     ///< from the mechanics
  unresolved,  ///< inverse fields: the iteration did not reach the tolerance
  undecided,   ///< not computed yet, or left to the CPU by a device
};

/// Trilinear value and derivative of a dense displacement; constant beyond the border of its grid.
class TrilinearField {
 public:
  TrilinearField() = default;
  explicit TrilinearField(const VolumeView<Vec3f>& field) : field_(field) {
    for (int a = 0; a < 3; ++a)
      for (int b = 0; b < 3; ++b) to_index_[a][b] = field.grid.direction[b][a] / field.grid.spacing[a];
  }
  const GridView& grid() const { return field_.grid; }

  /// u(X) [mm] and du/dX.
  MTLED_HD void evaluate(const Vec3d& X, Vec3d& u, Mat3d& gradient) const {
    const Vec3d c = to_index_ * (X - field_.grid.origin);
    int low[3], high[3];
    double t[3], slope[3];
    for (int a = 0; a < 3; ++a) {
      const int last = field_.grid.size[a] - 1, before_last = last > 1 ? last - 1 : 0;
      const double inside = clamped(c[a], 0.0, double(last));
      low[a] = int(inside) < before_last ? int(inside) : before_last;
      high[a] = low[a] + 1 < last ? low[a] + 1 : last;
      t[a] = inside - low[a];
      slope[a] = inside == c[a] && high[a] > low[a] ? 1 : 0;
    }
    u = {};
    Vec3d along[3];
    for (int corner = 0; corner < 8; ++corner) {
      const bool i = corner & 1, j = corner & 2, k = corner & 4;
      const Vec3f& value = field_.at(i ? high[0] : low[0], j ? high[1] : low[1], k ? high[2] : low[2]);
      const Vec3d v{value.x, value.y, value.z};
      const double x = i ? t[0] : 1 - t[0], y = j ? t[1] : 1 - t[1], z = k ? t[2] : 1 - t[2];
      u += (x * y * z) * v;
      along[0] += (i ? y * z : -y * z) * v;
      along[1] += (j ? x * z : -x * z) * v;
      along[2] += (k ? x * y : -x * y) * v;
    }
    for (int r = 0; r < 3; ++r)
      for (int b = 0; b < 3; ++b) {
        gradient[r][b] = 0;
        for (int a = 0; a < 3; ++a) gradient[r][b] += slope[a] * along[a][r] * to_index_[a][b];
      }
  }

 private:
  VolumeView<Vec3f> field_;
  Mat3d to_index_;
};

/// Solves X + u(X) = y at one point: Newton on the dense field, then Broyden's method on the true u from there. Steps
/// are halved until the residual falls, so the iteration also converges where |grad u| >= 1 (plain fixed-point
/// iteration X <- y - u(X) does not). `Displacement`: Coverage operator()(X, u) const, u [mm] where covered.
template <class Displacement>
class SolveForRestPosition {
 public:
  SolveForRestPosition() = default;
  /// `dense` must outlive this object.
  SolveForRestPosition(const VolumeView<Vec3f>& dense, const Displacement& u, double tolerance_mm) : dense_(dense), u_(u), tolerance_(tolerance_mm) {
    const Vec3d& h = dense.grid.spacing;
    smallest_spacing_ = h.x < h.y ? h.x : h.y;
    if (h.z < smallest_spacing_) smallest_spacing_ = h.z;
  }

  /// Covered: |X + u(X) - y| = residual <= tolerance; outside: u does not cover the solution; unresolved: the residual stayed
  /// above the tolerance; undecided: u was, on the way.
  MTLED_HD Coverage operator()(const Vec3d& y, Vec3d& X, double& residual) const {
    X = solve_on_dense_field(y);
    return solve_on_true_field(y, X, residual);
  }

 private:
  static constexpr int dense_iterations = 25, true_iterations = 25;
  static constexpr double smallest_determinant = 0.05;  ///< below it the field is (almost) folded: J = I instead

  MTLED_HD static Mat3d jacobian(Mat3d gradient) {
    for (int a = 0; a < 3; ++a) gradient[a][a] += 1;
    return determinant(gradient) < smallest_determinant ? Mat3d::identity() : gradient;
  }

  /// Broyden's update: the matrix nearest to J that maps dX to dr (Broyden 1965); I where that would be singular.
  MTLED_HD static void learn(Mat3d& J, const Vec3d& dX, const Vec3d& dr) {
    const Vec3d error = dr - J * dX;
    const double scale = 1 / squared_norm(dX);
    for (int a = 0; a < 3; ++a)
      for (int b = 0; b < 3; ++b) J[a][b] += scale * error[a] * dX[b];
    if (determinant(J) < smallest_determinant) J = Mat3d::identity();
  }

  MTLED_HD Vec3d solve_on_dense_field(const Vec3d& y) const {
    Vec3d X = y, u, best = y, step;
    Mat3d gradient;
    double smallest = 1e300;
    for (int iteration = 0; iteration < dense_iterations; ++iteration) {
      dense_.evaluate(X, u, gradient);
      const Vec3d r = X + u - y;
      if (norm(r) < smallest) {
        smallest = norm(r);
        best = X;
        if (smallest <= tolerance_) break;
        step = inverse(jacobian(gradient)) * r;
      } else {
        step = 0.5 * step;
      }
      X = best - step;
    }
    return best;
  }

  MTLED_HD Coverage solve_on_true_field(const Vec3d& y, Vec3d& X, double& residual) const {
    Vec3d u;
    Mat3d gradient;
    const Coverage start = u_(X, u);
    if (start != Coverage::covered) return start;
    Vec3d r = X + u - y;
    residual = norm(r);
    if (residual <= tolerance_) return Coverage::covered;
    dense_.evaluate(X, u, gradient);
    Mat3d J = jacobian(gradient);
    Vec3d step = inverse(J) * r;
    for (int iteration = 0; iteration < true_iterations; ++iteration) {
      const Vec3d trial = X - step;
      const Coverage there = u_(trial, u);
      if (there == Coverage::undecided) return there;
      if (there == Coverage::outside) {  // the way to the solution leaves the body
        if (norm(step) < 0.25 * smallest_spacing_) return Coverage::outside;
        step = 0.5 * step;
        continue;
      }
      const Vec3d trial_r = trial + u - y;
      if (norm(trial_r) <= tolerance_) {
        X = trial;
        residual = norm(trial_r);
        return Coverage::covered;
      }
      learn(J, Vec3d{} - step, trial_r - r);
      if (norm(trial_r) < residual) {
        X = trial;
        r = trial_r;
        residual = norm(r);
        step = inverse(J) * r;
      } else {
        step = 0.5 * step;
      }
    }
    return Coverage::unresolved;
  }

  TrilinearField dense_;
  Displacement u_;
  double tolerance_ = 0, smallest_spacing_ = 0;
};

}  // namespace mtled
