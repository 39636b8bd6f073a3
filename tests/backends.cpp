#include "backends.hpp"

#include "cuda/device_mechanics.hpp"
#include "cuda/serial_device.hpp"

namespace mtled::backends {

MakeMechanics mechanics_of(Backend backend) {
  switch (backend) {
    case Backend::cpu: return make_cpu_mechanics;
    case Backend::serial:
      return [](const DiscreteModel& model, const SolverOptions& options) -> std::unique_ptr<Mechanics> {
        if (options.double_precision) return std::make_unique<DeviceMechanics<double, SerialDevice>>(model, options);
        return std::make_unique<DeviceMechanics<float, SerialDevice>>(model, options);
      };
    case Backend::cuda: return cuda_mechanics(device().ordinal);
  }
  return {};
}

}  // namespace mtled::backends
