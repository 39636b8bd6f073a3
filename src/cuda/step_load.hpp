#pragma once
#include "core/step_control.hpp"

namespace mtled {

/// The load of a force evaluation: a given one, or that of the next step of a control in device memory. There, kernels
/// return at once after the verdict: steps that were queued beyond it change nothing.
struct StepLoad {
  const StepControl* control = nullptr;
  double given = 1;

  MTLED_HD bool over() const { return control && control->verdict != StepControl::going; }
  MTLED_HD double load() const { return control ? control->load() : given; }
  /// Whether prescribed parameters that depend on no others are imposed: they stay as they are once the load is there.
  MTLED_HD bool imposes() const { return !control || control->step <= control->ramp; }
};

}  // namespace mtled
