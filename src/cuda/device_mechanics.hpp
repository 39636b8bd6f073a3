#pragma once
#include <memory>
#include <utility>
#include <vector>

#include "core/coarse_space.hpp"
#include "core/mechanics.hpp"
#include "core/point_material.hpp"
#include "cuda/advance.hpp"
#include "cuda/constraints.hpp"
#include "cuda/dense_rows.hpp"
#include "cuda/field_rows.hpp"
#include "cuda/nodal_force.hpp"
#include "cuda/springs.hpp"
#include "cuda/uploaded.hpp"
#include "cuda/vectors.hpp"

namespace mtled {

/// Mechanics on a device with functors (CudaDevice; SerialDevice in tests). Tables are made on the host; the coarse matrix is
/// assembled and inverted there, too. Steps are queued without asking the host, and the control on the device ends them.
template <class Real, class Device>
class DeviceMechanics : public Mechanics {
  template <class T>
  using Buffer = typename Device::template Buffer<T>;
  using Values = Buffer<Vec4<Real>>;
  struct DeviceVector : Vector {
    DeviceVector(Device& device, std::size_t slots) : values(device, slots) {}
    Values values;
  };
  static Values& values(Vector& v) { return static_cast<DeviceVector&>(v).values; }
  static const Values& values(const Vector& v) { return static_cast<const DeviceVector&>(v).values; }

 public:
  /// Input error where the field averages pressure at nodes, which no functor does. Memory error where it does not fit.
  DeviceMechanics(const DiscreteModel& model, const SolverOptions& options, Device device = Device()) : device_(std::move(device)), model_(model), slots_(int(model.slots())) {
    require(!model.field->averages_pressure(), "elements with averaged pressure are computed on the CPU only; use --device cpu");
    require(model.slots() < std::size_t(1) << 29, "the model has ", model.slots(), " node positions, more than can be numbered on a GPU; use a larger node spacing, or --device cpu");
    if (options.relaxation == Relaxation::two_level) {
      coarse_space_ = std::make_unique<CoarseSpace>(model.position, model.coarse_active, options.coarse_unknowns, 5 * model.spacing);
      if (model.springs.size() > 0) coarse_space_->add_springs(model.springs, model.layout);
    }
    make_points();
    make_nodes();
    if (model.springs.size() > 0) springs_ = std::make_unique<SpringBuffers>(device_, model, seen_);
    constraints_ = std::make_unique<ConstraintBuffers>(device_, *model.constraints);
    if (coarse_space_ && coarse_space_->unknowns() > 0) coarse_ = std::make_unique<CoarseBuffers>(device_, *coarse_space_, model.slots());
  }

  VectorPointer vector() const override { return std::make_unique<DeviceVector>(device_, model_.slots()); }
  void upload(const std::vector<Vec3d>& from, Vector& to) const override { values(to).upload(rounded(from).data(), from.size()); }
  std::vector<Vec3d> download(const Vector& from) const override {
    std::vector<Vec4<Real>> read(model_.slots());
    values(from).download(read.data(), read.size());
    std::vector<Vec3d> to;
    to.reserve(read.size());
    for (const Vec4<Real>& a : read) to.push_back({double(a.x), double(a.y), double(a.z)});
    return to;
  }
  void copy(const Vector& from, Vector& to) const override { values(to).copy_from(values(from)); }
  void clear(Vector& y) const override { values(y).clear(); }
  void combine(Vector& y, double a, const Vector& x, double b) const override { device_.for_each(slots_, Combine<Real>{Real(a), Real(b), values(x).data(), values(y).data()}); }
  double dot(const Vector& a, const Vector& b) const override {
    const int blocks = DotProduct<Real>::blocks(slots_);
    device_.for_blocks(blocks, DotProduct<Real>{slots_, values(a).data(), values(b).data(), dot_part_->data()});
    return reduced<Add>(blocks, *dot_part_, 0.0, *sum_);
  }

