#pragma once

namespace mtled {

/// The files of src/report/page, made part of the program by CMake.
extern const char page_template[], page_style[], page_script[];

}  // namespace mtled
