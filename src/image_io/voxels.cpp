#include "image_io/voxels.hpp"

#include <cmath>
#include <limits>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "core/error.hpp"
#include "core/parallel.hpp"

namespace mtled {
namespace {

/// On entries of DᵀD - I: lets directions through that were written with 5 digits.
constexpr double orthonormal_tolerance = 1e-4;
/// Above it the direction is moved to the nearest rotation, so that Grid::index inverts Grid::point.
constexpr double rounding_tolerance = 1e-9;

std::string size_text(const itk::ImageIOBase& io) {
  std::string text;
  for (unsigned i = 0; i < io.GetNumberOfDimensions(); ++i)
    text += (i ? " x " : "") + std::to_string(io.GetDimensions(i));
  return text;
}

Mat3d orthonormal(const Mat3d& direction) {
  const Mat3d product = transpose(direction) * direction;
  double worst = 0;
  Mat3d correction;  // (3 I - DᵀD) / 2: one Newton step of the polar decomposition
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) {
      worst = std::max(worst, std::abs(product[i][j] - (i == j)));
      correction[i][j] = (3.0 * (i == j) - product[i][j]) / 2;
    }
  require(worst <= orthonormal_tolerance, "its axes are not at right angles (directions are ", worst,
          " off); resample it to a grid without shear");
  return worst > rounding_tolerance ? direction * correction : direction;
}

/// Calls `work` with a null pointer to the C++ type of the file's components.
template <class Work>
void with_component_type(itk::IOComponentEnum type, Work&& work) {
  using enum itk::IOComponentEnum;
  switch (type) {
    case UCHAR:
      return work(static_cast<unsigned char*>(nullptr));
    case CHAR:
      return work(static_cast<signed char*>(nullptr));
    case USHORT:
      return work(static_cast<unsigned short*>(nullptr));
    case SHORT:
      return work(static_cast<short*>(nullptr));
    case UINT:
      return work(static_cast<unsigned*>(nullptr));
    case INT:
      return work(static_cast<int*>(nullptr));
    case ULONG:
      return work(static_cast<unsigned long*>(nullptr));
    case LONG:
      return work(static_cast<long*>(nullptr));
    case ULONGLONG:
      return work(static_cast<unsigned long long*>(nullptr));
    case LONGLONG:
      return work(static_cast<long long*>(nullptr));
    case FLOAT:
      return work(static_cast<float*>(nullptr));
    case DOUBLE:
      return work(static_cast<double*>(nullptr));
    default:
      fail(Failure::input, "its type of numbers is not supported; convert it to float or short");
  }
}

/// False for what is no value of the result's type.
template <class Stored>
bool convert(const Stored& value, float& result) {
  result = float(value);
  return true;
}

template <class Stored>
bool convert(const Stored& value, std::uint16_t& result) {
  const double number = double(value);
  if (!(number >= 0 && number <= std::numeric_limits<std::uint16_t>::max())) return false;
  result = std::uint16_t(number);
  return double(result) == number;
}

/// The number of i in [0, count) for which is_bad(i), and the first of them.
template <class IsBad>
std::pair<std::size_t, std::size_t> bad_ones(std::size_t count, const IsBad& is_bad) {
  constexpr std::size_t piece = 1 << 16;
  std::vector<std::pair<std::size_t, std::size_t>> found((count + piece - 1) / piece);
  parallel_pieces(count, piece, [&](std::size_t begin, std::size_t end) {
    auto& [bad, first] = found[begin / piece];
    for (std::size_t i = begin; i < end; ++i)
      if (is_bad(i) && bad++ == 0) first = i;
  });
  std::pair<std::size_t, std::size_t> all{};
  for (const auto& [bad, first] : found) {
    if (all.first == 0) all.second = first;
    all.first += bad;
  }
  return all;
}

template <class T, class IsBad>
void require_good(const Grid& grid, const std::vector<T>& values, const IsBad& is_bad) {
  const auto [count, first] = bad_ones(values.size(), [&](std::size_t i) { return is_bad(values[i]); });
  const std::size_t row = std::size_t(grid.size[0]), slice = row * std::size_t(grid.size[1]);
  require(count == 0, count, count == 1 ? " voxel is" : " voxels are", " NaN or infinite, the first one at index (",
          first % row, ", ", first % slice / row, ", ", slice ? first / slice : 0, "); replace such values first");
}

}  // namespace

Grid grid_of(const itk::ImageIOBase& io) {
  const unsigned dimensions = io.GetNumberOfDimensions();
  bool three = dimensions >= 3;
  for (unsigned i = 3; i < dimensions; ++i) three &= io.GetDimensions(i) == 1;
  require(three, "it is not a 3-D image (its size is ", size_text(io), "); extract one 3-D volume");
  Grid grid;
  Mat3d direction;
  for (int i = 0; i < 3; ++i) {
    const auto size = io.GetDimensions(unsigned(i));
    require(size >= 1 && size <= itk::SizeValueType(std::numeric_limits<int>::max()), "its size ", size_text(io),
            " is not usable");
    grid.size[std::size_t(i)] = int(size);
    grid.origin[i] = io.GetOrigin(unsigned(i));
    grid.spacing[i] = io.GetSpacing(unsigned(i));
    require(grid.spacing[i] > 0 && std::isfinite(grid.spacing[i]) && std::isfinite(grid.origin[i]), "its spacing (",
            grid.spacing[i], " mm along axis ", i, ") or origin is not usable; correct its header");
    for (int j = 0; j < 3; ++j) direction[j][i] = io.GetDirection(unsigned(i))[std::size_t(j)];
  }
  grid.direction = orthonormal(direction);
  return grid;
}

template <class T>
void read_values(itk::ImageIOBase& io, T* values) {
  itk::ImageIORegion everything(io.GetNumberOfDimensions());
  for (unsigned i = 0; i < io.GetNumberOfDimensions(); ++i) everything.SetSize(i, io.GetDimensions(i));
  io.SetIORegion(everything);
  with_component_type(io.GetComponentType(), [&]<class Stored>(Stored*) {
    if constexpr (std::is_same_v<Stored, T>) return io.Read(values);
    const std::size_t count = std::size_t(io.GetImageSizeInComponents());
    const auto stored = std::make_unique_for_overwrite<Stored[]>(count);
    io.Read(stored.get());
    const auto [bad, first] = bad_ones(count, [&](std::size_t i) { return !convert(stored[i], values[i]); });
    if (bad > 0) fail(Failure::input, "it holds ", double(stored[first]), ", which is no label; labels must be whole numbers from 0 to 65535");
  });
}
template void read_values(itk::ImageIOBase& io, float* values);
template void read_values(itk::ImageIOBase& io, std::uint16_t* values);

void require_finite(const Grid& grid, const std::vector<float>& values) {
  require_good(grid, values, [](float v) { return !std::isfinite(v); });
}

void require_finite(const Grid& grid, const std::vector<Vec3f>& values) {
  require_good(grid, values,
               [](const Vec3f& v) { return !std::isfinite(v.x) || !std::isfinite(v.y) || !std::isfinite(v.z); });
}

}  // namespace mtled
