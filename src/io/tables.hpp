#pragma once
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "core/motion.hpp"

namespace mtled {

/// A CSV file with a header line; cells are text until asked for. Messages name file, row (as an editor counts lines)
/// and column.
class Table {
 public:
  static Table read(const std::filesystem::path& path);
  std::size_t rows() const { return cells_.size(); }
  bool has(const std::string& column) const;
  /// Column index; input error naming the columns that exist.
  int column(const std::string& name) const;
  /// Finite number in that cell, or an input error.
  double number(std::size_t row, int column) const;
  /// As number(); nothing when the cell is empty.
  std::optional<double> optional_number(std::size_t row, int column) const;
  const std::string& text(std::size_t row, int column) const;
  /// "points.csv, line 17" for messages.
  std::string place(std::size_t row) const;

 private:
  std::filesystem::path path_;
  std::vector<std::string> header_;
  std::vector<std::vector<std::string>> cells_;
};

/// Columns given by name (default x,y,z) as points [mm].
std::vector<Vec3d> read_points(const std::filesystem::path& path, const std::vector<std::string>& columns = {"x", "y", "z"});
/// x,y,z,ux,uy,uz with 9 significant digits.
void write_displacements(const std::filesystem::path& path, const std::vector<Vec3d>& points, const std::vector<Vec3d>& u);
void write_points(const std::filesystem::path& path, const std::vector<Vec3d>& points);

/// motions.json: {"convention": ..., "labels": [{"label", "center", "R" (row-major), "t"}, ...]}, LPS mm, moving -> fixed.
/// Input errors: not JSON, missing key, R not a rotation (1e-4), label twice.
std::vector<LabelMotion> read_motions(const std::filesystem::path& path);
void write_motions(const std::filesystem::path& path, const std::vector<LabelMotion>& motions);

/// Unstructured grid of vertices with vector and scalar point data (.vtu, binary appended or base64), for ParaView.
struct PointData { std::string name; int components; std::vector<float> values; };
void write_vtu(const std::filesystem::path& path, const std::vector<Vec3d>& points, const std::vector<PointData>& data);

}  // namespace mtled
