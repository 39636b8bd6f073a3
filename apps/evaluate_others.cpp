#include <algorithm>
#include <cctype>

#include "core/error.hpp"
#include "evaluate.hpp"
#include "image_io/image_io.hpp"

namespace mtled {
namespace {

constexpr std::size_t most_others = 5;  ///< that the report can show
/// Names of images, and of what else stands beside them in the tables and in the report.
constexpr const char* taken[] = {"fixed", "moving", "warped", "before", "after", "mtled", "edges", "displacement", "jacobian", "shear_modulus", "left_out_rows"};

void require_name(const std::string& name, const std::string& text, const std::vector<Other>& others) {
  const bool simple = !name.empty() && std::all_of(name.begin(), name.end(), [](unsigned char c) { return std::isalnum(c) || c == ' ' || c == '-' || c == '_' || c == '.'; });
  if (!simple) fail(Failure::usage, "--beside ", text, ": write NAME=FILE with a name of letters, digits, spaces and -_. such as B-spline=result/fixed_to_moving.nrrd");
  if (std::find(std::begin(taken), std::end(taken), name) != std::end(taken)) fail(Failure::usage, "--beside ", text, ": the name '", name, "' has a meaning of its own in the results; choose another one");
  if (std::any_of(others.begin(), others.end(), [&](const Other& o) { return o.name == name; })) fail(Failure::usage, "--beside ", text, ": the name '", name, "' is there twice; give every registration its own");
}

}  // namespace

std::vector<Other> parse_others(const std::vector<std::string>& texts) {
  std::vector<Other> others;
  if (texts.size() > most_others) fail(Failure::usage, "--beside is there ", texts.size(), " times; at most ", most_others, " registrations are compared at once");
  for (const std::string& text : texts) {
    const std::size_t equals = text.find('=');
    if (equals == std::string::npos || equals + 1 == text.size()) fail(Failure::usage, "--beside ", text, ": write NAME=FILE, such as B-spline=result/fixed_to_moving.nrrd");
    Other other;
    other.name = text.substr(0, equals);
    require_name(other.name, text, others);
    other.file = text.substr(equals + 1);
    if (std::filesystem::is_directory(other.file)) other.file /= "fixed_to_moving.nrrd";
    others.push_back(std::move(other));
  }
  return others;
}

void read_others(std::vector<Other>& others, const Image& moving, const Mask& mask, const LabelMaps& labels, const Landmarks& landmarks, Mask& where, Json& report) {
  for (Other& other : others) {
    DisplacementFunction there = read_transform(other.file, "transform '" + other.name + "'");
    const auto field = field_on(mask.grid, there);
    const Mask known = intersection(mask, field->covered);
    require(count(known) > 0, "--beside ", other.name, ": '", other.file.string(), "' is known at no voxel of the fixed image (within the mask); check that it belongs to these images");
    Mask inside;
    other.warped = warp_continued(moving, mask.grid, &field->displacement, inside);
    where = intersection(intersection(std::move(where), field->covered), inside);
    require(count(where) > 0, "--beside ", other.name, ": '", other.file.string(), "' and the registrations before it lead no common voxel (within the mask) into the moving image; check that it maps points of the fixed to the moving image");
    if (labels.moving) other.labels = warp_labels(*labels.moving, field->displacement);
    Json& j = report["beside"][other.name];
    j["jacobian"] = describe(jacobian_statistics(field->displacement, known));
    if (labels.fixed || other.labels) j["rigidity"] = describe(label_rigidity(labels.fixed ? *labels.fixed : *other.labels, *field));
    for (const Vec3d& f : landmarks.fixed) {
      Vec3d v;
      other.mapped.push_back(there(f, v) ? std::optional(f + v) : std::nullopt);
    }
  }
}

}  // namespace mtled
