#include <cmath>
#include <nlohmann/json.hpp>
#include <numbers>
#include <set>

#include "core/error.hpp"
#include "io/input.hpp"
#include "io/output.hpp"
#include "io/tables.hpp"

namespace mtled {
namespace {

using Json = nlohmann::ordered_json;

constexpr const char* convention = "LPS mm; moving point x -> fixed point y = R (x-c) + c + t ; R row-major";
/// On entries of R Rᵀ - I: lets rotations through that were written with 5 digits, and no scaling or shear that
/// matters.
constexpr double rotation_tolerance = 1e-4;

const Json& member(const Json& object, const char* key) {
  require(object.is_object() && object.contains(key), "the key \"", key, "\" is missing; add it");
  return object.at(key);
}

Vec3d vector_of(const Json& json, const char* key) {
  bool good = json.is_array() && json.size() == 3;
  for (int i = 0; good && i < 3; ++i) good = json[std::size_t(i)].is_number();
  require(good, "\"", key, "\" must hold three numbers, such as [1.5, 0, -2]");
  return {json[0].get<double>(), json[1].get<double>(), json[2].get<double>()};
}

Mat3d rotation_of(const Json& json) {
  require(json.is_array() && json.size() == 3, "\"R\" must be three rows of three numbers");
  Mat3d r;
  for (int i = 0; i < 3; ++i) {
    const Vec3d row = vector_of(json[std::size_t(i)], "R");
    for (int j = 0; j < 3; ++j) r[i][j] = row[j];
  }
  const Mat3d product = r * transpose(r);
  double worst = 0;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) worst = std::max(worst, std::abs(product[i][j] - (i == j)));
  require(worst <= rotation_tolerance, "\"R\" is not a rotation (R Rᵀ is ", worst,
          " off the identity); give a rotation without scale or shear, with 6 digits or more");
  require(determinant(r) > 0, "\"R\" is a reflection (determinant -1); give a rotation");
  return r;
}

LabelMotion label_motion(const Json& json) {
  const Json& label = member(json, "label");
  require(label.is_number_integer() && label.get<double>() >= 1 && label.get<double>() <= 65535, "\"label\" is ",
          label.dump(), "; it must be a whole number from 1 to 65535");
  return with_context(concatenate("label ", label.get<int>()), [&] {
    return LabelMotion{label.get<int>(),
                       RigidMotion{vector_of(member(json, "center"), "center"), rotation_of(member(json, "R")),
                                   vector_of(member(json, "t"), "t")}};
  });
}

Json parse(const std::string& text) {
  try {
    return Json::parse(text);
  } catch (const Json::exception& error) {
    const std::string what = error.what();  // "[json.exception.parse_error.101] parse error at line 3, ..."
    fail(Failure::input, "not valid JSON (", what.substr(std::min(what.find("] ") + 2, what.size())),
         "); correct the file");
  }
}

std::vector<LabelMotion> motions_of(const Json& document) {
  const Json& said = member(document, "convention");
  require(said.is_string() && said.get<std::string>().starts_with("LPS mm"), "\"convention\" is ", said.dump(),
          "; only \"", convention, "\" is understood: convert the motions to it");
  const Json& labels = member(document, "labels");
  require(labels.is_array(), "\"labels\" must be a list of motions");
  std::vector<LabelMotion> motions;
  std::set<int> seen;
  for (std::size_t i = 0; i < labels.size(); ++i) {
    motions.push_back(
        with_context(concatenate("entry ", i + 1, " of \"labels\""), [&] { return label_motion(labels[i]); }));
    require(seen.insert(motions.back().label).second, "label ", motions.back().label, " has two motions; remove one");
  }
  return motions;
}

Json json_of(const Vec3d& v) { return Json::array({v.x, v.y, v.z}); }

}  // namespace

std::vector<LabelMotion> read_motions(const std::filesystem::path& path) {
  const std::string text = read_file(path);
  return with_context(path.string(), [&] { return motions_of(parse(text)); });
}

void write_motions(const std::filesystem::path& path, const std::vector<LabelMotion>& motions) {
  Json labels = Json::array();
  for (const auto& [label, motion] : motions) {
    Json rows = Json::array();
    for (int i = 0; i < 3; ++i)
      rows.push_back(json_of({motion.rotation[i][0], motion.rotation[i][1], motion.rotation[i][2]}));
    labels.push_back({{"label", label},
                      {"center", json_of(motion.center)},
                      {"R", rows},
                      {"t", json_of(motion.translation)},
                      {"rotvec_deg", json_of(180 / std::numbers::pi * rotation_vector(motion.rotation))}});
  }
  write_text(path, Json{{"convention", convention}, {"labels", labels}}.dump(1) + "\n");
}

}  // namespace mtled
