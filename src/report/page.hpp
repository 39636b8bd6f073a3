#pragma once
#include <string>

#include "io/json.hpp"

namespace mtled {

/// A page of its own for `data` (docs/report.md): style, scripts and pictures are inside it.
std::string report_page(const Json& data);

/// Text that a JSON value may hold inside a <script> element of HTML.
std::string json_for_html(const Json& data);

}  // namespace mtled
