#include "imaging/rigid_registration.hpp"

#include <itkBSplineInterpolateImageFunction.h>
#include <itkBinShrinkImageFilter.h>
#include <itkCorrelationImageToImageMetricv4.h>
#include <itkEuler3DTransform.h>
#include <itkQuasiNewtonOptimizerv4.h>
#include <itkRegistrationParameterScalesFromPhysicalShift.h>
#include <itkSmoothingRecursiveGaussianImageFilter.h>
#include <vnl/algo/vnl_svd.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "core/error.hpp"
#include "imaging/itk_bridge.hpp"

namespace mtled {
namespace {

using Transform = itk::Euler3DTransform<double>;
using Optimizer = itk::QuasiNewtonOptimizerv4Template<double>;
using Cubic = itk::BSplineInterpolateImageFunction<ItkImage<float>, double, double>;

/// ITK's metric with all its sums in one work unit. SetMaximumNumberOfWorkUnits does not reach the partition of the
/// points (ITK 5.2), so that the last digits would depend on the number of cores.
class Metric : public itk::CorrelationImageToImageMetricv4<ItkImage<float>, ItkImage<float>> {
 public:
  using Self = Metric;
  using Pointer = itk::SmartPointer<Self>;
  itkFactorylessNewMacro(Self);

 private:
  Metric() {
    m_SparseGetValueAndDerivativeThreader->SetNumberOfWorkUnits(1);
    m_HelperSparseThreader->SetNumberOfWorkUnits(1);
  }
};

/// Gradient of the cubic spline that interpolates the image, so that the metric's derivative is that of its value.
class CubicGradient : public itk::ImageFunction<ItkImage<float>, itk::CovariantVector<double, 3>, double> {
 public:
  using Self = CubicGradient;
  using Pointer = itk::SmartPointer<Self>;
  itkFactorylessNewMacro(Self);

  void SetInputImage(const InputImageType* image) override {
    Superclass::SetInputImage(image);
    spline_->SetInputImage(image);
  }
  OutputType Evaluate(const PointType& point) const override { return spline_->EvaluateDerivative(point); }
  OutputType EvaluateAtIndex(const IndexType& index) const override {
    return EvaluateAtContinuousIndex(ContinuousIndexType(index));
  }
  OutputType EvaluateAtContinuousIndex(const ContinuousIndexType& index) const override {
    return spline_->EvaluateDerivativeAtContinuousIndex(index);
  }

