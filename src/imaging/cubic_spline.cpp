#include "imaging/cubic_spline.hpp"

#include <itkBSplineDecompositionImageFilter.h>

#include "imaging/itk_bridge.hpp"

namespace mtled {

Image spline_coefficients(const Image& image) {
  using Filter = itk::BSplineDecompositionImageFilter<ItkImage<float>, ItkImage<float>>;
  const auto filter = Filter::New();
  filter->SetSplineOrder(3);
  filter->SetInput(view_as_itk(image));
  filter->Update();
  Image coefficients = volume_from_itk<float>(*filter->GetOutput());
  coefficients.grid = image.grid;
  return coefficients;
}

}  // namespace mtled
