#pragma once
#include <algorithm>
#include <cstring>
#include <functional>
#include <memory>
#include <type_traits>
#include <vector>

namespace mtled {

/// Runs the functors of block.hpp on the host, one thread after the other: the reference of the CUDA launcher, with the same
/// interface. Results must not depend on the order of the threads within a phase, so that there are two.
class SerialDevice {
 public:
  template <class T>
  class Buffer {
    static_assert(std::is_trivially_copyable_v<T>);

   public:
    Buffer(SerialDevice&, std::size_t size) : memory_(size) { clear(); }
    T* data() { return memory_.data(); }
    const T* data() const { return memory_.data(); }
    std::size_t size() const { return memory_.size(); }
    std::size_t bytes() const { return size() * sizeof(T); }
    void upload(const T* from, std::size_t count) { std::copy(from, from + count, memory_.begin()); }
    void download(T* to, std::size_t count) const { std::copy(memory_.begin(), memory_.begin() + std::ptrdiff_t(count), to); }
    void copy_from(const Buffer& b) { memory_ = b.memory_; }
    void clear() {
      if (size() > 0) std::memset(static_cast<void*>(data()), 0, bytes());
    }

   private:
    std::vector<T> memory_;
  };

  explicit SerialDevice(bool descending = false, double free_bytes = 1e30) : descending_(descending), free_bytes_(free_bytes) {}
  double free_bytes() const { return free_bytes_; }

  template <class Functor>
  void for_each(int count, const Functor& functor) {
    static_assert(std::is_trivially_copyable_v<Functor>);
    each(count, descending_, [&](int i) { functor(i); });
  }
  template <class Functor>
  void for_blocks(int blocks, const Functor& functor) {
    static_assert(std::is_trivially_copyable_v<Functor>);
    each(blocks, descending_, [&](int b) {
      Block<Functor> block(b, descending_);
      functor(block);
    });
  }
  void repeat(const std::vector<const void*>&, int count, const std::function<void()>& body) {
    for (int i = 0; i < count; ++i) body();
  }
  void synchronize() {}

 private:
  template <class Body>
  static void each(int count, bool descending, Body&& body) {
    for (int i = 0; i < count; ++i) body(descending ? count - 1 - i : i);
  }

  template <class Functor>
  class Block {
   public:
    using Shared = typename Functor::Shared;
    static_assert(std::is_trivially_copyable_v<Shared>);
    Block(int index, bool descending) : index_(index), descending_(descending), shared_(new Shared) {
      std::memset(static_cast<void*>(shared_.get()), 0xff, sizeof(Shared));  // what is read before it is written is not a number
    }
    int index() const { return index_; }
    Shared& shared() { return *shared_; }
    template <class Body>
    void each_thread(Body&& body) {
      each(Functor::threads, descending_, body);
    }

   private:
    int index_;
    bool descending_;
    std::unique_ptr<Shared> shared_;
  };

  bool descending_;
  double free_bytes_;
};

}  // namespace mtled
