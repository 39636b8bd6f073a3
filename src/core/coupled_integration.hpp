#pragma once
#include "core/approximation.hpp"

namespace mtled {

/// Integration in coupled lattice cells (all eight corners are nodes, some of them prescribed; see ShapeEvaluator). There
/// the shape functions are partly trilinear, and like trilinear finite elements they lock: with several points per cell,
/// each of them asking for nearly constant volume, the cells around rigid bodies are far too stiff at a Poisson ratio of
/// 0.49. One point per cell does not lock but leaves modes without stiffness. Both functions keep total volume and centroid,
/// and return the points as they are when the cloud is no lattice or nothing is prescribed.

/// Points that do not know of the lattice, aligned with its coupled cells: each given point stands for a cube of its volume
/// around it. What of the cube lies in a coupled cell goes to 2 x 2 x 2 points per cell, at the centroids of what the eighths
/// received, with the mean moduli; the rest stays one point. Cells with eight prescribed corners get one point.
IntegrationPoints align_with_coupled_cells(const Approximation& field, const IntegrationPoints& points);

/// Selective reduced integration (Malkus and Hughes 1978): points in a coupled cell keep their shear modulus with k = 2 mu / 3
/// (Poisson ratio 0), and one more point at their centroid, without shear modulus, has the mean of what k lost. Cells with
/// eight prescribed corners stay as they are.
IntegrationPoints reduce_volumetric_integration(const Approximation& field, const IntegrationPoints& points);

}  // namespace mtled
