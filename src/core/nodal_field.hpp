#pragma once
#include <cstddef>
#include <cstdlib>
#include <memory>
#include <new>

#include "core/parallel.hpp"

namespace mtled {

/// Three components per slot, component by component, each 64-byte aligned and padded so that a pack may start at any
/// slot. Starts at zero.
template <class Real>
class NodalField {
 public:
  static constexpr std::size_t padding = 32;  ///< slots before and after
  NodalField() = default;
  explicit NodalField(std::size_t slots)
      : slots_(slots), stride_((slots + 2 * padding + 15) / 16 * 16),
        data_(static_cast<Real*>(std::aligned_alloc(64, 3 * stride_ * sizeof(Real))), &std::free) {
    if (!data_) throw std::bad_alloc();
    clear();
  }
  std::size_t slots() const { return slots_; }
  Real* component(int c) { return data_.get() + std::size_t(c) * stride_ + padding; }
  const Real* component(int c) const { return data_.get() + std::size_t(c) * stride_ + padding; }
  Real& at(std::size_t slot, int c) { return component(c)[slot]; }
  const Real& at(std::size_t slot, int c) const { return component(c)[slot]; }
  void copy_from(const NodalField& b) {
    parallel_pieces(3 * stride_, 65536, [&](std::size_t begin, std::size_t end) { std::copy(b.data_.get() + begin, b.data_.get() + end, data_.get() + begin); });
  }
  void clear() {
    parallel_pieces(3 * stride_, 65536, [&](std::size_t begin, std::size_t end) { std::fill(data_.get() + begin, data_.get() + end, Real(0)); });
  }
  void swap(NodalField& b) noexcept { std::swap(slots_, b.slots_), std::swap(stride_, b.stride_), std::swap(data_, b.data_); }

 private:
  std::size_t slots_ = 0, stride_ = 0;
  std::unique_ptr<Real[], decltype(&std::free)> data_{nullptr, &std::free};
};

/// Sum of products, in double; the same bits for any number of threads.
template <class Real>
double dot(const NodalField<Real>& a, const NodalField<Real>& b) {
  return parallel_sum(a.slots(), [&](std::size_t begin, std::size_t end) {
    double sum = 0;
    for (int c = 0; c < 3; ++c) {
      const Real *x = a.component(c), *y = b.component(c);
      double part[8] = {};
      std::size_t s = begin;
      for (; s + 8 <= end; s += 8)
        for (std::size_t l = 0; l < 8; ++l) part[l] += double(x[s + l]) * double(y[s + l]);
      for (; s < end; ++s) part[0] += double(x[s]) * double(y[s]);
      for (double p : part) sum += p;
    }
    return sum;
  });
}

}  // namespace mtled
