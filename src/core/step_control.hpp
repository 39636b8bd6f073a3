#pragma once
#include "core/host_device.hpp"

namespace mtled {

/// Sizes of the steps of the heavy-ball iteration.
struct StepSizes {
  double rho = 0.7;     ///< convergence rate
  double lambda = 1;    ///< largest eigenvalue of P K
};

/// Decides after every step whether to go on, on the device that does the steps, so that many can be done without asking the host.
/// Steps are numbered from 0; one is done when `step` is its number plus one.
struct StepControl {
  enum Verdict { going, calm, impatient, diverged };
  static constexpr int memory = 10;  ///< steps whose largest increment makes the estimate

  // Settings.
  int ramp = 0;               ///< steps over which the load rises; 0: it is there from the start
  double factor = 1;          ///< of the largest increment: error estimate rho / (1 - rho), with a margin on rho
  double tolerance = 0.05;    ///< of the estimate [mm]
  int consecutive = 20;       ///< steps with an estimate below the tolerance, after which the verdict is calm
  int may_stop_from = 0;      ///< step before which the estimate means nothing
  int impatient_from = 0;     ///< step from which the verdict is impatient, once it may stop
  double largest_increment = 0;  ///< beyond which it has diverged [mm]
  int longest_inversion = 1000;  ///< steps in a row with points inside out, after which it has diverged

  // State.
  int step = 0;
  int calm_for = 0, inverted_for = 0;
  int remembered = 0;         ///< steps since recent was cleared, at most `memory`
  double recent[memory] = {};
  double largest = 0;         ///< component of the last increment at the watched nodes [mm]
  double estimate = 0;        ///< of the error after the last step [mm]
  int verdict = going;

  /// Load of the step that comes next: a smooth rise without velocity and acceleration at both ends.
  MTLED_HD double load() const {
    if (step >= ramp) return 1;
    const double t = double(step + 1) / ramp;
    return t * t * t * (10 - 15 * t + 6 * t * t);
  }

  /// Books a step: its largest increment [mm] (NaN when it is not finite), and the points inside out before it.
  MTLED_HD void after_step(double largest_of_step, long inverted) {
    largest = largest_of_step;
    inverted_for = inverted > 0 ? inverted_for + 1 : 0;
    recent[step % memory] = largest;
    ++step;
    if (remembered < memory) ++remembered;
    double top = 0;
    for (int i = 1; i <= remembered; ++i) {
      const double r = recent[(step - i) % memory];
      if (r > top) top = r;
    }
    estimate = factor * top;
    if (!(largest < largest_increment) || inverted_for >= longest_inversion) {
      verdict = diverged;
      return;
    }
    const bool may_stop = step > may_stop_from;
    calm_for = may_stop && estimate < tolerance ? calm_for + 1 : 0;
    if (calm_for >= consecutive) verdict = calm;
    else if (may_stop && step > impatient_from) verdict = impatient;
  }
};

}  // namespace mtled
