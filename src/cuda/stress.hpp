#pragma once
#include "core/gather_table.hpp"
#include "core/material.hpp"
#include "cuda/block.hpp"
#include "cuda/step_load.hpp"

/// Pass one: one thread per integration point. Reads its stencil (16 bytes per term in float, shared or own) and 16 bytes of
/// displacement per term; writes 48 bytes. Points of one stencil lie next to each other, so a warp reads the same entries
/// and neighbouring slots. Parameters lie side by side: parameter[c * threads + t], c = 0 the volume, then those of the
/// material in the order of its struct (core/material.hpp). Idle threads (row -1) and points of volume 0 have no ratio.
namespace mtled {

/// Smallest J, and number of points with J <= 0.
template <class Real>
struct VolumeRatios {
  Real smallest;
  int inverted;
};
template <class Real>
MTLED_HD VolumeRatios<Real> no_volume_ratios() { return {Real(1e30), 0}; }
struct Worse {
  template <class Real>
  MTLED_HD VolumeRatios<Real> operator()(const VolumeRatios<Real>& a, const VolumeRatios<Real>& b) const {
    return {b.smallest < a.smallest || b.smallest != b.smallest ? b.smallest : a.smallest, a.inverted + b.inverted};
  }
};

/// sum u (x) grad of a thread's row, summed in T.
template <class T, class Real>
MTLED_HD Mat3<T> displacement_gradient(const GatherTableView<Real>& table, int thread, const Vec4<Real>* u) {
  Mat3<T> G;
  table.each(thread, [&](int slot, const GatherEntry<Real>& g) {
    const Vec4<Real> a = u[slot];
    const T x = T(g.x), y = T(g.y), z = T(g.z);
    G[0][0] += T(a.x) * x, G[0][1] += T(a.x) * y, G[0][2] += T(a.x) * z;
    G[1][0] += T(a.y) * x, G[1][1] += T(a.y) * y, G[1][2] += T(a.y) * z;
    G[2][0] += T(a.z) * x, G[2][1] += T(a.z) * y, G[2][2] += T(a.z) * z;
  });
  return G;
}
template <class T>
MTLED_HD Mat3<T> with_identity(Mat3<T> G) {
  for (int i = 0; i < 3; ++i) G[i][i] += 1;
  return G;
}

template <template <class> class Material, class T, class Real>
MTLED_HD Material<T> material_of_thread(const Real* parameter, int threads, int thread) {
  T value[parameter_count<Material>];
  for (int c = 0; c < parameter_count<Material>; ++c) value[c] = T(parameter[std::size_t(1 + c) * std::size_t(threads) + std::size_t(thread)]);
  return material_of<Material>(value);
}

/// Three arrays of rows, [places] each.
template <class Real>
struct StressRows {
  Vec4<Real>* row[3];
  MTLED_HD void set(int place, Real volume, const Mat3<Real>& P) const {
    for (int i = 0; i < 3; ++i) row[i][place] = {volume * P[i][0], volume * P[i][1], volume * P[i][2], Real(0)};
  }
};

/// volume * P(F(u)) to the place of each point; the volume ratios of each block.
template <template <class> class Material, class Real>
struct StressOfPoints {
  static constexpr int threads = block_threads;
  struct Shared { VolumeRatios<Real> ratio[threads]; };
  GatherTableView<Real> of_points;
  const Real* parameter;      ///< [(1 + parameter_count) * of_points.threads]
  const Vec4<Real>* u;        ///< [slots] [mm]
  StressRows<Real> stress;    ///< [places] [mN mm]
  VolumeRatios<Real>* ratio;  ///< [blocks]
  StepLoad step;

  template <class Block>
  MTLED_HD void operator()(Block& block) const {
    if (step.over()) return;
    block.each_thread([&](int t) {
      const int thread = block.index() * threads + t;
      block.shared().ratio[t] = thread < of_points.threads ? at(thread) : no_volume_ratios<Real>();
    });
    reduce<threads>(block, block.shared().ratio, Worse{});
    block.each_thread([&](int t) {
      if (t == 0) ratio[block.index()] = block.shared().ratio[0];
    });
  }

  MTLED_HD VolumeRatios<Real> at(int thread) const {
    const int place = of_points.row[thread];
    if (place < 0) return no_volume_ratios<Real>();
    const Mat3<Real> F = with_identity(displacement_gradient<Real>(of_points, thread, u));
    const Real volume = parameter[thread];
    Real J;
    const Mat3<Real> P = material_of_thread<Material, Real>(parameter, of_points.threads, thread).stress(F, J);
    stress.set(place, volume, P);
    if (volume == 0) return no_volume_ratios<Real>();
    return {J, J <= 0 ? 1 : 0};
  }
};

/// volume * dP(F(u), dF(v)) to the place of each point. Index functor over the threads of the table; reads both fields.
template <template <class> class Material, class Real>
struct TangentOfPoints {
  GatherTableView<Real> of_points;
  const Real* parameter;
  const Vec4<Real>* u;
  const Vec4<Real>* v;
  StressRows<Real> stress;

  MTLED_HD void operator()(int thread) const {
    const int place = of_points.row[thread];
    if (place < 0) return;
    const Mat3<Real> F = with_identity(displacement_gradient<Real>(of_points, thread, u)), dF = displacement_gradient<Real>(of_points, thread, v);
    stress.set(place, parameter[thread], stress_derivative(material_of_thread<Material, Real>(parameter, of_points.threads, thread), F, dF));
  }
};

/// Strain energy of each block's points [mN mm], all in double.
template <template <class> class Material, class Real>
struct EnergyOfPoints {
  static constexpr int threads = block_threads;
  struct Shared { double sum[threads]; };
  GatherTableView<Real> of_points;
  const Real* parameter;
  const Vec4<Real>* u;
  double* energy;  ///< [blocks]

  template <class Block>
  MTLED_HD void operator()(Block& block) const {
    block.each_thread([&](int t) {
      const int thread = block.index() * threads + t;
      double own = 0;
      if (thread < of_points.threads && of_points.row[thread] >= 0)
        own = double(parameter[thread]) * material_of_thread<Material, double>(parameter, of_points.threads, thread).energy(with_identity(displacement_gradient<double>(of_points, thread, u)));
      block.shared().sum[t] = own;
    });
    reduce<threads>(block, block.shared().sum, Add{});
    block.each_thread([&](int t) {
      if (t == 0) energy[block.index()] = block.shared().sum[0];
    });
  }
};

}  // namespace mtled
