#include <itkDisplacementFieldTransform.h>
#include <itkHDF5TransformIO.h>

#include "core/error.hpp"
#include "image_io/image_io.hpp"
#include "image_io/writing.hpp"

namespace mtled {
namespace {

using Transform = itk::DisplacementFieldTransform<float, 3>;
using Field = Transform::DisplacementFieldType;

/// An ITK image of vectors on the memory of `field`, which ITK neither changes nor frees.
Field::Pointer itk_view(const VectorImage& field) {
  const auto image = Field::New();
  Field::SizeType size;
  Field::PointType origin;
  Field::SpacingType spacing;
  Field::DirectionType direction;
  for (int i = 0; i < 3; ++i) {
    size[unsigned(i)] = itk::SizeValueType(field.grid.size[std::size_t(i)]);
    origin[unsigned(i)] = field.grid.origin[i];
    spacing[unsigned(i)] = field.grid.spacing[i];
    for (int j = 0; j < 3; ++j) direction(unsigned(i), unsigned(j)) = field.grid.direction[i][j];
  }
  image->SetRegions(size);
  image->SetOrigin(origin);
  image->SetSpacing(spacing);
  image->SetDirection(direction);
  const void* values = field.data.data();
  image->GetPixelContainer()->SetImportPointer(static_cast<Field::PixelType*>(const_cast<void*>(values)),
                                               field.data.size());
  return image;
}

}  // namespace

void write_displacement_transform(const std::filesystem::path& path, const VectorImage& inverse_field) {
  writing(path, {".h5"}, [&](const std::filesystem::path& temporary) {
    const auto transform = Transform::New();
    transform->SetDisplacementField(itk_view(inverse_field));
    using Writer = itk::HDF5TransformIOTemplate<float>;
    Writer::ConstTransformListType transforms{transform.GetPointer()};
    const auto writer = Writer::New();
    writer->SetFileName(temporary.string());
    writer->SetTransformList(transforms);
    writer->SetUseCompression(false);  // packing takes minutes for a large field
    writer->Write();
  });
}

}  // namespace mtled
