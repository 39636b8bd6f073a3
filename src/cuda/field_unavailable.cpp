// Dense fields of a program that is built without CUDA.
#include "core/error.hpp"
#include "cuda/field.hpp"

namespace mtled {
namespace {

[[noreturn]] void refuse(int ordinal) {
  fail(Failure::device, "cuda:", ordinal, " cannot compute fields: this program is built without CUDA; use --device cpu, or build it with -DMTLED_CUDA=ON");
}

}  // namespace

std::unique_ptr<FieldBackend> cuda_field(int ordinal, const ShapeEvaluator&, const std::vector<Vec3d>&) { refuse(ordinal); }
SampleDisplaced cuda_sampler(int ordinal) { refuse(ordinal); }

}  // namespace mtled
