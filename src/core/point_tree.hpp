#pragma once
#include <nanoflann.hpp>
#include <vector>

#include "core/tensor.hpp"

namespace mtled {

struct PointCloudAdaptor {
  const std::vector<Vec3d>& points;
  std::size_t kdtree_get_point_count() const { return points.size(); }
  double kdtree_get_pt(std::size_t i, std::size_t axis) const { return points[i][int(axis)]; }
  template <class Box> bool kdtree_get_bbox(Box&) const { return false; }
};
using PointTree = nanoflann::KDTreeSingleIndexAdaptor<nanoflann::L2_Simple_Adaptor<double, PointCloudAdaptor>, PointCloudAdaptor, 3, std::uint32_t>;

}  // namespace mtled
