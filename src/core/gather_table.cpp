#include "core/gather_table.hpp"

#include <algorithm>
#include <limits>
#include <map>
#include <numeric>
#include <span>
#include <unordered_map>

#include "core/error.hpp"
#include "core/parallel.hpp"

namespace mtled {
namespace {

constexpr std::size_t fewest_in_box = 64;    ///< points of a stencil that get a box of places
constexpr std::size_t emptiest_box = 16;     ///< places per point in a box
constexpr std::size_t fewest_sharing = 16;   ///< rows that share a stencil; fewer have entries of their own
constexpr int region_slots = 1 << 16;        ///< rows there follow each other, so that what they read stays in cache: some 10 MB of displacements and stresses
constexpr std::size_t window = 256;          ///< own rows among which they are sorted by length

/// A term while the tables are made: gradient number `entry` of the support table.
struct Term {
  std::int32_t index, entry;
  bool operator==(const Term&) const = default;
};
using Pattern = std::span<const Term>;

/// A row: its terms are those of a pattern, their indices relative to `base`.
struct Row {
  std::int32_t result, base, pattern, region;
};

/// The supports with the terms of every stencil sorted by offset, and what part of the slots a point sees.
struct Supports {
  const SupportTable& table;
  std::vector<Term> term;        ///< index: offset
  std::vector<int> first;        ///< [num_stencils] smallest offset
  int span = 0;                  ///< largest offset less the smallest, of any stencil

