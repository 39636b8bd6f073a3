// Dense fields and warps on a CUDA device. Compile without contraction of products and sums (-fmad=false): the kernels then take
// the CPU's decisions, such as which nodes lie within a support, to the last bit.
#include "cuda/field.hpp"

#include "cuda/cuda_device.cuh"
#include "cuda/field_on.hpp"

namespace mtled {
namespace {

CudaDevice device_with(int ordinal) {
  MTLED_CUDA(cudaSetDevice(ordinal));
  return CudaDevice();
}

}  // namespace

std::unique_ptr<FieldBackend> cuda_field(int ordinal, const ShapeEvaluator& evaluator, const std::vector<Vec3d>& parameter) {
  return std::make_unique<FieldOn<CudaDevice>>(device_with(ordinal), make_lattice_field(evaluator, parameter));
}

SampleDisplaced cuda_sampler(int ordinal) {
  return [ordinal](const Image& samples, const VectorImage& displacement, Interpolation interpolation, float outside) {
    CudaDevice device = device_with(ordinal);
    return sample_displaced_on(device, samples, displacement, interpolation, outside);
  };
}

}  // namespace mtled
