#include "imaging/gaussian_gradient.hpp"

#include <itkRecursiveGaussianImageFilter.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <memory>
#include <vector>

#include "core/parallel.hpp"
#include "imaging/itk_bridge.hpp"

namespace mtled {
namespace {

constexpr int fewest_voxels = 4;  ///< that the recursive filter needs along an axis
constexpr int lanes = 16;         ///< lines that are filtered at once

/// Of the recursion along a line: causal (n), anticausal (m), both (d), and at the ends (bn, bm).
struct Coefficients {
  double n[4], m[4], d[4], bn[4], bm[4];
};

/// ITK's filter, for its coefficients.
class ItkFilter : public itk::RecursiveGaussianImageFilter<ItkImage<float>, ItkImage<float>> {
 public:
  using Self = ItkFilter;
  using Superclass = itk::RecursiveGaussianImageFilter<ItkImage<float>, ItkImage<float>>;
  using Pointer = itk::SmartPointer<Self>;
  itkNewMacro(Self);
  Coefficients coefficients(double sigma_mm, double spacing_mm, itk::GaussianOrderEnum order) {
    SetSigma(sigma_mm);
    SetOrder(order);
    SetUp(spacing_mm);
    return {{m_N0, m_N1, m_N2, m_N3}, {m_M1, m_M2, m_M3, m_M4}, {m_D1, m_D2, m_D3, m_D4}, {m_BN1, m_BN2, m_BN3, m_BN4}, {m_BM1, m_BM2, m_BM3, m_BM4}};
  }
};

/// Compiled for several instruction sets; the best that the processor has is chosen at start.
#if defined(__x86_64__)
#define MTLED_INSTRUCTION_SETS __attribute__((target_clones("avx512f", "avx2", "default")))
#else
#define MTLED_INSTRUCTION_SETS
#endif

/// The recursion along `lanes` lines of n voxels: x to y, lane l of voxel i at [i * lanes + l]. Causal: up the lines;
/// anticausal: down them and one voxel behind. Outside the line x is that at its end, and y is x by the coefficients
/// `beyond`.
MTLED_INSTRUCTION_SETS void recurse(const double* x, double* y, int n, bool causal, const double (&in)[4], const double (&out)[4], const double (&beyond)[4]) {
  const int first = causal ? 0 : n - 1, step = causal ? lanes : -lanes;
  const double* x0 = x + first * lanes;
  double* y0 = y + first * lanes;
  for (int i = 0; i < n; ++i) {
    const double *from[4], *back[4];
    double factor[4];
    for (int t = 0; t < 4; ++t) {
      from[t] = x0 + std::max(causal ? i - t : i - t - 1, 0) * step;
      const bool inside = i > t;
      back[t] = inside ? y0 + (i - t - 1) * step : x0;
      factor[t] = inside ? out[t] : beyond[t];
    }
    double result[lanes];
    for (int l = 0; l < lanes; ++l) {
      result[l] = from[0][l] * in[0] + from[1][l] * in[1] + from[2][l] * in[2] + from[3][l] * in[3];
      result[l] -= back[0][l] * factor[0] + back[1][l] * factor[1] + back[2][l] * factor[2] + back[3][l] * factor[3];
    }
    for (int l = 0; l < lanes; ++l) y0[i * step + l] = result[l];
  }
}

/// `lanes` lines of n voxels side by side.
class Lines {
 public:
  explicit Lines(int most) : x_(std::size_t(most) * lanes), up_(x_.size()), down_(x_.size()) {}

