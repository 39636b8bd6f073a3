// What the program finds out about the devices of this machine.
#include "backends.hpp"

namespace mtled {
namespace {

using backends::OnCuda;

TEST(Status, IsCompleteWithAndWithoutDevices) {
  const CudaStatus status = cuda_status();
  EXPECT_EQ(status.problem.empty(), !status.devices.empty());
  EXPECT_EQ(status.problem.empty(), status.remedy.empty());
  EXPECT_EQ(status.built, !status.runtime.empty());
  EXPECT_EQ(status.built, !status.architectures.empty());
  EXPECT_TRUE(status.devices.empty() || !status.driver.empty());
}

TEST_F(OnCuda, DeviceIsDescribed) {
  const CudaStatus status = cuda_status();
  ASSERT_LT(std::size_t(backends::device().ordinal), status.devices.size());
  const DeviceDescription& d = status.devices[std::size_t(backends::device().ordinal)];
  EXPECT_EQ(d.unusable, "");
  EXPECT_FALSE(d.name.empty());
  EXPECT_GE(10 * d.capability_major + d.capability_minor, 50);
  EXPECT_GT(d.multiprocessors, 0);
  EXPECT_GT(d.free_bytes, 0);
  EXPECT_LE(d.free_bytes, d.memory_bytes);
}

}  // namespace
}  // namespace mtled