  VolumeRatioStatistics force(const Vector& u, double load, Vector& f) const override {
    const StepLoad step{nullptr, load};
    values(f).clear();  // slots that nothing acts on
    add_stress(values(u), step);
    gather_force(values(u), step, external_->data(), values(f));
    const VolumeRatios<Real> worst = reduced<Worse>(point_blocks(), *ratio_, no_volume_ratios<Real>(), *worst_);
    return {double(worst.smallest), worst.inverted};
  }
  void tangent(const Vector& u, const Vector& v, Vector& f) const override {
    values(f).clear();
    with_material_kind([&]<template <class> class Material>() {
      device_.for_each(of_points_->view().threads, TangentOfPoints<Material, Real>{of_points_->view(), parameter_->data(), values(u).data(), values(v).data(), stress()});
    });
    gather_force(values(v), {nullptr, 0}, nullptr, values(f));
  }
  void impose(Vector& u, double load) const override { impose(values(u), StepLoad{nullptr, load}); }
  void reduce(Vector& f) const override {
    const ConstraintBuffers& c = *constraints_;
    if (!c.direct) eliminate(values(f), {});
    device_.for_each(c.rows, ZeroPlaces<Real>{c.place.data(), &values(f).data()->x, {}});
  }

  void precondition(const Vector& f, Vector& g) const override {
    solve_coarse(values(f), {});
    device_.for_each(slots_, PreconditionedForce<Real>{preconditioner(), values(f).data(), values(g).data()});
  }
  void multiply_by_diagonal(const Vector& d, Vector& g) const override {
    device_.for_each(slots_, MultiplyByDiagonal<Real>{inverse_diagonal_->data(), values(d).data(), values(g).data()});
  }
  void assemble_coarse(const Vector& u) override {
    coarse_space_->assemble(model_.supports, *model_.points, download(u));
    if (coarse_) coarse_->inverse.upload(coarse_space_->inverse(), coarse_->inverse.size());
  }

  void steps(int count, const StepSizes& sizes, StepControl& control, Vector& u, Vector& increment, Vector& change) override {
    const StepFactors<Real> factors = factors_of<Real>(sizes);
    factors_->upload(&factors, 1);
    control_->upload(&control, 1);
    Values &now = values(u), &d = values(increment), &sum = values(change);
    device_.repeat({now.data(), d.data(), sum.data()}, count, [&] { do_step(now, d, sum); });
    control_->download(&control, 1);
  }

  double strain_energy(const Vector& u) const override {
    with_material_kind([&]<template <class> class Material>() {
      device_.for_blocks(point_blocks(), EnergyOfPoints<Material, Real>{of_points_->view(), parameter_->data(), values(u).data(), energy_->data()});
    });
    return reduced<Add>(point_blocks(), *energy_, 0.0, *sum_);
  }
  double largest_displacement(const Vector& x) const override {
    device_.for_blocks(blocks_for(rows_->rows), LargestOfRows<Real>{rows_->rows, rows_->begin.data(), rows_->slot.data(), rows_->value.data(), values(x).data(), rows_->largest.data()});
    return double(reduced<Larger>(blocks_for(rows_->rows), rows_->largest, Real(0), *largest_of_all_));
  }

  int coarse_unknowns() const override { return coarse_ ? coarse_->tables.unknowns : 0; }
  double bytes() const override { return bytes_; }
  /// What must be free before: also for code, stacks and graphs, and for what the allocator rounds up.
  double free_bytes_needed() const { return 1.02 * bytes_ + 256e6; }

