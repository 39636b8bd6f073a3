#pragma once
#include <cstddef>
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "core/motion.hpp"

namespace mtled {

/// A CSV file with a header line; cells are text until asked for. Messages name file, row (as an editor counts lines)
/// and column. RFC 4180 with tolerance: quoted cells may hold commas, line ends and doubled quotes; any line ends; a
/// UTF-8 byte order mark; blanks around unquoted cells and blank lines are dropped.
class Table {
 public:
  /// Input errors: cannot be read, no header, not text, separated by something else, open quote, rows of unequal
  /// length.
  static Table read(const std::filesystem::path& path);
  std::size_t rows() const { return lines_.size() - 1; }
  bool has(const std::string& column) const;
  /// Column index; input error naming the columns that exist, or when two have that name.
  int column(const std::string& name) const;
  /// Finite number in that cell, or an input error.
  double number(std::size_t row, int column) const;
  /// As number(); nothing when the cell is empty.
  std::optional<double> optional_number(std::size_t row, int column) const;
  /// The cell without its quotes; valid as long as the table is.
  std::string_view text(std::size_t row, int column) const { return cell((row + 1) * columns_ + std::size_t(column)); }
  /// "points.csv, line 17" for messages.
  std::string place(std::size_t row) const;

 private:
  Table() = default;
  std::string_view cell(std::size_t i) const {
    const std::size_t begin = i == 0 ? 0 : ends_[i - 1];
    return std::string_view(cells_).substr(begin, ends_[i] - begin);
  }
  std::string column_names() const;

  std::filesystem::path path_;
  std::size_t columns_ = 0;
  std::string cells_;               ///< all cells end to end, row after row; row 0 is the header
  std::vector<std::size_t> ends_;   ///< [(rows + 1) * columns] end of each cell in cells_
  std::vector<std::size_t> lines_;  ///< [rows + 1] line of the file where each row begins, from 1
};

/// Columns given by name (default x,y,z) as points [mm].
std::vector<Vec3d> read_points(const std::filesystem::path& path,
                               const std::vector<std::string>& columns = {"x", "y", "z"});
/// x,y,z,ux,uy,uz with 9 significant digits; NaN and infinity become empty cells.
void write_displacements(const std::filesystem::path& path, const std::vector<Vec3d>& points,
                         const std::vector<Vec3d>& u);
/// x,y,z in the same way.
void write_points(const std::filesystem::path& path, const std::vector<Vec3d>& points);

/// motions.json: {"convention": ..., "labels": [{"label", "center", "R" (row-major), "t"}, ...]}, LPS mm, moving ->
/// fixed. The convention must begin with "LPS mm"; other keys are ignored. Input errors: not JSON, missing key, label
/// outside 1..65535, R not a rotation (1e-4), label twice.
std::vector<LabelMotion> read_motions(const std::filesystem::path& path);
void write_motions(const std::filesystem::path& path, const std::vector<LabelMotion>& motions);

/// Values of one quantity at the points of a .vtu file.
struct PointData {
  std::string name;
  int components;
  std::vector<float> values;  ///< [points * components] components of a point side by side
};
/// Unstructured grid of vertices (.vtu, float32, raw appended) with vector and scalar point data, for ParaView.
void write_vtu(const std::filesystem::path& path, const std::vector<Vec3d>& points, const std::vector<PointData>& data);

}  // namespace mtled
