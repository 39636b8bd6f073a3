#pragma once
#include <itkImage.h>
#include <itkVector.h>

#include <algorithm>
#include <type_traits>

#include "core/volume.hpp"

namespace mtled {

/// Pixel type of ITK that has the memory layout of T.
template <class T>
using ItkPixel = std::conditional_t<std::is_same_v<T, Vec3f>, itk::Vector<float, 3>, T>;
template <class T>
using ItkImage = itk::Image<ItkPixel<T>, 3>;
static_assert(sizeof(itk::Vector<float, 3>) == sizeof(Vec3f));

/// Copies origin [mm], spacing [mm] and direction and size to an ITK image.
template <class Pixel>
void set_geometry(itk::Image<Pixel, 3>& image, const Grid& grid) {
  typename itk::Image<Pixel, 3>::SizeType size;
  typename itk::Image<Pixel, 3>::PointType origin;
  typename itk::Image<Pixel, 3>::SpacingType spacing;
  typename itk::Image<Pixel, 3>::DirectionType direction;
  for (int i = 0; i < 3; ++i) {
    size[i] = itk::SizeValueType(grid.size[i]);
    origin[i] = grid.origin[i];
    spacing[i] = grid.spacing[i];
    for (int j = 0; j < 3; ++j) direction(i, j) = grid.direction[i][j];
  }
  image.SetRegions(size);
  image.SetOrigin(origin);
  image.SetSpacing(spacing);
  image.SetDirection(direction);
}

/// Grid of the buffered region of an ITK image (its first voxel gets index 0).
template <class Pixel>
Grid grid_of(const itk::Image<Pixel, 3>& image) {
  const auto& region = image.GetBufferedRegion();
  typename itk::Image<Pixel, 3>::PointType origin = image.GetOrigin();
  if (region.GetIndex() != typename itk::Image<Pixel, 3>::IndexType{{0, 0, 0}})
    image.TransformIndexToPhysicalPoint(region.GetIndex(), origin);
  Grid grid;
  for (int i = 0; i < 3; ++i) {
    grid.size[i] = int(region.GetSize(i));
    grid.origin[i] = origin[i];
    grid.spacing[i] = image.GetSpacing()[i];
    for (int j = 0; j < 3; ++j) grid.direction[i][j] = image.GetDirection()(i, j);
  }
  return grid;
}

/// ITK image on the memory of `volume` (no copy): valid as long as `volume` lives and its data is not resized.
/// A filter that runs in place would write into `volume`; none may be given a const volume's view.
template <class T>
typename ItkImage<T>::Pointer view_as_itk(const Volume<T>& volume) {
  auto image = ItkImage<T>::New();
  set_geometry(*image, volume.grid);
  auto* pixels = reinterpret_cast<ItkPixel<T>*>(const_cast<T*>(volume.data.data()));
  image->GetPixelContainer()->SetImportPointer(pixels, volume.data.size(), false);
  return image;
}

/// Copy of the buffered region of an ITK image; T is the plain pixel type (Vec3f for itk::Vector<float, 3>).
template <class T>
Volume<T> volume_from_itk(const ItkImage<T>& image) {
  Volume<T> volume(grid_of(image));
  const T* pixels = reinterpret_cast<const T*>(image.GetBufferPointer());
  std::copy(pixels, pixels + volume.data.size(), volume.data.begin());
  return volume;
}

}  // namespace mtled
