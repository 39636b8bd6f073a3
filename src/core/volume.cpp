#include "core/volume.hpp"

#include "core/volume_view.hpp"

namespace mtled {

bool linear_value(const Image& volume, const Vec3d& point, double& value) { return interpolate_linearly(view_of(volume), point, value); }
bool linear_value(const VectorImage& volume, const Vec3d& point, Vec3d& value) { return interpolate_linearly(view_of(volume), point, value); }

}  // namespace mtled
