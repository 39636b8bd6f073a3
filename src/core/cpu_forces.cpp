#include "core/cpu_forces.hpp"

#include <algorithm>
#include <numeric>

#include "core/lanes.hpp"
#include "core/point_material.hpp"

namespace mtled {
namespace {

constexpr int fewest_in_aligned_pack = 3;  ///< below, point by point is cheaper than a mostly idle pack

}  // namespace

template <class Real>
struct CpuForces<Real>::Packs {
  static constexpr int W = LaneTraits<Real>::width;
  std::vector<int> begin, offset;
  std::vector<Real> gradient;
  std::vector<int> aligned_stencil, aligned_base, gathered_stencil, gathered_base;
  std::vector<Real> aligned_material, gathered_material;
  MaterialModel model = MaterialModel::neo_hookean;
  std::vector<PronyTerm> prony;
  std::vector<Real> aligned_memory, gathered_memory;
  std::vector<PackRange> ranges;
  std::size_t aligned_points = 0;

  PackView<Real> view() const {
    return {begin.data(), offset.data(), gradient.data(), aligned_stencil.data(), aligned_base.data(),
            aligned_material.data(), gathered_stencil.data(), gathered_base.data(), gathered_material.data()};
  }

  void set_material(std::vector<Real>& material, std::size_t pack, int lane, const IntegrationPoints& points, std::size_t p) {
    const int parameters = 2 + further_parameters(model);
    const std::size_t size = std::size_t((1 + parameters) * W);
    const bool is_new = material.size() < size * (pack + 1);
    if (is_new) material.resize(size * (pack + 1));
    Real* m = material.data() + size * pack;
    m[lane] = Real(points.volume[p]);
    // Idle lanes get the parameters of the first point: an exponent of 0, for one, would not give zero stress but NaN.
    for (int i = 0; i < parameters; ++i)
      for (int l = is_new ? 0 : lane; l < (is_new ? W : lane + 1); ++l) m[(1 + i) * W + l] = Real(material_parameter(points, p, i));
  }

  void add_aligned(const SupportTable& t, const IntegrationPoints& points, const std::uint32_t* first, const std::uint32_t* last) {
    const std::size_t pack = aligned_stencil.size();
    aligned_stencil.push_back(t.stencil[*first]);
    aligned_base.push_back(t.base[*first]);
    for (const std::uint32_t* p = first; p != last; ++p) set_material(aligned_material, pack, t.base[*p] - t.base[*first], points, *p);
    aligned_points += std::size_t(last - first);
  }

  void add_gathered(const SupportTable& t, const IntegrationPoints& points, const std::vector<std::uint32_t>& single) {
    for (std::size_t s = 0; s < single.size(); s += W) {
      const std::size_t pack = gathered_stencil.size() / W;
      for (int lane = 0; lane < W; ++lane) {
        const bool used = s + std::size_t(lane) < single.size();
        gathered_stencil.push_back(used ? t.stencil[single[s + std::size_t(lane)]] : -1);
        gathered_base.push_back(used ? t.base[single[s + std::size_t(lane)]] : 0);
        if (used) set_material(gathered_material, pack, lane, points, single[s + std::size_t(lane)]);
      }
    }
  }

