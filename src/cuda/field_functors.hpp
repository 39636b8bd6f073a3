#pragma once
#include "core/lattice_field.hpp"
#include "core/rest_position.hpp"
#include "core/volume_view.hpp"

/// Kernels of dense fields: index functors, one thread per voxel. Voxels are done in pieces: index i is voxel first + i, and
/// results lie at [i]. M: terms of the basis, see LatticeFieldView. Neighbouring threads are neighbours along the fastest axis, so they read the same nodes and write side by side.
namespace mtled {

/// u(X) at the voxels X. Reads about 4 x 4 x 4 lattice positions of 16 bytes, writes 13 bytes.
template <int M>
struct ForwardField {
  LatticeDisplacement<M> displacement;
  GridView grid;
  std::size_t first;
  Vec3f* u;            ///< [mm] written where covered
  Coverage* coverage;

  MTLED_HD void operator()(int i) const {
    Vec3d value;
    coverage[i] = displacement(grid.point_at(first + std::size_t(i)), value);
    if (coverage[i] == Coverage::covered) u[i] = {float(value.x), float(value.y), float(value.z)};
  }
};

/// X - y at the voxels y, where X + u(X) = y. Reads 8 voxels of the forward field per step of Newton's method, and for most
/// voxels one u(X); writes 21 bytes.
template <int M>
struct InverseField {
  SolveForRestPosition<LatticeDisplacement<M>> solve;
  GridView grid;
  std::size_t first;
  Vec3f* v;            ///< [mm] written where covered
  Coverage* coverage;
  double* residual;    ///< [mm] 0 where not covered

  MTLED_HD void operator()(int i) const {
    const Vec3d y = grid.point_at(first + std::size_t(i));
    Vec3d X;
    double r = 0;
    coverage[i] = solve(y, X, r);
    residual[i] = coverage[i] == Coverage::covered ? r : 0;
    if (coverage[i] != Coverage::covered) return;
    const Vec3d d = X - y;
    v[i] = {float(d.x), float(d.y), float(d.z)};
  }
};

/// Value of an image at the voxels y moved by v(y). Reads 12 bytes and 1 (nearest), 8 (linear) or 64 (cubic) voxels, writes 4 bytes.
struct WarpVoxels {
  VolumeView<float> samples;    ///< image, or coefficients of its spline
  Interpolation interpolation;
  float outside;
  GridView grid;
  std::size_t first;
  const Vec3f* v;               ///< [mm]
  float* warped;

  MTLED_HD void operator()(int i) const {
    const Vec3d point = grid.point_at(first + std::size_t(i)) + Vec3d{v[i].x, v[i].y, v[i].z};
    warped[i] = sample(samples, point, interpolation, outside);
  }
};

}  // namespace mtled
