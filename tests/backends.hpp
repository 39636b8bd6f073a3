#pragma once
#include <gtest/gtest.h>

#include <string>

#include "cuda/device_choice.hpp"

/// Backends for test bodies that run on each. Tests that need a device are named such that `*OnCuda.*:*/*cuda` finds them (they
/// have the label `gpu` in CTest), and no other test is. Without a device they are skipped, and say why. Large cases have "Large" in their name: compute-sanitizer leaves these out.
namespace mtled::backends {

/// The device that tests run on, or why there is none. Looks once.
inline const DeviceChoice& device() {
  static const DeviceChoice choice = choose_device({DeviceRequest::automatic}, cuda_status());
  return choice;
}

/// For tests of CUDA alone: TEST_F(OnCuda, Name).
class OnCuda : public testing::Test {
 protected:
  void SetUp() override {
    if (device().on_cpu()) GTEST_SKIP() << "SKIPPED: " << device().reason;
  }
};

enum class Backend {
  cpu,
  serial,  ///< the functors of the CUDA backend, one thread after the other on the host
  cuda,
};
inline const auto every_backend = testing::Values(Backend::cpu, Backend::serial, Backend::cuda);
inline const auto device_backends = testing::Values(Backend::serial, Backend::cuda);
inline std::string name(Backend backend) { return backend == Backend::cpu ? "cpu" : backend == Backend::serial ? "serial" : "cuda"; }
/// What the solver computes with on that backend (backends.cpp).
MakeMechanics mechanics_of(Backend backend);

/// For SetUp() of tests on a backend; the name of a parameter ends with that of the backend.
inline void skip_without_device(Backend backend) {
  if (backend == Backend::cuda && device().on_cpu()) GTEST_SKIP() << "SKIPPED: " << device().reason;
}
/// For tests on every backend: using Forces = EachBackend; TEST_P(Forces, Name) with `GetParam()`, and
/// INSTANTIATE_TEST_SUITE_P(On, Forces, every_backend, backend_name).
class EachBackend : public testing::TestWithParam<Backend> {
 protected:
  void SetUp() override { skip_without_device(GetParam()); }
};
inline std::string backend_name(const testing::TestParamInfo<Backend>& info) { return name(info.param); }

}  // namespace mtled::backends
