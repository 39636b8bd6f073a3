#pragma once
#include <algorithm>
#include <cstdint>
#include <functional>
#include <limits>
#include <map>
#include <memory>
#include <type_traits>
#include <utility>
#include <vector>

#include "core/host_device.hpp"
#include "cuda/check.hpp"

namespace mtled {

/// A block of threads on the GPU, see block.hpp.
template <class Functor>
class CudaBlock {
 public:
  using Shared = typename Functor::Shared;
  MTLED_HD explicit CudaBlock(Shared& shared) : shared_(shared) {}
  MTLED_HD int index() const {
#if defined(__CUDA_ARCH__)
    return int(blockIdx.x);
#else
    return 0;
#endif
  }
  MTLED_HD Shared& shared() { return shared_; }
  template <class Body>
  MTLED_HD void each_thread(const Body& body) {
#if defined(__CUDA_ARCH__)
    body(int(threadIdx.x));
    __syncthreads();
#endif
  }

 private:
  Shared& shared_;
};

inline constexpr int threads_per_index_block = 256;

/// The one place where indices are guarded.
template <class Functor>
__global__ void __launch_bounds__(threads_per_index_block) run_index_functor(int count, Functor functor) {
  const int i = int(blockIdx.x) * threads_per_index_block + int(threadIdx.x);
  if (i < count) functor(i);
}
template <class Functor>
__global__ void __launch_bounds__(Functor::threads) run_block_functor(Functor functor) {
  __shared__ typename Functor::Shared shared;
  CudaBlock<Functor> block(shared);
  functor(block);
}

/// Runs the functors of block.hpp on the current CUDA device, in order, on a stream of its own. Buffers start at zero. Calls
/// return before the work is done; errors of kernels appear at the next call that waits.
class CudaDevice {
 public:
  template <class T>
  class Buffer {
    static_assert(std::is_trivially_copyable_v<T>);

   public:
    Buffer(CudaDevice& device, std::size_t size) : size_(size), memory_(nullptr, Free{device.stream_.get()}) {
      if (size == 0) return;
      void* memory = nullptr;
      const cudaError_t result = cudaMallocAsync(&memory, bytes(), stream());
      if (result == cudaErrorMemoryAllocation) {
        cudaGetLastError();
        fail(Failure::memory, "the GPU has ", device.free_bytes() / 1e9, " GB of memory left, but ", double(bytes()) / 1e9,
             " GB more are needed; use a larger node spacing, or --device cpu");
      }
      MTLED_CUDA(result);
      memory_.reset(static_cast<T*>(memory));
      clear();
    }
    T* data() { return memory_.get(); }
    const T* data() const { return memory_.get(); }
    std::size_t size() const { return size_; }
    std::size_t bytes() const { return size_ * sizeof(T); }
    /// The host's memory may be used again on return.
    void upload(const T* from, std::size_t count) {
      if (count == 0) return;
      MTLED_CUDA(cudaMemcpyAsync(data(), from, count * sizeof(T), cudaMemcpyHostToDevice, stream()));
      MTLED_CUDA(cudaStreamSynchronize(stream()));
    }
    void download(T* to, std::size_t count) const {
      if (count == 0) return;
      MTLED_CUDA(cudaMemcpyAsync(to, data(), count * sizeof(T), cudaMemcpyDeviceToHost, stream()));
      MTLED_CUDA(cudaStreamSynchronize(stream()));
    }
    void copy_from(const Buffer& b) {
      if (bytes() > 0) MTLED_CUDA(cudaMemcpyAsync(data(), b.data(), bytes(), cudaMemcpyDeviceToDevice, stream()));
    }
    void clear() {
      if (bytes() > 0) MTLED_CUDA(cudaMemsetAsync(data(), 0, bytes(), stream()));
    }

   private:
    /// In the order of the stream, and into the pool of the device: vectors come and go during the relaxation.
    struct Free {
      cudaStream_t stream;
      void operator()(T* memory) const { cudaFreeAsync(memory, stream); }
    };
    cudaStream_t stream() const { return memory_.get_deleter().stream; }
    std::size_t size_;
    std::unique_ptr<T, Free> memory_;
  };