 private:
  using Superclass = itk::ImageFunction<ItkImage<float>, itk::CovariantVector<double, 3>, double>;
  Cubic::Pointer spline_ = Cubic::New();
};

constexpr int largest_iterations = 150;
constexpr int iterations_without_progress = 10;

Transform::Pointer to_itk(const RigidMotion& motion) {
  auto transform = Transform::New();
  Transform::MatrixType matrix;
  Transform::CenterType center;
  Transform::OutputVectorType translation;
  for (int i = 0; i < 3; ++i) {
    center[i] = motion.center[i];
    translation[i] = motion.translation[i];
    for (int j = 0; j < 3; ++j) matrix(i, j) = motion.rotation[i][j];
  }
  transform->SetCenter(center);
  transform->SetMatrix(matrix);
  transform->SetTranslation(translation);
  return transform;
}

RigidMotion from_itk(const Transform& transform) {
  RigidMotion motion;
  for (int i = 0; i < 3; ++i) {
    motion.center[i] = transform.GetCenter()[i];
    motion.translation[i] = transform.GetTranslation()[i];
    for (int j = 0; j < 3; ++j) motion.rotation[i][j] = transform.GetMatrix()(i, j);
  }
  return motion;
}

Metric::FixedSampledPointSetType::Pointer point_set(const std::vector<Vec3d>& points, std::size_t count) {
  const std::size_t stride = count == 0 ? 1 : std::max<std::size_t>(1, (points.size() + count - 1) / count);
  auto set = Metric::FixedSampledPointSetType::New();
  itk::IdentifierType id = 0;
  for (std::size_t p = stride / 2; p < points.size(); p += stride) {
    Metric::FixedSampledPointSetType::PointType point;
    for (int a = 0; a < 3; ++a) point[a] = points[p][a];
    set->SetPoint(id++, point);
  }
  return set;
}

/// In ITK's words the sampled image is "fixed" and the other "moving": its transform maps our moving to our fixed
/// image.
RigidMotion refine_at_level(const Image& moving, const Image& fixed, const std::vector<Vec3d>& points,
                            const RigidMotion& start, const RegistrationLevel& level) {
  auto transform = to_itk(start);
  auto metric = Metric::New();
  const auto sampled = view_as_itk(moving), other = view_as_itk(fixed);
  metric->SetFixedImage(sampled);
  metric->SetMovingImage(other);
  metric->SetVirtualDomainFromImage(sampled);
  metric->SetMovingTransform(transform);
  metric->SetFixedInterpolator(Cubic::New());
  metric->SetMovingInterpolator(Cubic::New());
  metric->SetMovingImageGradientCalculator(CubicGradient::New());
  metric->SetFixedSampledPointSet(point_set(points, level.points));
  metric->SetUseSampledPointSet(true);
  metric->SetUseFixedImageGradientFilter(false);
  metric->SetUseMovingImageGradientFilter(false);
  metric->Initialize();

  auto scales = itk::RegistrationParameterScalesFromPhysicalShift<Metric>::New();
  scales->SetMetric(metric);
  auto optimizer = Optimizer::New();
  optimizer->SetMetric(metric);
  optimizer->SetScalesEstimator(scales);
  optimizer->SetMaximumStepSizeInPhysicalUnits(level.largest_step_mm);
  optimizer->SetMaximumIterationsWithoutProgress(iterations_without_progress);
  optimizer->SetNumberOfIterations(largest_iterations);
  optimizer->SetNumberOfWorkUnits(1);
  optimizer->StartOptimization();
  return from_itk(*transform);
}

constexpr double tukey = 4.685;             ///< of the scale: 95 % as precise as least squares on Gaussian noise
constexpr int weightings = 25;              ///< of the scale of the differences; then it stays, so that the steps converge
constexpr int largest_newton_steps = 40;
constexpr double largest_change_mm = 3;     ///< of a point by the robust refinement

/// A cubic spline through an image.
class Spline {
 public:
  explicit Spline(const Image& image) : view_(view_as_itk(image)) { cubic_->SetInputImage(view_); }
  bool evaluate(const Vec3d& x, double& value, Vec3d& gradient) const {
    Cubic::PointType point;
    for (int a = 0; a < 3; ++a) point[a] = x[a];
    if (!cubic_->IsInsideBuffer(point)) return false;
    Cubic::CovariantVectorType derivative;
    cubic_->EvaluateValueAndDerivative(point, value, derivative);
    for (int a = 0; a < 3; ++a) gradient[a] = derivative[a];
    return true;
  }

