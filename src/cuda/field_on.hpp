#pragma once
#include <algorithm>
#include <type_traits>
#include <utility>
#include <vector>

#include "core/field_backend.hpp"
#include "cuda/field_functors.hpp"
#include "cuda/uploaded.hpp"

namespace mtled {

/// Voxels per launch: enough to fill a device, few enough that their results need little of its memory (90 MB).
inline constexpr std::size_t voxels_per_launch = std::size_t(1) << 22;

/// Calls work(first, count) for pieces of a grid's voxels.
template <class Work>
void each_piece_of(const Grid& grid, const Work& work) {
  for (std::size_t first = 0; first < grid.count(); first += voxels_per_launch) work(first, std::min(voxels_per_launch, grid.count() - first));
}
inline std::size_t largest_piece(const Grid& grid) { return std::min(voxels_per_launch, grid.count()); }

/// Dense fields by the functors of field_functors.hpp. `Device` runs index functors, see CudaDevice.
template <class Device>
class FieldOn : public FieldBackend {
 public:
  FieldOn(Device device, const LatticeField& field)
      : device_(std::move(device)), parameter_(uploaded(device_, field.parameter)), flags_(uploaded(device_, field.flags)), view_(field.view) {
    view_.parameter = parameter_.data(), view_.flags = flags_.data();
  }

  void forward(VectorImage& u, Volume<Coverage>& coverage) override {
    const std::size_t piece = largest_piece(u.grid);
    Buffer<Vec3f> u_here(device_, piece);
    Buffer<Coverage> coverage_here(device_, piece);
    each_piece_of(u.grid, [&](std::size_t first, std::size_t count) {
      with_basis([&](auto terms) { device_.for_each(int(count), ForwardField<terms()>{{view_}, GridView(u.grid), first, u_here.data(), coverage_here.data()}); });
      u_here.download(&u.data[first], count);
      coverage_here.download(&coverage.data[first], count);
    });
  }

  double inverse(const VectorImage& forward, double tolerance_mm, VectorImage& v, Volume<Coverage>& coverage) override {
    const std::size_t piece = largest_piece(v.grid);
    const Buffer<Vec3f> dense = uploaded(device_, forward.data);
    const VolumeView<Vec3f> start{GridView(forward.grid), dense.data()};
    Buffer<Vec3f> v_here(device_, piece);
    Buffer<Coverage> coverage_here(device_, piece);
    Buffer<double> residual_here(device_, piece);
    std::vector<double> residual(piece);
    double largest = 0;
    each_piece_of(v.grid, [&](std::size_t first, std::size_t count) {
      with_basis([&](auto terms) {
        device_.for_each(int(count), InverseField<terms()>{{start, {view_}, tolerance_mm}, GridView(v.grid), first, v_here.data(), coverage_here.data(), residual_here.data()});
      });
      v_here.download(&v.data[first], count);
      coverage_here.download(&coverage.data[first], count);
      residual_here.download(residual.data(), count);
      largest = std::max(largest, *std::max_element(residual.begin(), residual.begin() + std::ptrdiff_t(count)));
    });
    return largest;
  }

 private:
  template <class T>
  using Buffer = typename Device::template Buffer<T>;

  /// launch(terms of the basis), known to the compiler.
  template <class Launch>
  void with_basis(const Launch& launch) const {
    view_.quadratic ? launch(std::integral_constant<int, 10>()) : launch(std::integral_constant<int, 4>());
  }

  Device device_;
  Buffer<LatticeParameter> parameter_;
  Buffer<std::uint8_t> flags_;
  LatticeFieldView view_;
};

/// A SampleDisplaced by WarpVoxels.
template <class Device>
Image sample_displaced_on(Device& device, const Image& samples, const VectorImage& displacement, Interpolation interpolation, float outside) {
  using Floats = typename Device::template Buffer<float>;
  using Vectors = typename Device::template Buffer<Vec3f>;
  Image warped(displacement.grid);
  const std::size_t piece = largest_piece(warped.grid);
  const Floats source = uploaded(device, samples.data);
  Vectors v(device, piece);
  Floats here(device, piece);
  each_piece_of(warped.grid, [&](std::size_t first, std::size_t count) {
    v.upload(&displacement.data[first], count);
    device.for_each(int(count), WarpVoxels{{GridView(samples.grid), source.data()}, interpolation, outside, GridView(warped.grid), first, v.data(), here.data()});
    here.download(&warped.data[first], count);
  });
  return warped;
}

}  // namespace mtled
