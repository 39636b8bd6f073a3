#pragma once
#include <cstdint>
#include <string>
#include <vector>

#include "core/tensor.hpp"
#include "io/json.hpp"

namespace mtled {

/// The cloud of nodes as the report shows it: rest positions and displacements [mm], shear moduli [kPa], labels of rigid
/// bodies (0: soft tissue), all [num_nodes]; at most `most` nodes, spread evenly but not regularly, the same in every run.
/// The 255 lowest numbers of labels are kept; nodes of others are shown as soft tissue. Input error: lists of different
/// length.
Json node_cloud(const std::vector<Vec3d>& rest, const std::vector<Vec3d>& displacement, const std::vector<float>& shear_modulus_kpa, const std::vector<float>& label, std::size_t most = 30000);

}  // namespace mtled
