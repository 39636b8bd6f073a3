#include <algorithm>
#include <cmath>

#include "core/error.hpp"
#include "imaging/bone_motion.hpp"

namespace mtled {
namespace {

constexpr double degrees = 57.29577951308232;

/// How the upper of two neighbours moves against the lower one.
struct Joint {
  int lower = 0, upper = 0;
  double turn_deg = 0;
  double gap_mm = 0;       ///< distance between the images of the point midway between the centres
  double slide_mm = 0;     ///< part of the gap along the line through the centres
  double distance_mm = 0;  ///< of the centres
};

Joint joint_between(const LabelMotion& lower, const LabelMotion& upper) {
  const RigidMotion &a = lower.motion, &b = upper.motion;
  const Vec3d along = b.center - a.center, middle = 0.5 * (a.center + b.center);
  const Vec3d gap = b.apply(middle) - a.apply(middle);
  Joint joint{lower.label, upper.label, norm(rotation_vector(b.rotation * transpose(a.rotation))) * degrees,
              norm(gap),   0,           norm(along)};
  if (joint.distance_mm > 0) joint.slide_mm = dot(gap, a.rotation * along) / joint.distance_mm;
  return joint;
}

double median(std::vector<double> values) {
  std::nth_element(values.begin(), values.begin() + std::ptrdiff_t(values.size() / 2), values.end());
  return values[values.size() / 2];
}

}  // namespace

std::vector<std::string> implausible_neighbours(const std::vector<LabelMotion>& motions) {
  std::vector<LabelMotion> ordered = motions;
  std::sort(ordered.begin(), ordered.end(), [](const auto& a, const auto& b) { return a.label < b.label; });
  std::vector<Joint> joints;
  std::vector<double> turns, gaps;
  for (std::size_t i = 1; i < ordered.size(); ++i)
    if (ordered[i].label == ordered[i - 1].label + 1) {
      joints.push_back(joint_between(ordered[i - 1], ordered[i]));
      turns.push_back(joints.back().turn_deg);
      gaps.push_back(joints.back().gap_mm);
    }
  if (joints.empty()) return {};
  // A healthy joint turns by up to about 15 deg and hardly gapes; relative limits allow for odd centres and label maps,
  // fixed ones hold where most joints are wrong and the median with them.
  constexpr double most_turn_deg = 25, most_gap_mm = 25;
  const double turn_limit = std::min(std::max(8.0, 3 * median(turns) + 5), most_turn_deg);
  const double gap_limit = std::min(std::max(5.0, 3 * median(gaps) + 3), most_gap_mm);

  std::vector<std::string> warnings;
  for (const Joint& joint : joints) {
    const std::string pair = concatenate("labels ", joint.lower, " and ", joint.upper);
    if (joint.distance_mm > 0 && std::abs(joint.slide_mm) > 0.6 * joint.distance_mm &&
        std::abs(joint.slide_mm) < 1.4 * joint.distance_mm)
      warnings.push_back(concatenate(pair, " move ", std::abs(joint.slide_mm),
                                     joint.slide_mm > 0 ? " mm apart" : " mm together",
                                     " along the spine, about the distance between them (", joint.distance_mm,
                                     " mm): one of them was probably taken for its neighbour"));
    else if (joint.gap_mm > gap_limit)
      warnings.push_back(concatenate(pair, " shift by ", joint.gap_mm,
                                     " mm against each other (median of all neighbours ", median(gaps),
                                     " mm): check both registrations"));
    if (joint.turn_deg > turn_limit)
      warnings.push_back(concatenate(pair, " turn by ", joint.turn_deg,
                                     " deg against each other (median of all neighbours ", median(turns),
                                     " deg): check both registrations"));
  }
  return warnings;
}

}  // namespace mtled
