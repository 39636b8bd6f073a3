#pragma once
#include <itkImageIOBase.h>

#include <cstdint>
#include <vector>

#include "core/volume.hpp"

namespace mtled {

/// The grid of a file whose information ITK has read. Input errors: not 3-D (further dimensions of size 1 are dropped),
/// no or negative spacing, axes not orthogonal.
Grid grid_of(const itk::ImageIOBase& io);
/// Reads all voxels to `values` (as many as the file has, times its components) and converts them to T: without a
/// second buffer when the file holds T. Input error for T = uint16: not a whole number in 0..65535.
template <class T>
void read_values(itk::ImageIOBase& io, T* values);
extern template void read_values(itk::ImageIOBase& io, float* values);
extern template void read_values(itk::ImageIOBase& io, std::uint16_t* values);
/// Input error: NaN or infinity among the values, with their number and the first position.
void require_finite(const Grid& grid, const std::vector<float>& values);
void require_finite(const Grid& grid, const std::vector<Vec3f>& values);

}  // namespace mtled
