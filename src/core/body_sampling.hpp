#pragma once
#include <string>
#include <vector>

#include "core/approximation.hpp"
#include "core/cloud.hpp"
#include "core/motion.hpp"
#include "core/springs.hpp"
#include "core/volume.hpp"

namespace mtled {

struct SamplingOptions {
  double node_spacing_mm = 3.5;
  double smallest_cell = 0.1;     ///< part of a lattice cell that must be body for its corners to become nodes
  double smallest_point = 0.02;   ///< part of an integration cell below which its soft tissue is left out
  double poisson_ratio = 0.49;    ///< [0, 0.5)
  double density = 1e-6;          ///< [kg/mm^3]
  double rigid_stiffness = 1;     ///< beta of the springs on rigid bodies, see sample_body()
};

/// A body made of nodes and integration points, ready for shape functions.
struct SampledBody {
  Cloud cloud;
  IntegrationPoints points;           ///< of the soft tissue
  SpringPlaces rigid;                 ///< pieces of the rigid bodies, one per integration cell and body, at its centroid; sets "label N"
  std::vector<int> labels_outside;    ///< rigid bodies that no sample of the body meets
  double body_volume_mm3 = 0;         ///< of the mask, as sampled
};

/// Samples the body on a lattice along LPS.
///  - Nodes: all corners of lattice cells that are at least `smallest_cell` body, so also just outside it.
///  - Points: cells of 4/5 x 4/5 x 3/4 node spacings (2.08 per node), each at the centroid of its soft tissue inside the
///    body and weighted by its volume. Moduli: arithmetic means of `shear_modulus` and `bulk_modulus` [kPa] over the same
///    part; without the latter, the bulk modulus follows from the Poisson ratio of the options.
///  - Rigid pieces: what voxels of a label that moves fill of a cell, at the centroid of that. They have no elasticity, but
///    a spring of stiffness beta (k + 4 mu / 3) volume / spacing^2 with the shear modulus of the soft tissue of their cell,
///    or, where it has none, of the mean around their body, and the Poisson ratio of the options: the layer in which the
///    field turns from the motion of the tissue to that of the body is then spacing / sqrt(beta) wide, no thinner than the
///    nodes resolve.
/// Input errors: empty mask, too few nodes, no soft tissue, modulus not positive in soft tissue.
SampledBody sample_body(const Mask& body, const Image& shear_modulus, const LabelImage& labels,
                        const std::vector<LabelMotion>& motions, const SamplingOptions& options, const Image* bulk_modulus = nullptr);

}  // namespace mtled