 private:
  struct SpringBuffers {
    SpringBuffers(Device& device, const DiscreteModel& model, const std::vector<std::uint8_t>& seen) : SpringBuffers(device, SpringTables<Real>(model.springs, model.layout, seen)) {}
    SpringBuffers(Device& device, const SpringTables<Real>& t)
        : count(int(t.stiffness.size())), used(int(t.used_slot.size())), begin(uploaded(device, t.begin)), of_slot(uploaded(device, t.of_slot)), spring(uploaded(device, t.spring)),
          slot(uploaded(device, t.slot)), used_slot(uploaded(device, t.used_slot)), coefficient(uploaded(device, t.coefficient)), stiffness(uploaded(device, t.stiffness)),
          coefficient_of(uploaded(device, t.coefficient_of)), target(uploaded(device, t.target)), pull(device, t.stiffness.size()) {}
    int count, used;
    Buffer<std::uint32_t> begin, of_slot, spring;
    Buffer<std::int32_t> slot, used_slot;
    Buffer<Real> coefficient, stiffness, coefficient_of;
    Values target, pull;
  };
  struct ConstraintBuffers {
    ConstraintBuffers(Device& device, const ConstraintOperator& constraints) : ConstraintBuffers(device, ConstraintArrays<Real>({constraints.table(0), constraints.table(1), constraints.table(2)})) {}
    ConstraintBuffers(Device& device, const ConstraintArrays<Real>& a)
        : direct(a.direct), rows(int(a.place.size())), used(int(a.used_place.size())), block_begin{a.block_begin[0], a.block_begin[1], a.block_begin[2], a.block_begin[3]},
          place(uploaded(device, a.place)), begin(uploaded(device, a.begin)), free_place(uploaded(device, a.free_place)), identity(uploaded(device, a.identity)),
          used_place(uploaded(device, a.used_place)), used_begin(uploaded(device, a.used_begin)), used_row(uploaded(device, a.used_row)), value(uploaded(device, a.value)),
          free_value(uploaded(device, a.free_value)), inverse(uploaded(device, a.inverse)), transposed(uploaded(device, a.transposed)), used_value(uploaded(device, a.used_value)),
          right(device, a.place.size()), multiplier(device, a.place.size()) {}
    MatrixRows<Real, Real> times(const Buffer<Real>& matrix, const Buffer<std::int32_t>& to, Real* result, StepLoad step) const {
      return {{block_begin[0], block_begin[1], block_begin[2], block_begin[3]}, matrix.data(), right.data(), to.data(), result, step};
    }
    bool direct;
    int rows, used, block_begin[4];
    Buffer<std::int32_t> place, begin, free_place, identity, used_place, used_begin, used_row;
    Buffer<Real> value, free_value, inverse, transposed, used_value, right, multiplier;
  };
  struct CoarseBuffers {
    CoarseBuffers(Device& device, const CoarseSpace& space, std::size_t slots)
        : tables(space.nodes(), space.functions(), space.used_functions(), slots), begin(uploaded(device, tables.cell_begin)), slot(uploaded(device, tables.slot)), first(uploaded(device, tables.first)),
          node_of_slot(uploaded(device, tables.node_of_slot)), right_begin(uploaded(device, tables.right_begin)), right_item(uploaded(device, tables.right_item)), place(uploaded(device, tables.place)),
          node(uploaded(device, tables.node)), cell_sum(device, std::size_t(functions_per_cell * tables.cells)), right(device, std::size_t(tables.unknowns)),
          inverse(device, std::size_t(tables.unknowns) * std::size_t(tables.unknowns)), y(device, std::size_t(tables.functions)) {}
    CoarseTables<Real> tables;
    Buffer<std::int32_t> begin, slot, first, node_of_slot, right_begin, right_item, place;
    Buffer<CoarseNode<Real>> node;
    Values cell_sum;
    Buffer<float> right, inverse;
    Buffer<Vec4<float>> y;
  };
  struct RowBuffers {
    RowBuffers(Device& device, const FieldRows& r)
        : rows(int(r.size())), begin(uploaded(device, std::vector<std::uint32_t>(r.begin.begin(), r.begin.end()))), slot(uploaded(device, std::vector<std::int32_t>(r.slot.begin(), r.slot.end()))),
          value(uploaded(device, r.value)), largest(device, std::size_t(blocks_for(rows))) {}
    int rows;
    Buffer<std::uint32_t> begin;
    Buffer<std::int32_t> slot;
    Buffer<float> value;
    Buffer<Real> largest;
  };

