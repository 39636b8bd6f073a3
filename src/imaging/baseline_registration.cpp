#include "imaging/baseline_registration.hpp"

#include <itkSignedMaurerDistanceMapImageFilter.h>
#include <vnl/algo/vnl_lbfgsb.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <functional>
#include <limits>
#include <optional>

#include "core/error.hpp"
#include "core/parallel.hpp"
#include "imaging/bone_motion.hpp"
#include "imaging/itk_bridge.hpp"
#include "imaging/mutual_information.hpp"
#include "imaging/rigid_registration.hpp"
#include "imaging/slices.hpp"
#include "imaging/voxel_loop.hpp"
#include "imaging/warp.hpp"

namespace mtled {
namespace {

using Parameters = vnl_vector<double>;
/// Mutual information at some parameters and its gradient.
using Objective = std::function<double(const Parameters&, Parameters& gradient)>;

constexpr double smallest_gain = 1e-7;  ///< of the mutual information by one step; less is convergence

/// The negative of an objective for vnl, which remembers the best parameters: the minimiser may stop beside them.
class Cost : public vnl_cost_function {
 public:
  Cost(unsigned parameters, const Objective& objective) : vnl_cost_function(int(parameters)), objective_(objective) {}
  void compute(const Parameters& x, double* value, Parameters* gradient) override {
    Parameters slope(unsigned(dim), 0.0);
    const double found = objective_(x, slope);
    if (evaluations == 0) first = found;
    if (evaluations == 0 || found > best) best = found, at_best = x;
    ++evaluations;
    if (value) *value = -found;
    if (gradient) *gradient = -slope;
  }

  double first = 0, best = 0;
  Parameters at_best;
  int evaluations = 0;

