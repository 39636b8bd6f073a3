#pragma once
#include <filesystem>
#include <functional>

namespace mtled {

/// Checks of what ITK's readers let pass in silence: what a cut-off file lacks they fill up with zeros, or leave what
/// was in memory. Each throws an input error with reason and remedy.

/// NIfTI (.nii, .nii.gz): not NIfTI-1, cut off or damaged, NaN or infinite voxels, units other than mm, intent 1006, or a .nii beside the
/// .nii.gz (which ITK's reader would take the voxels from).
/// Looks at the header and the file's size, so that no memory is taken for voxels that are not there; the returned function looks at the voxels, which takes as long as reading them.
[[nodiscard]] std::function<void()> check_nifti(const std::filesystem::path& file);
/// The same for a file just written, whatever its voxels hold.
void check_written_nifti(const std::filesystem::path& file);
/// MetaImage (.mha, .mhd): cut off or damaged, data file missing, data spread over several files.
void check_meta_image(const std::filesystem::path& file);
/// True for a DICOM file with voxels, false for any other file: GDCM must see no other, as some make it end the
/// program. Input error: cut off. The rare big-endian and deflated ones are not looked through.
bool check_dicom(const std::filesystem::path& file);

}  // namespace mtled
