#include "report/page.hpp"

#include "core/error.hpp"
#include "report/page_text.hpp"

namespace mtled {
namespace {

void replace(std::string& text, const std::string& marker, const std::string& by) {
  const std::size_t at = text.find(marker);
  require(at != std::string::npos, "the template of the report has no ", marker);
  text.replace(at, marker.size(), by);
}

}  // namespace

std::string json_for_html(const Json& data) {
  std::string text = data.dump(-1, ' ', false, Json::error_handler_t::replace), safe;
  safe.reserve(text.size());
  // Neither the end of the element nor the start of a comment may appear in it.
  for (const char c : text) c == '<' ? safe += "\\u003c" : safe += c;
  return safe;
}

std::string report_page(const Json& data) {
  std::string page = page_template;
  replace(page, "/*STYLE*/", page_style);
  replace(page, "/*SCRIPT*/", page_script);
  replace(page, "/*DATA*/", json_for_html(data));
  return page;
}

}  // namespace mtled
