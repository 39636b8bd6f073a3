#include "imaging/gaussian_gradient.hpp"

#include <gtest/gtest.h>
#include <itkRecursiveGaussianImageFilter.h>

#include <algorithm>
#include <cmath>
#include <random>

#include "imaging/itk_bridge.hpp"

namespace mtled {
namespace {

/// Of the largest derivative: each of three passes rounds to single precision, by up to 6e-8, and sums by another compiler or
/// ITK may fall on the other side. With ITK 5.2 and GCC 12 the difference is 0; with fused multiplication it was 4e-11.
constexpr double float_rounding = 1e-6;

Image noise(std::array<int, 3> size) {
  Grid grid;
  grid.size = size, grid.spacing = {0.8, 1.1, 2.5}, grid.origin = {3, -7, 20};
  Image image(grid);
  std::mt19937 random(3);
  for (float& v : image.data) v = std::normal_distribution<float>(100, 800)(random);
  return image;
}

/// Derivative [intensity/mm] along `axis` by ITK's filter, one axis after the other.
std::vector<float> derivative_of_itk(const Image& image, double sigma_mm, int axis) {
  Image copy = image;
  auto result = view_as_itk(copy);
  for (int a = 0; a < 3; ++a) {
    if (image.grid.size[std::size_t(a)] < 4) continue;
    const auto filter = itk::RecursiveGaussianImageFilter<ItkImage<float>, ItkImage<float>>::New();
    filter->SetInput(result);
    filter->SetDirection(unsigned(a));
    filter->SetSigma(sigma_mm);
    filter->SetOrder(a == axis ? itk::GaussianOrderEnum::FirstOrder : itk::GaussianOrderEnum::ZeroOrder);
    filter->Update();
    result = filter->GetOutput();
    result->DisconnectPipeline();
  }
  std::vector<float> derivative(result->GetBufferPointer(), result->GetBufferPointer() + image.data.size());
  for (float& v : derivative) v *= float(1 / image.grid.spacing[axis]);
  return derivative;
}

std::vector<float> values(const std::unique_ptr<float[]>& volume, const Grid& grid) { return {volume.get(), volume.get() + grid.count()}; }

double largest_size(const std::vector<float>& values) {
  const auto [low, high] = std::minmax_element(values.begin(), values.end());
  return std::max(std::abs(*low), std::abs(*high));
}

TEST(GaussianGradient, IsThatOfItk) {
  for (const std::array<int, 3>& size : {std::array{37, 20, 18}, std::array{16, 4, 5}, std::array{5, 33, 1}}) {
    const Image image = noise(size);
    for (const double sigma_mm : {0.7, 2.0, 6.0}) {
      const Gradient g = gaussian_gradient(image, sigma_mm);
      for (int a = 0; a < 3; ++a)
        if (size[std::size_t(a)] >= 4) {
          const std::vector<float> expected = derivative_of_itk(image, sigma_mm, a);
          const double bound = float_rounding * largest_size(expected);
          for (std::size_t v = 0; v < expected.size(); ++v) ASSERT_NEAR(g.along[a][v], expected[v], bound) << size[0] << " voxels, " << sigma_mm << " mm, axis " << a;
        }
      for (std::size_t v = 0; v < image.data.size(); ++v) {
        const float x = g.along[0][v], y = g.along[1][v], z = g.along[2][v];
        ASSERT_FLOAT_EQ(g.magnitude[v], std::sqrt(x * x + y * y + z * z));
      }
    }
  }
}

TEST(GaussianGradient, OfARampIsItsSlope) {
  Image ramp = noise({40, 30, 24});
  for (int k = 0; k < 24; ++k)
    for (int j = 0; j < 30; ++j)
      for (int i = 0; i < 40; ++i) ramp.at(i, j, k) = float(3 * 0.8 * i - 2 * 1.1 * j + 5 * 2.5 * k);
  const Gradient g = gaussian_gradient(ramp, 1.5);
  constexpr double far_from_the_border = 1e-3;  // ten sigma: what is left of the border, of the approximation and of single precision
  const double expected[] = {3, -2, 5};
  for (int a = 0; a < 3; ++a) EXPECT_NEAR(g.along[a][ramp.grid.offset(20, 15, 12)], expected[a], far_from_the_border);
}

TEST(GaussianGradient, AxesOfFewVoxelsAreNotDifferentiated) {
  const Gradient g = gaussian_gradient(noise({20, 3, 12}), 2);
  for (const float v : values(g.along[1], g.grid)) EXPECT_EQ(v, 0);
  EXPECT_GT(g.magnitude[g.grid.offset(10, 1, 6)], 0);
}

}  // namespace
}  // namespace mtled
