#include "core/nodal_pressure.hpp"

#include <algorithm>

namespace mtled {
namespace {

constexpr std::size_t piece = 2048;  ///< elements or nodes that one thread does in a row

Mat3d plus_identity(Mat3d G) {
  for (int i = 0; i < 3; ++i) G[i][i] += 1;
  return G;
}

double contraction(const Mat3d& a, const Mat3d& b) {
  double sum = 0;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) sum += a[i][j] * b[i][j];
  return sum;
}

/// Derivative of cofactors(F) in the direction dF.
Mat3d cofactors_derivative(const Mat3d& F, const Mat3d& dF) {
  Mat3d d;
  for (int i = 0; i < 3; ++i) {
    const int p = (i + 1) % 3, q = (i + 2) % 3;
    for (int j = 0; j < 3; ++j) {
      const int s = (j + 1) % 3, t = (j + 2) % 3;
      d[i][j] = dF[p][s] * F[q][t] + F[p][s] * dF[q][t] - dF[p][t] * F[q][s] - F[p][t] * dF[q][s];
    }
  }
  return d;
}

Mat3d scaled(double factor, Mat3d A) {
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) A[i][j] *= factor;
  return A;
}
Mat3d sum(Mat3d A, const Mat3d& B) {
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) A[i][j] += B[i][j];
  return A;
}

}  // namespace

template <class Real>
NodalPressure<Real>::NodalPressure(const SupportTable& supports, const IntegrationPoints& points) : tetrahedra_(points.size()) {
  for (std::size_t p = 0; p < points.size(); ++p) {
    Tetrahedron& t = tetrahedra_[p];
    const std::size_t first = std::size_t(supports.begin[std::size_t(supports.stencil[p])]);
    for (std::size_t c = 0; c < 4; ++c) {
      t.slot[c] = supports.base[p] + supports.offset[first + c];
      t.gradient[c] = supports.gradient[first + c];
      slot_.push_back(t.slot[c]);
    }
    t.volume = points.volume[p], t.bulk_modulus = points.bulk_modulus[p];
  }
  std::sort(slot_.begin(), slot_.end());
  slot_.erase(std::unique(slot_.begin(), slot_.end()), slot_.end());
  begin_.assign(slot_.size() + 1, 0);
  for (Tetrahedron& t : tetrahedra_)
    for (std::size_t c = 0; c < 4; ++c) {
      t.node[c] = int(std::lower_bound(slot_.begin(), slot_.end(), t.slot[c]) - slot_.begin());
      ++begin_[std::size_t(t.node[c]) + 1];
    }
  for (std::size_t a = 0; a < slot_.size(); ++a) begin_[a + 1] += begin_[a];
  element_of_.resize(4 * tetrahedra_.size()), corner_of_.resize(element_of_.size());
  std::vector<std::size_t> next(begin_.begin(), begin_.end() - 1);
  for (std::size_t e = 0; e < tetrahedra_.size(); ++e)
    for (std::size_t c = 0; c < 4; ++c) {
      const std::size_t at = next[std::size_t(tetrahedra_[e].node[c])]++;
      element_of_[at] = std::uint32_t(e), corner_of_[at] = std::uint8_t(c);
    }
  volume_.assign(slot_.size(), 0.0);
  for (const Tetrahedron& t : tetrahedra_)
    for (int a : t.node) volume_[std::size_t(a)] += t.volume / 4;
  bulk_modulus_ = nodal_means(points.bulk_modulus);
}

template <class Real>
Mat3d NodalPressure<Real>::gradient(const NodalField<Real>& u, const Tetrahedron& t) {
  Mat3d G;
  for (std::size_t c = 0; c < 4; ++c)
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) G[i][j] += double(u.at(std::size_t(t.slot[c]), i)) * t.gradient[c][j];
  return G;
}

