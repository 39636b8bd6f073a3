#pragma once
#include <optional>
#include <string>
#include <vector>

#include "core/volume.hpp"

namespace mtled {

struct CannyOptions {
  double sigma_mm = 2.0;         ///< Gaussian smoothing
  double lower_threshold = 15;   ///< [intensity/mm] hysteresis
  double upper_threshold = 40;
};
/// 3-D Canny edges (ITK), only inside `where` if it is given. Same parameters for both images of a comparison.
Mask canny_edges(const Image& image, const CannyOptions& options, const Mask* where);

/// Directed distances between two edge sets [mm], percentile Hausdorff distance (Mostayed et al. 2013, Garlapati et al.
/// 2015), with and without the round-trip consistency filter.
struct EdgeDistance {
  std::size_t edges_a = 0, edges_b = 0;              ///< edge voxels
  double kept_a = 0, kept_b = 0;                     ///< fraction that passes the round trip
  std::vector<double> percents;                      ///< 60, 75, 85, 95
  std::vector<double> hausdorff_mm;                  ///< per percent: max of both directions, consistent edges
  std::vector<double> hausdorff_all_mm;              ///< the same for all edges
  double mean_mm = 0;                                ///< mean distance, max of both directions, consistent edges
  double modified_hausdorff_mm = 0;                  ///< M-HD (Sim, Kwon, Park 1999): mean of min(d, 10 mm), max of both
  double within_two_voxels = 0;                      ///< fraction of consistent edges (both directions pooled) closer than
                                                     ///< twice the largest voxel spacing
  double within_two_voxels_all = 0;                  ///< the same for all edges
};
/// `round_trip_mm`: x is consistent when nearest_a(nearest_b(x)) lies within it.
EdgeDistance compare_edges(const Mask& edges_a, const Mask& edges_b, double round_trip_mm);

/// Distances of corresponding points [mm].
struct PointErrors {
  std::vector<double> distance_mm;
  double mean = 0, median = 0, percentile_95 = 0, maximum = 0;
};
PointErrors point_errors(const std::vector<Vec3d>& a, const std::vector<Vec3d>& b);

struct LabelOverlap {
  int label = 0;
  double dice = 0;               ///< in [0, 1]
  double hausdorff95_mm = 0;     ///< 95th percentile of surface distance, max of both directions; NaN if one is empty
};
/// Per label that occurs in either image; both on the same grid (input error otherwise).
std::vector<LabelOverlap> label_overlap(const LabelImage& a, const LabelImage& b);

}  // namespace mtled
