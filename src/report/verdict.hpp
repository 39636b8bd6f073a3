#pragma once
#include "io/json.hpp"

namespace mtled {

/// What speaks for and against a registration, from the numbers of a report (docs/report.md): `level` (good, check, bad),
/// `headline`, and `items` with level, label, value, compared, detail. The last of `candidates` is judged; the others are
/// what it is compared with. Bad: it folds, goes the wrong way, did not converge, or made edges, landmarks or labels
/// worse than doing nothing. To be checked: warnings, worse than another candidate, a label that it bends or whose motion it
/// misses.
Json verdict_of(const Json& facts);

constexpr double noticeable_rigidity_mm = 0.5;  ///< rms distance of a label from its rigid motion that is pointed out

}  // namespace mtled
