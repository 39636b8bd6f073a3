#include "imaging/bone_starts.hpp"

#include <algorithm>
#include <cmath>

#include "imaging/pose_search.hpp"
#include "imaging/rigid_registration.hpp"

namespace mtled {
namespace {

constexpr double degree = 0.017453292519943295;
constexpr std::size_t points_per_label = 1500, points_per_spine = 2000;
constexpr double label_sigma_mm = 2.5, spine_sigma_mm = 4;
constexpr double surroundings_mm = 30;  ///< of the labels, beyond the largest shift, that the search may look at

/// The two images around the labels, smoothed for a search.
struct SearchImages {
  Image moving, fixed;
  SearchImages(const Image& m, const Image& f, double sigma_mm)
      : moving(smooth(m, sigma_mm)), fixed(smooth(f, sigma_mm)) {}
};

std::vector<Vec3d> all_points(const std::vector<LabelRegion>& regions) {
  std::vector<Vec3d> points;
  for (const LabelRegion& region : regions) points.insert(points.end(), region.points.begin(), region.points.end());
  return points;
}

/// Rotation that takes the principal axes `a` to `b`, of the four that differ by the axes' signs the smallest turn.
Mat3d aligning_turn(const Mat3d& a, const Mat3d& b) {
  Mat3d best = Mat3d::identity();
  double smallest = INFINITY;
  for (int flip = 0; flip < 4; ++flip) {
    Mat3d flipped = b;
    for (int row = 0; row < 3; ++row) {
      if (flip & 1) flipped[row][0] = -flipped[row][0];
      if (flip & 2) flipped[row][1] = -flipped[row][1];
      if (flip == 1 || flip == 2) flipped[row][2] = -flipped[row][2];
    }
    const Mat3d turn = flipped * transpose(a);
    const double angle = norm(rotation_vector(turn));
    if (angle < smallest) smallest = angle, best = turn;
  }
  return best;
}

/// Search for one label around a pose.
Pose search_label(const SearchImages& images, const LabelRegion& region, const RigidMotion& around,
                  const SearchRange& range) {
  const Samples samples = sample(images.moving, region.points, points_per_label);
  const SearchRange step{std::max(range.shift_mm / 2, 0.1), std::max(range.turn_rad / 2, 0.1 * degree)};
  return best_pose(samples, images.fixed, poses_around(around, range, step), 4, {2, 2 * degree}, 3);
}

}  // namespace

std::vector<BoneStart> starts_from_labels(const Image& moving, const Image& fixed,
                                          const std::vector<LabelRegion>& regions,
                                          const std::vector<LabelRegion>& fixed_regions,
                                          const BoneMotionOptions& options) {
  const SearchImages images(coarsen(crop(moving, all_points(regions), 20), 1.5),
                            coarsen(crop(fixed, all_points(fixed_regions), 20), 1.5), label_sigma_mm);
  std::vector<BoneStart> starts;
  for (std::size_t r = 0; r < regions.size(); ++r) {
    const LabelRegion& region = regions[r];
    const RigidMotion shifted{region.centroid, Mat3d::identity(), fixed_regions[r].centroid - region.centroid};
    RigidMotion turned = shifted;
    turned.rotation = aligning_turn(region.axes, fixed_regions[r].axes);
    const Samples samples = sample(images.moving, region.points, points_per_label);
    const bool turn = norm(rotation_vector(turned.rotation)) <= options.largest_turn_deg * degree &&
                      similarity(samples, images.fixed, turned) > similarity(samples, images.fixed, shifted);
    const RigidMotion& given = turn ? turned : shifted;
    const double turn_range = std::min(options.largest_turn_deg, 16.0) * degree;
    starts.push_back({given, search_label(images, region, given, {4, turn_range}).motion});
  }
  return starts;
}

std::vector<BoneStart> starts_along_spine(const Image& moving, const Image& fixed,
                                          const std::vector<LabelRegion>& regions, const RigidMotion& global,
                                          const BoneMotionOptions& options) {
  const std::vector<Vec3d> points = all_points(regions);
  const Image moving_part = coarsen(crop(moving, points, 20), 1.5);
  const Image fixed_part = coarsen(crop(fixed, moved(points, global), options.largest_shift_mm + surroundings_mm), 1.5);

  Vec3d center;
  for (const Vec3d& x : points) center += (1.0 / double(points.size())) * x;
  const SearchImages wide(moving_part, fixed_part, spine_sigma_mm);
  const SearchRange range{options.largest_shift_mm, options.largest_turn_deg * degree};
  const RigidMotion spine =
      best_pose(sample(wide.moving, points, points_per_spine), wide.fixed,
                poses_around(recentred(global, center), range, {10, std::max(range.turn_rad / 3, 0.1 * degree)}), 10,
                {5, 4 * degree}, 3)
          .motion;

  const SearchImages images(moving_part, fixed_part, label_sigma_mm);
  std::vector<Pose> poses;
  for (const LabelRegion& region : regions)
    poses.push_back(search_label(images, region, recentred(spine, region.centroid), {8, 8 * degree}));
  for (std::size_t r = 0; r < regions.size(); ++r)  // a bone that is half outside is a poor anchor
    poses[r].similarity *= fraction_inside(moved(regions[r].points, poses[r].motion), fixed);
  const int anchor = int(std::max_element(poses.begin(), poses.end(),
                                          [](const Pose& a, const Pose& b) { return a.similarity < b.similarity; }) -
                         poses.begin());
  for (const int direction : {1, -1})
    for (int r = anchor + direction; r >= 0 && r < int(regions.size()); r += direction) {
      const double distance = norm(regions[r].centroid - regions[r - direction].centroid);
      const SearchRange near{std::min(0.35 * distance, options.largest_shift_mm),
                             std::min(0.4 * distance, options.largest_turn_deg) * degree};
      const RigidMotion expected = recentred(poses[r - direction].motion, regions[r].centroid);
      poses[r] = fraction_inside(moved(regions[r].points, expected), fixed) < visible_enough
                     ? Pose{expected, 0}
                     : search_label(images, regions[r], expected, near);
    }

  std::vector<BoneStart> starts;
  for (std::size_t r = 0; r < regions.size(); ++r)
    starts.push_back({recentred(global, regions[r].centroid), poses[r].motion});
  return starts;
}

}  // namespace mtled
