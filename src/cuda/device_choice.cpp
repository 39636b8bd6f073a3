#include "cuda/device_choice.hpp"

#include <charconv>
#include <vector>

#include "core/error.hpp"

namespace mtled {
namespace {

double gigabytes(double bytes) { return bytes / 1e9; }
std::string describe(const DeviceDescription& d) { return concatenate("cuda:", d.ordinal, " ", d.name, " (", int(gigabytes(d.memory_bytes) + 0.5), " GB)"); }

/// "the first; the second"
std::string listed(const std::vector<std::string>& parts) {
  std::string text;
  for (const std::string& part : parts) text += (text.empty() ? "" : "; ") + part;
  return text;
}

DeviceChoice cpu_because(const std::string& reason) { return {-1, reason, "cpu"}; }

}  // namespace

DeviceRequest parse_device(const std::string& text) {
  if (text == "auto") return {DeviceRequest::automatic};
  if (text == "cpu") return {DeviceRequest::cpu};
  if (text == "cuda") return {DeviceRequest::cuda};
  const std::string prefix = "cuda:";
  int ordinal = -1;
  const char* const end = text.data() + text.size();
  const bool has_prefix = text.compare(0, prefix.size(), prefix) == 0;
  const auto [stop, error] = has_prefix ? std::from_chars(text.data() + prefix.size(), end, ordinal) : std::from_chars_result{end, std::errc::invalid_argument};
  if (error != std::errc() || stop != end || ordinal < 0)
    fail(Failure::usage, "--device is '", text, "'; choose auto, cpu, cuda or cuda:N with the number N of a device (`mtled info` lists them)");
  return {DeviceRequest::cuda, ordinal};
}

std::string DeviceChoice::sentence() const { return concatenate("device: ", description, reason.empty() ? "" : concatenate(" (", reason, ")")); }

DeviceChoice choose_device(const DeviceRequest& request, const CudaStatus& status, double bytes_needed) {
  if (request.kind == DeviceRequest::cpu) return cpu_because("");
  const bool asked = request.kind == DeviceRequest::cuda;
  const std::string option = request.ordinal < 0 ? "--device cuda" : concatenate("--device cuda:", request.ordinal);
  if (!status.problem.empty()) {
    if (asked) fail(Failure::device, option, ": ", status.problem, "; ", status.remedy, ", or use --device cpu");
    return cpu_because(status.problem);
  }
  std::vector<std::string> all, defective, small;
  bool there = false;
  for (const DeviceDescription& d : status.devices) {
    all.push_back(describe(d));
    if (request.ordinal >= 0 && d.ordinal != request.ordinal) continue;
    there = true;
    if (!d.unusable.empty()) defective.push_back(describe(d) + ": " + d.unusable);
    else if (d.free_bytes < bytes_needed) small.push_back(concatenate(describe(d), ": ", gigabytes(bytes_needed), " GB needed, ", gigabytes(d.free_bytes), " GB free"));
    else return {d.ordinal, "", describe(d)};
  }
  if (!there) fail(Failure::device, option, ": there is no such device; there are: ", listed(all), ". Choose one of them, or use --device cpu");
  if (asked && small.empty()) fail(Failure::device, option, ": no device works: ", listed(defective), ". Or use --device cpu");
  if (asked)
    fail(Failure::memory, option, ": too little memory: ", listed(small), ". End other programs on the device, use a larger node spacing, or --device cpu");
  defective.insert(defective.end(), small.begin(), small.end());
  return cpu_because("no CUDA device can be used: " + listed(defective));
}

}  // namespace mtled
