#include "imaging/cubic_spline.hpp"

#include <itkBSplineDecompositionImageFilter.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>

#include "imaging/itk_bridge.hpp"

namespace mtled {
namespace {

/// Index of the voxel that mirrors `i` into [0, n).
int mirrored(int i, int n) {
  if (n == 1) return 0;
  const int last = n - 1;
  return last - std::abs(last - std::abs(i));
}

/// Cubic B-spline at the four coefficients around a position t in [0, 1] between the middle two.
void cubic_weights(double t, double weight[4]) {
  const double s = 1 - t;
  weight[0] = s * s * s / 6;
  weight[1] = (4 - 6 * t * t + 3 * t * t * t) / 6;
  weight[2] = (4 - 6 * s * s + 3 * s * s * s) / 6;
  weight[3] = t * t * t / 6;
}

}  // namespace

CubicSpline::CubicSpline(const Image& image) {
  using Filter = itk::BSplineDecompositionImageFilter<ItkImage<float>, ItkImage<float>>;
  const auto filter = Filter::New();
  filter->SetSplineOrder(3);
  filter->SetInput(view_as_itk(image));
  filter->Update();
  coefficients_ = volume_from_itk<float>(*filter->GetOutput());
  coefficients_.grid = image.grid;
}

bool CubicSpline::evaluate(const Vec3d& point, double& value) const {
  const Vec3d c = coefficients_.grid.index(point);
  double weight[3][4];
  int tap[3][4];
  for (int a = 0; a < 3; ++a) {
    const int n = coefficients_.grid.size[a];
    if (!(c[a] >= -0.5 && c[a] <= n - 0.5)) return false;
    const double clamped = std::clamp(c[a], 0.0, double(n - 1));
    const int low = std::min(int(clamped), std::max(n - 2, 0));
    cubic_weights(clamped - low, weight[a]);
    for (int b = 0; b < 4; ++b) tap[a][b] = mirrored(low - 1 + b, n);
  }
  value = 0;
  for (int k = 0; k < 4; ++k)
    for (int j = 0; j < 4; ++j) {
      const float* row = &coefficients_.data[coefficients_.grid.offset(0, tap[1][j], tap[2][k])];
      double sum = 0;
      for (int i = 0; i < 4; ++i) sum += weight[0][i] * row[tap[0][i]];
      value += weight[1][j] * weight[2][k] * sum;
    }
  return true;
}

}  // namespace mtled
