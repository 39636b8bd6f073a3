#include "imaging/pose_search.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "core/parallel.hpp"

namespace mtled {

Samples sample(const Image& moving, const std::vector<Vec3d>& points, std::size_t count) {
  const std::size_t stride = count == 0 ? 1 : std::max<std::size_t>(1, (points.size() + count - 1) / count);
  Samples samples;
  for (std::size_t p = stride / 2; p < points.size(); p += stride) {
    double value;
    if (!linear_value(moving, points[p], value)) continue;
    samples.points.push_back(points[p]);
    samples.values.push_back(value);
  }
  return samples;
}

std::vector<Vec3d> moved(std::vector<Vec3d> points, const RigidMotion& motion) {
  for (Vec3d& point : points) point = motion.apply(point);
  return points;
}

double fraction_inside(const std::vector<Vec3d>& points, const Image& image) {
  double inside = 0, ignored;
  for (const Vec3d& point : points) inside += linear_value(image, point, ignored);
  return inside / double(points.size());
}

double similarity(const Samples& samples, const Image& fixed, const RigidMotion& motion) {
  // Sums about the first pair of values, so that large offsets (HU) do not cost digits.
  double n = 0, a0 = 0, b0 = 0, sa = 0, sb = 0, saa = 0, sbb = 0, sab = 0;
  for (std::size_t p = 0; p < samples.points.size(); ++p) {
    double b;
    if (!linear_value(fixed, motion.apply(samples.points[p]), b)) continue;
    double a = samples.values[p];
    if (n == 0) a0 = a, b0 = b;
    a -= a0, b -= b0;
    n += 1, sa += a, sb += b, saa += a * a, sbb += b * b, sab += a * b;
  }
  if (n == 0 || 2 * n < double(samples.points.size())) return -1;
  const double variances = (saa - sa * sa / n) * (sbb - sb * sb / n);
  return variances > 0 ? (sab - sa * sb / n) / std::sqrt(variances) : 0;
}

RigidMotion recentred(const RigidMotion& motion, const Vec3d& center) {
  return {center, motion.rotation, motion.displacement(center)};
}

Pose climb(const Samples& samples, const Image& fixed, const RigidMotion& start, const SearchRange& first_step,
           int halvings) {
  Pose best{start, similarity(samples, fixed, start)};
  double scale = 1;
  for (int level = 0; level <= halvings; ++level, scale /= 2) {
    for (bool improved = true; improved;) {
      improved = false;
      for (int freedom = 0; freedom < 6; ++freedom)
        for (const double sign : {scale, -scale}) {
          RigidMotion trial = best.motion;
          Vec3d step;
          step[freedom % 3] = sign * (freedom < 3 ? first_step.shift_mm : first_step.turn_rad);
          if (freedom < 3)
            trial.translation += step;
          else
            trial.rotation = rotation_matrix(step) * trial.rotation;
          const double value = similarity(samples, fixed, trial);
          if (value <= best.similarity) continue;
          best = {trial, value};
          improved = true;
          break;
        }
    }
  }
  return best;
}

Pose best_pose(const Samples& samples, const Image& fixed, const std::vector<RigidMotion>& starts, int climbs,
               const SearchRange& first_step, int halvings) {
  std::vector<double> values(starts.size());
  parallel_for(
      starts.size(), [&](std::size_t s) { values[s] = similarity(samples, fixed, starts[s]); }, 16);
  std::vector<int> order(starts.size());
  std::iota(order.begin(), order.end(), 0);
  std::stable_sort(order.begin(), order.end(), [&](int a, int b) { return values[a] > values[b]; });

  std::vector<Pose> climbed(std::min<std::size_t>(std::size_t(climbs), starts.size()));
  parallel_for(
      climbed.size(),
      [&](std::size_t c) { climbed[c] = climb(samples, fixed, starts[std::size_t(order[c])], first_step, halvings); },
      1);
  Pose best{starts[order[0]], values[order[0]]};
  for (const Pose& pose : climbed)
    if (pose.similarity > best.similarity) best = pose;
  return best;
}

std::vector<RigidMotion> poses_around(const RigidMotion& start, const SearchRange& range, const SearchRange& step) {
  std::vector<Mat3d> turns{Mat3d::identity()};
  for (double angle = step.turn_rad; angle <= range.turn_rad * (1 + 1e-9); angle += step.turn_rad)
    for (int axis = 0; axis < 3; ++axis)
      for (const double sign : {1.0, -1.0}) {
        Vec3d turn;
        turn[axis] = sign * angle;
        turns.push_back(rotation_matrix(turn));
      }
  std::vector<RigidMotion> poses{start};
  const int reach = int(range.shift_mm / step.shift_mm);
  for (int k = -reach; k <= reach; ++k)
    for (int j = -reach; j <= reach; ++j)
      for (int i = -reach; i <= reach; ++i) {
        const Vec3d shift{i * step.shift_mm, j * step.shift_mm, k * step.shift_mm};
        if (norm(shift) > range.shift_mm) continue;
        for (const Mat3d& turn : turns)
          poses.push_back({start.center, turn * start.rotation, start.translation + shift});
      }
  return poses;
}

}  // namespace mtled
