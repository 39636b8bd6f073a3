#pragma once
#include <cstdint>
#include <memory>
#include <vector>

#include "core/tensor.hpp"

namespace mtled {

/// Exact nearest neighbour among fixed points [mm] by a KD-tree; queries are safe from many threads.
class NearestPoint {
 public:
  /// `points` must not be empty and must outlive this object.
  explicit NearestPoint(const std::vector<Vec3d>& points);
  ~NearestPoint();

  struct Found {
    std::uint32_t index;
    double squared_distance;  ///< [mm^2]
  };
  Found operator()(const Vec3d& query) const;

 private:
  struct Tree;
  std::unique_ptr<Tree> tree_;
};

}  // namespace mtled
