#pragma once
#include <string>

#include "core/volume.hpp"
#include "io/json.hpp"

namespace mtled {

/// A volume as the report shows it: one byte a voxel.
using ByteVolume = Volume<std::uint8_t>;

/// Values of the first and the last byte.
struct ByteRange {
  double low = 0, high = 1;
};

/// Grid of cubes along the axes of LPS around the voxels of `image` (only those where `where` is not 0 and `margin_mm`
/// around them, if it is given), not finer than the image and of at most `most_voxels`.
Grid view_grid(const Grid& image, std::size_t most_voxels, const Mask* where = nullptr, double margin_mm = 0);

/// Means of the image over the voxels of `view` in `range`; the first byte where it does not reach.
ByteVolume grey_bytes(const Image& image, const Grid& view, const ByteRange& range);
/// Values of the nearest voxels: 1 to 255 in `range`, 0 where there is none or it is NaN.
ByteVolume scalar_bytes(const Image& image, const Grid& view, const ByteRange& range);
/// Sets `bit` in every voxel of `view` that holds, or whose centre lies in, a voxel that is not 0.
void set_bits(ByteVolume& view, const Mask& mask, std::uint8_t bit);
/// Sets to the first byte after 0 every voxel of `view` that holds, or whose centre lies in, a voxel that is not 0.
void set_lowest(ByteVolume& view, const Mask& mask);

/// The axial slices side by side in one picture, see docs/report.md.
Json mosaic_as_jpeg(const ByteVolume& volume);
Json mosaic_as_png(const ByteVolume& volume);
Json describe_view(const Grid& view);

/// Vectors at the nodes of a coarse grid over `view`, at most `most` of them.
Json coarse_vectors(const VectorImage& field, const Mask& known, const Grid& view, std::size_t most);

}  // namespace mtled
