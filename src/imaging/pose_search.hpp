#pragma once
#include <vector>

#include "core/motion.hpp"
#include "core/volume.hpp"

namespace mtled {

/// Points of the moving image [LPS mm] and the intensities there.
struct Samples {
  std::vector<Vec3d> points;
  std::vector<double> values;
};
/// About `count` of the points (evenly strided; all if count is 0), with the intensities of `moving` by linear
/// interpolation. Points outside the image are left out.
Samples sample(const Image& moving, const std::vector<Vec3d>& points, std::size_t count);

std::vector<Vec3d> moved(std::vector<Vec3d> points, const RigidMotion& motion);
/// Fraction [0, 1] of the points that lie inside the image.
double fraction_inside(const std::vector<Vec3d>& points, const Image& image);

/// Normalised correlation [-1, 1] of the samples with `fixed` at their moved positions. Positions outside `fixed` do
/// not count; -1 where less than half of them lie inside, 0 where one side is constant.
double similarity(const Samples& samples, const Image& fixed, const RigidMotion& motion);

/// The same map x -> y, written about another centre.
RigidMotion recentred(const RigidMotion& motion, const Vec3d& center);

struct Pose {
  RigidMotion motion;
  double similarity = -2;
};

/// Largest steps of a search; a turn is about the centre of the motion.
struct SearchRange {
  double shift_mm = 0;
  double turn_rad = 0;
};
/// Coordinate search uphill from `start`: tries +-step along the three shifts and turns, halves the step when nothing
/// improves, `halvings` times.
Pose climb(const Samples& samples, const Image& fixed, const RigidMotion& start, const SearchRange& first_step,
           int halvings);

/// The best of the given poses and of the `climbs` best of them after climbing. Deterministic for any number of
/// threads.
Pose best_pose(const Samples& samples, const Image& fixed, const std::vector<RigidMotion>& starts, int climbs,
               const SearchRange& first_step, int halvings);

/// `start` shifted by every multiple of `step.shift_mm` within `range.shift_mm` (a ball) and turned about one axis by
/// every multiple of `step.turn_rad` within `range.turn_rad`; `start` comes first.
std::vector<RigidMotion> poses_around(const RigidMotion& start, const SearchRange& range, const SearchRange& step);

}  // namespace mtled