  /// Packs of the points [first, last), which are sorted by stencil and base.
  void add_range(const SupportTable& t, const IntegrationPoints& points, const std::uint32_t* first, const std::uint32_t* last) {
    PackRange range{aligned_stencil.size(), 0, gathered_stencil.size() / W, 0};
    std::vector<std::uint32_t> single;
    while (first != last) {
      const std::uint32_t* end = first + 1;
      while (end != last && t.stencil[*end] == t.stencil[*first] && t.base[*end] < t.base[*first] + W &&
             t.base[*end] != t.base[end[-1]])
        ++end;
      if (end - first >= fewest_in_aligned_pack) {
        add_aligned(t, points, first, end);
      } else {
        single.insert(single.end(), first, end);
      }
      first = end;
    }
    std::sort(single.begin(), single.end(), [&](auto a, auto b) { return t.base[a] != t.base[b] ? t.base[a] < t.base[b] : a < b; });
    add_gathered(t, points, single);
    range.aligned_end = aligned_stencil.size(), range.gathered_end = gathered_stencil.size() / W;
    ranges.push_back(range);
  }
};

template <class Real>
CpuForces<Real>::CpuForces(const SupportTable& t, const SlotLayout& layout, const IntegrationPoints& instantaneous) : packs_(new Packs) {
  const IntegrationPoints faded = instantaneous.viscoelastic() ? long_term(instantaneous) : IntegrationPoints{};
  const IntegrationPoints& points = instantaneous.viscoelastic() ? faded : instantaneous;
  require(points.further.size() == points.size() * std::size_t(further_parameters(points.model)), "every integration point needs all parameters of the material");
  const PronyTerm sum = total(instantaneous.prony);
  require(instantaneous.prony.size() <= std::size_t(MemoryView<Real>::most_terms) && sum.alpha < 1 && sum.alpha_volumetric < 1,
          "a Prony series has at most ", MemoryView<Real>::most_terms, " terms, whose alphas sum to less than 1");
  packs_->model = points.model;
  packs_->prony = instantaneous.prony;
  packs_->begin = t.begin;
  packs_->offset = t.offset;
  packs_->gradient.resize(4 * t.gradient.size());
  for (std::size_t s = 0; s < t.gradient.size(); ++s)
    for (int c = 0; c < 3; ++c) packs_->gradient[4 * s + std::size_t(c)] = Real(t.gradient[s][c]);

  std::vector<int> low(std::size_t(t.num_stencils())), high(low.size());
  for (std::size_t s = 0; s < low.size(); ++s) {
    const auto [a, b] = std::minmax_element(t.offset.begin() + t.begin[s], t.offset.begin() + t.begin[s + 1]);
    if (t.begin[s] < t.begin[s + 1]) low[s] = *a, high[s] = *b;
  }
  std::vector<std::uint32_t> order;
  std::vector<int> first_slot(points.size());
  int span = 0;
  for (std::size_t p = 0; p < points.size(); ++p) {
    const int s = t.stencil[p];
    if (s < 0) continue;
    order.push_back(std::uint32_t(p));
    first_slot[p] = t.base[p] + low[std::size_t(s)];
    span = std::max(span, high[std::size_t(s)] - low[std::size_t(s)]);
  }
  // Idle lanes of aligned packs add zeros up to W - 1 slots beyond: they count as touched.
  const int length = span + LaneTraits<Real>::width + 1;
  std::sort(order.begin(), order.end(), [&](std::uint32_t a, std::uint32_t b) {
    const int ra = first_slot[a] / length, rb = first_slot[b] / length;
    if (ra != rb) return ra < rb;
    if (t.stencil[a] != t.stencil[b]) return t.stencil[a] < t.stencil[b];
    return t.base[a] != t.base[b] ? t.base[a] < t.base[b] : a < b;
  });
  int range = 0;
  std::size_t begin = 0;
  while (range * static_cast<long>(length) < layout.num_slots) {
    std::size_t end = begin;
    while (end < order.size() && first_slot[order[end]] / length == range) ++end;
    packs_->add_range(t, points, order.data() + begin, order.data() + end);
    begin = end, ++range;
  }
  packs_->aligned_memory.assign(packs_->prony.size() * 6 * packs_->aligned_stencil.size() * LaneTraits<Real>::width, Real(0));
  packs_->gathered_memory.assign(packs_->prony.size() * 6 * packs_->gathered_stencil.size(), Real(0));
}

template <class Real>
CpuForces<Real>::~CpuForces() = default;

namespace {

template <class Real>
FieldView<Real> view(const NodalField<Real>& u) { return {{u.component(0), u.component(1), u.component(2)}}; }
template <class Real>
MutableFieldView<Real> view(NodalField<Real>& u) { return {{u.component(0), u.component(1), u.component(2)}}; }

/// body(range number) for the even ranges, then for the odd ones.
template <class Body>
void each_range(std::size_t ranges, Body&& body) {
  for (std::size_t colour = 0; colour < 2; ++colour)
    parallel_pieces((ranges + 1 - colour) / 2, 1, [&](std::size_t b, std::size_t) { body(2 * b + colour); });
}

}  // namespace

template <class Real>
template <class Kernel>
VolumeRatioStatistics CpuForces<Real>::over_ranges(Kernel&& kernel) const {
  std::vector<VolumeRatioStatistics> part(packs_->ranges.size());
  each_range(packs_->ranges.size(), [&](std::size_t r) { part[r] = kernel(packs_->ranges[r]); });
  VolumeRatioStatistics all;
  for (const auto& s : part) {
    if (!(s.smallest >= all.smallest) && !std::isnan(all.smallest)) all.smallest = s.smallest;
    all.inverted += s.inverted;
  }
  return all;
}

template <class Real>
VolumeRatioStatistics CpuForces<Real>::force(const NodalField<Real>& u, NodalField<Real>& f) const {
  f.clear();
  const PackView<Real> packs = packs_->view();
  const auto from = view(u);
  const auto to = view(f);
  const auto kernel = best_kernels<Real>().of[int(packs_->model)].force;
  return over_ranges([&](const PackRange& range) { return kernel(packs, range, from, to); });
}

template <class Real>
VolumeRatioStatistics CpuForces<Real>::force_in_time(const NodalField<Real>& u, double time_step, NodalField<Real>& f) {
  if (!viscoelastic()) return force(u, f);
  const PronyTerm sum = total(packs_->prony);
  const double instantaneous[2] = {1 / (1 - sum.alpha), 1 / (1 - sum.alpha_volumetric)};
  MemoryView<Real> memory{packs_->aligned_memory.data(), packs_->gathered_memory.data(), int(packs_->prony.size()), {Real(instantaneous[0]), Real(instantaneous[1])}, {}, {}};
  for (std::size_t t = 0; t < packs_->prony.size(); ++t) {
    const PronyTerm& term = packs_->prony[t];
    const double share = time_step / (time_step + term.tau);
    memory.gain[t][0] = Real(term.alpha * share * instantaneous[0]), memory.gain[t][1] = Real(term.alpha_volumetric * share * instantaneous[1]);
    memory.decay[t] = Real(term.tau / (time_step + term.tau));
  }
  f.clear();
  const PackView<Real> packs = packs_->view();
  const auto from = view(u);
  const auto to = view(f);
  const auto kernel = best_kernels<Real>().of[int(packs_->model)].force_in_time;
  return over_ranges([&](const PackRange& range) { return kernel(packs, range, from, to, memory); });
}

template <class Real>
bool CpuForces<Real>::viscoelastic() const { return !packs_->prony.empty(); }

template <class Real>
void CpuForces<Real>::tangent(const NodalField<Real>& u, const NodalField<Real>& v, NodalField<Real>& f) const {
  f.clear();
  const PackView<Real> packs = packs_->view();
  const auto at = view(u), along = view(v);
  const auto to = view(f);
  each_range(packs_->ranges.size(), [&](std::size_t r) { best_kernels<Real>().of[int(packs_->model)].tangent(packs, packs_->ranges[r], at, along, to); });
}

template <class Real>
std::size_t CpuForces<Real>::bytes() const {
  const Packs& p = *packs_;
  return sizeof(int) * (p.begin.size() + p.offset.size() + p.aligned_stencil.size() + p.aligned_base.size() + p.gathered_stencil.size() + p.gathered_base.size()) +
         sizeof(Real) * (p.gradient.size() + p.aligned_material.size() + p.gathered_material.size() + p.aligned_memory.size() + p.gathered_memory.size());
}
template <class Real>
std::size_t CpuForces<Real>::aligned_points() const { return packs_->aligned_points; }
template <class Real>
std::size_t CpuForces<Real>::aligned_packs() const { return packs_->aligned_stencil.size(); }

template class CpuForces<float>;
template class CpuForces<double>;

}  // namespace mtled
