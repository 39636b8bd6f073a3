#pragma once
#include <itkImageIOBase.h>

#include <filesystem>
#include <string>
#include <string_view>

#include "core/error.hpp"

namespace mtled {

enum class Format { nifti, nrrd, meta, unknown };

/// By the end of the name, in small or capital letters.
Format format_of(const std::filesystem::path& path);
bool has_extension(const std::filesystem::path& path, std::string_view extension);
/// Turns ITK's warnings on stderr off: the program's own messages say what matters.
void silence_libraries();
/// ITK's reader and writer for that format; never for `unknown`.
itk::ImageIOBase::Pointer image_io_for(Format format);
/// The telling line of an ITK error: without class names, addresses and the chain of callers.
std::string reason_of(const itk::ExceptionObject& error);
/// Output error: the file cannot be written, because.
[[noreturn]] void fail_to_write(const std::string& reason);

/// Runs `work`; an ITK error becomes an Error of kind `failure` that gives the reason and `remedy`.
/// Running out of memory becomes a memory error.
template <class Work>
decltype(auto) translating_errors(Failure failure, const std::string& remedy, Work&& work) {
  try {
    return work();
  } catch (const itk::MemoryAllocationError&) {
    fail(Failure::memory, "not enough memory; use a smaller image or a larger machine");
  } catch (const itk::ExceptionObject& error) {
    fail(failure, reason_of(error), "; ", remedy);
  } catch (const std::bad_alloc&) {
    fail(Failure::memory, "not enough memory; use a smaller image or a larger machine");
  }
}

}  // namespace mtled
