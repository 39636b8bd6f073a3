#include "report/node_cloud.hpp"

#include <algorithm>
#include <set>

#include "core/error.hpp"
#include "report/packing.hpp"

namespace mtled {
namespace {

constexpr double stiffest_shown_kpa = 5;  ///< as in the pictures: bone shares the last colour
constexpr std::size_t most_labels = 255;      ///< of a byte, beside 0

/// Bits of a number well mixed (the finaliser of SplitMix64, Steele, Lea, Flood 2014): neighbours in the list, which are
/// neighbours in space, are chosen independently.
std::uint64_t mixed(std::uint64_t n) {
  n += 0x9e3779b97f4a7c15u;
  n = (n ^ n >> 30) * 0xbf58476d1ce4e5b9u;
  n = (n ^ n >> 27) * 0x94d049bb133111ebu;
  return n ^ n >> 31;
}

std::vector<std::size_t> chosen(std::size_t count, std::size_t most) {
  std::vector<std::size_t> nodes(count);
  for (std::size_t n = 0; n < count; ++n) nodes[n] = n;
  if (count <= most) return nodes;
  std::nth_element(nodes.begin(), nodes.begin() + std::ptrdiff_t(most), nodes.end(), [](std::size_t a, std::size_t b) { return mixed(a) < mixed(b); });
  nodes.resize(most);
  std::sort(nodes.begin(), nodes.end());
  return nodes;
}

/// The numbers but 0 that occur among the labels of some nodes, rising, the first 255 of them: what a byte can point to.
std::vector<int> numbers_in(const std::vector<float>& label, const std::vector<std::size_t>& nodes) {
  std::set<int> numbers;
  for (const std::size_t n : nodes)
    if (label[n] != 0) numbers.insert(int(label[n]));
  std::vector<int> kept(numbers.begin(), numbers.end());
  kept.resize(std::min(kept.size(), most_labels));
  return kept;
}

}  // namespace

Json node_cloud(const std::vector<Vec3d>& rest, const std::vector<Vec3d>& displacement, const std::vector<float>& shear_modulus_kpa, const std::vector<float>& label, std::size_t most) {
  require(displacement.size() == rest.size() && shear_modulus_kpa.size() == rest.size() && label.size() == rest.size(), "the cloud of ", rest.size(), " nodes has ", displacement.size(), " displacements, ",
          shear_modulus_kpa.size(), " moduli and ", label.size(), " labels; give one of each per node");
  const std::vector<std::size_t> nodes = chosen(rest.size(), most);
  Vec3d middle{};
  for (const std::size_t n : nodes) middle += rest[n];
  if (!nodes.empty()) middle = 1.0 / double(nodes.size()) * middle;
  PackedVectors positions, displacements;
  const std::vector<int> numbers = numbers_in(label, nodes);
  std::vector<std::uint8_t> stiffness, labels;
  for (const std::size_t n : nodes) {
    positions.add(rest[n] - middle);
    displacements.add(displacement[n]);
    stiffness.push_back(std::uint8_t(std::lround(255 * std::clamp(shear_modulus_kpa[n] / stiffest_shown_kpa, 0.0, 1.0))));
    const auto number = std::lower_bound(numbers.begin(), numbers.end(), int(label[n]));
    labels.push_back(number != numbers.end() && *number == int(label[n]) ? std::uint8_t(1 + (number - numbers.begin())) : std::uint8_t(0));
  }
  return {{"count", rest.size()}, {"shown", nodes.size()}, {"origin_mm", {middle.x, middle.y, middle.z}}, {"scale_mm", PackedVectors::scale_mm}, {"rest", positions.text()}, {"displacement", displacements.text()},
          {"scalars", {{{"name", "Shear modulus"}, {"unit", "kPa"}, {"low", 0}, {"high", stiffest_shown_kpa}, {"open_end", true}, {"data", base64(stiffness)}}}}, {"labels", numbers}, {"label", base64(labels)}};
}

}  // namespace mtled