template <class Real>
std::vector<double> NodalPressure<Real>::nodal_means(const std::vector<double>& of_element) const {
  std::vector<double> mean(slot_.size());
  parallel_for(mean.size(), [&](std::size_t a) {
    for (std::size_t i = begin_[a]; i < begin_[a + 1]; ++i) mean[a] += tetrahedra_[element_of_[i]].volume * of_element[element_of_[i]];
    mean[a] /= 4 * volume_[a];
  }, piece);
  return mean;
}

template <class Real>
std::vector<double> NodalPressure<Real>::pressure_excess(const std::vector<double>& change) const {
  const std::vector<double> mean = nodal_means(change);
  std::vector<double> excess(change.size());
  parallel_for(excess.size(), [&](std::size_t e) {
    const Tetrahedron& t = tetrahedra_[e];
    for (int a : t.node) excess[e] += bulk_modulus_[std::size_t(a)] * mean[std::size_t(a)] / 4;
    excess[e] -= t.bulk_modulus * change[e];
  }, piece);
  return excess;
}

template <class Real>
void NodalPressure<Real>::gather(const std::vector<Mat3d>& S, NodalField<Real>& f) const {
  parallel_for(slot_.size(), [&](std::size_t a) {
    Vec3d force{};
    for (std::size_t i = begin_[a]; i < begin_[a + 1]; ++i) force += S[element_of_[i]] * tetrahedra_[element_of_[i]].gradient[corner_of_[i]];
    for (int c = 0; c < 3; ++c) f.at(std::size_t(slot_[a]), c) += Real(force[c]);
  }, piece);
}

template <class Real>
void NodalPressure<Real>::add_force(const NodalField<Real>& u, NodalField<Real>& f) const {
  std::vector<Mat3d> S(tetrahedra_.size());
  std::vector<double> change(S.size());
  parallel_for(S.size(), [&](std::size_t e) {
    S[e] = plus_identity(gradient(u, tetrahedra_[e]));
    change[e] = determinant(S[e]) - 1;
  }, piece);
  const std::vector<double> excess = pressure_excess(change);
  parallel_for(S.size(), [&](std::size_t e) { S[e] = scaled(tetrahedra_[e].volume * excess[e], cofactors(S[e])); }, piece);
  gather(S, f);
}

template <class Real>
void NodalPressure<Real>::add_tangent(const NodalField<Real>& u, const NodalField<Real>& v, NodalField<Real>& f) const {
  std::vector<Mat3d> F(tetrahedra_.size()), dF(F.size());
  std::vector<double> change(F.size()), change_derivative(F.size());
  parallel_for(F.size(), [&](std::size_t e) {
    F[e] = plus_identity(gradient(u, tetrahedra_[e])), dF[e] = gradient(v, tetrahedra_[e]);
    change[e] = determinant(F[e]) - 1, change_derivative[e] = contraction(cofactors(F[e]), dF[e]);
  }, piece);
  const std::vector<double> excess = pressure_excess(change), derivative = pressure_excess(change_derivative);
  parallel_for(F.size(), [&](std::size_t e) {
    F[e] = scaled(tetrahedra_[e].volume, sum(scaled(derivative[e], cofactors(F[e])), scaled(excess[e], cofactors_derivative(F[e], dF[e]))));
  }, piece);
  gather(F, f);
}

template <class Real>
double NodalPressure<Real>::energy(const NodalField<Real>& u) const {
  std::vector<double> change(tetrahedra_.size());
  parallel_for(change.size(), [&](std::size_t e) { change[e] = determinant(plus_identity(gradient(u, tetrahedra_[e]))) - 1; }, piece);
  const std::vector<double> mean = nodal_means(change);
  double difference = 0;
  for (std::size_t a = 0; a < mean.size(); ++a) difference += volume_[a] * bulk_modulus_[a] / 2 * mean[a] * mean[a];
  for (std::size_t e = 0; e < change.size(); ++e) difference -= tetrahedra_[e].volume * tetrahedra_[e].bulk_modulus / 2 * change[e] * change[e];
  return difference;
}

template class NodalPressure<float>;
template class NodalPressure<double>;

}  // namespace mtled
