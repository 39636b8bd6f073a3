#pragma once
#include <filesystem>

#include "core/volume.hpp"

namespace mtled {

/// The one DICOM series in `folder` (not in folders below) as intensities, rescale slope and intercept applied; slices
/// ordered along their normal. Input errors: no series, several (listed), one slice only, slices that differ in size or
/// orientation, that are missing or repeated, or a tilted gantry.
Image read_dicom_series(const std::filesystem::path& folder);

}  // namespace mtled
