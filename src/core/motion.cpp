#include "core/motion.hpp"

#include <Eigen/Geometry>

namespace mtled {

RigidMotion inverse(const RigidMotion& motion) {
  const Mat3d back = transpose(motion.rotation);
  return {motion.center + motion.translation, back, Vec3d{} - motion.translation};
}

RigidMotion compose(const RigidMotion& outer, const RigidMotion& inner) {
  return {inner.center, outer.rotation * inner.rotation, outer.apply(inner.apply(inner.center)) - inner.center};
}

Vec3d rotation_vector(const Mat3d& rotation) {
  Eigen::Matrix3d r;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) r(i, j) = rotation[i][j];
  const Eigen::AngleAxisd turn(r);
  const Eigen::Vector3d v = turn.angle() * turn.axis();
  return {v.x(), v.y(), v.z()};
}

Mat3d rotation_matrix(const Vec3d& vector) {
  const double angle = norm(vector);
  if (angle == 0) return Mat3d::identity();
  const Eigen::Matrix3d r = Eigen::AngleAxisd(angle, Eigen::Vector3d(vector.x, vector.y, vector.z) / angle).toRotationMatrix();
  Mat3d result;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) result[i][j] = r(i, j);
  return result;
}

}  // namespace mtled
