#pragma once
#include <functional>
#include <string>
#include <vector>

#include "core/solver.hpp"
#include "core/volume.hpp"
#include "imaging/field_difference.hpp"

namespace mtled {

/// An RGB picture, row-major, 3 bytes a pixel.
struct Picture {
  int width = 0, height = 0;
  std::vector<unsigned char> rgb;
};
/// An image to compare with the fixed one, on any grid.
struct Candidate {
  std::string title;  ///< ASCII
  const Image* image;
};
/// Axial, coronal and sagittal slices (LPS, whatever the direction of the voxels) through the middle of the fixed image
/// in grey, with the candidate's edges in orange: where they leave the grey outlines, the images disagree. One row per
/// candidate (e.g. before, rigid, mtled). Soft-tissue window for CT, percentiles otherwise; letters name the patient's
/// sides (axial: left on the right, front up; coronal and sagittal: head up). Throws an input error without candidates.
Picture overlay_figure(const Image& fixed, const std::vector<Candidate>& candidates);
/// |u| in colour, with lines at the labelled values [mm] of the colour bar, on the same three slices of the moving
/// image; coloured where `covered` is not 0.
Picture displacement_figure(const Image& moving, const VectorImage& displacement, const Mask& covered);
/// Shear modulus [kPa] in colour on the same slices, where it is positive; 5 kPa and more (bone) share the last colour.
Picture shear_modulus_figure(const Image& moving, const Image& shear_modulus);
/// How the solver came to its end: estimated error with the tolerance [mm] on a logarithmic axis, convergence rate and
/// strain energy [mN mm] over the relaxation step. NaN is left out: there is no estimate at first, and the energy is
/// computed now and then. Throws an input error without history.
Picture convergence_figure(const std::vector<HistoryEntry>& history, double tolerance_mm);
/// Where and how much a displacement differs from a reference: `difference_on` a slice [mm] in colour on the three slices
/// of the image, the distribution of the difference, and the difference over the displacement. `colors`: what the colours
/// show, for the note below.
Picture field_difference_figure(const Image& image, const std::function<Image(const Grid&)>& difference_on, const FieldDifference& difference, const std::string& colors);

}  // namespace mtled
