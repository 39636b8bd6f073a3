#pragma once
#include <array>
#include <map>
#include <vector>

#include "core/volume.hpp"

namespace mtled {

/// Area [mm^2] of an organ's surface within a cell between eight voxel centres, by the corners that are inside: bit b is
/// the corner at index (b & 1, b >> 1 & 1, b >> 2 & 1). As in marching cubes (Lorensen and Cline 1987), the surface cuts
/// edges with one end inside in their middle. Of a cell and its complement it is the same one: with at most four corners
/// inside, those at opposite corners of a face are cut off one by one. Its polygons are divided into the triangles that
/// have the largest total area where the spacing is 1 on all axes (no ties: the other divisions of flat polygons are
/// equal). These are the areas of DeepMind's `surface-distance`, which the Learn2Reg challenge uses.
std::array<double, 256> surface_areas_in_cells(const Vec3d& spacing);

/// A piece of surface: the middle of its cell, and its area [mm^2].
struct SurfaceElement {
  Vec3d position;
  double area;
};
/// Per label, the cells that its surface passes; beyond the image is outside.
std::map<int, std::vector<SurfaceElement>> surface_elements(const LabelImage& labels);

/// The distance [mm] that `percent` per cent of the area of one surface do not exceed to the cells of the other, the
/// larger one of both directions. NaN when one is empty.
double hausdorff_by_area(const std::vector<SurfaceElement>& a, const std::vector<SurfaceElement>& b, double percent);

}  // namespace mtled
