#include "core/coupled_integration.hpp"

#include <algorithm>
#include <cmath>
#include <unordered_map>

namespace mtled {
namespace {

constexpr double smallest_piece = 1e-6;  ///< of a cube; less is rounding

/// Mean of points, weighted by their volumes. Further parameters that are no moduli (an exponent, a fibre's direction) are
/// those of the largest contribution.
struct PointSum {
  static constexpr int most_further = 4;
  double volume = 0, shear = 0, bulk = 0, density = 0, largest = 0;
  std::array<double, most_further> further{};
  Vec3d position{};

  void add(const IntegrationPoints& points, std::size_t p, double piece, const Vec3d& place) {
    volume += piece, position += piece * place;
    shear += piece * points.shear_modulus[p], bulk += piece * points.bulk_modulus[p], density += piece * points.density[p];
    const int count = further_parameters(points.model), moduli = further_moduli(points.model);
    for (int i = 0; i < count; ++i) {
      const double value = points.further[p * std::size_t(count) + std::size_t(i)];
      if (i < moduli) further[std::size_t(i)] += piece * value;
      else if (piece > largest) further[std::size_t(i)] = value;
    }
    largest = std::max(largest, piece);
  }
  void add(const PointSum& other, MaterialModel model) {
    volume += other.volume, position += other.position;
    shear += other.shear, bulk += other.bulk, density += other.density;
    for (int i = 0; i < further_parameters(model); ++i) {
      if (i < further_moduli(model)) further[std::size_t(i)] += other.further[std::size_t(i)];
      else if (other.largest > largest) further[std::size_t(i)] = other.further[std::size_t(i)];
    }
    largest = std::max(largest, other.largest);
  }
  void append_to(IntegrationPoints& points) const {
    if (volume <= 0) return;
    points.position.push_back((1 / volume) * position);
    points.volume.push_back(volume);
    points.shear_modulus.push_back(shear / volume), points.bulk_modulus.push_back(bulk / volume), points.density.push_back(density / volume);
    for (int i = 0; i < further_parameters(points.model); ++i)
      points.further.push_back(i < further_moduli(points.model) ? further[std::size_t(i)] / volume : further[std::size_t(i)]);
  }
};

/// No points, of the same material law.
IntegrationPoints none_like(const IntegrationPoints& points) {
  IntegrationPoints none;
  none.model = points.model, none.prony = points.prony;
  return none;
}

void append(const IntegrationPoints& from, std::size_t p, IntegrationPoints& to) {
  to.position.push_back(from.position[p]), to.volume.push_back(from.volume[p]);
  to.shear_modulus.push_back(from.shear_modulus[p]), to.bulk_modulus.push_back(from.bulk_modulus[p]), to.density.push_back(from.density[p]);
  const std::size_t count = std::size_t(further_parameters(from.model));
  to.further.insert(to.further.end(), from.further.begin() + std::ptrdiff_t(p * count), from.further.begin() + std::ptrdiff_t((p + 1) * count));
}

enum class Cell { incomplete, free, coupled, rigid };

Cell kind_of(const Approximation& field, const std::array<int, 3>& cell) {
  int prescribed = 0;
  for (int c = 0; c < 8; ++c) {
    const int n = field.cloud().lattice->node(cell[0] + (c & 1), cell[1] + (c >> 1 & 1), cell[2] + (c >> 2));
    if (n < 0) return Cell::incomplete;
    prescribed += field.prescribed(n);
  }
  return prescribed == 0 ? Cell::free : prescribed < 8 ? Cell::coupled : Cell::rigid;
}

bool has_coupled_cells(const Approximation& field) { return field.cloud().lattice && field.any_prescribed(); }

/// Values by lattice cell, in the order in which the cells were first asked for.
template <class Value>
class ByCell {
 public:
  explicit ByCell(const Lattice& lattice) : lattice_(lattice) {}
  Value& operator[](const std::array<int, 3>& cell) {
    const auto [it, is_new] = number_.emplace(lattice_.offset(cell[0], cell[1], cell[2]), values_.size());
    if (is_new) values_.emplace_back();
    return values_[it->second];
  }
  std::vector<Value>& values() { return values_; }

