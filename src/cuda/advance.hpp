#pragma once
#include "cuda/coarse.hpp"
#include "cuda/stress.hpp"

namespace mtled {

/// P f at a slot: the inverse diagonal, 0 where a parameter is not free, and the coarse correction.
template <class Real>
struct Preconditioner {
  const Vec4<Real>* inverse_diagonal;  ///< [slots] [mm/mN]
  CoarseCorrection<Real> coarse;
  MTLED_HD Vec4<Real> at(int slot, const Vec4<Real>* f) const { return inverse_diagonal[slot] * f[slot] + coarse.at(slot); }
  /// Whether any parameter at the slot is free.
  MTLED_HD bool moves(int slot) const {
    const Vec4<Real> d = inverse_diagonal[slot];
    return d.x != 0 || d.y != 0 || d.z != 0;
  }
};

/// g = P f. Index functor over slots; y of the coarse correction is there already.
template <class Real>
struct PreconditionedForce {
  Preconditioner<Real> preconditioner;
  const Vec4<Real>* f;
  Vec4<Real>* g;
  MTLED_HD void operator()(int slot) const { g[slot] = preconditioner.at(slot, f); }
};

/// Factors of a step, in device memory so that a queue of steps need not be made again when they change.
template <class Real>
struct StepFactors {
  Real inertia;  ///< rho^2
  Real scale;    ///< (1 + rho)^2 / lambda
};
template <class Real>
StepFactors<Real> factors_of(const StepSizes& sizes) {
  return {Real(sizes.rho * sizes.rho), Real((1 + sizes.rho) * (1 + sizes.rho) / sizes.lambda)};
}

/// increment = inertia * increment - scale * P f, u += increment, change += increment, one thread per slot; the largest
/// component of the increments at each block's watched slots (not a number where any is not). Reads 81 and writes 48 bytes
/// per slot in float, without the coarse correction; where nothing is free (a lattice's slots are a box, half of it empty
/// around a torso) it reads 16 only.
template <class Real>
struct AdvanceNodes {
  static constexpr int threads = block_threads;
  struct Shared { Real largest[threads]; };
  int slots;
  Preconditioner<Real> preconditioner;
  const StepFactors<Real>* factors;
  const std::uint8_t* watched;  ///< [slots]
  const Vec4<Real>* f;
  Vec4<Real>* u;
  Vec4<Real>* increment;
  Vec4<Real>* change;
  Real* largest;                ///< [blocks]
  StepLoad step;

  template <class Block>
  MTLED_HD void operator()(Block& block) const {
    if (step.over()) return;
    block.each_thread([&](int t) {
      const int slot = block.index() * threads + t;
      Real own = 0;
      if (slot < slots && preconditioner.moves(slot)) {
        const Vec4<Real> d = factors->inertia * increment[slot] - factors->scale * preconditioner.at(slot, f);
        increment[slot] = d;
        u[slot] = u[slot] + d;
        change[slot] = change[slot] + d;
        if (watched[slot]) own = largest_component(d);
      }
      block.shared().largest[t] = own;
    });
    reduce<threads>(block, block.shared().largest, Larger{});
    block.each_thread([&](int t) {
      if (t == 0) largest[block.index()] = block.shared().largest[0];
    });
  }
};

/// Books a step: one block reduces what the blocks of StressOfPoints and AdvanceNodes left, and tells the control.
template <class Real>
struct FinishStep {
  static constexpr int threads = block_threads;
  struct Shared {
    Real largest[threads];
    VolumeRatios<Real> ratio[threads];
  };
  int largest_count, ratio_count;
  const Real* largest;
  const VolumeRatios<Real>* ratio;
  StepControl* control;

  template <class Block>
  MTLED_HD void operator()(Block& block) const {
    if (control->verdict != StepControl::going) return;
    block.each_thread([&](int t) {
      Real top = 0;
      VolumeRatios<Real> worst = no_volume_ratios<Real>();
      for (int i = t; i < largest_count; i += threads) top = larger(top, largest[i]);
      for (int i = t; i < ratio_count; i += threads) worst = Worse{}(worst, ratio[i]);
      block.shared().largest[t] = top, block.shared().ratio[t] = worst;
    });
    reduce<threads>(block, block.shared().largest, Larger{});
    reduce<threads>(block, block.shared().ratio, Worse{});
    block.each_thread([&](int t) {
      if (t == 0) control->after_step(double(block.shared().largest[0]), block.shared().ratio[0].inverted);
    });
  }
};

}  // namespace mtled
