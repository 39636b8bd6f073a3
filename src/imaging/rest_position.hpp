#pragma once
#include "imaging/warp.hpp"

namespace mtled {

/// Trilinear value and derivative of a dense displacement; constant beyond the border of its grid.
class TrilinearField {
 public:
  /// `field` must outlive this object.
  explicit TrilinearField(const VectorImage& field);
  /// u(X) [mm] and du/dX.
  void evaluate(const Vec3d& X, Vec3d& u, Mat3d& gradient) const;

 private:
  const VectorImage& field_;
  Mat3d to_index_;
};

/// Solves X + u(X) = y at one point: Newton on the dense field, then Broyden's method on the true u from there. Steps
/// are halved until the residual falls, so the iteration also converges where |grad u| >= 1 (plain fixed-point
/// iteration X <- y - u(X) does not).
class SolveForRestPosition {
 public:
  /// The arguments must outlive this object.
  SolveForRestPosition(const VectorImage& dense, const DisplacementFunction& u, double tolerance_mm);

  enum class Outcome {
    covered,     ///< |X + u(X) - y| = residual <= tolerance
    outside,     ///< u does not cover the solution
    unresolved,  ///< the residual stayed above the tolerance
  };
  Outcome operator()(const Vec3d& y, Vec3d& X, double& residual) const;

 private:
  Vec3d solve_on_dense_field(const Vec3d& y) const;
  Outcome solve_on_true_field(const Vec3d& y, Vec3d& X, double& residual) const;

  TrilinearField dense_;
  const DisplacementFunction& u_;
  double tolerance_, smallest_spacing_;
};

}  // namespace mtled
