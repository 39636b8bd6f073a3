#include "core/cpu_kernels.hpp"

namespace mtled {

#define MTLED_DECLARE_KERNELS(name)              \
  namespace name {                               \
  extern const KernelTable<float> float_table;   \
  extern const KernelTable<double> double_table; \
  }
MTLED_DECLARE_KERNELS(kernels_baseline)
#if defined(MTLED_X86)
MTLED_DECLARE_KERNELS(kernels_v3)
MTLED_DECLARE_KERNELS(kernels_v4)
#endif

namespace {

struct Choice {
  const KernelTable<float>* single;
  const KernelTable<double>* twice;
  const char* name;
};

Choice choose() {
#if defined(MTLED_X86)
  if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512bw"))
    return {&kernels_v4::float_table, &kernels_v4::double_table, "AVX-512"};
  if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma"))
    return {&kernels_v3::float_table, &kernels_v3::double_table, "AVX2"};
#endif
  return {&kernels_baseline::float_table, &kernels_baseline::double_table, "baseline"};
}

const Choice chosen = choose();

}  // namespace

template <>
const KernelTable<float>& best_kernels<float>() { return *chosen.single; }
template <>
const KernelTable<double>& best_kernels<double>() { return *chosen.twice; }
const char* best_kernels_name() { return chosen.name; }

}  // namespace mtled
