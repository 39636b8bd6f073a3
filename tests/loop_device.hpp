#pragma once
#include <algorithm>
#include <vector>

#include "core/parallel.hpp"

namespace mtled {

/// Runs index functors on the CPU, in host memory, with the interface of CudaDevice.
struct LoopDevice {
  template <class T>
  class Buffer {
   public:
    Buffer(LoopDevice&, std::size_t size) : memory_(size) {}
    T* data() { return memory_.data(); }
    const T* data() const { return memory_.data(); }
    void upload(const T* from, std::size_t count) { std::copy(from, from + count, memory_.begin()); }
    void download(T* to, std::size_t count) const { std::copy(memory_.begin(), memory_.begin() + std::ptrdiff_t(count), to); }

   private:
    std::vector<T> memory_;
  };
  template <class Functor>
  void for_each(int count, const Functor& functor) {
    parallel_for(std::size_t(count), [&](std::size_t i) { functor(int(i)); });
  }
};

}  // namespace mtled
