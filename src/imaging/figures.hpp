#pragma once
#include <string>
#include <vector>

#include "core/volume.hpp"

namespace mtled {

/// An RGB picture, row-major, 3 bytes a pixel.
struct Picture {
  int width = 0, height = 0;
  std::vector<unsigned char> rgb;
};
/// Three orthogonal slices through the middle of the fixed image with the edges of another image on top: columns axial,
/// coronal, sagittal; rows: one per entry of `candidates` (e.g. before, rigid, mtled), each titled in the picture.
struct Candidate { std::string title; const Image* image; };
Picture overlay_figure(const Image& fixed, const std::vector<Candidate>& candidates);
/// |u| on the three slices with a colour bar labelled in mm, on top of the moving image.
Picture displacement_figure(const Image& moving, const VectorImage& displacement, const Mask& covered);

}  // namespace mtled
