#pragma once
#include <cstddef>

#include "core/body_sampling.hpp"

namespace mtled {

enum class CloudKind { lattice, general };

/// A torso made of formulas, 0.40 m x 0.26 m x 0.50 m: an elliptic cylinder that tapers towards its ends, with a rim of fat,
/// lungs, heart, liver, and twelve vertebrae with ribs that move as rigid bodies. It is voxelised and sampled as `register` does with
/// an image, at the node spacing that gives about `nodes` nodes; the same numbers come out everywhere.
/// General cloud: the same nodes, each moved by up to 0.3 spacings along every axis, so that no two supports are alike.
/// Input error: fewer than 500 nodes, at which the vertebrae fall through the nodes.
SampledBody sample_torso(std::size_t nodes, CloudKind kind);

/// Displacement [mm] by which the torso bends forward as one, and its vertebrae with it; near equilibrium, but not there.
Vec3d torso_bending(const Vec3d& x);

}  // namespace mtled
