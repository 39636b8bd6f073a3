#include "image_io/formats.hpp"

#include <itkMetaImageIO.h>
#include <itkNiftiImageIO.h>
#include <itkNrrdImageIO.h>

#include <algorithm>
#include <cctype>
#include <sstream>

namespace mtled {

bool has_extension(const std::filesystem::path& path, std::string_view extension) {
  std::string name = path.filename().string();
  std::transform(name.begin(), name.end(), name.begin(), [](unsigned char c) { return char(std::tolower(c)); });
  return name.ends_with(extension);
}

Format format_of(const std::filesystem::path& path) {
  const auto ends_in = [&](auto... extensions) { return (has_extension(path, extensions) || ...); };
  if (ends_in(".nii", ".nii.gz")) return Format::nifti;
  if (ends_in(".nrrd", ".nhdr")) return Format::nrrd;
  if (ends_in(".mha", ".mhd")) return Format::meta;
  return Format::unknown;
}

void silence_libraries() { itk::Object::SetGlobalWarningDisplay(false); }

itk::ImageIOBase::Pointer image_io_for(Format format) {
  silence_libraries();
  switch (format) {
    case Format::nifti:
      return itk::NiftiImageIO::New().GetPointer();
    case Format::nrrd:
      return itk::NrrdImageIO::New().GetPointer();
    case Format::meta:
      return itk::MetaImageIO::New().GetPointer();
    case Format::unknown:
      break;
  }
  fail(Failure::internal, "there is no reader for this format");
}

std::string reason_of(const itk::ExceptionObject& error) {
  std::istringstream lines(error.GetDescription());
  std::string last;
  for (std::string line; std::getline(lines, line);)
    if (!line.empty()) last = line;
  const std::size_t itk_prefix = last.starts_with("ITK ERROR:") ? last.find("): ") : std::string::npos;
  if (itk_prefix != std::string::npos) last.erase(0, itk_prefix + 3);
  const std::size_t nrrd_prefix = last.starts_with("[nrrd]") ? last.find(": ") : std::string::npos;
  if (nrrd_prefix != std::string::npos) last.erase(0, nrrd_prefix + 2);
  while (!last.empty() && (last.back() == '.' || last.back() == ' ' || last.back() == '!')) last.pop_back();
  last.erase(0, last.find_first_not_of(' '));
  return last.empty() ? "the ITK library gave no reason" : last;
}

void fail_to_write(const std::string& reason) {
  fail(Failure::output, "it cannot be written (", reason, "); check the free space and the permissions of the folder");
}

}  // namespace mtled
