// Forces of one range of packs. Compiled once per instruction set (MTLED_KERNELS names the namespace), so that nothing
// here may leave a shared inline function behind: every kernel is flattened, and only raw pointers are used.
//
// Per aligned pack and support node: 3 pack loads of u, 9 multiply-adds; then the stress of W points at once; then 9
// multiply-adds and 3 pack additions to f. Gathered packs do the same point by point with quads of four.
#include "core/cpu_kernels.hpp"

#include "core/lanes.hpp"
#include "core/material.hpp"

namespace mtled::MTLED_KERNELS {
namespace {

template <class Real>
using Pack = typename LaneTraits<Real>::Pack;
template <class Real>
using Quad = typename LaneTraits<Real>::Quad;

/// Adds u ⊗ grad phi over the supports of an aligned pack.
template <class Real>
inline void add_gradient(const PackView<Real>& view, int stencil, int base, const FieldView<Real>& u, Mat3<Pack<Real>>& G) {
  for (int s = view.begin[stencil]; s < view.begin[stencil + 1]; ++s) {
    const Real* g = view.gradient + 4 * std::size_t(s);
    const std::ptrdiff_t slot = std::ptrdiff_t(base) + view.offset[s];
    for (int i = 0; i < 3; ++i) {
      const Pack<Real> ui = load_pack(u.c[i] + slot);
      G.m[i][0] += ui * g[0], G.m[i][1] += ui * g[1], G.m[i][2] += ui * g[2];
    }
  }
}

template <class Real>
inline void scatter(const PackView<Real>& view, int stencil, int base, const Mat3<Pack<Real>>& P, const MutableFieldView<Real>& f) {
  for (int s = view.begin[stencil]; s < view.begin[stencil + 1]; ++s) {
    const Real* g = view.gradient + 4 * std::size_t(s);
    const std::ptrdiff_t slot = std::ptrdiff_t(base) + view.offset[s];
    for (int i = 0; i < 3; ++i) {
      Real* to = f.c[i] + slot;
      store_pack(to, load_pack<Real>(to) + (P.m[i][0] * g[0] + P.m[i][1] * g[1] + P.m[i][2] * g[2]));
    }
  }
}

/// The same for W points of their own stencils: lane by lane.
template <class Real>
inline void gather_gradient(const PackView<Real>& view, const int* stencil, const int* base, const FieldView<Real>& u, Mat3<Pack<Real>>& G) {
  for (int lane = 0; lane < LaneTraits<Real>::width; ++lane) {
    if (stencil[lane] < 0) continue;
    Quad<Real> row[3] = {};
    for (int s = view.begin[stencil[lane]]; s < view.begin[stencil[lane] + 1]; ++s) {
      Quad<Real> g;
      __builtin_memcpy(&g, view.gradient + 4 * std::size_t(s), sizeof g);
      const std::ptrdiff_t slot = std::ptrdiff_t(base[lane]) + view.offset[s];
      for (int i = 0; i < 3; ++i) row[i] += g * u.c[i][slot];
    }
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) G.m[i][j][lane] += row[i][j];
  }
}

template <class Real>
inline void scatter_lanes(const PackView<Real>& view, const int* stencil, const int* base, const Mat3<Pack<Real>>& P, const MutableFieldView<Real>& f) {
  for (int lane = 0; lane < LaneTraits<Real>::width; ++lane) {
    if (stencil[lane] < 0) continue;
    Quad<Real> column[3];
    for (int j = 0; j < 3; ++j) column[j] = Quad<Real>{P.m[0][j][lane], P.m[1][j][lane], P.m[2][j][lane], Real(0)};
    for (int s = view.begin[stencil[lane]]; s < view.begin[stencil[lane] + 1]; ++s) {
      const Real* g = view.gradient + 4 * std::size_t(s);
      const std::ptrdiff_t slot = std::ptrdiff_t(base[lane]) + view.offset[s];
      const Quad<Real> force = column[0] * g[0] + column[1] * g[1] + column[2] * g[2];
      for (int i = 0; i < 3; ++i) f.c[i][slot] += force[i];
    }
  }
}

template <class Real>
inline Mat3<Pack<Real>> zero() {
  Mat3<Pack<Real>> a;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) a.m[i][j] = Pack<Real>{};
  return a;
}

/// F = I + G, and I in idle lanes.
template <class Real>
inline void deformation_gradient(Mat3<Pack<Real>>& G, const Pack<Real>& volume) {
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) {
      G.m[i][j] = volume > 0 ? G.m[i][j] : Pack<Real>{};
      if (i == j) G.m[i][j] += 1;
    }
}

template <class Real>
inline void scale(Mat3<Pack<Real>>& P, const Pack<Real>& volume) {
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) P.m[i][j] *= volume;
}

template <class Real>
struct Material {
  Pack<Real> volume, shear, bulk;
  explicit Material(const Real* m)
      : volume(load_pack(m)), shear(load_pack(m + LaneTraits<Real>::width)), bulk(load_pack(m + 2 * LaneTraits<Real>::width)) {}
};