  explicit Supports(const SupportTable& t) : table(t), term(t.offset.size()), first(std::size_t(t.num_stencils())) {
    parallel_for(term.size(), [&](std::size_t e) { term[e] = {t.offset[e], std::int32_t(e)}; });
    parallel_for(first.size(), [&](std::size_t s) {
      std::sort(term.begin() + t.begin[s], term.begin() + t.begin[s + 1], [](const Term& a, const Term& b) { return a.index < b.index; });
    });
    for (std::size_t s = 0; s < first.size(); ++s) {
      const Pattern terms = of_stencil(int(s));
      if (!terms.empty()) first[s] = terms.front().index, span = std::max(span, terms.back().index - terms.front().index);
    }
  }
  Pattern of_stencil(int s) const { return {term.data() + table.begin[std::size_t(s)], term.data() + table.begin[std::size_t(s) + 1]}; }
  bool used(std::size_t p) const { return table.stencil[p] >= 0; }
  int first_slot(std::size_t p) const { return table.base[p] + first[std::size_t(table.stencil[p])]; }
};

/// Points with one stencil, whose places lie as their bases do in the slot layout.
struct Box {
  std::size_t points = 0;
  int some_plane = 0, low = 0, high = 0;  ///< planes of their bases
  int period = 0;                ///< greatest common divisor of the distances between the planes; 0: one plane
  std::int64_t first = -1;       ///< place of the lowest block in the lowest plane; -1: no box
};

/// [places] the point at each place, -1 where there is none.
std::vector<std::int32_t> arrange_points(const Supports& supports, const SlotLayout& layout) {
  const SupportTable& t = supports.table;
  const int plane_slots = SlotLayout::period * SlotLayout::period * layout.blocks;
  std::vector<Box> boxes(layout.lattice ? supports.first.size() : 0);
  const auto box_of = [&](std::size_t p) { return boxes.empty() ? nullptr : &boxes[std::size_t(t.stencil[p])]; };
  for (std::size_t p = 0; p < t.base.size() && !boxes.empty(); ++p) {
    if (!supports.used(p)) continue;
    Box& box = *box_of(p);
    const int plane = t.base[p] / plane_slots;
    if (box.points++ == 0) box.some_plane = box.low = box.high = plane;
    box.low = std::min(box.low, plane), box.high = std::max(box.high, plane);
    box.period = std::gcd(box.period, plane - box.some_plane);
  }
  // All boxes have the same range of blocks and, where that is possible, the same period: a step of the lattice is then the
  // same difference of places in all of them.
  int low_block = std::numeric_limits<int>::max(), high_block = 0;
  std::map<int, std::size_t> points_with_period;
  for (std::size_t p = 0; p < t.base.size() && !boxes.empty(); ++p) {
    if (!supports.used(p) || box_of(p)->points < fewest_in_box) continue;
    low_block = std::min(low_block, t.base[p] % layout.blocks), high_block = std::max(high_block, t.base[p] % layout.blocks);
    if (box_of(p)->period > 0) ++points_with_period[box_of(p)->period];
  }
  const auto most = std::max_element(points_with_period.begin(), points_with_period.end(), [](const auto& a, const auto& b) { return a.second < b.second; });
  const int period = most == points_with_period.end() ? 1 : most->first;
  const std::int64_t blocks = high_block - low_block + 1;
  std::int64_t places = 0;
  for (Box& box : boxes) {
    if (box.points < fewest_in_box) continue;
    if (box.period % period == 0) box.period = period;
    const std::int64_t size = ((box.high - box.low) / box.period + 1) * blocks;
    if (std::size_t(size) > emptiest_box * box.points) continue;
    box.first = places, places += size;
  }
  require(places + std::int64_t(t.base.size()) < std::numeric_limits<std::int32_t>::max(), "the integration points need ",
          places + std::int64_t(t.base.size()), " places, more than can be numbered; use fewer points or a larger spacing");

  std::vector<std::int32_t> point_at(std::size_t(places), -1), rest;
  for (std::size_t p = 0; p < t.base.size(); ++p) {
    if (!supports.used(p)) continue;
    const Box* box = box_of(p);
    std::int32_t* at = nullptr;
    if (box && box->first >= 0)
      at = &point_at[std::size_t(box->first + (t.base[p] / plane_slots - box->low) / box->period * blocks + t.base[p] % layout.blocks - low_block)];
    if (at && *at < 0) *at = std::int32_t(p);
    else rest.push_back(std::int32_t(p));  // also the second of two points in one position
  }
  std::sort(rest.begin(), rest.end(), [&](std::int32_t a, std::int32_t b) {
    const int fa = supports.first_slot(std::size_t(a)), fb = supports.first_slot(std::size_t(b));
    return fa != fb ? fa < fb : a < b;
  });
  point_at.insert(point_at.end(), rest.begin(), rest.end());
  return point_at;
}

struct PatternHash {
  std::size_t operator()(const Pattern& pattern) const {
    std::uint64_t h = pattern.size();
    for (const Term& term : pattern) {
      h = (h ^ (std::uint64_t(std::uint32_t(term.index)) << 32 | std::uint32_t(term.entry))) * 0x9e3779b97f4a7c15u;
      h ^= h >> 29;
    }
    return std::size_t(h);
  }
};
struct PatternEqual {
  bool operator()(const Pattern& a, const Pattern& b) const { return std::equal(a.begin(), a.end(), b.begin(), b.end()); }
};
/// Number of each distinct pattern.
using PatternNumbers = std::unordered_map<Pattern, std::int32_t, PatternHash, PatternEqual>;

/// The rows of some slots that follow each other.
struct Chunk {
  std::vector<Term> term;
  std::vector<std::size_t> begin{0};   ///< [distinct patterns + 1]
  std::vector<std::int32_t> pattern;   ///< [slots] -1: no terms
  std::vector<std::int32_t> base;      ///< [slots] lowest place
  Pattern distinct(std::size_t i) const { return {term.data() + begin[i], term.data() + begin[i + 1]}; }
};

/// Rows of the slots [low, high), gathered from the points at `places` (ascending).
Chunk transpose(const Supports& supports, const std::vector<std::int32_t>& point_at, const std::vector<std::int32_t>& places, int low, int high) {
  const auto each_term = [&](auto&& visit) {
    for (const std::int32_t place : places) {
      const std::size_t p = std::size_t(point_at[std::size_t(place)]);
      const Pattern terms = supports.of_stencil(supports.table.stencil[p]);
      const int base = supports.table.base[p];
      auto term = std::lower_bound(terms.begin(), terms.end(), low - base, [](const Term& a, int offset) { return a.index < offset; });
      for (; term != terms.end() && base + term->index < high; ++term) visit(std::size_t(base + term->index - low), Term{place, term->entry});
    }
  };
  const std::size_t slots = std::size_t(high - low);
  std::vector<std::size_t> begin(slots + 2, 0);  // while filling, begin[s + 1] is where the next term of s goes
  each_term([&](std::size_t s, const Term&) { ++begin[s + 2]; });
  std::partial_sum(begin.begin(), begin.end(), begin.begin());
  std::vector<Term> term(begin.back());
  each_term([&](std::size_t s, const Term& t) { term[begin[s + 1]++] = t; });

  Chunk chunk;
  chunk.pattern.assign(slots, -1);
  chunk.base.assign(slots, 0);
  PatternNumbers numbers;
  std::vector<Pattern> distinct;
  for (std::size_t s = 0; s < slots; ++s) {
    const std::span<Term> row(term.data() + begin[s], term.data() + begin[s + 1]);
    if (row.empty()) continue;
    chunk.base[s] = row.front().index;
    for (Term& t : row) t.index -= chunk.base[s];
    const auto [number, is_new] = numbers.emplace(row, std::int32_t(distinct.size()));
    if (is_new) distinct.push_back(row);
    chunk.pattern[s] = number->second;
  }
  for (const Pattern& d : distinct) chunk.begin.push_back(chunk.begin.back() + d.size());
  chunk.term.reserve(chunk.begin.back());
  for (const Pattern& d : distinct) chunk.term.insert(chunk.term.end(), d.begin(), d.end());
  return chunk;
}

/// Rows of all slots that have any: their terms gather places. Only patterns that differ are kept, in `chunks`.
struct TransposedRows {
  std::vector<Chunk> chunks;
  std::vector<Pattern> patterns;  ///< into `chunks`
  std::vector<Row> rows;          ///< by rising slot

