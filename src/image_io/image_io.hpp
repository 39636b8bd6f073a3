#pragma once
#include <filesystem>

#include "core/motion.hpp"
#include "core/volume.hpp"
#include "imaging/figures.hpp"
#include "imaging/free_form_deformation.hpp"
#include "imaging/warp.hpp"

namespace mtled {

/// Reads a 3-D scalar image in LPS mm: NIfTI (.nii, .nii.gz), NRRD, MetaImage, or a folder with one DICOM series;
/// rescale slope and intercept are applied. Further dimensions of size 1 are dropped. Input errors (file, reason,
/// remedy): missing, unreadable, cut off, damaged, not 3-D scalar, lengths not in mm, axes not at right angles, NaN or
/// infinite voxels, several or irregular series in the folder. Memory errors: too large. `describe` names it in
/// messages ("fixed image").
Image read_image(const std::filesystem::path& path, const std::string& describe);
/// The same for label maps (no DICOM): whole numbers 0..65535 only.
LabelImage read_labels(const std::filesystem::path& path, const std::string& describe);
/// A label map as mask: 1 where the label is not 0.
Mask read_mask(const std::filesystem::path& path, const std::string& describe);
/// A dense displacement field (3-component vectors, LPS mm): NRRD, MetaImage, or NIfTI of intent 1007 (vector), as ANTs
/// writes it; NIfTI of intent 1006 is refused with a reason (ITK 5.2 misreads it).
VectorImage read_vector_image(const std::filesystem::path& path, const std::string& describe);
/// A transform of points y -> y + v(y), LPS mm, as the function v: a displacement field as above, defined within its
/// grid, or what ITK writes to .h5, .hdf5, .tfm, .txt or .mat (ANTs' affine), defined everywhere, composites
/// included. One that is a displacement field itself is defined within its grid; in a composite, ITK goes on with 0
/// beyond. A field is given as DenseDisplacement. Input errors (file, reason, remedy) also: not one transform, not 3-D.
DisplacementFunction read_transform(const std::filesystem::path& path, const std::string& describe);

/// Written to a temporary name beside `path` and renamed; compressed where the format can: .nii, .nii.gz, .nrrd, .mha
/// (formats of two files cannot be renamed as one). Output errors: other extension, no such folder, disk full, ...
void write_image(const std::filesystem::path& path, const Image& image);
void write_labels(const std::filesystem::path& path, const LabelImage& labels);
void write_mask(const std::filesystem::path& path, const Mask& mask);
/// The same in .nrrd or .mha.
void write_vector_image(const std::filesystem::path& path, const VectorImage& field);
/// ITK displacement field transform (.h5, float32, not compressed), fixed -> moving, as 3D Slicer and
/// antsApplyTransforms read it.
void write_displacement_transform(const std::filesystem::path& path, const VectorImage& inverse_field);
/// ITK transform (.tfm, text), fixed -> moving, for 3D Slicer and ITK: a rigid motion, or a composite of that motion after
/// y -> y + b(y) with a B-spline b.
void write_transform(const std::filesystem::path& path, const RigidMotion& fixed_to_moving, const FreeFormDeformation* deformation = nullptr);
void write_png(const std::filesystem::path& path, const Picture& picture);

}  // namespace mtled