  CudaDevice() {
    cudaStream_t stream;
    MTLED_CUDA(cudaStreamCreateWithFlags(&stream, cudaStreamNonBlocking));
    stream_.reset(stream);
    int device = 0;
    MTLED_CUDA(cudaGetDevice(&device));
    MTLED_CUDA(cudaDeviceGetDefaultMemPool(&pool_, device));
    std::uint64_t keep_all = std::numeric_limits<std::uint64_t>::max();
    MTLED_CUDA(cudaMemPoolSetAttribute(pool_, cudaMemPoolAttrReleaseThreshold, &keep_all));
  }
  double free_bytes() const {
    std::size_t free_bytes = 0, total = 0;
    MTLED_CUDA(cudaMemGetInfo(&free_bytes, &total));
    std::uint64_t reserved = 0, used = 0;  // what the pool keeps can be used again
    MTLED_CUDA(cudaMemPoolGetAttribute(pool_, cudaMemPoolAttrReservedMemCurrent, &reserved));
    MTLED_CUDA(cudaMemPoolGetAttribute(pool_, cudaMemPoolAttrUsedMemCurrent, &used));
    return double(free_bytes) + double(reserved - used);
  }

  template <class Functor>
  void for_each(int count, const Functor& functor) {
    if (count <= 0) return;
    run_index_functor<<<unsigned((count + threads_per_index_block - 1) / threads_per_index_block), threads_per_index_block, 0, stream_.get()>>>(count, functor);
    MTLED_CUDA(cudaGetLastError());
  }
  template <class Functor>
  void for_blocks(int blocks, const Functor& functor) {
    if (blocks <= 0) return;
    run_block_functor<<<unsigned(blocks), Functor::threads, 0, stream_.get()>>>(functor);
    MTLED_CUDA(cudaGetLastError());
  }

  /// Calls `body` count times in effect: it is recorded into a graph of several repetitions, once for each `key`, and what
  /// is left over is launched directly. The body only launches functors, and the key names all that it captures.
  void repeat(const std::vector<const void*>& key, int count, const std::function<void()>& body) {
    constexpr int repetitions = 10;
    if (count >= repetitions) {
      Graph& graph = graphs_[key];
      if (!graph) {
        body(), --count;  // loads the kernels, which not every driver can do while it records
        graph = record(repetitions, body);
      }
      for (; count >= repetitions; count -= repetitions) MTLED_CUDA(cudaGraphLaunch(graph.get(), stream_.get()));
    }
    for (int i = 0; i < count; ++i) body();
  }
  void synchronize() { MTLED_CUDA(cudaStreamSynchronize(stream_.get())); }

 private:
  struct DestroyStream {
    void operator()(cudaStream_t stream) const { cudaStreamDestroy(stream); }
  };
  struct DestroyGraph {
    void operator()(cudaGraph_t graph) const { cudaGraphDestroy(graph); }
  };
  struct DestroyExecutable {
    void operator()(cudaGraphExec_t graph) const { cudaGraphExecDestroy(graph); }
  };
  using Graph = std::unique_ptr<std::remove_pointer_t<cudaGraphExec_t>, DestroyExecutable>;

  Graph record(int repetitions, const std::function<void()>& body) {
    MTLED_CUDA(cudaStreamBeginCapture(stream_.get(), cudaStreamCaptureModeThreadLocal));
    cudaGraph_t captured = nullptr;
    try {
      for (int i = 0; i < repetitions; ++i) body();
    } catch (...) {
      cudaStreamEndCapture(stream_.get(), &captured);
      if (captured) cudaGraphDestroy(captured);
      throw;
    }
    MTLED_CUDA(cudaStreamEndCapture(stream_.get(), &captured));
    const std::unique_ptr<std::remove_pointer_t<cudaGraph_t>, DestroyGraph> graph(captured);
    cudaGraphExec_t executable;
    MTLED_CUDA(cudaGraphInstantiate(&executable, graph.get(), 0));
    return Graph(executable);
  }

  std::unique_ptr<std::remove_pointer_t<cudaStream_t>, DestroyStream> stream_;
  cudaMemPool_t pool_ = nullptr;
  std::map<std::vector<const void*>, Graph> graphs_;
};

}  // namespace mtled
