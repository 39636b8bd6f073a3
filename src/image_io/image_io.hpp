#pragma once
#include <filesystem>

#include "core/volume.hpp"
#include "imaging/figures.hpp"

namespace mtled {

/// Reads a 3-D scalar image in LPS mm: NIfTI, NRRD, MetaImage, or a folder with one DICOM series.
/// Input errors (file, reason, remedy): missing, unreadable, truncated, not 3-D scalar, NaN or infinite voxels,
/// several series in the folder. `describe` names it in messages ("fixed image").
Image read_image(const std::filesystem::path& path, const std::string& describe);
/// The same for label maps: whole numbers 0..65535 only.
LabelImage read_labels(const std::filesystem::path& path, const std::string& describe);
Mask read_mask(const std::filesystem::path& path, const std::string& describe);
/// A dense displacement field (3-component vectors, LPS mm): NRRD, MetaImage; NIfTI with intent 1006 is refused with a
/// reason (ITK 5.2 mis-reads it).
VectorImage read_vector_image(const std::filesystem::path& path, const std::string& describe);

/// Written to a temporary name beside `path` and renamed; compressed where the format can. Output errors: disk full, ...
void write_image(const std::filesystem::path& path, const Image& image);
void write_labels(const std::filesystem::path& path, const LabelImage& labels);
void write_mask(const std::filesystem::path& path, const Mask& mask);
void write_vector_image(const std::filesystem::path& path, const VectorImage& field);
/// ITK displacement field transform (.h5), fixed -> moving, as 3D Slicer and antsApplyTransforms read it.
void write_displacement_transform(const std::filesystem::path& path, const VectorImage& inverse_field);
void write_png(const std::filesystem::path& path, const Picture& picture);

}  // namespace mtled
