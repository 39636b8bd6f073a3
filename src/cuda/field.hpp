#pragma once
#include <memory>
#include <vector>

#include "core/field_backend.hpp"

namespace mtled {

class ShapeEvaluator;

/// The dense fields of a body on a lattice on CUDA device `ordinal`. `parameter`: [num_nodes] of the solution [mm]. Device error
/// without CUDA or when the device fails; memory error when its memory is too small; input error unless the nodes are a lattice.
std::unique_ptr<FieldBackend> cuda_field(int ordinal, const ShapeEvaluator& evaluator, const std::vector<Vec3d>& parameter);
/// The same for warps.
SampleDisplaced cuda_sampler(int ordinal);

}  // namespace mtled