  TransposedRows(const Supports& supports, const std::vector<std::int32_t>& point_at, const SlotLayout& layout) {
    // Shorter chunks need less memory each; longer ones see fewer points of their neighbours.
    const int length = std::max(4096, supports.span / 4 + 1);
    chunks.resize((std::size_t(layout.num_slots) + std::size_t(length) - 1) / std::size_t(length));
    std::vector<std::vector<std::int32_t>> starting(chunks.size());  // places whose support begins in the chunk
    for (std::size_t place = 0; place < point_at.size(); ++place)
      if (point_at[place] >= 0) starting[std::size_t(supports.first_slot(std::size_t(point_at[place])) / length)].push_back(std::int32_t(place));
    parallel_for(
        chunks.size(),
        [&](std::size_t c) {
          const std::size_t before = std::min(c, std::size_t(supports.span / length + 1));
          std::vector<std::int32_t> places;
          for (std::size_t b = c - before; b <= c; ++b) places.insert(places.end(), starting[b].begin(), starting[b].end());
          std::sort(places.begin(), places.end());
          const int low = int(c) * length;
          chunks[c] = transpose(supports, point_at, places, low, int(std::min<std::int64_t>(layout.num_slots, std::int64_t(low) + length)));
        },
        1);
    PatternNumbers numbers;
    for (std::size_t c = 0; c < chunks.size(); ++c) {
      Chunk& chunk = chunks[c];
      std::vector<std::int32_t> number(chunk.begin.size() - 1);
      for (std::size_t i = 0; i < number.size(); ++i) {
        const auto [it, is_new] = numbers.emplace(chunk.distinct(i), std::int32_t(patterns.size()));
        if (is_new) patterns.push_back(chunk.distinct(i));
        number[i] = it->second;
      }
      for (std::size_t s = 0; s < chunk.pattern.size(); ++s) {
        const std::int32_t slot = std::int32_t(c) * length + std::int32_t(s);
        if (chunk.pattern[s] >= 0) rows.push_back({slot, chunk.base[s], number[std::size_t(chunk.pattern[s])], slot / region_slots});
      }
      chunk.pattern = {}, chunk.base = {};
    }
  }
};

constexpr int whole_slices(std::size_t rows) {
  constexpr std::size_t slice = GatherTableView<float>::slice;
  return int((rows + slice - 1) / slice * slice);
}

/// The table of `rows`, given in an order in which neighbours read from near places.
template <class Real>
GatherTable<Real> lay_out(std::vector<Row> rows, const std::vector<Pattern>& patterns, const std::vector<Vec3d>& gradient) {
  constexpr std::size_t slice = GatherTableView<Real>::slice;
  const auto entry = [&](const Term& t, std::int32_t base) {
    const Vec3d& g = gradient[std::size_t(t.entry)];
    return GatherEntry<Real>{Real(g.x), Real(g.y), Real(g.z), base + t.index};
  };
  const auto pattern = [&](const Row& row) { return patterns[std::size_t(row.pattern)]; };
  GatherTable<Real> table;
  std::vector<std::size_t> sharing(patterns.size(), 0);
  for (const Row& row : rows) ++sharing[std::size_t(row.pattern)], table.terms += pattern(row).size();

  std::vector<std::int32_t> stencil(patterns.size(), -1);
  for (std::size_t i = 0; i < patterns.size(); ++i) {
    if (sharing[i] < fewest_sharing) continue;
    stencil[i] = std::int32_t(table.stencil_begin.size()) - 1;
    for (const Term& t : patterns[i]) table.stencil_entry.push_back(entry(t, 0));
    table.stencil_begin.push_back(std::uint32_t(table.stencil_entry.size()));
  }
  const auto own = std::stable_partition(rows.begin(), rows.end(), [&](const Row& row) { return stencil[std::size_t(row.pattern)] >= 0; });
  std::sort(rows.begin(), own, [](const Row& a, const Row& b) {
    if (a.region != b.region) return a.region < b.region;
    if (a.pattern != b.pattern) return a.pattern < b.pattern;
    return a.base != b.base ? a.base < b.base : a.result < b.result;
  });
  const std::size_t num_shared = std::size_t(own - rows.begin()), num_own = rows.size() - num_shared;
  parallel_pieces(num_own, window, [&](std::size_t begin, std::size_t end) {
    std::stable_sort(own + std::ptrdiff_t(begin), own + std::ptrdiff_t(end), [&](const Row& a, const Row& b) { return pattern(a).size() > pattern(b).size(); });
  });

  table.shared_threads = whole_slices(num_shared);
  table.threads = table.shared_threads + whole_slices(num_own);
  table.row.assign(std::size_t(table.threads), -1);
  table.base.assign(std::size_t(table.shared_threads), 0);
  table.stencil.assign(std::size_t(table.shared_threads), 0);
  for (std::size_t i = 0; i < num_shared; ++i)
    table.row[i] = rows[i].result, table.base[i] = rows[i].base, table.stencil[i] = stencil[std::size_t(rows[i].pattern)];
  for (std::size_t i = 0; i < num_own; ++i) table.row[std::size_t(table.shared_threads) + i] = own[std::ptrdiff_t(i)].result;
  for (std::size_t i = 0; i < num_own; i += slice) {
    std::size_t longest = 0;
    for (std::size_t lane = 0; lane < std::min(slice, num_own - i); ++lane) longest = std::max(longest, pattern(own[std::ptrdiff_t(i + lane)]).size());
    table.slice_begin.push_back(table.slice_begin.back() + slice * longest);
  }
  table.own.resize(table.slice_begin.back());
  parallel_for(
      num_own,
      [&](std::size_t i) {
        const Row& row = own[std::ptrdiff_t(i)];
        const Pattern terms = pattern(row);
        const std::size_t begin = table.slice_begin[i / slice], end = table.slice_begin[i / slice + 1];
        for (std::size_t e = 0, at = begin + i % slice; at < end; ++e, at += slice)
          // Beyond the row nothing is added, from where it has just been.
          table.own[at] = e < terms.size() ? entry(terms[e], row.base) : GatherEntry<Real>{0, 0, 0, row.base + terms.back().index};
      },
      256);
  return table;
}

template <class T>
std::size_t bytes_of(const std::vector<T>& v) { return v.size() * sizeof(T); }

}  // namespace

template <class Real>
GatherTableView<Real> GatherTable<Real>::view() const {
  return {threads, shared_threads, row.data(), base.data(), stencil.data(), stencil_begin.data(), stencil_entry.data(), slice_begin.data(), own.data()};
}

template <class Real>
std::size_t GatherTable<Real>::bytes() const {
  return bytes_of(row) + bytes_of(base) + bytes_of(stencil) + bytes_of(stencil_begin) + bytes_of(stencil_entry) + bytes_of(slice_begin) + bytes_of(own);
}

template <class Real>
GatherTables<Real> make_gather_tables(const SupportTable& t, const SlotLayout& layout) {
  const Supports supports(t);
  const std::vector<std::int32_t> point_at = arrange_points(supports, layout);
  GatherTables<Real> tables;
  tables.places = int(point_at.size());
  {
    std::vector<Pattern> stencils;
    for (int s = 0; s < t.num_stencils(); ++s) stencils.push_back(supports.of_stencil(s));
    std::vector<Row> rows;
    for (std::size_t place = 0; place < point_at.size(); ++place) {
      const std::size_t p = std::size_t(point_at[place]);
      if (point_at[place] >= 0) rows.push_back({std::int32_t(place), t.base[p], t.stencil[p], t.base[p] / region_slots});
    }
    tables.of_points = lay_out<Real>(std::move(rows), stencils, t.gradient);
  }
  for (const std::int32_t place : tables.of_points.row) tables.point.push_back(place < 0 ? -1 : point_at[std::size_t(place)]);
  TransposedRows transposed(supports, point_at, layout);
  tables.of_nodes = lay_out<Real>(std::move(transposed.rows), transposed.patterns, t.gradient);
  return tables;
}

template struct GatherTable<float>;
template struct GatherTable<double>;
template GatherTables<float> make_gather_tables<float>(const SupportTable&, const SlotLayout&);
template GatherTables<double> make_gather_tables<double>(const SupportTable&, const SlotLayout&);

}  // namespace mtled
