#include <charconv>
#include <cmath>
#include <ostream>

#include "core/error.hpp"
#include "io/output.hpp"
#include "io/tables.hpp"

namespace mtled {
namespace {

constexpr int significant_digits = 9;

void append_number(std::string& text, double value) {
  char buffer[32];
  if (!std::isfinite(value)) return;
  const auto end =
      std::to_chars(buffer, buffer + sizeof buffer, value, std::chars_format::general, significant_digits).ptr;
  text.append(buffer, end);
}

void append_vector(std::string& text, const Vec3d& v) {
  for (int i = 0; i < 3; ++i) {
    if (i) text += ',';
    append_number(text, v[i]);
  }
}

}  // namespace

std::vector<Vec3d> read_points(const std::filesystem::path& path, const std::vector<std::string>& columns) {
  if (columns.size() != 3) fail(Failure::internal, "read_points needs three columns");
  const Table table = Table::read(path);
  const int x = table.column(columns[0]), y = table.column(columns[1]), z = table.column(columns[2]);
  std::vector<Vec3d> points(table.rows());
  for (std::size_t i = 0; i < points.size(); ++i)
    points[i] = {table.number(i, x), table.number(i, y), table.number(i, z)};
  return points;
}

void write_displacements(const std::filesystem::path& path, const std::vector<Vec3d>& points,
                         const std::vector<Vec3d>& u) {
  if (points.size() != u.size()) fail(Failure::internal, "one displacement per point is needed");
  write_stream(path, [&](std::ostream& stream) {
    stream << "x,y,z,ux,uy,uz\n";
    std::string row;
    for (std::size_t i = 0; i < points.size(); ++i) {
      row.clear();
      append_vector(row, points[i]);
      row += ',';
      append_vector(row, u[i]);
      stream << (row += '\n');
    }
  });
}

void write_points(const std::filesystem::path& path, const std::vector<Vec3d>& points) {
  write_stream(path, [&](std::ostream& stream) {
    stream << "x,y,z\n";
    std::string row;
    for (const Vec3d& point : points) {
      row.clear();
      append_vector(row, point);
      stream << (row += '\n');
    }
  });
}

}  // namespace mtled
