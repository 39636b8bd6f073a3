#pragma once
#include <vector>

#include "core/gather_table.hpp"

namespace mtled {

template <class T, class Device>
typename Device::template Buffer<T> uploaded(Device& device, const std::vector<T>& values) {
  typename Device::template Buffer<T> buffer(device, values.size());
  buffer.upload(values.data(), values.size());
  return buffer;
}

/// A table of gathers in the memory of a device.
template <class Real, class Device>
class UploadedTable {
  template <class T>
  using Buffer = typename Device::template Buffer<T>;

 public:
  UploadedTable(Device& device, const GatherTable<Real>& t)
      : threads_(t.threads), shared_threads_(t.shared_threads), row_(uploaded(device, t.row)), base_(uploaded(device, t.base)), stencil_(uploaded(device, t.stencil)),
        stencil_begin_(uploaded(device, t.stencil_begin)), stencil_entry_(uploaded(device, t.stencil_entry)), slice_begin_(uploaded(device, t.slice_begin)),
        own_(uploaded(device, t.own)) {}
  GatherTableView<Real> view() const {
    return {threads_, shared_threads_, row_.data(), base_.data(), stencil_.data(), stencil_begin_.data(), stencil_entry_.data(), slice_begin_.data(), own_.data()};
  }
  std::size_t bytes() const {
    return row_.bytes() + base_.bytes() + stencil_.bytes() + stencil_begin_.bytes() + stencil_entry_.bytes() + slice_begin_.bytes() + own_.bytes();
  }

 private:
  int threads_, shared_threads_;
  Buffer<std::int32_t> row_, base_, stencil_;
  Buffer<std::uint32_t> stencil_begin_;
  Buffer<GatherEntry<Real>> stencil_entry_;
  Buffer<std::uint64_t> slice_begin_;
  Buffer<GatherEntry<Real>> own_;
};

}  // namespace mtled
