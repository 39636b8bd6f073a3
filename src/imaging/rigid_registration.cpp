#include "imaging/rigid_registration.hpp"

#include <itkBSplineInterpolateImageFunction.h>
#include <itkBinShrinkImageFilter.h>
#include <itkCorrelationImageToImageMetricv4.h>
#include <itkEuler3DTransform.h>
#include <itkQuasiNewtonOptimizerv4.h>
#include <itkRegistrationParameterScalesFromPhysicalShift.h>
#include <itkSmoothingRecursiveGaussianImageFilter.h>

#include <algorithm>
#include <cmath>

#include "core/error.hpp"
#include "imaging/itk_bridge.hpp"

namespace mtled {
namespace {

using Transform = itk::Euler3DTransform<double>;
using Optimizer = itk::QuasiNewtonOptimizerv4Template<double>;
using Cubic = itk::BSplineInterpolateImageFunction<ItkImage<float>, double, double>;

/// ITK's metric with all its sums in one work unit. SetMaximumNumberOfWorkUnits does not reach the partition of the points
/// (ITK 5.2), so that the last digits would depend on the number of cores.
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

/// In ITK's words the sampled image is "fixed" and the other "moving": its transform maps our moving to our fixed image.
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

}  // namespace

RigidMotion refine_motion(const Image& moving, const Image& fixed, const std::vector<Vec3d>& points,
                          const RigidMotion& start, const std::vector<RegistrationLevel>& levels) {
  RigidMotion motion = start;
  try {
    for (const RegistrationLevel& level : levels)
      motion = level.sigma_mm > 0 ? refine_at_level(smooth(moving, level.sigma_mm), smooth(fixed, level.sigma_mm), points,
                                                    motion, level)
                                  : refine_at_level(moving, fixed, points, motion, level);
  } catch (const itk::ExceptionObject& error) {
    fail(Failure::numerical, "the rigid registration failed (", error.GetDescription(),
         "); check that the two images show the same part of the body");
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
