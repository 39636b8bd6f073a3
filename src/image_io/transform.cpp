#include <itkBSplineTransform.h>
#include <itkCompositeTransform.h>
#include <itkDisplacementFieldTransform.h>
#include <itkEuler3DTransform.h>
#include <itkHDF5TransformIO.h>
#include <itkTxtTransformIO.h>

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

using Rigid = itk::Euler3DTransform<double>;
using BSpline = itk::BSplineTransform<double, 3, 3>;

Rigid::Pointer to_itk(const RigidMotion& motion) {
  const auto transform = Rigid::New();
  Rigid::MatrixType matrix;
  Rigid::CenterType center;
  Rigid::OutputVectorType translation;
  for (int i = 0; i < 3; ++i) {
    center[unsigned(i)] = motion.center[i];
    translation[unsigned(i)] = motion.translation[i];
    for (int j = 0; j < 3; ++j) matrix(unsigned(i), unsigned(j)) = motion.rotation[i][j];
  }
  transform->SetCenter(center);
  transform->SetMatrix(matrix);
  transform->SetTranslation(translation);
  return transform;
}

BSpline::Pointer to_itk(const FreeFormDeformation& deformation) {
  const Grid& control = deformation.control;
  const auto transform = BSpline::New();
  BSpline::MeshSizeType mesh;
  BSpline::OriginType origin;
  BSpline::PhysicalDimensionsType extent;
  BSpline::DirectionType direction;
  const Vec3d first = control.point(1, 1, 1);  // the image begins at the second control point
  for (unsigned i = 0; i < 3; ++i) {
    mesh[i] = unsigned(control.size[i] - 3);
    origin[i] = first[int(i)];
    extent[i] = control.spacing[int(i)] * mesh[i];
    for (unsigned j = 0; j < 3; ++j) direction(i, j) = control.direction[int(i)][int(j)];
  }
  transform->SetTransformDomainOrigin(origin);
  transform->SetTransformDomainDirection(direction);
  transform->SetTransformDomainPhysicalDimensions(extent);
  transform->SetTransformDomainMeshSize(mesh);
  const std::size_t controls = deformation.coefficients.size();
  BSpline::ParametersType parameters{itk::SizeValueType(3 * controls)};
  for (std::size_t c = 0; c < controls; ++c)
    for (std::size_t a = 0; a < 3; ++a) parameters[unsigned(a * controls + c)] = deformation.coefficients[c][int(a)];
  transform->SetParametersByValue(parameters);
  return transform;
}

}  // namespace

void write_transform(const std::filesystem::path& path, const RigidMotion& fixed_to_moving, const FreeFormDeformation* deformation) {
  writing(path, {".tfm"}, [&](const std::filesystem::path& temporary) {
    using Writer = itk::TxtTransformIOTemplate<double>;
    const auto composite = itk::CompositeTransform<double, 3>::New();  // applies what was added last first
    composite->AddTransform(to_itk(fixed_to_moving));
    if (deformation) composite->AddTransform(to_itk(*deformation));
    const auto writer = Writer::New();
    writer->SetFileName(temporary.string());
    Writer::ConstTransformListType transforms{composite.GetPointer()};
    if (!deformation) transforms.front() = composite->GetNthTransformConstPointer(0);
    writer->SetTransformList(transforms);
    writer->Write();
  });
}

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
