#include "core/lattice_field.hpp"

#include "core/error.hpp"
#include "core/parallel.hpp"
#include "core/shape_evaluator.hpp"

namespace mtled {

LatticeField make_lattice_field(const ShapeEvaluator& evaluator, const std::vector<Vec3d>& parameter) {
  require(evaluator.cloud().lattice.has_value(), "the nodes are no lattice; evaluate their field one by one, with ShapeEvaluator");
  const Lattice& l = *evaluator.cloud().lattice;
  const MlsOptions& o = evaluator.options();
  LatticeField field;
  LatticeFieldView& v = field.view;
  v.origin = l.origin, v.spacing = l.spacing;
  for (int a = 0; a < 3; ++a) v.size[a] = l.size[std::size_t(a)];
  v.quadratic = o.basis != Basis::linear;
  v.penalty = o.basis == Basis::modified_quadratic ? o.quadratic_penalty : 0;
  v.worst_condition = o.worst_condition();
  v.smallest_support = int(o.smallest_support());
  v.radius = o.dilatation * l.spacing;
  v.reach = int(std::ceil(v.radius / l.spacing));
  field.parameter.resize(l.node_at.size());
  field.flags.resize(l.node_at.size());
  const std::size_t rows = std::size_t(l.size[1]) * std::size_t(l.size[2]);
  const auto each_cell = [&](const auto& work) {
    parallel_for(rows, [&](std::size_t row) {
      const int j = int(row % std::size_t(l.size[1])), k = int(row / std::size_t(l.size[1]));
      for (int i = 0; i < l.size[0]; ++i) work(i, j, k, l.offset(i, j, k));
    }, 16);
  };
  each_cell([&](int i, int j, int k, std::size_t cell) {
    if (const int n = l.node_at[cell]; n >= 0) {
      const Vec3d& p = parameter[std::size_t(n)];
      field.parameter[cell] = {float(p.x), float(p.y), float(p.z), 1};
    } else {
      field.parameter[cell] = {};
    }
    bool complete = true, surrounded = true;
    for (int c = 0; c < 8; ++c) complete = complete && l.node(i + (c & 1), j + (c >> 1 & 1), k + (c >> 2)) >= 0;
    const int beyond = v.reach - 1;
    for (int c = k - beyond; c <= k + beyond && surrounded; ++c)
      for (int b = j - beyond; b <= j + beyond && surrounded; ++b)
        for (int a = i - beyond; a <= i + beyond && surrounded; ++a) surrounded = l.holds_body(a, b, c);
    field.flags[cell] = std::uint8_t((complete ? LatticeFieldView::complete : 0) | (l.holds_body(i, j, k) ? LatticeFieldView::body : 0) |
                                     (surrounded ? LatticeFieldView::surrounded : 0) |
                                     (evaluator.any_prescribed() && evaluator.coupled({i, j, k}) ? LatticeFieldView::coupled : 0));
  });
  return field;
}

}  // namespace mtled
