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

PointErrors errors_of(const Other& other, const Landmarks& landmarks) {
  std::vector<Vec3d> mapped;
  for (const Vec3d& f : landmarks.fixed) {
    Vec3d v;
    other.there(f, v);
    mapped.push_back(f + v);
  }
  return point_errors(mapped, landmarks.moving);
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

void leave_out_unknown(Landmarks& landmarks, const std::vector<Other>& others) {
  Landmarks known;
  known.left_out = landmarks.left_out;
  for (std::size_t p = 0; p < landmarks.rows.size(); ++p) {
    Vec3d v;
    const bool by_all = std::all_of(others.begin(), others.end(), [&](const Other& other) { return other.there(landmarks.fixed[p], v); });
    if (!by_all) {
      known.left_out.push_back(landmarks.rows[p]);
      continue;
    }
    known.rows.push_back(landmarks.rows[p]);
    known.fixed.push_back(landmarks.fixed[p]), known.moving.push_back(landmarks.moving[p]), known.mapped.push_back(landmarks.mapped[p]);
  }
  std::sort(known.left_out.begin(), known.left_out.end());
  require(landmarks.rows.empty() || !known.rows.empty(), "no landmark is known to all registrations that are compared; leave out the one of --beside whose field is too small");
  landmarks = std::move(known);
}

void report_landmarks(const Landmarks& landmarks, const std::vector<Other>& others, const Maps& maps, Json& report) {
  if (landmarks.rows.empty()) return;
  Json& j = report["landmarks"];
  j["before"] = describe(point_errors(landmarks.fixed, landmarks.moving));
  for (const Other& other : others) j[other.name] = describe(errors_of(other, landmarks));
  if (maps.there) j["after"] = describe(point_errors(landmarks.mapped, landmarks.moving));
  j["left_out_rows"] = landmarks.left_out;
  if (landmarks.left_out.empty()) return;
  std::string rows;
  for (std::size_t p = 0; p < std::min(rows_to_name, landmarks.left_out.size()); ++p) rows += concatenate(p ? ", " : "", landmarks.left_out[p]);
  if (landmarks.left_out.size() > rows_to_name) rows += ", ...";
  note(report, concatenate(landmarks.left_out.size(), " of ", landmarks.left_out.size() + landmarks.rows.size(), " landmarks lie outside the images or a displacement field and are left out (row ", rows, ")"));
}

std::string landmark_table(const Landmarks& landmarks, const Maps& maps) {
  std::string table = maps.there ? "row,fx,fy,fz,mx,my,mz,before_mm,after_mm\n" : "row,fx,fy,fz,mx,my,mz,before_mm\n";
  for (std::size_t p = 0; p < landmarks.rows.size(); ++p) {
    const Vec3d &f = landmarks.fixed[p], &m = landmarks.moving[p];
    table += concatenate(landmarks.rows[p], ",", f.x, ",", f.y, ",", f.z, ",", m.x, ",", m.y, ",", m.z, ",", norm(f - m));
    if (maps.there) table += concatenate(",", norm(landmarks.mapped[p] - m));
    table += "\n";
  }
  return table;
}

}  // namespace mtled
