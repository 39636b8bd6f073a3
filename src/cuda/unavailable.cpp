// The CUDA backend of a program that is built without it.
#include "cuda/backend.hpp"

namespace mtled {

CudaStatus cuda_status() {
  CudaStatus status;
  status.problem = "no CUDA device: this program is built without CUDA";
  status.remedy = "build it where there is a CUDA Toolkit, with -DMTLED_CUDA=ON";
  return status;
}

}  // namespace mtled
