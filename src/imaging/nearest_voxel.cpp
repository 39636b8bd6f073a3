#include "imaging/nearest_voxel.hpp"

#include <algorithm>
#include <limits>
#include <vector>

#include "core/error.hpp"
#include "core/parallel.hpp"

namespace mtled {
namespace {

constexpr std::uint16_t no_voxel = 65535;
constexpr double infinite = std::numeric_limits<double>::infinity();

double square(double x) { return x * x; }

/// Per voxel of a row of n, the nearest marked i; no_voxel where none is.
void nearest_in_row(const std::uint8_t* marked, int n, std::uint16_t* nearest) {
  std::uint16_t last = no_voxel;
  for (int i = 0; i < n; ++i) nearest[i] = last = marked[i] ? std::uint16_t(i) : last;
  std::uint16_t next = no_voxel;
  for (int i = n - 1; i >= 0; --i) {
    if (marked[i]) next = std::uint16_t(i);
    if (next != no_voxel && (nearest[i] == no_voxel || next - i < i - nearest[i])) nearest[i] = next;
  }
}

/// Lower envelope of the parabolas height + spacing^2 (x - at)^2, added by rising `at`.
class Envelope {
 public:
  explicit Envelope(int most) : at_(std::size_t(most)), height_(std::size_t(most)), begins_(std::size_t(most)) {}
  void clear() { count_ = 0; }
  bool empty() const { return count_ == 0; }
  /// `height` in squared spacings.
  void add(int at, double height) {
    double begin = -infinite;
    while (count_ > 0) {
      const double top = at_[count_ - 1];
      begin = (height - height_[count_ - 1] + square(at) - square(top)) / (2 * (at - top));
      if (begin > begins_[count_ - 1]) break;
      --count_;
    }
    at_[count_] = at, height_[count_] = height, begins_[count_] = count_ ? begin : -infinite;
    ++count_;
  }
  /// Calls work(x, at) for x = 0, 1, ... n - 1 with the place of the lowest parabola.
  template <class Work>
  void walk(int n, const Work& work) const {
    std::size_t p = 0;
    for (int x = 0; x < n; ++x) {
      while (p + 1 < count_ && begins_[p + 1] < x) ++p;
      work(x, at_[p]);
    }
  }

 private:
  std::vector<int> at_;
  std::vector<double> height_, begins_;
  std::size_t count_ = 0;
};

}  // namespace

NearestVoxel::NearestVoxel(const Mask& marked) : grid_(marked.grid), nearest_(std::make_unique_for_overwrite<InSlice[]>(marked.data.size())) {
  const int ni = grid_.size[0], nj = grid_.size[1];
  require(ni < no_voxel && nj < no_voxel, "a slice of ", ni, " x ", nj, " voxels is too large for distances between edges; resample the image");
  const double squared_ratio = square(grid_.spacing.x / grid_.spacing.y);
  const std::size_t row = std::size_t(ni), slice = row * std::size_t(nj);
  parallel_for(
      std::size_t(grid_.size[2]),
      [&](std::size_t k) {
        std::vector<std::uint16_t> in_row(slice);
        for (std::size_t j = 0; j < std::size_t(nj); ++j) nearest_in_row(marked.data.data() + k * slice + j * row, ni, in_row.data() + j * row);
        Envelope envelope(nj);
        for (std::size_t i = 0; i < row; ++i) {
          envelope.clear();
          for (std::size_t j = 0; j < std::size_t(nj); ++j)
            if (const std::uint16_t near = in_row[j * row + i]; near != no_voxel) envelope.add(int(j), squared_ratio * square(near - int(i)));
          if (envelope.empty()) {  // and so is every column
            std::fill_n(&nearest_[k * slice], slice, InSlice{no_voxel, no_voxel});
            return;
          }
          envelope.walk(nj, [&](int j, int at) { nearest_[k * slice + std::size_t(j) * row + i] = {in_row[std::size_t(at) * row + i], std::uint16_t(at)}; });
        }
      },
      1);
}

NearestVoxel::Found NearestVoxel::in_slice(const Index& voxel) const {
  const auto [i, j, k] = voxel;
  const InSlice near = nearest_[grid_.offset(i, j, k)];
  if (near.i == no_voxel) return {voxel, infinite};
  return {{near.i, near.j, k}, square(grid_.spacing.x * (near.i - i)) + square(grid_.spacing.y * (near.j - j))};
}

NearestVoxel::Found NearestVoxel::anywhere(const Index& voxel) const {
  const auto [i, j, k] = voxel;
  Found best = in_slice(voxel);
  const int farthest = std::max(k, grid_.size[2] - 1 - k);
  for (int step = 1; step <= farthest; ++step) {
    const double along_k = square(grid_.spacing.z * step);
    if (along_k >= best.squared_distance) break;
    for (const int slice : {k - step, k + step}) {
      if (slice < 0 || slice >= grid_.size[2]) continue;
      Found found = in_slice({i, j, slice});
      found.squared_distance += along_k;
      if (found.squared_distance < best.squared_distance) best = found;
    }
  }
  return best;
}

}  // namespace mtled
