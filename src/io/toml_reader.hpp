#pragma once
#include <toml++/toml.h>

#include <filesystem>
#include <set>
#include <string>
#include <type_traits>

#include "core/error.hpp"

namespace mtled {

/// One table of a TOML file, read key by key; keys that nobody asked for are errors (finish()).
class TomlSection {
 public:
  /// `table` may be null: every optional value is then its default.
  TomlSection(const toml::table* table, std::string file, std::string name) : table_(table), file_(std::move(file)), name_(std::move(name)) {}

  bool has(const std::string& key) {
    known_.insert(key);
    return table_ && table_->contains(key);
  }
  template <class T>
  T value(const std::string& key, T otherwise) {
    if (!has(key)) return otherwise;
    const auto v = (*table_)[key].template value<T>();
    require(v.has_value(), place(key), " has the wrong type; it must be ", kind<T>);
    return *v;
  }
  std::string required_text(const std::string& key) {
    require(has(key), file_, ": [", name_, "] lacks `", key, "`");
    return value<std::string>(key, "");
  }
  const toml::table* section(const std::string& key) {
    if (!has(key)) return nullptr;
    require((*table_)[key].is_table(), place(key), " must be a table");
    return (*table_)[key].as_table();
  }
  const toml::array* array(const std::string& key) {
    if (!has(key)) return nullptr;
    require((*table_)[key].is_array(), place(key), " must be an array");
    return (*table_)[key].as_array();
  }
  std::string place(const std::string& key) const { return file_ + ": `" + (name_.empty() ? "" : name_ + ".") + key + "`"; }
  /// Input error when the table has a key that was never asked for.
  void finish() const {
    if (!table_) return;
    for (const auto& [key, node] : *table_) {
      if (known_.count(std::string(key.str()))) continue;
      std::string list;
      for (const std::string& k : known_) list += (list.empty() ? "" : ", ") + k;
      fail(Failure::input, place(std::string(key.str())), " is not a known setting (line ", node.source().begin.line, "); known here: ", list);
    }
  }

 private:
  template <class T>
  static constexpr const char* kind = std::is_same_v<T, bool> ? "true or false" : std::is_same_v<T, std::string> ? "a text in quotes" : std::is_integral_v<T> ? "a whole number" : "a number";

  const toml::table* table_;
  std::string file_, name_;
  std::set<std::string> known_;
};

/// Parses a TOML file; input error with line and reason.
toml::table parse_toml(const std::filesystem::path& path);

}  // namespace mtled
