#include "core/loads.hpp"

#include <algorithm>

#include "core/error.hpp"
#include "core/parallel.hpp"

namespace mtled {

double History::at(double t) const {
  const std::size_t next = std::size_t(std::upper_bound(time.begin(), time.end(), t) - time.begin());
  if (next == 0) return factor.front();
  if (next == time.size()) return factor.back();
  double s = (t - time[next - 1]) / (time[next] - time[next - 1]);
  if (smooth) s = s * s * s * (10 - 15 * s + 6 * s * s);
  return factor[next - 1] + s * (factor[next] - factor[next - 1]);
}

std::vector<double> lumped_mass(const Approximation& field, const IntegrationPoints& points) {
  std::vector<double> mass(field.cloud().size(), 0.0);
  constexpr std::size_t block = 16384;  // shape functions that are kept at a time
  std::vector<ShapeFunctions> shapes(std::min(block, points.size()));
  for (std::size_t first = 0; first < points.size(); first += block) {
    const std::size_t count = std::min(block, points.size() - first);
    parallel_for(count, [&](std::size_t p) {
      if (!field.at(points.position[first + p], shapes[p])) shapes[p].clear();
    }, 256);
    for (std::size_t p = 0; p < count; ++p)
      for (std::size_t i = 0; i < shapes[p].node.size(); ++i)
        mass[std::size_t(shapes[p].node[i])] += points.density[first + p] * points.volume[first + p] * shapes[p].value[i];
  }
  return mass;
}

std::map<std::string, std::vector<Vec3d>> nodal_forces(const Approximation& field, const Loads& loads, const std::vector<double>& mass) {
  const std::size_t nodes = field.cloud().size();
  std::map<std::string, std::vector<Vec3d>> forces;
  if (loads.gravity != Vec3d{}) {
    std::vector<Vec3d>& weight = forces["gravity"];
    for (double m : mass) weight.push_back(m * loads.gravity);
  }
  for (const std::string& name : loads.set_names) forces[name].resize(nodes);
  ShapeFunctions shapes;
  for (std::size_t p = 0; p < loads.place.size(); ++p) {
    const Vec3d& x = loads.place[p];
    require(field.touches(x) && field.at(x, shapes), "the load of row ", p, " at (", x.x, ", ", x.y, ", ", x.z,
            ") mm lies outside the body; remove it or move it into the body");
    std::vector<Vec3d>& force = forces[loads.set_names[std::size_t(loads.set[p])]];
    for (std::size_t i = 0; i < shapes.node.size(); ++i) force[std::size_t(shapes.node[i])] += shapes.value[i] * loads.force[p];
  }
  return forces;
}

}  // namespace mtled