 private:
  ItkImage<float>::Pointer view_;
  Cubic::Pointer cubic_ = Cubic::New();
};

/// Difference of the intensities at a pair of points, and its derivatives by shift, turn about the centre of the motion
/// in the fixed image, gain and offset.
struct Difference {
  double value = 0;
  std::array<double, 8> derivative{};
};

/// 1.4826 times the median magnitude: the standard deviation of Gaussian differences.
double robust_scale(const std::vector<Difference>& differences) {
  std::vector<double> magnitudes;
  for (const Difference& d : differences) magnitudes.push_back(std::abs(d.value));
  const auto middle = magnitudes.begin() + std::ptrdiff_t(magnitudes.size() / 2);
  std::nth_element(magnitudes.begin(), middle, magnitudes.end());
  return 1.4826 * *middle;
}

}  // namespace

RigidMotion refine_motion(const Image& moving, const Image& fixed, const std::vector<Vec3d>& points,
                          const RigidMotion& start, const std::vector<RegistrationLevel>& levels) {
  RigidMotion motion = start;
  try {
    for (const RegistrationLevel& level : levels)
      motion = level.sigma_mm > 0 ? refine_at_level(smooth(moving, level.sigma_mm), smooth(fixed, level.sigma_mm),
                                                    points, motion, level)
                                  : refine_at_level(moving, fixed, points, motion, level);
  } catch (const itk::ExceptionObject& error) {
    fail(Failure::numerical, "the rigid registration failed (", error.GetDescription(),
         "); check that the two images show the same part of the body");
  }
  return motion;
}

RigidMotion refine_robustly(const Image& moving, const Image& fixed, const std::vector<Vec3d>& moving_points,
                            const std::vector<Vec3d>& fixed_points, const RigidMotion& start) {
  const Spline from(moving), to(fixed);
  RigidMotion motion = start;
  double gain = 1, offset = 0, scale = 0;
  std::vector<Difference> differences;
  for (int step = 0; step < largest_newton_steps; ++step) {
    differences.clear();
    const Vec3d center = motion.center + motion.translation;
    const auto compare = [&](const Vec3d& x, const Vec3d& y, bool seen_in_moving) {
      double at_x = 0, at_y = 0;
      Vec3d gradient_x, gradient_y;
      if (!from.evaluate(x, at_x, gradient_x) || !to.evaluate(y, at_y, gradient_y)) return;
      const Vec3d force = seen_in_moving ? gain * gradient_y : motion.rotation * gradient_x;
      const Vec3d torque = cross(y - center, force);
      differences.push_back({gain * at_y + offset - at_x,
                             {force.x, force.y, force.z, torque.x, torque.y, torque.z, at_y, 1}});
    };
    const RigidMotion back = inverse(motion);
    for (const Vec3d& x : moving_points) compare(x, motion.apply(x), true);
    for (const Vec3d& y : fixed_points) compare(back.apply(y), y, false);
    if (differences.empty()) return start;
    if (step < weightings) scale = robust_scale(differences);
    if (scale <= 0) break;  // the images agree already

    vnl_matrix<double> normal(8, 8, 0.0);
    vnl_vector<double> right(8, 0.0);
    for (const Difference& d : differences) {
      const double u = d.value / (tukey * scale);
      if (std::abs(u) >= 1) continue;
      const double weight = (1 - u * u) * (1 - u * u);
      for (unsigned a = 0; a < 8; ++a) {
        for (unsigned b = 0; b < 8; ++b) normal(a, b) += weight * d.derivative[a] * d.derivative[b];
        right[a] -= weight * d.value * d.derivative[a];
      }
    }
    const vnl_vector<double> change = vnl_svd<double>(normal).solve(right);
    if (!change.is_finite()) return start;
    motion.translation += Vec3d{change[0], change[1], change[2]};
    motion.rotation = rotation_matrix({change[3], change[4], change[5]}) * motion.rotation;
    gain += change[6];
    offset += change[7];
    for (const Vec3d& x : moving_points)
      if (norm(motion.apply(x) - start.apply(x)) > largest_change_mm) return start;
    if (change.extract(3).two_norm() < 1e-4 && change.extract(3, 3).two_norm() < 1e-6) break;
  }
  return motion;
}

Image smooth(const Image& image, double sigma_mm) {
  auto filter = itk::SmoothingRecursiveGaussianImageFilter<ItkImage<float>, ItkImage<float>>::New();
  filter->SetInput(view_as_itk(image));
  filter->SetSigma(sigma_mm);
  filter->Update();
  return volume_from_itk<float>(*filter->GetOutput());
}

Image coarsen(const Image& image, double spacing_mm) {
  auto filter = itk::BinShrinkImageFilter<ItkImage<float>, ItkImage<float>>::New();
  filter->SetInput(view_as_itk(image));
  for (int a = 0; a < 3; ++a) {
    const int wanted = int(std::lround(spacing_mm / image.grid.spacing[a])), most = image.grid.size[a] / 4;
    filter->SetShrinkFactor(unsigned(a), unsigned(std::max(1, std::min(wanted, most))));
  }
  filter->Update();
  return volume_from_itk<float>(*filter->GetOutput());
}

Image crop(const Image& image, const std::vector<Vec3d>& points, double margin_mm) {
  Vec3d low{INFINITY, INFINITY, INFINITY}, high{-INFINITY, -INFINITY, -INFINITY};
  for (const Vec3d& point : points) {
    const Vec3d index = image.grid.index(point);
    for (int a = 0; a < 3; ++a) low[a] = std::min(low[a], index[a]), high[a] = std::max(high[a], index[a]);
  }
  Grid grid = image.grid;
  int first[3];
  for (int a = 0; a < 3; ++a) {
    const double margin = std::max(margin_mm / grid.spacing[a], 2.0);
    const int last_start = std::max(image.grid.size[a] - 4, 0);
    first[a] = int(std::clamp(std::floor(low[a] - margin), 0.0, double(last_start)));
    const int end = int(std::clamp(std::ceil(high[a] + margin), double(first[a]), double(image.grid.size[a] - 1)));
    grid.size[a] = std::min(std::max(end - first[a] + 1, 4), image.grid.size[a] - first[a]);
  }
  grid.origin = image.grid.point(first[0], first[1], first[2]);
  Image part(grid);
  for (int k = 0; k < grid.size[2]; ++k)
    for (int j = 0; j < grid.size[1]; ++j)
      std::copy_n(&image.at(first[0], first[1] + j, first[2] + k), grid.size[0], &part.at(0, j, k));
  return part;
}

}  // namespace mtled
