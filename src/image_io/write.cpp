#include <itkPNGImageIO.h>

#include "core/error.hpp"
#include "image_io/format_checks.hpp"
#include "image_io/image_io.hpp"
#include "image_io/stored_bytes.hpp"
#include "image_io/writing.hpp"
#include "io/temporary_file.hpp"

namespace mtled {
namespace {

namespace fs = std::filesystem;

constexpr int fast_compression = 1;  // on CT nearly as small as the default, and several times faster

/// Geometry and kind of the voxels of `grid` for the writer.
void describe(itk::ImageIOBase& io, const Grid& grid, itk::IOComponentEnum type, unsigned components) {
  io.SetNumberOfDimensions(3);
  itk::ImageIORegion everything(3);
  for (int i = 0; i < 3; ++i) {
    const auto axis = unsigned(i);
    io.SetDimensions(axis, itk::SizeValueType(grid.size[axis]));
    everything.SetSize(axis, itk::SizeValueType(grid.size[axis]));
    io.SetOrigin(axis, grid.origin[i]);
    io.SetSpacing(axis, grid.spacing[i]);
    io.SetDirection(axis, std::vector<double>{grid.direction[0][i], grid.direction[1][i], grid.direction[2][i]});
  }
  io.SetIORegion(everything);
  io.SetComponentType(type);
  io.SetPixelType(components == 1 ? itk::IOPixelEnum::SCALAR : itk::IOPixelEnum::VECTOR);
  io.SetNumberOfComponents(components);
}

void write_with(itk::ImageIOBase& io, const fs::path& file, const void* values) {
  io.SetFileName(file.string());
  io.SetUseCompression(true);
  io.SetCompressionLevel(fast_compression);
  io.Write(values);
}

/// ITK's writers for NIfTI and MetaImage do not notice a full disk.
void require_written(void (*check)(const fs::path&), const fs::path& file) {
  try {
    check(file);
  } catch (const Error&) {
    fail_to_write("it would be cut off");
  }
}

/// ITK packs NIfTI slowly (about 10 MB/s): let it write plain NIfTI, and pack that.
void write_packed_nifti(itk::ImageIOBase& io, const fs::path& target, const fs::path& file, const void* values) {
  const TemporaryFile plain(target.parent_path() / target.stem());
  write_with(io, plain.path(), values);
  require_written(check_written_nifti, plain.path());
  gzip(plain.path(), file);
}

void write_voxels(const fs::path& path, const Grid& grid, itk::IOComponentEnum type, unsigned components,
                  const void* values, const std::vector<std::string>& extensions) {
  writing(path, extensions, [&](const fs::path& temporary) {
    const Format format = format_of(path);
    const itk::ImageIOBase::Pointer io = image_io_for(format);
    describe(*io, grid, type, components);
    if (has_extension(path, ".nii.gz")) return write_packed_nifti(*io, path, temporary, values);
    write_with(*io, temporary, values);
    if (format == Format::nifti) require_written(check_written_nifti, temporary);
    if (format == Format::meta) require_written(check_meta_image, temporary);
  });
}

const std::vector<std::string> scalar_extensions{".nii", ".nii.gz", ".nrrd", ".mha"},
    vector_extensions{".nrrd", ".mha"};

}  // namespace

void write_image(const fs::path& path, const Image& image) {
  write_voxels(path, image.grid, itk::IOComponentEnum::FLOAT, 1, image.data.data(), scalar_extensions);
}

void write_labels(const fs::path& path, const LabelImage& labels) {
  write_voxels(path, labels.grid, itk::IOComponentEnum::USHORT, 1, labels.data.data(), scalar_extensions);
}

void write_mask(const fs::path& path, const Mask& mask) {
  write_voxels(path, mask.grid, itk::IOComponentEnum::UCHAR, 1, mask.data.data(), scalar_extensions);
}

void write_vector_image(const fs::path& path, const VectorImage& field) {
  write_voxels(path, field.grid, itk::IOComponentEnum::FLOAT, 3, field.data.data(), vector_extensions);
}

void write_png(const fs::path& path, const Picture& picture) {
  writing(path, {".png"}, [&](const fs::path& temporary) {
    const auto io = itk::PNGImageIO::New();
    io->SetNumberOfDimensions(2);
    itk::ImageIORegion everything(2);
    for (unsigned i = 0; i < 2; ++i) {
      const auto size = itk::SizeValueType(i == 0 ? picture.width : picture.height);
      io->SetDimensions(i, size);
      everything.SetSize(i, size);
    }
    io->SetIORegion(everything);
    io->SetComponentType(itk::IOComponentEnum::UCHAR);
    io->SetPixelType(itk::IOPixelEnum::RGB);
    io->SetNumberOfComponents(3);
    io->SetFileName(temporary.string());
    io->Write(picture.rgb.data());
  });
}

}  // namespace mtled
