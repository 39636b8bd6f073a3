#include "core/volume.hpp"

#include <algorithm>

namespace mtled {
namespace {

template <class T, class R>
bool interpolate_linearly(const Volume<T>& volume, const Vec3d& point, R& value) {
  const Vec3d c = volume.grid.index(point);
  int low[3], high[3];
  double t[3];
  for (int a = 0; a < 3; ++a) {
    const int n = volume.grid.size[a];
    if (!(c[a] >= -0.5 && c[a] <= n - 0.5)) return false;
    const double clamped = std::clamp(c[a], 0.0, double(n - 1));
    low[a] = std::min(int(clamped), std::max(n - 2, 0));
    high[a] = std::min(low[a] + 1, n - 1);
    t[a] = clamped - low[a];
  }
  value = R{};
  for (int corner = 0; corner < 8; ++corner) {
    const bool i = corner & 1, j = corner & 2, k = corner & 4;
    const double weight = (i ? t[0] : 1 - t[0]) * (j ? t[1] : 1 - t[1]) * (k ? t[2] : 1 - t[2]);
    const T& v = volume.at(i ? high[0] : low[0], j ? high[1] : low[1], k ? high[2] : low[2]);
    if constexpr (std::is_same_v<R, Vec3d>)
      value += weight * Vec3d{v.x, v.y, v.z};
    else
      value += weight * v;
  }
  return true;
}

}  // namespace

bool linear_value(const Image& volume, const Vec3d& point, double& value) { return interpolate_linearly(volume, point, value); }
bool linear_value(const VectorImage& volume, const Vec3d& point, Vec3d& value) { return interpolate_linearly(volume, point, value); }

}  // namespace mtled
