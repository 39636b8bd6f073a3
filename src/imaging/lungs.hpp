#pragma once
#include "imaging/body.hpp"

namespace mtled {

/// The lungs in a CT: air (at most `threshold`) inside the body, in pieces of at least a fiftieth of the largest one
/// (collapsed lungs lie in pieces; gas in the bowel is mostly less), with what lies enclosed in them within a slice
/// along k (vessels). The airways are part of them as
/// far as they are connected. Empty where the body holds no air. Input error: there is no body.
Mask lung_mask(const Image& ct, const BodyOptions& options);

}  // namespace mtled