  static std::vector<Vec4<Real>> rounded(const std::vector<Vec3d>& from) {
    std::vector<Vec4<Real>> to;
    to.reserve(from.size());
    for (const Vec3d& a : from) to.push_back({Real(a.x), Real(a.y), Real(a.z), Real(0)});
    return to;
  }
  template <class T>
  std::unique_ptr<Buffer<T>> buffer(std::size_t size) { return std::make_unique<Buffer<T>>(device_, size); }
  template <class T>
  std::unique_ptr<Buffer<T>> on_device(const std::vector<T>& from) { return std::make_unique<Buffer<T>>(uploaded(device_, from)); }

  /// Tables of both passes, and the rows of the field; of a viscoelastic body with its long-term moduli.
  void make_points() {
    const IntegrationPoints faded = model_.points->viscoelastic() ? long_term(*model_.points) : IntegrationPoints{};
    const IntegrationPoints& points = model_.points->viscoelastic() ? faded : *model_.points;
    const GatherTables<Real> tables = make_gather_tables<Real>(model_.supports, model_.layout);
    const FieldRows rows = field_at_watched_nodes(model_);
    require_memory(tables, rows);
    rows_ = std::make_unique<RowBuffers>(device_, rows);
    of_points_ = std::make_unique<UploadedTable<Real, Device>>(device_, tables.of_points);
    of_nodes_ = std::make_unique<UploadedTable<Real, Device>>(device_, tables.of_nodes);
    seen_.assign(model_.slots(), 0);
    for (const std::int32_t slot : tables.of_nodes.row)
      if (slot >= 0) seen_[std::size_t(slot)] = 1;
    const std::size_t threads = tables.point.size();
    const int parameters = 2 + further_parameters(points.model);
    std::vector<Real> parameter(std::size_t(1 + parameters) * threads);
    for (std::size_t t = 0; t < threads; ++t) {
      if (tables.point[t] < 0) continue;
      const std::size_t p = std::size_t(tables.point[t]);
      parameter[t] = Real(points.volume[p]);
      for (int i = 0; i < parameters; ++i) parameter[std::size_t(1 + i) * threads + t] = Real(material_parameter(points, p, i));
    }
    parameter_ = on_device(parameter);
    for (int i = 0; i < 3; ++i) stress_.emplace_back(device_, std::size_t(tables.places));
    ratio_ = buffer<VolumeRatios<Real>>(std::size_t(point_blocks()));
    energy_ = buffer<double>(std::size_t(point_blocks()));
  }
  /// Counts what all of it will take, vectors of the relaxation included (most_vectors at a time), before anything is made.
  void require_memory(const GatherTables<Real>& tables, const FieldRows& rows) {
    constexpr double constraint_matrices = 2, most_vectors = 12, own_vectors = 3, vec4 = sizeof(Vec4<Real>);
    const double slots = double(model_.slots()), unknowns = coarse_space_ ? double(coarse_space_->unknowns()) : 0, nodes = coarse_space_ ? double(coarse_space_->nodes().size()) : 0;
    const double of_slots = slots * ((most_vectors + own_vectors + (model_.external.empty() ? 0 : 1)) * vec4 + 1);
    const double of_points = double(tables.point.size()) * double(3 + further_parameters(model_.points->model)) * sizeof(Real) + 3 * vec4 * double(tables.places);
    const double of_tables = double(tables.of_points.bytes() + tables.of_nodes.bytes());
    const double of_coarse = unknowns * unknowns * sizeof(float) + nodes * (sizeof(CoarseNode<Real>) + 3 * sizeof(std::int32_t)) + slots * sizeof(std::int32_t) * (coarse_space_ ? 1 : 0);
    const double of_springs = double(model_.springs.node.size()) * 2 * (sizeof(Real) + sizeof(std::int32_t)) + double(model_.springs.size()) * 2 * vec4;
    const double of_constraints = constraint_matrices * model_.constraints->inverse_entries() * sizeof(Real);
    const double of_rows = double(rows.slot.size()) * (sizeof(float) + sizeof(std::int32_t)) + double(rows.size()) * sizeof(std::uint32_t);
    bytes_ = of_slots + of_points + of_tables + of_coarse + of_springs + of_constraints + of_rows;
    if (const double free_bytes = device_.free_bytes(); free_bytes_needed() > free_bytes)
      fail(Failure::memory, "the model needs ", free_bytes_needed() / 1e9, " GB on the GPU (", model_.field->cloud().size(), " nodes: ", bytes_ / double(model_.field->cloud().size()),
           " bytes per node, of which tables ", of_tables / 1e9, " GB), but only ", free_bytes / 1e9, " GB are free; use a larger node spacing, or --device cpu");
  }
  void make_nodes() {
    const std::size_t slots = model_.slots();
    std::vector<Vec3d> inverse(slots);
    for (std::size_t s = 0; s < slots; ++s)
      for (int c = 0; c < 3; ++c)
        if (const std::size_t i = std::size_t(c) * slots + s; model_.active[i]) inverse[s][c] = 1 / model_.diagonal[i];
    inverse_diagonal_ = on_device(rounded(inverse));
    external_ = on_device(rounded(model_.external));
    watched_ = on_device(model_.watched);
    force_ = buffer<Vec4<Real>>(slots);
    largest_ = buffer<Real>(std::size_t(blocks_for(slots_)));
    dot_part_ = buffer<double>(std::size_t(DotProduct<Real>::blocks(slots_)));
    sum_ = buffer<double>(1), worst_ = buffer<VolumeRatios<Real>>(1), largest_of_all_ = buffer<Real>(1);
    factors_ = buffer<StepFactors<Real>>(1), control_ = buffer<StepControl>(1);
  }

