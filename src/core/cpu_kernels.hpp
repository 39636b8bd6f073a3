#pragma once
#include <cstddef>

#include "core/material_model.hpp"
#include "core/volume_ratio.hpp"

namespace mtled {

/// Raw views for the CPU kernels. W = LaneTraits<Real>::width points make a pack.
///  - aligned packs: W points of one stencil whose bases are consecutive slots (base, base + 1, ...); idle lanes have
///    volume 0;
///  - gathered packs: any W points; idle lanes have stencil -1 and volume 0.
template <class Real>
struct PackView {
  const int* begin;         ///< [num_stencils + 1]
  const int* offset;        ///< [entries]
  const Real* gradient;     ///< [entries * 4] x, y, z, 0 [1/mm]
  const int* aligned_stencil;   ///< [aligned packs]
  const int* aligned_base;      ///< [aligned packs]
  const Real* aligned_material; ///< [aligned packs * (3 + further parameters) * W] volume, shear modulus, bulk modulus, ...
  const int* gathered_stencil;  ///< [gathered packs * W]
  const int* gathered_base;     ///< [gathered packs * W]
  const Real* gathered_material;///< [gathered packs * (3 + further parameters) * W]
};

/// Packs that one thread works through in order.
struct PackRange {
  std::size_t aligned_begin, aligned_end, gathered_begin, gathered_end;
};

template <class Real>
struct FieldView {
  const Real* c[3];
};
template <class Real>
struct MutableFieldView {
  Real* c[3];
};

/// Memory of a viscoelastic body and what one time step does to it. The response at once, S0, follows from that to long-term
/// moduli, S, part by part: S0 = instantaneous * S. Each term remembers a stress gamma, gamma+ = decay gamma + gain S, where
/// gain has one value per part; the stress is S0 - sum gamma (second Piola-Kirchhoff, six components).
template <class Real>
struct MemoryView {
  static constexpr int most_terms = 3;
  Real* aligned;    ///< [aligned packs * terms * 6 * W] gamma [kPa]
  Real* gathered;   ///< [gathered packs * terms * 6 * W]
  int terms;
  Real instantaneous[2];            ///< isochoric, volumetric
  Real gain[most_terms][2];         ///< isochoric, volumetric
  Real decay[most_terms];
};

/// The kernels of one material. All add to `f`; a range writes only the slots its points support.
template <class Real>
struct MaterialKernels {
  /// f += sum_points volume * P(F(u)) grad phi [mN]
  VolumeRatioStatistics (*force)(const PackView<Real>&, const PackRange&, const FieldView<Real>& u, const MutableFieldView<Real>& f);
  /// f += K(u) v: the derivative of the force at u in the direction v
  void (*tangent)(const PackView<Real>&, const PackRange&, const FieldView<Real>& u, const FieldView<Real>& v, const MutableFieldView<Real>& f);
  /// As force(), with memory, which it advances by one time step.
  VolumeRatioStatistics (*force_in_time)(const PackView<Real>&, const PackRange&, const FieldView<Real>& u, const MutableFieldView<Real>& f, const MemoryView<Real>&);
};

/// The kernels of one instruction set, by MaterialModel.
template <class Real>
struct KernelTable {
  MaterialKernels<Real> of[number_of_material_models];
};

/// The fastest kernels that this processor runs, and their name ("x86-64-v4").
template <class Real>
const KernelTable<Real>& best_kernels();
const char* best_kernels_name();

}  // namespace mtled