 private:
  const Lattice& lattice_;
  std::unordered_map<std::size_t, std::size_t> number_;
  std::vector<Value> values_;
};

struct Eighths {
  Cell kind;
  std::array<PointSum, 8> part;
};

}  // namespace

IntegrationPoints align_with_coupled_cells(const Approximation& field, const IntegrationPoints& points) {
  if (!has_coupled_cells(field)) return points;
  const Lattice& l = *field.cloud().lattice;
  ByCell<Eighths> aligned(l);
  IntegrationPoints result = none_like(points);
  for (std::size_t p = 0; p < points.size(); ++p) {
    const std::array<int, 3> own = cell_of(l, points.position[p]);
    const Cell own_kind = kind_of(field, own);
    const double half_edge = std::cbrt(points.volume[p]) / 2;
    int low[3], high[3];
    for (int a = 0; a < 3; ++a) {
      low[a] = int(std::floor((points.position[p][a] - half_edge - l.origin[a]) / l.spacing));
      high[a] = int(std::floor((points.position[p][a] + half_edge - l.origin[a]) / l.spacing));
    }
    PointSum rest;
    bool touches_coupled = false;
    for (int k = low[2]; k <= high[2]; ++k)
      for (int j = low[1]; j <= high[1]; ++j)
        for (int i = low[0]; i <= high[0]; ++i) {
          // A piece in a cell without all its nodes lies outside the body: the point's true cell is cut there.
          const std::array<int, 3> there{i, j, k};
          const Cell there_kind = kind_of(field, there);
          const bool outside = there_kind == Cell::incomplete;
          const std::array<int, 3>& cell = outside ? own : there;
          const Cell kind = outside ? own_kind : there_kind;
          for (int e = 0; e < 8; ++e) {
            double piece = 1;
            Vec3d place;
            for (int a = 0; a < 3; ++a) {
              const double from = l.origin[a] + l.spacing * (there[std::size_t(a)] + 0.5 * (e >> a & 1));
              const double lower = std::max(from, points.position[p][a] - half_edge), upper = std::min(from + l.spacing / 2, points.position[p][a] + half_edge);
              piece *= std::max(0.0, upper - lower), place[a] = (lower + upper) / 2;
            }
            if (piece <= smallest_piece * points.volume[p]) continue;
            if (outside) place = points.position[p];
            if (kind != Cell::coupled && kind != Cell::rigid) {
              rest.add(points, p, piece, place);
              continue;
            }
            int eighth = e;
            if (outside) {
              eighth = 0;
              for (int a = 0; a < 3; ++a) eighth |= (place[a] - l.origin[a] > l.spacing * (own[std::size_t(a)] + 0.5) ? 1 : 0) << a;
            }
            touches_coupled = true;
            Eighths& eighths = aligned[cell];
            eighths.kind = kind;
            eighths.part[std::size_t(eighth)].add(points, p, piece, place);
          }
        }
    if (touches_coupled) rest.append_to(result);
    else append(points, p, result);
  }
  for (const Eighths& eighths : aligned.values()) {
    PointSum whole;
    for (const PointSum& part : eighths.part) {
      if (eighths.kind == Cell::coupled) part.append_to(result);
      whole.add(part, points.model);
    }
    if (eighths.kind == Cell::rigid) whole.append_to(result);
  }
  return result;
}

IntegrationPoints reduce_volumetric_integration(const Approximation& field, const IntegrationPoints& points) {
  if (!has_coupled_cells(field)) return points;
  ByCell<PointSum> volumetric(*field.cloud().lattice);
  IntegrationPoints result = points;
  for (std::size_t p = 0; p < points.size(); ++p) {
    const std::array<int, 3> cell = cell_of(*field.cloud().lattice, points.position[p]);
    if (kind_of(field, cell) != Cell::coupled) continue;
    result.bulk_modulus[p] = std::min(points.bulk_modulus[p], 2 * points.shear_modulus[p] / 3);
    PointSum& sum = volumetric[cell];
    sum.add(points, p, points.volume[p], points.position[p]);
    sum.bulk -= points.volume[p] * result.bulk_modulus[p];
  }
  for (PointSum& sum : volumetric.values()) {
    sum.shear = sum.density = 0;  // the mass stays with the points that give the shear modulus
    for (int i = 0; i < further_moduli(points.model); ++i) sum.further[std::size_t(i)] = 0;
    if (sum.bulk > 0) sum.append_to(result);
  }
  return result;
}

}  // namespace mtled
