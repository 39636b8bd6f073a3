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

/// Volumes and materials of a pack of points.
template <template <class> class Material, class Real>
struct PackMaterial {
  static constexpr int size = (1 + parameter_count<Material>) * LaneTraits<Real>::width;
  Pack<Real> volume;
  Material<Pack<Real>> material;
  explicit PackMaterial(const Real* m) : volume(load_pack(m)) {
    __builtin_memcpy(static_cast<void*>(&material), m + LaneTraits<Real>::width, sizeof material);
  }
};

/// The stress is handed through `remember(material, F, J, P, place of the pack in the memory)`.
template <template <class> class Material, class Real, class Remember>
inline VolumeRatioStatistics force_range(const PackView<Real>& view, const PackRange& range, const FieldView<Real>& u, const MutableFieldView<Real>& f, const Remember& remember) {
  constexpr int W = LaneTraits<Real>::width;
  using Point = PackMaterial<Material, Real>;
  Pack<Real> smallest = Pack<Real>{} + Real(1e30);
  long inverted = 0;
  const auto stress = [&](Mat3<Pack<Real>>& F, const Point& m, bool aligned, std::size_t pack) {
    deformation_gradient<Real>(F, m.volume);
    Pack<Real> J;
    Mat3<Pack<Real>> P = m.material.stress(F, J);
    remember(m.material, F, J, P, aligned, pack);
    scale<Real>(P, m.volume);
    smallest = J < smallest ? J : smallest;
    const auto bad = J <= 0;
    for (int lane = 0; lane < W; ++lane) inverted -= long(bad[lane]);
    return P;
  };
  for (std::size_t p = range.aligned_begin; p < range.aligned_end; ++p) {
    Mat3<Pack<Real>> F = zero<Real>();
    add_gradient(view, view.aligned_stencil[p], view.aligned_base[p], u, F);
    const Mat3<Pack<Real>> P = stress(F, Point(view.aligned_material + Point::size * p), true, p);
    scatter(view, view.aligned_stencil[p], view.aligned_base[p], P, f);
  }
  for (std::size_t p = range.gathered_begin; p < range.gathered_end; ++p) {
    Mat3<Pack<Real>> F = zero<Real>();
    gather_gradient(view, view.gathered_stencil + W * p, view.gathered_base + W * p, u, F);
    const Mat3<Pack<Real>> P = stress(F, Point(view.gathered_material + Point::size * p), false, p);
    scatter_lanes(view, view.gathered_stencil + W * p, view.gathered_base + W * p, P, f);
  }
  VolumeRatioStatistics statistics;
  for (int lane = 0; lane < W; ++lane)
    if (!(smallest[lane] >= statistics.smallest)) statistics.smallest = double(smallest[lane]);
  statistics.inverted = inverted;
  return statistics;
}

/// S0 - sum gamma in place of S, see MemoryView.
template <template <class> class Material, class Real>
inline void apply_memory(const MemoryView<Real>& memory, Real* gamma, const Material<Pack<Real>>& material, const Mat3<Pack<Real>>& F, const Pack<Real>& J, Mat3<Pack<Real>>& P) {
  constexpr int W = LaneTraits<Real>::width;
  const Mat3<Pack<Real>> cof = cofactors(F);
  const Pack<Real> pressure = material.bulk_modulus * (J - 1), inverse_J = 1 / at_least(J, smallest_isochoric_volume_ratio);
  Mat3<Pack<Real>> volumetric, isochoric;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) {
      volumetric.m[i][j] = pressure * cof.m[i][j];
      isochoric.m[i][j] = P.m[i][j] - volumetric.m[i][j];
      P.m[i][j] = memory.instantaneous[0] * isochoric.m[i][j] + memory.instantaneous[1] * volumetric.m[i][j];
    }
  // F^-1 P is symmetric: six components of each part.
  constexpr int row[6] = {0, 1, 2, 0, 1, 2}, column[6] = {0, 1, 2, 1, 2, 0};
  Mat3<Pack<Real>> faded = zero<Real>();
  for (int c = 0; c < 6; ++c) {
    const int i = row[c], j = column[c];
    Pack<Real> S[2] = {};
    for (int a = 0; a < 3; ++a) S[0] += cof.m[a][i] * isochoric.m[a][j], S[1] += cof.m[a][i] * volumetric.m[a][j];
    for (int t = 0; t < memory.terms; ++t) {
      Real* at = gamma + (6 * t + c) * W;
      const Pack<Real> g = memory.decay[t] * load_pack<Real>(at) + inverse_J * (memory.gain[t][0] * S[0] + memory.gain[t][1] * S[1]);
      store_pack(at, g);
      faded.m[i][j] += g;
    }
    faded.m[j][i] = faded.m[i][j];
  }
  const Mat3<Pack<Real>> Q = F * faded;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) P.m[i][j] -= Q.m[i][j];
}

