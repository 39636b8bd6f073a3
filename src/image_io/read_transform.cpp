#include <itkDisplacementFieldTransform.h>
#include <itkHDF5TransformIO.h>
#include <itkMatlabTransformIO.h>
#include <itkTransformFileReader.h>
#include <itkTxtTransformIO.h>

#include <cstdint>
#include <cstring>
#include <fstream>
#include <memory>
#include <string>

#include "core/error.hpp"
#include "image_io/formats.hpp"
#include "image_io/image_io.hpp"
#include "image_io/stored_bytes.hpp"
#include "image_io/voxels.hpp"
#include "imaging/itk_bridge.hpp"

namespace mtled {
namespace {

using Transform = itk::Transform<double, 3, 3>;
using FieldTransform = itk::DisplacementFieldTransform<double, 3>;

/// Whether an HDF5 file is as long as its superblock says (HDF5 file format, versions 0, 2 and 3, addresses of 8 bytes); the
/// library would report one that is cut off with a page of its own.
void check_hdf5(const std::filesystem::path& path) {
  std::ifstream stream(path, std::ios::binary);
  unsigned char head[48]{};
  stream.read(reinterpret_cast<char*>(head), sizeof head);
  require(std::memcmp(head, "\x89HDF\r\n\x1a\n", 8) == 0, "it is damaged or of another format; check that its extension tells the format");
  const int version = head[8], address_bytes = head[version < 2 ? 13 : 9], end_of_file = version == 0 ? 40 : 28;
  if (version > 3 || version == 1 || address_bytes != 8) return;
  std::uint64_t needed = 0;
  for (int byte = 7; byte >= 0; --byte) needed = needed << 8 | head[end_of_file + byte];
  require_complete(stored_bytes(path, 0), needed);
}

/// Whether a Matlab file (level 4, as ITK and ANTs write) holds the matrix that it announces; ITK would ask for its memory.
void check_matlab(const std::filesystem::path& path) {
  std::ifstream stream(path, std::ios::binary);
  std::uint32_t head[3]{};  // type, rows, columns
  stream.read(reinterpret_cast<char*>(head), sizeof head);
  require(stream.good() && std::uint64_t(head[1]) * head[2] * sizeof(float) <= std::filesystem::file_size(path), "it is damaged, or no transform that ITK or ANTs wrote; copy it again or convert it to .tfm");
}

/// ITK takes any text for a transform file and fails somewhere inside.
void check_text(const std::filesystem::path& path) {
  std::ifstream stream(path);
  std::string first;
  std::getline(stream, first);
  require(first.starts_with("#Insight Transform File"), "it is no transform file of ITK (no '#Insight Transform File' in its first line); of an elastix result, give the displacement field that `transformix -def all` writes");
}

itk::TransformIOBaseTemplate<double>::Pointer io_for(const std::filesystem::path& path) {
  const auto ends_in = [&](auto... extensions) { return (has_extension(path, extensions) || ...); };
  if (ends_in(".h5", ".hdf5")) return check_hdf5(path), itk::HDF5TransformIOTemplate<double>::New().GetPointer();
  if (ends_in(".tfm", ".txt")) return check_text(path), itk::TxtTransformIOTemplate<double>::New().GetPointer();
  if (ends_in(".mat")) return check_matlab(path), itk::MatlabTransformIOTemplate<double>::New().GetPointer();
  fail(Failure::input, "its format is not supported; use .h5, .tfm, .txt or .mat for a transform, .nrrd, .mha or .nii.gz for a displacement field");
}

/// The field of ITK's transform in single precision, so that its border is known.
std::shared_ptr<VectorImage> field_of(const FieldTransform& transform) {
  const FieldTransform::DisplacementFieldType& image = *transform.GetDisplacementField();
  auto field = std::make_shared<VectorImage>(grid_of(image));
  const auto* v = image.GetBufferPointer();
  for (std::size_t voxel = 0; voxel < field->data.size(); ++voxel) field->data[voxel] = {float(v[voxel][0]), float(v[voxel][1]), float(v[voxel][2])};
  require_finite(field->grid, field->data);
  return field;
}

DisplacementFunction read_itk_transform(const std::filesystem::path& path) {
  require(std::filesystem::exists(path), "there is no such file; check the name and the folder");
  require(std::filesystem::is_regular_file(path), "it is a folder; give a file");
  silence_libraries();
  const auto io = io_for(path);
  require(io->CanReadFile(path.c_str()), "it is damaged or of another format; check that its extension tells the format");
  const auto reader = itk::TransformFileReaderTemplate<double>::New();
  reader->SetFileName(path.string());
  reader->SetTransformIO(io);
  reader->Update();
  const auto& transforms = *reader->GetModifiableTransformList();
  require(transforms.size() == 1, "it holds ", transforms.size(), " transforms and does not say how they follow each other; write them as one composite transform");
  const Transform::ConstPointer transform = dynamic_cast<const Transform*>(transforms.front().GetPointer());
  require(transform.IsNotNull(), "it is no 3-D transform but ", transforms.front()->GetTransformTypeAsString(), "; give a transform of 3-D points");
  if (const auto* field = dynamic_cast<const FieldTransform*>(transform.GetPointer())) return DenseDisplacement{field_of(*field)};
  return [transform](const Vec3d& y, Vec3d& v) {
    Transform::InputPointType point;
    for (int a = 0; a < 3; ++a) point[unsigned(a)] = y[a];
    const Transform::OutputPointType image = transform->TransformPoint(point);
    v = Vec3d{image[0], image[1], image[2]} - y;
    return true;
  };
}

}  // namespace

DisplacementFunction read_transform(const std::filesystem::path& path, const std::string& describe) {
  if (format_of(path) != Format::unknown) return DenseDisplacement{std::make_shared<VectorImage>(read_vector_image(path, describe))};
  return with_context(concatenate("reading ", describe, " '", path.string(), "'"),
                      [&] { return translating_errors(Failure::input, "check that it is a complete transform file", [&] { return read_itk_transform(path); }); });
}

}  // namespace mtled
