#pragma once
#include <string>
#include <vector>

#include "core/volume.hpp"

namespace mtled {

struct CannyOptions {
  double sigma_mm = 2.0;        ///< Gaussian smoothing, the same along all axes
  double lower_threshold = 15;  ///< [intensity/mm] an edge is followed down to this gradient
  double upper_threshold = 40;  ///< [intensity/mm] and starts at this one
};
/// 3-D edges after Canny (1986) in physical space, one voxel thick: Gaussian gradient, non-maximum suppression along
/// the gradient, hysteresis over 26 neighbours; only inside `where` if it is given (what lies outside does not start an
/// edge). ITK's filter takes derivatives per voxel, so that its thresholds depend on spacing and direction; this one's
/// are per mm. Voxels whose gradient points out of the image are no edges; axes of fewer than four voxels are not
/// differentiated. Use the same options for both images of a comparison. Input errors: thresholds, width, `where` on
/// another grid.
Mask canny_edges(const Image& image, const CannyOptions& options, const Mask* where);
/// The same for every slice along k by itself: the 2-D edges of a stack of pictures.
Mask canny_edges_of_slices(const Image& image, const CannyOptions& options, const Mask* where);

/// Distances between the voxel centres of two edge sets [mm]: percentile Hausdorff distance (Mostayed et al. 2013,
/// Garlapati et al. 2015), with and without the round-trip consistency filter. The filter removes large errors, so its
/// figures are biased low: read them together with `kept` and with the figures for all edges. Percentiles interpolate
/// linearly between order statistics.
struct EdgeDistance {
  std::size_t edges_a = 0, edges_b = 0;  ///< edge voxels
  double kept_a = 0, kept_b = 0;         ///< fraction that passes the round trip
  bool comparable() const { return !curve_mm.empty(); }  ///< there are distances
  std::vector<double> percents;          ///< 60, 75, 85, 95
  std::vector<double> hausdorff_mm;      ///< per percent: max of both directions, consistent edges
  std::vector<double> hausdorff_all_mm;  ///< the same for all edges
  std::vector<double> curve_mm;          ///< [100] the same for every percent from 1 to 100, consistent edges
  std::vector<double> curve_all_mm;      ///< [100] the same for all edges
  std::size_t unmatched_a = 0;           ///< edge voxels without a distance: their slice of the other image has no edge
  std::size_t unmatched_b = 0;
  double mean_mm = 0;                    ///< mean distance, max of both directions, consistent edges
  double modified_hausdorff_mm = 0;      ///< M-HD (Sim, Kwon, Park 1999): mean of min(d, 10 mm), max of both
                                         ///< directions, all edges
  double two_voxels_mm = 0;              ///< twice the largest voxel spacing of either grid, or of the source
  double within_two_voxels = 0;          ///< fraction of consistent edges (both directions pooled) closer than that
  double within_two_voxels_all = 0;      ///< the same for all edges; unmatched ones count as far
};
/// Where the nearest edge is looked for: anywhere, or in the same slice along k. Edges of a slice are those of
/// canny_edges_of_slices(); two voxels are then twice the larger spacing within the slice.
enum class EdgeSpace { volume, slices };
/// Of a voxel along the axes in which edges are looked for [mm].
double largest_spacing(const Grid& grid, EdgeSpace space);

/// `round_trip_mm`: x is consistent when nearest_a(nearest_b(x)) lies within it, or x itself is as near; of equally near
/// edges always the same one is taken. The grids may differ (which takes longer), but not by slices. When a set is empty,
/// or no slice has edges of both, there are no distances: the lists are empty, and the means and fractions are 0.
/// `source_voxel_mm`: largest spacing of the image that one of the two was resampled from; 0 if neither was.
EdgeDistance compare_edges(const Mask& edges_a, const Mask& edges_b, double round_trip_mm, EdgeSpace space = EdgeSpace::volume, double source_voxel_mm = 0);

/// Distances of corresponding points [mm]; percentiles as above.
struct PointErrors {
  std::vector<double> distance_mm;
  double mean = 0, median = 0, percentile_95 = 0, maximum = 0;
};
/// Throws an input error when the lists differ in length or are empty.
PointErrors point_errors(const std::vector<Vec3d>& a, const std::vector<Vec3d>& b);

struct LabelOverlap {
  int label = 0;
  double dice = 0;            ///< in [0, 1]
  std::size_t voxels_a = 0, voxels_b = 0;
  double hausdorff95_mm = 0;  ///< 95th percentile of the distance between the centres of surface voxels (a face
                              ///< neighbour differs, or the image ends; axes of one voxel have no neighbours), max of
                              ///< both directions; NaN if one is empty
  double hausdorff95_pooled_mm = 0;        ///< the same percentile of both directions' distances together (MedPy)
  double hausdorff95_learn2reg_mm = 0;     ///< the 95th percentile by area of the distance between surface elements, max of both
                                           ///< directions (see hausdorff_by_area()); NaN too in images of a single slice
  double surface_area_a_mm2 = 0, surface_area_b_mm2 = 0;  ///< of the same elements; NaN in images of a single slice
  double average_surface_distance_mm = 0;  ///< mean of both directions' distances together
};
/// Per label that occurs in either image, ascending; both on the same grid (input error otherwise).
std::vector<LabelOverlap> label_overlap(const LabelImage& a, const LabelImage& b);

}  // namespace mtled
