#pragma once
#include <vector>

#include "core/tensor.hpp"

namespace mtled {

/// y = rotation (x - center) + center + translation; x in the moving, y in the fixed image, LPS mm.
struct RigidMotion {
  Vec3d center{};
  Mat3d rotation = Mat3d::identity();
  Vec3d translation{};
  Vec3d apply(const Vec3d& x) const { return rotation * (x - center) + center + translation; }
  Vec3d displacement(const Vec3d& x) const { return apply(x) - x; }
};

struct LabelMotion {
  int label = 0;
  RigidMotion motion;
};

RigidMotion inverse(const RigidMotion& motion);
/// x -> outer(inner(x)), about the centre of `inner`.
RigidMotion compose(const RigidMotion& outer, const RigidMotion& inner);
/// Rotation vector [rad] of a rotation matrix, and back (Rodrigues).
Vec3d rotation_vector(const Mat3d& rotation);
Mat3d rotation_matrix(const Vec3d& rotation_vector);

}  // namespace mtled
