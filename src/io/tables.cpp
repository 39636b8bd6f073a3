#include "io/tables.hpp"

#include <charconv>
#include <cmath>
#include <system_error>

#include "core/error.hpp"
#include "io/input.hpp"

namespace mtled {
namespace {

/// Cells of a CSV text, moved to the front of the same buffer: a cell is never longer than what it was read from.
class CsvSplitter {
 public:
  CsvSplitter(std::string& text, const std::string& name) : text_(text), name_(name) {
    if (text_.starts_with("\xEF\xBB\xBF")) in_ = 3;
  }
  /// Appends the cells of the next row that is not blank to `ends`, its line to `lines`; false at the end of the text.
  bool next_row(std::vector<std::size_t>& ends, std::vector<std::size_t>& lines) {
    while (in_ < text_.size() && blank_line()) {
    }
    if (in_ == text_.size()) {
      text_.resize(out_);
      return false;
    }
    lines.push_back(line_);
    do {
      next_cell();
      ends.push_back(out_);
    } while (in_ < text_.size() && text_[in_] == ',' && ++in_);
    skip_line_end();
    return true;
  }

 private:
  static bool is_blank(char c) { return c == ' ' || c == '\t'; }
  static bool is_line_end(char c) { return c == '\n' || c == '\r'; }
  void skip_blanks() {
    while (in_ < text_.size() && is_blank(text_[in_])) ++in_;
  }
  void skip_line_end() {
    if (in_ == text_.size()) return;
    if (text_[in_] == '\r' && in_ + 1 < text_.size() && text_[in_ + 1] == '\n') ++in_;
    ++in_, ++line_;
  }
  bool blank_line() {
    skip_blanks();
    if (in_ == text_.size() || !is_line_end(text_[in_])) return false;
    skip_line_end();
    return true;
  }
  void next_cell() {
    skip_blanks();
    if (in_ < text_.size() && text_[in_] == '"') return quoted_cell();
    const std::size_t begin = out_;
    while (in_ < text_.size() && text_[in_] != ',' && !is_line_end(text_[in_])) text_[out_++] = text_[in_++];
    while (out_ > begin && is_blank(text_[out_ - 1])) --out_;
  }
  void quoted_cell() {
    const std::size_t first_line = line_;
    for (++in_;; ++in_) {
      require(in_ < text_.size(), name_, ", line ", first_line, ": a quote (\") is never closed; close it");
      if (text_[in_] == '\n') ++line_;
      if (text_[in_] == '"' && (++in_ == text_.size() || text_[in_] != '"')) break;
      text_[out_++] = text_[in_];
    }
    skip_blanks();
    require(in_ == text_.size() || text_[in_] == ',' || is_line_end(text_[in_]), name_, ", line ", line_,
            ": text follows a closing quote (\"); write a quote within a cell twice");
  }

  std::string& text_;
  const std::string& name_;
  std::size_t in_ = 0, out_ = 0, line_ = 1;
};

bool parse_finite(std::string_view text, double& value) {
  if (text.starts_with('+') && !text.starts_with("+-")) text.remove_prefix(1);
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  return error == std::errc() && end == text.data() + text.size() && std::isfinite(value);
}

}  // namespace

Table Table::read(const std::filesystem::path& path) {
  Table table;
  table.path_ = path;
  table.cells_ = read_file(path);
  const std::string name = path.string();
  require(table.cells_.find('\0') == std::string::npos, name, ": not a text file; save the table as CSV in UTF-8");
  CsvSplitter splitter(table.cells_, name);
  require(splitter.next_row(table.ends_, table.lines_), name,
          ": the file is empty; its first line must name the columns");
  table.columns_ = table.ends_.size();
  const std::string_view first = table.cell(0);
  require(table.columns_ > 1 || first.find_first_of(";\t") == first.npos, name,
          ": the columns are not separated by commas ('", first, "'); save the table with commas");
  while (splitter.next_row(table.ends_, table.lines_)) {
    const std::size_t found = table.ends_.size() - table.columns_ * (table.lines_.size() - 1);
    require(found == table.columns_, name, ", line ", table.lines_.back(), ": ", found, " cells where the header has ",
            table.columns_, "; add or remove commas");
  }
  return table;
}

bool Table::has(const std::string& name) const {
  for (std::size_t i = 0; i < columns_; ++i)
    if (cell(i) == name) return true;
  return false;
}

int Table::column(const std::string& name) const {
  int found = -1;
  for (std::size_t i = 0; i < columns_; ++i) {
    if (cell(i) != name) continue;
    require(found < 0, path_.string(), ": two columns are named '", name, "'; rename one");
    found = int(i);
  }
  require(found >= 0, path_.string(), ": no column '", name, "'; the columns are ", column_names());
  return found;
}

double Table::number(std::size_t row, int column) const {
  const std::string_view value = text(row, column);
  double number = 0;
  if (parse_finite(value, number)) return number;
  const std::string problem =
      value.empty() ? "the cell is empty" : concatenate("'", value.substr(0, 40), "' is not a finite number");
  fail(Failure::input, place(row), ", column '", cell(std::size_t(column)), "': ", problem,
       "; write one such as -12.5");
}

std::optional<double> Table::optional_number(std::size_t row, int column) const {
  if (text(row, column).empty()) return std::nullopt;
  return number(row, column);
}

std::string Table::place(std::size_t row) const { return concatenate(path_.string(), ", line ", lines_[row + 1]); }

std::string Table::column_names() const {
  std::string names;
  for (std::size_t i = 0; i < columns_; ++i) names.append(i ? ", '" : "'").append(cell(i)).append("'");
  return names;
}

}  // namespace mtled