  /// Lane l of voxel i from source[i * along + l * across]; lanes from `used` on repeat the last one.
  void load(const float* source, int n, std::size_t along, std::size_t across, int used) {
    n_ = n;
    std::size_t to = 0;
    for (int i = 0; i < n; ++i)
      for (int l = 0; l < lanes; ++l) x_[to++] = source[std::size_t(i) * along + std::size_t(std::min(l, used - 1)) * across];
  }
  /// The filtered lines; the loaded ones stay. A line of too few voxels stays as it is.
  void filter(const Coefficients& c, float* target, std::size_t along, std::size_t across, int used) {
    const bool enough = n_ >= fewest_voxels;
    if (enough) {
      recurse(x_.data(), up_.data(), n_, true, c.n, c.d, c.bn);
      recurse(x_.data(), down_.data(), n_, false, c.m, c.d, c.bm);
    }
    for (int i = 0; i < n_; ++i)
      for (int l = 0; l < used; ++l) {
        const std::size_t at = std::size_t(i * lanes + l);
        target[std::size_t(i) * along + std::size_t(l) * across] = float(enough ? up_[at] + down_[at] : x_[at]);
      }
  }

 private:
  std::vector<double> x_, up_, down_;
  int n_ = 0;
};

/// Calls work(first, used) for every group of `lanes` lines out of `count`.
template <class Work>
void for_each_group(int count, const Work& work) {
  for (int first = 0; first < count; first += lanes) work(std::size_t(first), std::min(lanes, count - first));
}

}  // namespace

Gradient gaussian_gradient(const Image& image, double sigma_mm) {
  const auto volume = [&] { return std::make_unique_for_overwrite<float[]>(image.grid.count()); };
  Gradient g{image.grid, {volume(), volume(), volume()}, volume()};
  const auto& n = image.grid.size;
  Coefficients smooth[3], slope[3];
  float per_mm[3];  // the filter differentiates by index
  const auto filter = ItkFilter::New();
  for (int a = 0; a < 3; ++a) {
    smooth[a] = filter->coefficients(sigma_mm, image.grid.spacing[a], itk::GaussianOrderEnum::ZeroOrder);
    slope[a] = filter->coefficients(sigma_mm, image.grid.spacing[a], itk::GaussianOrderEnum::FirstOrder);
    per_mm[a] = n[std::size_t(a)] < fewest_voxels ? 0 : float(1 / image.grid.spacing[a]);
  }
  const std::size_t row = std::size_t(n[0]), slice = row * std::size_t(n[1]);
  parallel_for(
      std::size_t(n[2]),
      [&](std::size_t k) {
        Lines lines(std::max(n[0], n[1]));
        std::vector<float> smoothed(slice), differentiated(slice);
        for_each_group(n[1], [&](std::size_t j, int used) {
          lines.load(image.data.data() + k * slice + j * row, n[0], 1, row, used);
          lines.filter(smooth[0], smoothed.data() + j * row, 1, row, used);
          lines.filter(slope[0], differentiated.data() + j * row, 1, row, used);
        });
        for_each_group(n[0], [&](std::size_t i, int used) {
          const std::size_t first = k * slice + i;
          lines.load(differentiated.data() + i, n[1], row, 1, used);
          lines.filter(smooth[1], &g.along[0][first], row, 1, used);
          lines.load(smoothed.data() + i, n[1], row, 1, used);
          lines.filter(slope[1], &g.along[1][first], row, 1, used);
          lines.filter(smooth[1], &g.along[2][first], row, 1, used);
        });
      },
      1);
  parallel_for(
      std::size_t(n[1]),
      [&](std::size_t j) {
        Lines lines(n[2]);
        for_each_group(n[0], [&](std::size_t i, int used) {
          const std::size_t first = j * row + i;
          for (int a = 0; a < 3; ++a) {
            lines.load(&g.along[a][first], n[2], slice, 1, used);
            lines.filter(a == 2 ? slope[2] : smooth[2], &g.along[a][first], slice, 1, used);
          }
          for (std::size_t k = 0; k < std::size_t(n[2]); ++k)
            for (std::size_t v = first + k * slice; v < first + k * slice + std::size_t(used); ++v) {
              float squares = 0;
              for (int a = 0; a < 3; ++a) {
                float& component = g.along[a][v];
                component *= per_mm[a];
                squares += component * component;
              }
              g.magnitude[v] = std::sqrt(squares);
            }
        });
      },
      1);
  return g;
}

}  // namespace mtled
