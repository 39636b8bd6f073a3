#include <tbb/parallel_invoke.h>

#include <cstdint>
#include <exception>
#include <fstream>
#include <functional>

#include "core/error.hpp"
#include "image_io/dicom.hpp"
#include "image_io/format_checks.hpp"
#include "image_io/formats.hpp"
#include "image_io/image_io.hpp"
#include "image_io/voxels.hpp"
#include "io/input.hpp"

namespace mtled {
namespace {

namespace fs = std::filesystem;

static_assert(sizeof(Vec3f) == 3 * sizeof(float), "three floats of a vector must lie side by side");

/// Runs `work` so that every error says what was being read.
template <class Work>
auto reading(const fs::path& path, const std::string& describe, Work&& work) {
  return with_context(concatenate("reading ", describe, " '", path.string(), "'"), [&] {
    return translating_errors(Failure::input, "check that it is a complete image file", work);
  });
}

/// ITK's reader after it has read the header, and what is left to be checked of the voxels.
struct OpenImage {
  itk::ImageIOBase::Pointer io;
  std::function<void()> check_voxels = [] {};
};

OpenImage open_image(const fs::path& path) {
  OpenImage image;
  require(fs::exists(path), "there is no such file; check the name and the folder");
  require(!fs::is_directory(path), "it is a folder; give a file (only intensity images may be DICOM folders)");
  require(!has_extension(path, ".dcm"), "a single DICOM file is no 3-D image; give the folder that holds the series");
  const Format format = format_of(path);
  require(format != Format::unknown,
          "its format is not supported; use .nii, .nii.gz, .nrrd, .nhdr, .mha, .mhd or a folder "
          "with a DICOM series");
  require(std::ifstream(path).good(), "it cannot be opened (", system_reason(), "); check its permissions");
  if (format == Format::nifti) image.check_voxels = check_nifti(path);
  if (format == Format::meta) check_meta_image(path);
  const itk::ImageIOBase::Pointer& io = image.io = image_io_for(format);
  require(io->CanReadFile(path.c_str()),
          "it is damaged or of another format; check that its extension tells the format");
  io->SetFileName(path.string());
  io->ReadImageInformation();
  return image;
}

/// Reads the voxels while they are checked: both unpack the file, which takes longest. What the check says comes first.
template <class T>
void read_checked(const OpenImage& image, T* values) {
  std::exception_ptr unsound, unreadable;
  const auto run = [](const auto& work, std::exception_ptr& error) {
    try {
      work();
    } catch (...) {
      error = std::current_exception();
    }
  };
  tbb::parallel_invoke([&] { run(image.check_voxels, unsound); }, [&] { run([&] { read_values(*image.io, values); }, unreadable); });
  for (const std::exception_ptr& error : {unsound, unreadable})
    if (error) std::rethrow_exception(error);
}

template <class T>
Volume<T> read_scalars(const fs::path& path) {
  const OpenImage opened = open_image(path);
  const itk::ImageIOBase::Pointer& io = opened.io;
  require(io->GetNumberOfComponents() == 1 && io->GetPixelType() == itk::IOPixelEnum::SCALAR, "it has ",
          io->GetNumberOfComponents(), " values per voxel (", io->GetPixelTypeAsString(io->GetPixelType()),
          "); give an image with one number per voxel");
  Volume<T> volume(grid_of(*io));
  read_checked(opened, volume.data.data());
  return volume;
}

}  // namespace

Image read_image(const fs::path& path, const std::string& describe) {
  return reading(path, describe, [&] {
    Image image = fs::is_directory(path) ? read_dicom_series(path) : read_scalars<float>(path);
    require_finite(image.grid, image.data);
    return image;
  });
}

LabelImage read_labels(const fs::path& path, const std::string& describe) {
  return reading(path, describe, [&] { return read_scalars<std::uint16_t>(path); });
}

Mask read_mask(const fs::path& path, const std::string& describe) {
  const LabelImage labels = read_labels(path, describe);
  Mask mask(labels.grid);
  for (std::size_t i = 0; i < mask.data.size(); ++i) mask.data[i] = labels.data[i] != 0;
  return mask;
}

VectorImage read_vector_image(const fs::path& path, const std::string& describe) {
  return reading(path, describe, [&] {
    const OpenImage opened = open_image(path);
    const itk::ImageIOBase::Pointer& io = opened.io;
    require(io->GetNumberOfComponents() == 3, "it has ", io->GetNumberOfComponents(),
            " value(s) per voxel; give a displacement field with three");
    VectorImage field(grid_of(*io));
    read_checked(opened, &field.data.data()->x);
    require_finite(field.grid, field.data);
    return field;
  });
}

}  // namespace mtled
