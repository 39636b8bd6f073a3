#include "imaging/label_region.hpp"

#include <itkSymmetricEigenAnalysis.h>

#include <algorithm>
#include <cmath>
#include <map>

#include "imaging/morphology.hpp"

namespace mtled {
namespace {

struct Box {
  int low[3] = {INT32_MAX, INT32_MAX, INT32_MAX};
  int high[3] = {-1, -1, -1};
  void include(const int (&index)[3]) {
    for (int a = 0; a < 3; ++a) low[a] = std::min(low[a], index[a]), high[a] = std::max(high[a], index[a]);
  }
};

std::map<int, Box> bounding_boxes(const LabelImage& labels) {
  std::map<int, Box> boxes;
  const auto& n = labels.grid.size;
  for (int k = 0; k < n[2]; ++k)
    for (int j = 0; j < n[1]; ++j)
      for (int i = 0; i < n[0]; ++i)
        if (const int label = labels.at(i, j, k); label != 0) boxes[label].include({i, j, k});
  return boxes;
}

void measure_shape(LabelRegion& region) {
  for (const Vec3d& x : region.voxels) region.centroid += x;
  region.centroid = (1.0 / double(region.voxels.size())) * region.centroid;
  itk::Matrix<double, 3, 3> covariance, rows;
  covariance.Fill(0);
  rows.Fill(0);
  for (const Vec3d& x : region.voxels) {
    const Vec3d d = x - region.centroid;
    for (int a = 0; a < 3; ++a)
      for (int b = 0; b < 3; ++b) covariance(a, b) += d[a] * d[b];
  }
  itk::Vector<double, 3> ascending(0.0);
  itk::SymmetricEigenAnalysis<itk::Matrix<double, 3, 3>, itk::Vector<double, 3>, itk::Matrix<double, 3, 3>> analysis(3);
  analysis.ComputeEigenValuesAndVectors(covariance, ascending, rows);
  for (int a = 0; a < 3; ++a) region.axes[a][0] = rows(2, a), region.axes[a][1] = rows(1, a);
  const Vec3d third = cross(Vec3d{region.axes[0][0], region.axes[1][0], region.axes[2][0]},
                            Vec3d{region.axes[0][1], region.axes[1][1], region.axes[2][1]});
  for (int a = 0; a < 3; ++a) region.axes[a][2] = third[a];
}

LabelRegion region_in(const LabelImage& labels, int label, const Box& box, double margin_mm) {
  LabelRegion region;
  region.label = label;
  Grid grid = labels.grid;
  int first[3];
  for (int a = 0; a < 3; ++a) {
    const int margin = int(std::ceil(margin_mm / grid.spacing[a]));
    first[a] = std::max(box.low[a] - margin, 0);
    grid.size[a] = std::min(box.high[a] + margin, labels.grid.size[a] - 1) - first[a] + 1;
    region.touches_border |= box.low[a] == 0 || box.high[a] == labels.grid.size[a] - 1;
  }
  const auto label_at = [&](int i, int j, int k) { return labels.at(first[0] + i, first[1] + j, first[2] + k); };
  grid.origin = labels.grid.point(first[0], first[1], first[2]);
  Mask inside(grid);
  for (int k = 0; k < grid.size[2]; ++k)
    for (int j = 0; j < grid.size[1]; ++j)
      for (int i = 0; i < grid.size[0]; ++i) inside.at(i, j, k) = label_at(i, j, k) == label;
  const Mask around = dilate(inside, margin_mm);
  for (int k = 0; k < grid.size[2]; ++k)
    for (int j = 0; j < grid.size[1]; ++j)
      for (int i = 0; i < grid.size[0]; ++i) {
        const Vec3d x = grid.point(i, j, k);
        if (inside.at(i, j, k)) {
          region.voxels.push_back(x);
          for (int corner = 0; corner < 8; ++corner)
            region.octants.push_back(grid.point(Vec3d{i + (corner & 1 ? 0.25 : -0.25), j + (corner & 2 ? 0.25 : -0.25),
                                                      k + (corner & 4 ? 0.25 : -0.25)}));
        }
        if (inside.at(i, j, k) || (around.at(i, j, k) && label_at(i, j, k) == 0)) region.points.push_back(x);
      }
  measure_shape(region);
  return region;
}

}  // namespace

std::vector<LabelRegion> label_regions(const LabelImage& labels, double margin_mm) {
  std::vector<LabelRegion> regions;
  for (const auto& [label, box] : bounding_boxes(labels)) regions.push_back(region_in(labels, label, box, margin_mm));
  return regions;
}

}  // namespace mtled
