#pragma once
#include <vector>

#include "core/cloud.hpp"
#include "core/motion.hpp"
#include "core/volume.hpp"

namespace mtled {

struct SamplingOptions {
  double node_spacing_mm = 3.5;
  double smallest_cell = 0.1;     ///< part of a lattice cell that must be body for its corners to become nodes
  double smallest_point = 0.02;   ///< part of an integration cell below which it is left out
  double poisson_ratio = 0.49;    ///< [0, 0.5)
  double density = 1e-6;          ///< [kg/mm^3]
};

/// A body made of nodes and integration points, ready for shape functions.
struct SampledBody {
  Cloud cloud;
  IntegrationPoints points;
  Constraints constraints;        ///< one set per label, named "label N"; displacement from the motions
  std::vector<int> labels_without_nodes;  ///< rigid bodies too thin for this spacing
  double body_volume_mm3 = 0;     ///< of the mask, as sampled
};

/// Samples the body on a lattice along LPS.
///  - Nodes: all corners of lattice cells that are at least `smallest_cell` body, so also just outside it; nodes are
///    prescribed where their voxel has a label that moves.
///  - Points: cells of 4/5 x 4/5 x 3/4 node spacings (2.08 per node), each at the centroid of its part inside the body and
///    weighted by its volume; lattice cells that touch a prescribed node are cut into 2 x 2 x 2 sub-cells instead, and
///    those that are wholly one rigid body need none.
///  - Moduli: arithmetic means of `shear_modulus` and `bulk_modulus` [kPa] over the part inside the body; without the latter,
///    the bulk modulus follows from the Poisson ratio of the options.
/// Input errors: empty mask, too few nodes, a label of `motions` that no voxel has, modulus not positive in the body.
SampledBody sample_body(const Mask& body, const Image& shear_modulus, const LabelImage& labels,
                        const std::vector<LabelMotion>& motions, const SamplingOptions& options, const Image* bulk_modulus = nullptr);

}  // namespace mtled
