#include <algorithm>

#include "core/error.hpp"
#include "evaluate.hpp"
#include "io/tables.hpp"

namespace mtled {
namespace {

constexpr std::size_t rows_to_name = 10;  ///< of landmarks, in messages

bool inside(const Grid& grid, const Vec3d& point) {
  const Vec3d c = grid.index(point);
  bool in = true;
  for (int a = 0; a < 3; ++a) in = in && c[a] >= -0.5 && c[a] <= grid.size[a] - 0.5;
  return in;
}

std::vector<Vec3d> all(const std::vector<std::optional<Vec3d>>& points) {
  std::vector<Vec3d> values;
  for (const auto& point : points) values.push_back(*point);
  return values;
}

}  // namespace

Landmarks read_landmarks(const EvaluateOptions& options, const Grid& fixed, const std::optional<Image>& moving, const Maps& maps) {
  const bool one_file = !options.evaluation.landmarks.empty();
  const std::filesystem::path& fixed_file = one_file ? options.evaluation.landmarks : options.fixed_landmarks;
  const std::filesystem::path& moving_file = one_file ? options.evaluation.landmarks : options.moving_landmarks;
  if (fixed_file.empty()) return {};
  using Columns = std::vector<std::string>;
  const std::vector<Vec3d> f = read_points(fixed_file, one_file ? Columns{"fx", "fy", "fz"} : Columns{"x", "y", "z"});
  const std::vector<Vec3d> m = read_points(moving_file, one_file ? Columns{"mx", "my", "mz"} : Columns{"x", "y", "z"});
  require(f.size() == m.size(), "'", fixed_file.string(), "' has ", f.size(), " landmarks, '", moving_file.string(), "' has ", m.size(), "; both need the same points in the same order");
  require(!f.empty(), "'", fixed_file.string(), "' holds no landmarks; give at least one pair, or leave them out");
  Landmarks landmarks;
  for (std::size_t p = 0; p < f.size(); ++p) {
    Vec3d v;
    if (!inside(fixed, f[p]) || (moving && !inside(moving->grid, m[p])) || (maps.there && !maps.there(f[p], v))) {
      landmarks.left_out.push_back(p + 1);
      continue;
    }
    landmarks.rows.push_back(p + 1);
    landmarks.fixed.push_back(f[p]);
    landmarks.moving.push_back(m[p]);
    landmarks.mapped.push_back(f[p] + v);
  }
  require(!landmarks.rows.empty(), "all ", f.size(), " landmarks lie outside the images (or the displacement field); coordinates must be LPS mm, and fixed and moving must not be swapped");
  return landmarks;
}

void leave_out_unknown(Landmarks& landmarks, std::vector<Other>& others) {
  std::vector<std::size_t> kept;
  for (std::size_t p = 0; p < landmarks.rows.size(); ++p) {
    if (std::all_of(others.begin(), others.end(), [p](const Other& other) { return other.mapped[p].has_value(); })) kept.push_back(p);
    else landmarks.left_out.push_back(landmarks.rows[p]);
  }
  require(landmarks.rows.empty() || !kept.empty(), "no landmark is known to all registrations that are compared; leave out the one of --beside whose field is too small");
  const auto keep = [&](auto& list) {
    for (std::size_t k = 0; k < kept.size(); ++k) list[k] = list[kept[k]];
    list.resize(kept.size());
  };
  keep(landmarks.rows), keep(landmarks.fixed), keep(landmarks.moving), keep(landmarks.mapped);
  for (Other& other : others) keep(other.mapped);
  std::sort(landmarks.left_out.begin(), landmarks.left_out.end());
}

void report_landmarks(const Landmarks& landmarks, const std::vector<Other>& others, const Maps& maps, Json& report) {
  if (landmarks.rows.empty()) return;
  Json& j = report["landmarks"];
  j["before"] = describe(point_errors(landmarks.fixed, landmarks.moving));
  for (const Other& other : others) j[other.name] = describe(point_errors(all(other.mapped), landmarks.moving));
  if (maps.there) j["after"] = describe(point_errors(landmarks.mapped, landmarks.moving));
  j["left_out_rows"] = landmarks.left_out;
  if (landmarks.left_out.empty()) return;
  std::string rows;
  for (std::size_t p = 0; p < std::min(rows_to_name, landmarks.left_out.size()); ++p) rows += concatenate(p ? ", " : "", landmarks.left_out[p]);
  if (landmarks.left_out.size() > rows_to_name) rows += ", ...";
  note(report, concatenate(landmarks.left_out.size(), " of ", landmarks.left_out.size() + landmarks.rows.size(), " landmarks lie outside the images or a displacement field and are left out (row ", rows, ")"));
}

std::string landmark_table(const Landmarks& landmarks, const std::vector<Other>& others, const Maps& maps) {
  std::string table = "row,fx,fy,fz,mx,my,mz,before_mm";
  for (const Other& other : others) table += "," + other.name + "_mm";
  table += maps.there ? ",after_mm\n" : "\n";
  for (std::size_t p = 0; p < landmarks.rows.size(); ++p) {
    const Vec3d &f = landmarks.fixed[p], &m = landmarks.moving[p];
    table += concatenate(landmarks.rows[p], ",", f.x, ",", f.y, ",", f.z, ",", m.x, ",", m.y, ",", m.z, ",", norm(f - m));
    for (const Other& other : others) table += concatenate(",", norm(*other.mapped[p] - m));
    if (maps.there) table += concatenate(",", norm(landmarks.mapped[p] - m));
    table += "\n";
  }
  return table;
}

}  // namespace mtled
