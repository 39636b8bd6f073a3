// Which device is taken of those there are, and what is said when there is none; with made-up devices.
#include <gtest/gtest.h>

#include "core/error.hpp"
#include "cuda/device_choice.hpp"

namespace mtled {
namespace {

DeviceDescription device(int ordinal, const std::string& name, double memory_bytes, double free_bytes, const std::string& unusable = "") {
  return {ordinal, name, 9, 0, 132, memory_bytes, free_bytes, unusable};
}

CudaStatus with_devices(std::vector<DeviceDescription> devices) {
  CudaStatus status;
  status.built = true;
  status.runtime = status.driver = "13.0";
  status.devices = std::move(devices);
  return status;
}

CudaStatus without_driver() {
  CudaStatus status;
  status.built = true;
  status.problem = "no CUDA device: the driver is not installed";
  status.remedy = "install one";
  return status;
}

/// A small and a large device.
CudaStatus two_devices() { return with_devices({device(0, "Small", 8e9, 7e9), device(1, "Large", 80.4e9, 79e9)}); }

DeviceChoice choose(const std::string& text, const CudaStatus& status, double bytes_needed = 0) { return choose_device(parse_device(text), status, bytes_needed); }

/// `work` fails in this way, with a message that holds all `parts`.
template <class Work>
void expect_failure(Failure failure, const std::vector<std::string>& parts, Work&& work) {
  try {
    work();
    ADD_FAILURE() << "no error; expected '" << parts[0] << "'";
  } catch (const Error& error) {
    EXPECT_EQ(int(error.failure()), int(failure)) << error.what();
    for (const std::string& part : parts) EXPECT_NE(std::string(error.what()).find(part), std::string::npos) << "'" << part << "' is not in: " << error.what();
  }
}

TEST(ParseDevice, ReadsWhatIsAllowed) {
  EXPECT_EQ(parse_device("auto").kind, DeviceRequest::automatic);
  EXPECT_EQ(parse_device("cpu").kind, DeviceRequest::cpu);
  EXPECT_EQ(parse_device("cuda").kind, DeviceRequest::cuda);
  EXPECT_EQ(parse_device("cuda").ordinal, -1);
  EXPECT_EQ(parse_device("cuda:0").ordinal, 0);
  EXPECT_EQ(parse_device("cuda:12").ordinal, 12);
}

TEST(ParseDevice, RefusesTheRest) {
  for (const char* text : {"", "gpu", "CPU", "Cuda", "cuda:", "cuda:-1", "cuda:+1", "cuda: 1", "cuda:1 ", "cuda:1x", "cuda:1.0", "cuda:99999999999", "cuda0", "cud", "auto:0", "cpu:0", "opencl:0"})
    expect_failure(Failure::usage, {concatenate("--device is '", text, "'"), "auto, cpu, cuda or cuda:N"}, [&] { parse_device(text); });
}

TEST(ChooseDevice, AutoTakesTheFirstThatWorksAndSaysWhich) {
  const DeviceChoice choice = choose("auto", two_devices());
  EXPECT_EQ(choice.ordinal, 0);
  EXPECT_EQ(choice.sentence(), "device: cuda:0 Small (8 GB)");
  EXPECT_EQ(choose("auto", with_devices({device(0, "Broken", 8e9, 7e9, "it smokes"), device(1, "Large", 80.4e9, 79e9)})).sentence(), "device: cuda:1 Large (80 GB)");
}

TEST(ChooseDevice, AutoTakesTheFirstWithTheMemory) {
  EXPECT_EQ(choose("auto", two_devices(), 7e9).ordinal, 0);
  EXPECT_EQ(choose("auto", two_devices(), 7.1e9).ordinal, 1);
  const DeviceChoice none = choose("auto", two_devices(), 90e9);
  EXPECT_TRUE(none.on_cpu());
  EXPECT_EQ(none.sentence(), "device: cpu (no CUDA device can be used: cuda:0 Small (8 GB): 90 GB needed, 7 GB free; cuda:1 Large (80 GB): 90 GB needed, 79 GB free)");
}

TEST(ChooseDevice, AutoSaysWhyItIsTheCpu) {
  EXPECT_EQ(choose("auto", without_driver()).sentence(), "device: cpu (no CUDA device: the driver is not installed)");
  EXPECT_EQ(choose("auto", with_devices({device(0, "Broken", 8e9, 7e9, "it smokes")})).sentence(), "device: cpu (no CUDA device can be used: cuda:0 Broken (8 GB): it smokes)");
}

TEST(ChooseDevice, CpuNeedsNoReason) {
  const DeviceChoice choice = choose("cpu", two_devices());
  EXPECT_TRUE(choice.on_cpu());
  EXPECT_EQ(choice.sentence(), "device: cpu");
}

TEST(ChooseDevice, TakesTheDeviceThatWasAskedFor) {
  EXPECT_EQ(choose("cuda", two_devices()).ordinal, 0);
  EXPECT_EQ(choose("cuda", two_devices(), 20e9).ordinal, 1);
  EXPECT_EQ(choose("cuda:1", two_devices()).ordinal, 1);
}

TEST(ChooseDevice, AskedForWithoutAnyIsAnError) {
  for (const char* text : {"cuda", "cuda:0"})
    expect_failure(Failure::device, {concatenate("--device ", text, ": "), "the driver is not installed", "install one", "--device cpu"}, [&] { choose(text, without_driver()); });
}

TEST(ChooseDevice, WrongNumberNamesTheDevicesThereAre) {
  expect_failure(Failure::device, {"--device cuda:7", "no such device", "cuda:0 Small (8 GB)", "cuda:1 Large (80 GB)"}, [] { choose("cuda:7", two_devices()); });
}

TEST(ChooseDevice, AskedForDefectiveIsAnErrorWithTheReason) {
  const CudaStatus status = with_devices({device(0, "Broken", 8e9, 7e9, "it smokes"), device(1, "Large", 80.4e9, 79e9)});
  expect_failure(Failure::device, {"--device cuda:0", "it smokes", "--device cpu"}, [&] { choose("cuda:0", status); });
  EXPECT_EQ(choose("cuda", status).ordinal, 1);
}

TEST(ChooseDevice, AskedForTooSmallIsAMemoryErrorWithBothSizes) {
  expect_failure(Failure::memory, {"--device cuda:0", "Small", "7.5 GB needed", "7 GB free", "node spacing"}, [] { choose("cuda:0", two_devices(), 7.5e9); });
  expect_failure(Failure::memory, {"--device cuda", "Small", "Large", "90 GB needed", "79 GB free"}, [] { choose("cuda", two_devices(), 90e9); });
}

}  // namespace
}  // namespace mtled
