#pragma once
/// Marks a function that both the CPU backend and CUDA kernels compile.
#if defined(__CUDACC__)
#define MTLED_HD __host__ __device__
#else
#define MTLED_HD
#endif
