#include "step_traffic.hpp"

namespace mtled {

StepTraffic step_traffic(const DiscreteModel& model, int real, bool fused, int coarse_unknowns) {
  const double R = real, passes = fused ? 1 : 2, force = 2 * 3 * R;
  const double nodes = double(model.field->cloud().size()), points = double(model.points->size() - model.supports.dropped.size());
  StepTraffic bytes;
  bytes.tables = passes * ((3 * R + 4) * double(model.supports.gradient.size()) + 8 * points + (R + 4) * double(model.springs.node.size())) + 3 * R * points +
                 4 * R * double(model.springs.size());
  bytes.displacement = 3 * R * nodes;
  bytes.stresses = fused ? 0 : 2 * 9 * R * points;
  bytes.state = (7 * 3 * R + 1 + (fused ? force : 0)) * nodes;
  if (coarse_unknowns > 0) bytes.coarse = (fused ? 0 : force) * nodes + 4.0 * coarse_unknowns * coarse_unknowns;
  return bytes;
}

}  // namespace mtled