  /// Calls kind.operator()<Material>() with the material of the body.
  template <class Kind>
  void with_material_kind(const Kind& kind) const {
    switch (model_.points->model) {
      case MaterialModel::neo_hookean: return kind.template operator()<NeoHookean>();
      case MaterialModel::mooney_rivlin: return kind.template operator()<MooneyRivlin>();
      case MaterialModel::yeoh: return kind.template operator()<Yeoh>();
      case MaterialModel::ogden: return kind.template operator()<Ogden>();
      case MaterialModel::transversely_isotropic: return kind.template operator()<TransverselyIsotropic>();
    }
  }
  int point_blocks() const { return blocks_for(of_points_->view().threads); }
  StressRows<Real> stress() const { return {{stress_[0].data(), stress_[1].data(), stress_[2].data()}}; }
  Preconditioner<Real> preconditioner() const {
    if (!coarse_) return {inverse_diagonal_->data(), {}};
    return {inverse_diagonal_->data(), {coarse_->node_of_slot.data(), coarse_->first.data(), coarse_->node.data(), coarse_->y.data(), coarse_->tables.stride_y, coarse_->tables.stride_z}};
  }
  template <class Combination, class T>
  T reduced(int count, const Buffer<T>& from, T none, Buffer<T>& to) const {
    device_.for_blocks(1, ReduceValues<T, Combination>{count, from.data(), none, to.data()});
    T result;
    to.download(&result, 1);
    return result;
  }

