#pragma once
#include <functional>
#include <string>

#include "imaging/figure_layout.hpp"

namespace mtled {

/// Three slices of `image` under the colours of `values_on` each slice (NaN: not coloured) [unit in `title`], up to
/// `largest` (0: the largest value there is), with black lines at the labelled values if `lines`.
Picture colored_slices(const Image& image, const std::function<Image(const Grid&)>& values_on, const std::string& title, double largest, bool lines);

}  // namespace mtled