 private:
  const Objective& objective_;
};

/// Maximises from `x`, which becomes the best parameters.
BaselineLevel maximise(const Objective& objective, Parameters& x, int evaluations) {
  Cost cost(x.size(), objective);
  vnl_lbfgsb minimiser(cost);
  minimiser.set_cost_function_convergence_factor(smallest_gain / std::numeric_limits<double>::epsilon());
  minimiser.set_projected_gradient_tolerance(0);
  minimiser.set_max_function_evals(evaluations - 1);  // vnl stops after one more
  minimiser.minimize(x);
  x = cost.at_best;
  return {0, 0, cost.first, cost.best, cost.evaluations, 0};
}

constexpr double smallest_overlap = 1.0 / 16;  ///< of the samples, as in ITK

/// Lets the samples count that lie in the moving image, and returns their fraction. Input error when these are too few.
double count_inside(MattesMutualInformation& metric, const std::vector<Vec3d>& position) {
  const double overlap = metric.count_inside(position);
  require(overlap >= smallest_overlap, "of the samples in the fixed image only ", 100 * overlap,
          " % lie inside the moving image at the start; the images hardly overlap: choose another start, or check the headers of the images and the mask");
  return overlap;
}

/// Both images on one resolution and the samples drawn there.
struct Level {
  double spacing_mm;
  std::vector<IntensitySample> samples;
  MattesMutualInformation metric;
};
Image at_resolution(const Image& image, double spacing_mm, bool smoothed) {
  const Image coarse = coarsen(image, spacing_mm);
  return smoothed ? smooth(coarse, spacing_mm / 2) : coarse;
}
Level make_level(const Image& moving, const Image& fixed, const Mask* mask, int number, const BaselineOptions& options) {
  const int left = options.levels - 1 - number;
  const double spacing = options.finest_spacing_mm * std::pow(2, left);
  const Image from = at_resolution(moving, spacing, left > 0), to = at_resolution(fixed, spacing, left > 0);
  std::vector<IntensitySample> samples = draw_samples(to, mask, options.samples, options.seed + std::uint64_t(number));
  MattesMutualInformation metric(from, samples, options.bins);
  return {spacing, std::move(samples), std::move(metric)};
}

/// The same optimisation level by level.
template <class Optimise>
std::vector<BaselineLevel> from_coarse_to_fine(const Image& moving, const Image& fixed, const Mask* mask, const BaselineOptions& options, const Optimise& optimise) {
  for (const Image* image : {&moving, &fixed})
    for (const int n : image->grid.size) require(n >= 4, "an image has only ", n, " voxels along one axis; the registration needs at least 4");
  std::vector<BaselineLevel> reports;
  for (int number = 0; number < options.levels; ++number) {
    const auto begin = std::chrono::steady_clock::now();
    Level level = make_level(moving, fixed, mask, number, options);
    BaselineLevel report = optimise(level, number);
    report.spacing_mm = level.spacing_mm;
    report.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
    reports.push_back(report);
  }
  return reports;
}

/// d = jacobian e, where turning by the rotation vector w + e is turning by d after w (left Jacobian of the rotations).
Mat3d left_jacobian(const Vec3d& w) {
  const double angle = norm(w);
  const double a = angle < 1e-4 ? 0.5 : (1 - std::cos(angle)) / (angle * angle), b = angle < 1e-4 ? 1.0 / 6 : (angle - std::sin(angle)) / (angle * angle * angle);
  Mat3d jacobian = Mat3d::identity();
  for (int j = 0; j < 3; ++j) {
    Vec3d unit;
    unit[j] = 1;
    const Vec3d once = cross(w, unit), twice = cross(w, once);
    for (int i = 0; i < 3; ++i) jacobian[i][j] += a * once[i] + b * twice[i];
  }
  return jacobian;
}

/// Shift [mm] and turn about the centre of `motion` that maximise the mutual information of a level. Turns are measured by
/// how far they move samples, so that all six parameters are of one size.
BaselineLevel refine(Level& level, RigidMotion& motion, int evaluations) {
  double squared_radius = 0;
  for (const IntensitySample& s : level.samples) squared_radius += squared_norm(s.place - motion.center) / double(level.samples.size());
  const double radius = std::sqrt(squared_radius);
  const auto moved_by = [&](const Parameters& p) {
    RigidMotion m = motion;
    m.translation += Vec3d{p[0], p[1], p[2]};
    m.rotation = rotation_matrix((1 / radius) * Vec3d{p[3], p[4], p[5]}) * m.rotation;
    return m;
  };
  std::vector<Vec3d> position(level.samples.size()), derivative;
  const auto move_to = [&](const RigidMotion& m) { parallel_for(position.size(), [&](std::size_t s) { position[s] = m.apply(level.samples[s].place); }); };
  const Objective objective = [&](const Parameters& p, Parameters& gradient) {
    const RigidMotion m = moved_by(p);
    move_to(m);
    const double value = level.metric.evaluate(position, derivative);
    Vec3d force, torque;
    for (std::size_t s = 0; s < position.size(); ++s) {
      force += derivative[s];
      torque += cross(position[s] - m.center - m.translation, derivative[s]);
    }
    torque = (1 / radius) * (transpose(left_jacobian((1 / radius) * Vec3d{p[3], p[4], p[5]})) * torque);
    for (unsigned a = 0; a < 3; ++a) gradient[a] = force[int(a)], gradient[3 + a] = torque[int(a)];
    return value;
  };
  move_to(motion);
  const double overlap = count_inside(level.metric, position);
  Parameters p(6, 0.0);
  BaselineLevel report = maximise(objective, p, evaluations);
  report.overlap = overlap;
  motion = moved_by(p);
  return report;
}

/// The gradient of the control points is summed in this many parts, whatever the number of threads.
constexpr std::size_t gradient_parts = 16;

BaselineLevel refine(Level& level, const RigidMotion& motion, const Image* freedom, FreeFormDeformation& deformation, int evaluations) {
  const std::size_t count = level.samples.size(), controls = deformation.coefficients.size();
  std::vector<FreeFormDeformation::Weights> weights(count);
  std::vector<double> free(count, 1);
  parallel_for(count, [&](std::size_t s) {
    const Vec3d& y = level.samples[s].place;
    if (!deformation.weights(y, weights[s]) || (freedom && !linear_value(*freedom, y, free[s]))) free[s] = 0;
  });
  const auto set = [&](const Parameters& p) {
    for (std::size_t c = 0; c < controls; ++c)
      for (std::size_t a = 0; a < 3; ++a) deformation.coefficients[c][int(a)] = p[unsigned(a * controls + c)];
  };
  std::vector<Vec3d> position(count), derivative;
  const Mat3d back = transpose(motion.rotation);
  const auto move = [&] {
    parallel_for(count, [&](std::size_t s) {
      Vec3d b;
      if (free[s] > 0) deformation.for_each_control(weights[s], [&](std::size_t c, double w) { b += w * deformation.coefficients[c]; });
      position[s] = motion.apply(level.samples[s].place + free[s] * b);
    });
  };
  const Objective objective = [&](const Parameters& p, Parameters& gradient) {
    set(p);
    move();
    const double value = level.metric.evaluate(position, derivative);
    const std::size_t piece = (count + gradient_parts - 1) / gradient_parts;
    std::vector<std::vector<Vec3d>> part(gradient_parts);
    parallel_pieces(count, piece, [&](std::size_t begin, std::size_t end) {
      std::vector<Vec3d>& sum = part[begin / piece];
      sum.assign(controls, Vec3d{});
      for (std::size_t s = begin; s < end; ++s) {
        if (free[s] == 0 || derivative[s] == Vec3d{}) continue;
        const Vec3d pull = free[s] * (back * derivative[s]);
        deformation.for_each_control(weights[s], [&](std::size_t c, double w) { sum[c] += w * pull; });
      }
    });
    gradient.fill(0);
    for (const std::vector<Vec3d>& sum : part)
      for (std::size_t c = 0; c < sum.size(); ++c)
        for (std::size_t a = 0; a < 3; ++a) gradient[unsigned(a * controls + c)] += sum[c][int(a)];
    return value;
  };
  move();
  const double overlap = count_inside(level.metric, position);
  Parameters p(unsigned(3 * controls));
  for (std::size_t c = 0; c < controls; ++c)
    for (std::size_t a = 0; a < 3; ++a) p[unsigned(a * controls + c)] = deformation.coefficients[c][int(a)];
  BaselineLevel report = maximise(objective, p, evaluations);
  report.overlap = overlap;
  set(p);
  return report;
}

RigidMotion start_motion(RigidStart start, const Image& moving, const Image& fixed) {
  RigidMotion motion;
  motion.center = middle(fixed.grid);
  if (start == RigidStart::geometry) motion.translation = middle(moving.grid) - motion.center;
  if (start == RigidStart::moments) motion.translation = center_of_intensity(moving, nullptr) - center_of_intensity(fixed, nullptr);
  return motion;
}

}  // namespace

const char* name_of(RigidStart start) {
  switch (start) {
    case RigidStart::moments: return "moments";
    case RigidStart::geometry: return "geometry";
    case RigidStart::identity: return "identity";
    default: return "best";
  }
}

RigidBaseline register_rigid_baseline(const Image& moving, const Image& fixed, const Mask* fixed_mask, RigidStart start, const BaselineOptions& options) {
  RigidBaseline result;
  std::vector<RigidStart> starts{start};
  if (start == RigidStart::best) starts = {RigidStart::moments, RigidStart::geometry, RigidStart::identity};
  result.levels = from_coarse_to_fine(moving, fixed, fixed_mask, options, [&](Level& level, int number) {
    if (number > 0) return refine(level, result.fixed_to_moving, options.evaluations);
    std::optional<BaselineLevel> best;
    std::optional<Error> no_overlap;
    for (const RigidStart candidate : starts) {
      RigidMotion motion = start_motion(candidate, moving, fixed);
      try {
        const BaselineLevel report = refine(level, motion, options.evaluations);
        if (!best || report.after * report.overlap > best->after * best->overlap) best = report, result.fixed_to_moving = motion, result.start = candidate;
      } catch (const Error& error) {
        no_overlap = error;
      }
    }
    if (!best) throw *no_overlap;
    return *best;
  });
  return result;
}

FreeFormBaseline register_free_form_baseline(const Image& moving, const Image& fixed, const Mask* fixed_mask, const RigidMotion& start,
                                             const std::array<int, 3>& mesh, const Image* freedom, const BaselineOptions& options) {
  FreeFormBaseline result{FreeFormDeformation(fixed.grid, mesh), {}};
  result.levels = from_coarse_to_fine(moving, fixed, fixed_mask, options,
                                      [&](Level& level, int) { return refine(level, start, freedom, result.deformation, options.evaluations); });
  return result;
}

Image freedom_outside(const Mask& still, double width_mm) {
  using Filter = itk::SignedMaurerDistanceMapImageFilter<ItkImage<std::uint8_t>, ItkImage<float>>;
  Image freedom(still.grid, 1);
  if (std::all_of(still.data.begin(), still.data.end(), [](auto s) { return s == 0; })) return freedom;
  auto filter = Filter::New();
  filter->SetInput(view_as_itk(still));
  filter->SetUseImageSpacing(true);
  filter->SetSquaredDistance(false);
  filter->Update();
  const Image distance = volume_from_itk<float>(*filter->GetOutput());  // negative inside, 0 on the outermost voxels there
  for (std::size_t v = 0; v < freedom.data.size(); ++v) {
    const double t = std::clamp(distance.data[v] / width_mm, 0.0, 1.0);
    freedom.data[v] = float(t * t * (3 - 2 * t));
  }
  return freedom;
}

VectorImage compose(const VectorImage& v, const VectorImage& b) {
  VectorImage both = v;
  for_each_voxel(b.grid, [&](int i, int j, int k, std::size_t voxel) {
    const Vec3f& shift = b.data[voxel];
    const Vec3d z = b.grid.point(i, j, k) + Vec3d{shift.x, shift.y, shift.z};
    Vec3d then;
    if (shift != Vec3f{} && linear_value(v, z, then)) both.data[voxel] = shift + Vec3f{float(then.x), float(then.y), float(then.z)};
  });
  return both;
}

VectorImage compose_without_folds(const VectorImage& v, VectorImage& b, const Mask& body, double width_mm, int& reductions) {
  const Mask everywhere(b.grid, 1), folded_already = folded_voxels(v, body);
  for (reductions = 0;; ++reductions) {
    const VectorImage both = compose(v, b);
    const Mask of_both = folded_voxels(both, body);
    Mask folded = folded_voxels(b, everywhere);
    for (std::size_t n = 0; n < folded.data.size(); ++n) folded.data[n] |= of_both.data[n] && !folded_already.data[n];
    if (std::none_of(folded.data.begin(), folded.data.end(), [](auto f) { return f != 0; })) return both;
    const Image freedom = freedom_outside(folded, width_mm);
    for (std::size_t n = 0; n < b.data.size(); ++n) b.data[n] = (0.5f + 0.5f * freedom.data[n]) * b.data[n];
  }
}

}  // namespace mtled
