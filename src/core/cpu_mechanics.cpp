#include "core/coarse_space.hpp"
#include "core/cpu_forces.hpp"
#include "core/mechanics.hpp"
#include "core/nodal_pressure.hpp"
#include "core/springs.hpp"

namespace mtled {
namespace {

constexpr std::size_t piece = 16384;  ///< slots that one thread does in a row

template <class Real>
struct CpuVector : Vector {
  explicit CpuVector(std::size_t slots) : values(slots) {}
  NodalField<Real> values;
};

template <class Real>
class CpuMechanics : public Mechanics {
  using Field = NodalField<Real>;
  static Field& values(Vector& v) { return static_cast<CpuVector<Real>&>(v).values; }
  static const Field& values(const Vector& v) { return static_cast<const CpuVector<Real>&>(v).values; }
  /// body(component, first slot, end) over pieces of every component.
  template <class Body>
  void each_component(Body&& body) const {
    parallel_pieces(model_.slots(), piece, [&](std::size_t begin, std::size_t end) {
      for (int c = 0; c < 3; ++c) body(c, begin, end);
    });
  }

 public:
  CpuMechanics(const DiscreteModel& model, const SolverOptions& options)
      : model_(model), forces_(model.supports, model.layout, *model.points), constraints_(*model.constraints),
        inverse_diagonal_(model.slots()), force_(model.slots()), push_(model.slots()) {
    const std::size_t slots = model.slots();
    if (model.springs.size() > 0) springs_ = std::make_unique<SpringForces<Real>>(model.springs, model.layout);
    if (model.field->averages_pressure()) nodal_pressure_ = std::make_unique<NodalPressure<Real>>(model.supports, *model.points);
    if (!model.external.empty()) {
      external_ = Field(slots);
      each_component([&](int c, std::size_t begin, std::size_t end) {
        for (std::size_t s = begin; s < end; ++s) external_.at(s, c) = Real(model.external[s][c]);
      });
    }
    each_component([&](int c, std::size_t begin, std::size_t end) {
      for (std::size_t s = begin; s < end; ++s)
        if (const std::size_t i = std::size_t(c) * slots + s; model.active[i]) inverse_diagonal_.at(s, c) = Real(1 / model.diagonal[i]);
    });
    if (options.relaxation == Relaxation::two_level) {
      coarse_ = std::make_unique<CoarseSpace>(model.position, model.coarse_active, options.coarse_unknowns, 5 * model.spacing);
      if (model.springs.size() > 0) coarse_->add_springs(model.springs, model.layout);
    }
  }

  VectorPointer vector() const override { return std::make_unique<CpuVector<Real>>(model_.slots()); }
  void upload(const std::vector<Vec3d>& from, Vector& to) const override {
    each_component([&](int c, std::size_t begin, std::size_t end) {
      for (std::size_t s = begin; s < end; ++s) values(to).at(s, c) = Real(from[s][c]);
    });
  }
  std::vector<Vec3d> download(const Vector& from) const override {
    std::vector<Vec3d> to(model_.slots());
    each_component([&](int c, std::size_t begin, std::size_t end) {
      for (std::size_t s = begin; s < end; ++s) to[s][c] = double(values(from).at(s, c));
    });
    return to;
  }
  void copy(const Vector& from, Vector& to) const override { values(to).copy_from(values(from)); }
  void clear(Vector& y) const override { values(y).clear(); }
  void combine(Vector& y, double a, const Vector& x, double b) const override {
    each_component([&](int c, std::size_t begin, std::size_t end) {
      const Real* from = values(x).component(c);
      Real* to = values(y).component(c);
      for (std::size_t s = begin; s < end; ++s) to[s] = Real(a) * from[s] + Real(b) * to[s];
    });
  }
  double dot(const Vector& a, const Vector& b) const override { return mtled::dot(values(a), values(b)); }

  VolumeRatioStatistics force(const Vector& u, double load, Vector& f) const override { return force(values(u), load, values(f)); }
  void tangent(const Vector& u, const Vector& v, Vector& f) const override {
    forces_.tangent(values(u), values(v), values(f));
    if (springs_) springs_->add_tangent(values(v), values(f));
    if (nodal_pressure_) nodal_pressure_->add_tangent(values(u), values(v), values(f));
  }
  void impose(Vector& u, double load) const override { constraints_.impose(values(u), load); }
  void reduce(Vector& f) const override { constraints_.reduce(values(f)); }
  void precondition(const Vector& f, Vector& g) const override { precondition(values(f), values(g)); }
  void multiply_by_diagonal(const Vector& d, Vector& g) const override {
    each_component([&](int c, std::size_t begin, std::size_t end) {
      const Real *from = values(d).component(c), *inverse = inverse_diagonal_.component(c);
      Real* to = values(g).component(c);
      for (std::size_t s = begin; s < end; ++s) to[s] = inverse[s] > 0 ? from[s] / inverse[s] : Real(0);
    });
  }
  void assemble_coarse(const Vector& u) override { coarse_->assemble(model_.supports, *model_.points, download(u)); }

