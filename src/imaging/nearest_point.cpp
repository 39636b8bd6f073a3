#include "imaging/nearest_point.hpp"

#include <nanoflann.hpp>

namespace mtled {

struct NearestPoint::Tree {
  struct Points {
    const std::vector<Vec3d>& values;
    std::size_t kdtree_get_point_count() const { return values.size(); }
    double kdtree_get_pt(std::size_t i, std::size_t axis) const { return values[i][int(axis)]; }
    template <class Box>
    bool kdtree_get_bbox(Box&) const {
      return false;
    }
  };
  using Index =
      nanoflann::KDTreeSingleIndexAdaptor<nanoflann::L2_Simple_Adaptor<double, Points>, Points, 3, std::uint32_t>;

  explicit Tree(const std::vector<Vec3d>& values) : points{values}, index(3, points) { index.buildIndex(); }
  Points points;
  Index index;
};

NearestPoint::NearestPoint(const std::vector<Vec3d>& points) : tree_(std::make_unique<Tree>(points)) {}
NearestPoint::~NearestPoint() = default;

NearestPoint::Found NearestPoint::operator()(const Vec3d& query) const {
  const double point[3] = {query.x, query.y, query.z};
  Found found{};
  tree_->index.knnSearch(point, 1, &found.index, &found.squared_distance);
  return found;
}

}  // namespace mtled
