#pragma once
#include <nlohmann/json.hpp>

namespace mtled {

/// Reports keep their keys in the order in which they were written.
using Json = nlohmann::ordered_json;

}  // namespace mtled