  void steps(int count, const StepSizes& sizes, StepControl& control, Vector& u, Vector& increment, Vector& change) override {
    for (int i = 0; i < count && control.verdict == StepControl::going; ++i) {
      const double load = control.load();
      if (control.step <= control.ramp || !constraints_.direct()) impose(u, load);
      const VolumeRatioStatistics ratio = force(values(u), load, force_);
      constraints_.reduce(force_);
      precondition(force_, push_);
      control.after_step(advance(sizes, values(u), values(increment), values(change)), ratio.inverted);
    }
  }

  double strain_energy(const Vector& u) const override { return measure_points(model_, download(u)).strain_energy; }
  double largest_displacement(const Vector& x) const override {
    if (field_rows_.size() == 0) field_rows_ = field_at_watched_nodes(model_);
    const Field& from = values(x);
    std::vector<double> top((field_rows_.size() + piece - 1) / piece, 0.0);
    parallel_pieces(field_rows_.size(), piece, [&](std::size_t begin, std::size_t end) {
      double& largest = top[begin / piece];
      for (std::size_t r = begin; r < end; ++r)
        for (int c = 0; c < 3; ++c) {
          double u = 0;
          for (std::size_t e = field_rows_.begin[r]; e < field_rows_.begin[r + 1]; ++e) u += double(field_rows_.value[e]) * double(from.at(std::size_t(field_rows_.slot[e]), c));
          largest = std::max(largest, std::abs(u));
        }
    });
    return *std::max_element(top.begin(), top.end());
  }
  int coarse_unknowns() const override { return coarse_ ? coarse_->unknowns() : 0; }
  double bytes() const override {
    constexpr double working_vectors = 12;
    return double(forces_.bytes()) + working_vectors * 3 * double(model_.slots()) * sizeof(Real) + (coarse_ ? double(coarse_->bytes()) : 0);
  }

 private:
  VolumeRatioStatistics force(const Field& u, double load, Field& f) const {
    const VolumeRatioStatistics ratio = forces_.force(u, f);
    if (springs_) springs_->add_force(u, load, f);
    if (nodal_pressure_) nodal_pressure_->add_force(u, f);
    if (external_.slots() > 0)
      each_component([&](int c, std::size_t begin, std::size_t end) {
        for (std::size_t s = begin; s < end; ++s) f.at(s, c) -= Real(load) * external_.at(s, c);
      });
    return ratio;
  }
  void precondition(const Field& f, Field& g) const {
    each_component([&](int c, std::size_t begin, std::size_t end) {
      const Real *from = f.component(c), *d = inverse_diagonal_.component(c);
      Real* to = g.component(c);
      for (std::size_t s = begin; s < end; ++s) to[s] = d[s] * from[s];
    });
    if (coarse_) coarse_->add_correction(f, g);
  }
  /// The update of one step from push_; returns the largest component of the increment over the watched nodes.
  double advance(const StepSizes& sizes, Field& u, Field& increment, Field& change) const {
    const Real inertia = Real(sizes.rho * sizes.rho), scale = Real((1 + sizes.rho) * (1 + sizes.rho) / sizes.lambda);
    std::vector<Real> largest((u.slots() + piece - 1) / piece);
    parallel_pieces(u.slots(), piece, [&](std::size_t begin, std::size_t end) {
      Real top = 0;
      for (int c = 0; c < 3; ++c) {
        const Real* push = push_.component(c);
        Real *now = u.component(c), *d = increment.component(c), *sum = change.component(c);
        const std::uint8_t* watched = model_.watched.data();
        for (std::size_t s = begin; s < end; ++s) {
          d[s] = inertia * d[s] - scale * push[s];
          now[s] += d[s];
          sum[s] += d[s];
          const Real size = watched[s] ? std::abs(d[s]) : Real(0);
          top = size > top || size != size ? size : top;
        }
      }
      largest[begin / piece] = top;
    });
    double top = 0;
    for (Real x : largest)
      if (!(x <= top)) top = double(x);
    return top;
  }

  const DiscreteModel& model_;
  CpuForces<Real> forces_;
  const ConstraintOperator& constraints_;
  std::unique_ptr<SpringForces<Real>> springs_;          ///< null: none
  std::unique_ptr<NodalPressure<Real>> nodal_pressure_;  ///< null: each point has a pressure of its own
  Field external_;           ///< dead loads [mN]; no slots: none
  Field inverse_diagonal_;   ///< [mm/mN] 0 where not active
  std::unique_ptr<CoarseSpace> coarse_;                  ///< null: diagonal preconditioner only
  mutable FieldRows field_rows_;                         ///< made when first needed
  Field force_, push_;       ///< of steps()
};

}  // namespace

std::unique_ptr<Mechanics> make_cpu_mechanics(const DiscreteModel& model, const SolverOptions& options) {
  if (options.double_precision) return std::make_unique<CpuMechanics<double>>(model, options);
  return std::make_unique<CpuMechanics<float>>(model, options);
}

}  // namespace mtled
