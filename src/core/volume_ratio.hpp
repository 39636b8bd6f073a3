#pragma once

namespace mtled {

/// Smallest J = det F met by a force evaluation, and the number of points with J <= 0.
struct VolumeRatioStatistics {
  double smallest = 1e30;
  long inverted = 0;
};

}  // namespace mtled