template <template <class> class Material, class Real>
inline void tangent_range(const PackView<Real>& view, const PackRange& range, const FieldView<Real>& u, const FieldView<Real>& v, const MutableFieldView<Real>& f) {
  constexpr int W = LaneTraits<Real>::width;
  using Point = PackMaterial<Material, Real>;
  const auto stress = [](Mat3<Pack<Real>>& F, Mat3<Pack<Real>>& dF, const Point& m) {
    deformation_gradient<Real>(F, m.volume);
    Mat3<Pack<Real>> dP = stress_derivative(m.material, F, dF);
    scale<Real>(dP, m.volume);
    return dP;
  };
  for (std::size_t p = range.aligned_begin; p < range.aligned_end; ++p) {
    Mat3<Pack<Real>> F = zero<Real>(), dF = zero<Real>();
    add_gradient(view, view.aligned_stencil[p], view.aligned_base[p], u, F);
    add_gradient(view, view.aligned_stencil[p], view.aligned_base[p], v, dF);
    const Mat3<Pack<Real>> dP = stress(F, dF, Point(view.aligned_material + Point::size * p));
    scatter(view, view.aligned_stencil[p], view.aligned_base[p], dP, f);
  }
  for (std::size_t p = range.gathered_begin; p < range.gathered_end; ++p) {
    Mat3<Pack<Real>> F = zero<Real>(), dF = zero<Real>();
    gather_gradient(view, view.gathered_stencil + W * p, view.gathered_base + W * p, u, F);
    gather_gradient(view, view.gathered_stencil + W * p, view.gathered_base + W * p, v, dF);
    const Mat3<Pack<Real>> dP = stress(F, dF, Point(view.gathered_material + Point::size * p));
    scatter_lanes(view, view.gathered_stencil + W * p, view.gathered_base + W * p, dP, f);
  }
}

template <template <class> class Material, class Real>
[[gnu::flatten]] VolumeRatioStatistics force(const PackView<Real>& view, const PackRange& range, const FieldView<Real>& u, const MutableFieldView<Real>& f) {
  return force_range<Material>(view, range, u, f, [](auto&&...) {});
}
template <template <class> class Material, class Real>
[[gnu::flatten]] VolumeRatioStatistics force_in_time(const PackView<Real>& view, const PackRange& range, const FieldView<Real>& u, const MutableFieldView<Real>& f, const MemoryView<Real>& memory) {
  const std::size_t size = std::size_t(memory.terms) * 6 * LaneTraits<Real>::width;
  return force_range<Material>(view, range, u, f, [&](const Material<Pack<Real>>& material, const Mat3<Pack<Real>>& F, const Pack<Real>& J, Mat3<Pack<Real>>& P, bool aligned, std::size_t pack) {
    apply_memory<Material, Real>(memory, (aligned ? memory.aligned : memory.gathered) + size * pack, material, F, J, P);
  });
}
template <template <class> class Material, class Real>
[[gnu::flatten]] void tangent(const PackView<Real>& view, const PackRange& range, const FieldView<Real>& u, const FieldView<Real>& v, const MutableFieldView<Real>& f) {
  tangent_range<Material>(view, range, u, v, f);
}

template <template <class> class Material, class Real>
constexpr MaterialKernels<Real> kernels_of{&force<Material, Real>, &tangent<Material, Real>, &force_in_time<Material, Real>};
template <class Real>
constexpr KernelTable<Real> all_kernels{{kernels_of<NeoHookean, Real>, kernels_of<MooneyRivlin, Real>, kernels_of<Yeoh, Real>, kernels_of<Ogden, Real>, kernels_of<TransverselyIsotropic, Real>}};

}  // namespace

extern const KernelTable<float> float_table;
extern const KernelTable<double> double_table;
const KernelTable<float> float_table = all_kernels<float>;
const KernelTable<double> double_table = all_kernels<double>;

}  // namespace mtled::MTLED_KERNELS