template <class Real>
inline VolumeRatioStatistics force_range(const PackView<Real>& view, const PackRange& range, const FieldView<Real>& u, const MutableFieldView<Real>& f) {
  constexpr int W = LaneTraits<Real>::width;
  Pack<Real> smallest = Pack<Real>{} + Real(1e30);
  long inverted = 0;
  const auto stress = [&](Mat3<Pack<Real>>& F, const Material<Real>& m) {
    deformation_gradient<Real>(F, m.volume);
    Pack<Real> J;
    Mat3<Pack<Real>> P = NeoHookean<Pack<Real>>{m.shear, m.bulk}.stress(F, J);
    scale<Real>(P, m.volume);
    smallest = J < smallest ? J : smallest;
    const auto bad = J <= 0;
    for (int lane = 0; lane < W; ++lane) inverted -= long(bad[lane]);
    return P;
  };
  for (std::size_t p = range.aligned_begin; p < range.aligned_end; ++p) {
    Mat3<Pack<Real>> F = zero<Real>();
    add_gradient(view, view.aligned_stencil[p], view.aligned_base[p], u, F);
    const Mat3<Pack<Real>> P = stress(F, Material<Real>(view.aligned_material + 3 * W * p));
    scatter(view, view.aligned_stencil[p], view.aligned_base[p], P, f);
  }
  for (std::size_t p = range.gathered_begin; p < range.gathered_end; ++p) {
    Mat3<Pack<Real>> F = zero<Real>();
    gather_gradient(view, view.gathered_stencil + W * p, view.gathered_base + W * p, u, F);
    const Mat3<Pack<Real>> P = stress(F, Material<Real>(view.gathered_material + 3 * W * p));
    scatter_lanes(view, view.gathered_stencil + W * p, view.gathered_base + W * p, P, f);
  }
  VolumeRatioStatistics statistics;
  for (int lane = 0; lane < W; ++lane)
    if (!(smallest[lane] >= statistics.smallest)) statistics.smallest = double(smallest[lane]);
  statistics.inverted = inverted;
  return statistics;
}

template <class Real>
inline void tangent_range(const PackView<Real>& view, const PackRange& range, const FieldView<Real>& u, const FieldView<Real>& v, const MutableFieldView<Real>& f) {
  constexpr int W = LaneTraits<Real>::width;
  const auto stress = [](Mat3<Pack<Real>>& F, Mat3<Pack<Real>>& dF, const Material<Real>& m) {
    deformation_gradient<Real>(F, m.volume);
    Mat3<Pack<Real>> dP = NeoHookean<Pack<Real>>{m.shear, m.bulk}.stress_derivative(F, dF);
    scale<Real>(dP, m.volume);
    return dP;
  };
  for (std::size_t p = range.aligned_begin; p < range.aligned_end; ++p) {
    Mat3<Pack<Real>> F = zero<Real>(), dF = zero<Real>();
    add_gradient(view, view.aligned_stencil[p], view.aligned_base[p], u, F);
    add_gradient(view, view.aligned_stencil[p], view.aligned_base[p], v, dF);
    const Mat3<Pack<Real>> dP = stress(F, dF, Material<Real>(view.aligned_material + 3 * W * p));
    scatter(view, view.aligned_stencil[p], view.aligned_base[p], dP, f);
  }
  for (std::size_t p = range.gathered_begin; p < range.gathered_end; ++p) {
    Mat3<Pack<Real>> F = zero<Real>(), dF = zero<Real>();
    gather_gradient(view, view.gathered_stencil + W * p, view.gathered_base + W * p, u, F);
    gather_gradient(view, view.gathered_stencil + W * p, view.gathered_base + W * p, v, dF);
    const Mat3<Pack<Real>> dP = stress(F, dF, Material<Real>(view.gathered_material + 3 * W * p));
    scatter_lanes(view, view.gathered_stencil + W * p, view.gathered_base + W * p, dP, f);
  }
}

}  // namespace

#define MTLED_FLAT [[gnu::flatten]]
MTLED_FLAT VolumeRatioStatistics force_float(const PackView<float>& v, const PackRange& r, const FieldView<float>& u, const MutableFieldView<float>& f) { return force_range(v, r, u, f); }
MTLED_FLAT VolumeRatioStatistics force_double(const PackView<double>& v, const PackRange& r, const FieldView<double>& u, const MutableFieldView<double>& f) { return force_range(v, r, u, f); }
MTLED_FLAT void tangent_float(const PackView<float>& v, const PackRange& r, const FieldView<float>& u, const FieldView<float>& d, const MutableFieldView<float>& f) { tangent_range(v, r, u, d, f); }
MTLED_FLAT void tangent_double(const PackView<double>& v, const PackRange& r, const FieldView<double>& u, const FieldView<double>& d, const MutableFieldView<double>& f) { tangent_range(v, r, u, d, f); }
extern const KernelTable<float> float_table;
extern const KernelTable<double> double_table;
const KernelTable<float> float_table{&force_float, &tangent_float};
const KernelTable<double> double_table{&force_double, &tangent_double};

}  // namespace mtled::MTLED_KERNELS