  void add_stress(const Values& u, StepLoad step) const {
    with_material_kind([&]<template <class> class Material>() {
      device_.for_blocks(point_blocks(), StressOfPoints<Material, Real>{of_points_->view(), parameter_->data(), u.data(), stress(), ratio_->data(), step});
    });
  }
  /// f of the stresses, the springs at u, and the external force (null: none).
  void gather_force(const Values& u, StepLoad step, const Vec4<Real>* external, Values& f) const {
    device_.for_each(of_nodes_->view().threads, ForceOfNodes<Real>{of_nodes_->view(), {stress_[0].data(), stress_[1].data(), stress_[2].data()}, external, f.data(), step});
    if (!springs_) return;
    SpringBuffers& s = *springs_;
    device_.for_each(s.count, PullOfSprings<Real>{s.begin.data(), s.slot.data(), s.coefficient.data(), s.stiffness.data(), s.target.data(), u.data(), s.pull.data(), step});
    device_.for_each(s.used, ForceOfSprings<Real>{s.used_slot.data(), s.of_slot.data(), s.spring.data(), s.coefficient_of.data(), s.pull.data(), external, f.data(), step});
  }
  void impose(Values& u, StepLoad step) const {
    ConstraintBuffers& c = *constraints_;
    if (c.rows == 0) return;
    Real* components = &u.data()->x;
    if (c.direct) {
      device_.for_each(c.rows, SetPlaces<Real>{c.place.data(), c.value.data(), components, step});
    } else {
      device_.for_each(c.rows, RightOfConstraints<Real>{c.value.data(), c.begin.data(), c.free_place.data(), c.free_value.data(), components, c.right.data(), step});
      device_.for_blocks(MatrixRows<Real, Real>::blocks(c.rows), c.times(c.inverse, c.place, components, step));
    }
  }
  /// f_F -= Phi_BF^T Phi_BB^-T f_B
  void eliminate(Values& f, StepLoad step) const {
    ConstraintBuffers& c = *constraints_;
    Real* components = &f.data()->x;
    device_.for_each(c.rows, ForceAtPlaces<Real>{c.place.data(), components, c.right.data(), step});
    device_.for_blocks(MatrixRows<Real, Real>::blocks(c.rows), c.times(c.transposed, c.identity, c.multiplier.data(), step));
    device_.for_each(c.used, SubtractMultipliers<Real>{c.used_place.data(), c.used_begin.data(), c.used_row.data(), c.used_value.data(), c.multiplier.data(), components, step});
  }
  void solve_coarse(const Values& f, StepLoad step) const {
    if (!coarse_) return;
    CoarseBuffers& c = *coarse_;
    const int n = c.tables.unknowns;
    device_.for_blocks(c.tables.cells, RestrictToCells<Real>{c.begin.data(), c.slot.data(), c.node.data(), f.data(), c.cell_sum.data(), step});
    device_.for_each(n / 3, RightSide<Real>{c.right_begin.data(), c.right_item.data(), c.cell_sum.data(), c.right.data(), step});
    device_.for_blocks(MatrixRows<float, float>::blocks(n), MatrixRows<float, float>{{0, n, n, n}, c.inverse.data(), c.right.data(), c.place.data(), &c.y.data()->x, step});
  }
  void do_step(Values& u, Values& increment, Values& change) {
    const StepLoad step{control_->data(), 1};
    impose(u, step);
    add_stress(u, step);
    gather_force(u, step, external_->data(), *force_);
    // Prescribed entries need not be zeroed: the preconditioner knows them as not active.
    if (!constraints_->direct) eliminate(*force_, step);
    solve_coarse(*force_, step);
    device_.for_blocks(blocks_for(slots_), AdvanceNodes<Real>{slots_, preconditioner(), factors_->data(), watched_->data(), force_->data(), u.data(), increment.data(), change.data(), largest_->data(), step});
    device_.for_blocks(1, FinishStep<Real>{blocks_for(slots_), point_blocks(), largest_->data(), ratio_->data(), control_->data()});
  }

  mutable Device device_;
  const DiscreteModel& model_;
  int slots_;
  double bytes_ = 0;
  std::vector<std::uint8_t> seen_;                                    ///< [slots] by integration points
  std::unique_ptr<UploadedTable<Real, Device>> of_points_, of_nodes_;
  std::unique_ptr<Buffer<Real>> parameter_;
  mutable std::vector<Values> stress_;
  std::unique_ptr<Buffer<VolumeRatios<Real>>> ratio_, worst_;
  std::unique_ptr<Buffer<double>> energy_, dot_part_, sum_;
  std::unique_ptr<Values> inverse_diagonal_, external_, force_;       ///< external: empty without loads
  std::unique_ptr<Buffer<std::uint8_t>> watched_;
  std::unique_ptr<Buffer<Real>> largest_, largest_of_all_;
  std::unique_ptr<Buffer<StepFactors<Real>>> factors_;
  std::unique_ptr<Buffer<StepControl>> control_;
  std::unique_ptr<SpringBuffers> springs_;                            ///< null: none
  std::unique_ptr<ConstraintBuffers> constraints_;
  std::unique_ptr<CoarseSpace> coarse_space_;                         ///< null: diagonal preconditioner only
  std::unique_ptr<CoarseBuffers> coarse_;                             ///< null: no correction
  std::unique_ptr<RowBuffers> rows_;
};

}  // namespace mtled
