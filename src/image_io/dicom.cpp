#include "image_io/dicom.hpp"

#include <gdcmTrace.h>
#include <itkGDCMImageIO.h>

#include <algorithm>
#include <cmath>
#include <map>

#include "core/error.hpp"
#include "image_io/format_checks.hpp"
#include "image_io/formats.hpp"
#include "image_io/voxels.hpp"

namespace mtled {
namespace {

/// Part of the slice distance by which a slice may lie off the regular grid: positions are rounded decimal texts.
constexpr double regularity_tolerance = 0.05;
constexpr double direction_tolerance = 1e-4;

struct Slice {
  itk::GDCMImageIO::Pointer io;
  Grid grid;
  std::string name;
};

/// Runs `work` so that its errors name the slice.
template <class Work>
auto in_slice(const std::string& name, Work&& work) {
  return with_context(name,
                      [&] { return translating_errors(Failure::input, "replace this slice by a sound copy", work); });
}

Slice open_slice(const std::filesystem::path& file) {
  const auto io = itk::GDCMImageIO::New();
  io->SetFileName(file.string());
  io->ReadImageInformation();
  require(io->GetNumberOfComponents() == 1, "it has ", io->GetNumberOfComponents(),
          " values per voxel; give a series of CT or MR slices");
  return {io, grid_of(*io), file.filename().string()};
}

std::string tag(const Slice& slice, const char* key) {
  std::string value;
  slice.io->GetValueFromTag(key, value);
  return value;
}

std::string described(const std::vector<Slice>& slices) {
  return concatenate(slices.size(), slices.size() == 1 ? " file " : " files ", tag(slices.front(), "0008|0060"), " '",
                     tag(slices.front(), "0008|103e"), "' such as ", slices.front().name);
}

std::vector<std::filesystem::path> sorted_files(const std::filesystem::path& folder) {
  std::vector<std::filesystem::path> files;
  for (const auto& entry : std::filesystem::directory_iterator(folder))
    if (entry.is_regular_file()) files.push_back(entry.path());
  std::sort(files.begin(), files.end());
  return files;
}

std::vector<Slice> slices_of_only_series(const std::filesystem::path& folder) {
  std::map<std::string, std::vector<Slice>> series;
  for (const std::filesystem::path& file : sorted_files(folder)) {
    const std::string name = file.filename().string();
    in_slice(name, [&] {
      if (!check_dicom(file)) return;
      Slice slice = open_slice(file);
      series[tag(slice, "0020|000e")].push_back(std::move(slice));
    });
  }
  require(!series.empty(), "the folder holds no DICOM images; give the folder whose files are the slices");
  std::string list;
  for (const auto& [uid, slices] : series) list += (list.empty() ? "" : "; ") + described(slices);
  require(series.size() == 1, "the folder holds ", series.size(), " DICOM series (", list,
          "); move the files of the wanted one to a folder of their own");
  return std::move(series.begin()->second);
}

Vec3d normal_of(const Grid& grid) { return {grid.direction[0][2], grid.direction[1][2], grid.direction[2][2]}; }

void require_same_plane(const Slice& first, const Slice& slice) {
  double turned = 0;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j)
      turned = std::max(turned, std::abs(slice.grid.direction[i][j] - first.grid.direction[i][j]));
  require(slice.grid.size == first.grid.size && turned <= direction_tolerance &&
              std::abs(slice.grid.spacing.x / first.grid.spacing.x - 1) <= direction_tolerance &&
              std::abs(slice.grid.spacing.y / first.grid.spacing.y - 1) <= direction_tolerance,
          "the slices ", first.name, " and ", slice.name,
          " differ in size, spacing or orientation; leave only the slices of one volume in the folder");
}

/// Grid of the volume that `slices`, sorted along their normal, make up.
Grid stacked(const std::vector<Slice>& slices) {
  require(slices.size() > 1, "the series has one slice only, which is no 3-D image; give the whole series");
  Grid grid = slices.front().grid;
  const Vec3d normal = normal_of(grid);
  const double gaps = double(slices.size() - 1);
  grid.size[2] = int(slices.size());
  grid.spacing.z = dot(slices.back().grid.origin - grid.origin, normal) / gaps;
  require(grid.spacing.z > 0, "all slices lie at the same position; give a series of slices at different positions");
  for (std::size_t k = 0; k < slices.size(); ++k) {
    require_same_plane(slices.front(), slices[k]);
    const double off = norm(slices[k].grid.origin - grid.point(0, 0, int(k)));
    require(off <= regularity_tolerance * grid.spacing.z, "the slice ", slices[k].name, " lies ", off,
            " mm off a regular grid of ", grid.spacing.z,
            " mm: slices are missing or repeated, or the gantry was tilted; complete the series or resample it");
  }
  return grid;
}

}  // namespace

Image read_dicom_series(const std::filesystem::path& folder) {
  silence_libraries();
  gdcm::Trace::WarningOff();
  gdcm::Trace::ErrorOff();
  std::vector<Slice> slices = slices_of_only_series(folder);
  const bool multi_frame = slices.size() == 1 && slices.front().grid.size[2] > 1;
  const Vec3d normal = normal_of(slices.front().grid);
  std::sort(slices.begin(), slices.end(),
            [&](const Slice& a, const Slice& b) { return dot(a.grid.origin, normal) < dot(b.grid.origin, normal); });
  Image image(multi_frame ? slices.front().grid : stacked(slices));
  const std::size_t slice_size = image.data.size() / slices.size();
  for (std::size_t k = 0; k < slices.size(); ++k)
    in_slice(slices[k].name, [&] { read_values(*slices[k].io, image.data.data() + k * slice_size); });
  return image;
}

}  // namespace mtled
