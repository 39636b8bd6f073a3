// The materials beyond neo-Hookean; NeoHookean takes part where its hand-written derivative is compared.
#include "core/lanes.hpp"  // first: the functions of packs must be known where material.hpp calls them
#include "core/material.hpp"

#include <gtest/gtest.h>

#include <limits>
#include <vector>

#include "deformations.hpp"

namespace mtled {
namespace {

constexpr double mu = 1.3, k = 40;  ///< [kPa]; about nu = 0.485
constexpr double difference_step = 1e-5;
// Central differences: truncation step^2 times third derivatives of size 10 to 100, rounding 1e-16 / step; relative.
constexpr double difference_tolerance = 1e-7;

/// Template and parameters, all far from those that would make the material neo-Hookean.
struct NeoHookeanCase {
  template <class T> using Material = NeoHookean<T>;
  static std::vector<double> parameters() { return {mu, k}; }
};
struct MooneyRivlinCase {
  template <class T> using Material = MooneyRivlin<T>;
  static std::vector<double> parameters() { return {mu, k, 0.2}; }
};
struct YeohCase {
  template <class T> using Material = Yeoh<T>;
  static std::vector<double> parameters() { return {mu, k, 0.3, 0.05}; }
};
struct BrainOgdenCase {  // exponent of brain tissue (Miller and Chinzei 2002)
  template <class T> using Material = Ogden<T>;
  static std::vector<double> parameters() { return {mu, k, -4.7}; }
};
struct OgdenCase {
  template <class T> using Material = Ogden<T>;
  static std::vector<double> parameters() { return {mu, k, 3.5}; }
};
struct FibresCase {
  template <class T> using Material = TransverselyIsotropic<T>;
  static std::vector<double> parameters() { return {mu, k, 2.5, 2.0 / 3, -1.0 / 3, 2.0 / 3}; }
};

template <class Case>
class Materials : public testing::Test {
 public:
  template <class T>
  using Material = typename Case::template Material<T>;
  static constexpr int count = sizeof(Material<double>) / sizeof(double);
  template <class T = double>
  static Material<T> make(const std::vector<double>& parameters = Case::parameters()) {
    T converted[std::size_t(count)];
    for (int i = 0; i < count; ++i) converted[i] = T{} + T(parameters[std::size_t(i)]);
    Material<T> material;
    memcpy(static_cast<void*>(&material), converted, sizeof material);
    return material;
  }
  static Mat3d stress(const Mat3d& F, const std::vector<double>& parameters = Case::parameters()) {
    double J;
    return make(parameters).stress(F, J);
  }
  static Mat3d derivative(const Mat3d& F, const Mat3d& dF) { return stress_derivative(make(), F, dF); }
  static Mat3d difference(const Mat3d& F, const Mat3d& D) {
    return combine(0.5 / difference_step, stress(combine(1.0, F, difference_step, D)), -0.5 / difference_step, stress(combine(1.0, F, -difference_step, D)));
  }
};
using AllCases = testing::Types<NeoHookeanCase, MooneyRivlinCase, YeohCase, BrainOgdenCase, OgdenCase, FibresCase>;
TYPED_TEST_SUITE(Materials, AllCases);

TYPED_TEST(Materials, RestAndRotationsAreFreeOfStressAndEnergy) {
  Samples samples;
  for (int n = 0; n < 20; ++n) {
    const Mat3d R = n == 0 ? Mat3d::identity() : samples.rotation();
    EXPECT_LT(largest(this->stress(R)), 1e-13 * k);
    EXPECT_NEAR(this->make().energy(R), 0, 1e-13 * k);
  }
}

TYPED_TEST(Materials, StressIsEnergyGradient) {
  Samples samples;
  for (int n = 0; n < 50; ++n) {
    const Mat3d F = samples.deformation();
    const auto material = this->make();
    Mat3d expected;
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) {
        Mat3d up = F, down = F;
        up[i][j] += difference_step, down[i][j] -= difference_step;
        expected[i][j] = (material.energy(up) - material.energy(down)) / (2 * difference_step);
      }
    const double tolerance = difference_tolerance * std::max(k, largest(expected));
    EXPECT_LT(largest(combine(1.0, this->stress(F), -1.0, expected)), tolerance);
    auto wrong = TypeParam::parameters();
    wrong[0] *= 1.01;  // must be seen
    EXPECT_GT(largest(combine(1.0, this->stress(F, wrong), -1.0, expected)), 10 * tolerance);
  }
}

TYPED_TEST(Materials, StressDerivativeIsTheDifferenceOfStress) {
  Samples samples;
  for (int n = 0; n < 50; ++n) {
    const Mat3d F = samples.deformation(), D = samples.direction(), expected = this->difference(F, D);
    const double tolerance = difference_tolerance * std::max(k, largest(expected));
    EXPECT_LT(largest(combine(1.0, this->derivative(F, D), -1.0, expected)), tolerance);
    EXPECT_GT(largest(combine(1.0, this->derivative(Mat3d::identity(), D), -1.0, expected)), 1000 * tolerance);
  }
}

TYPED_TEST(Materials, StressDerivativeIsSymmetric) {
  Samples samples;
  for (int n = 0; n < 50; ++n) {
    const Mat3d F = samples.deformation(), A = samples.direction(), B = samples.direction();
    const double AB = contract(this->derivative(F, A), B), size = std::max(k, largest(this->derivative(F, A)));
    EXPECT_NEAR(AB, contract(this->derivative(F, B), A), 1e-11 * size);
  }
}

TYPED_TEST(Materials, StressDerivativeAtRestIsLinearElasticityWithTheGivenModuli) {
  Samples samples;
  const double lambda = k - 2 * mu / 3;
  const bool fibres = std::is_same_v<TypeParam, FibresCase>;
  const auto parameters = TypeParam::parameters();
  Mat3d G;  // a (x) a - I / 3
  if (fibres)
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) G[i][j] = parameters[std::size_t(3 + i)] * parameters[std::size_t(3 + j)] - (i == j ? 1.0 / 3 : 0);
  for (int n = 0; n < 20; ++n) {
    const Mat3d D = samples.direction(), e = combine(0.5, D, 0.5, transpose(D));
    Mat3d expected = combine(2 * mu, e, lambda * (e[0][0] + e[1][1] + e[2][2]), Mat3d::identity());
    if (fibres) expected = combine(1.0, expected, 4 * parameters[2] * contract(G, e), G);
    EXPECT_LT(largest(combine(1.0, this->derivative(Mat3d::identity(), D), -1.0, expected)), 1e-12 * k);
  }
}

TYPED_TEST(Materials, AreObjective) {
  Samples samples;
  for (int n = 0; n < 20; ++n) {
    const Mat3d F = samples.deformation(), R = samples.rotation();
    const double size = std::max(k, largest(this->stress(F)));
    EXPECT_LT(largest(combine(1.0, this->stress(R * F), -1.0, R * this->stress(F))), 1e-12 * size);
    EXPECT_NEAR(this->make().energy(R * F), this->make().energy(F), 1e-12 * size);
    // Isotropic ones do not mind a rotation beforehand; fibres do.
    const double beforehand = largest(combine(1.0, this->stress(F * R), -1.0, this->stress(F) * R));
    if (std::is_same_v<TypeParam, FibresCase>) EXPECT_GT(beforehand, 1e-3 * k);
    else EXPECT_LT(beforehand, 1e-12 * size);
  }
}

TYPED_TEST(Materials, InvertedPointsKeepFiniteStress) {
  Samples samples;
  for (double s : {0.04, 0.0, -0.5}) {
    Mat3d F = Mat3d::identity();
    F[2][2] = s;
    double J;
    const Mat3d P = this->make().stress(F, J), dP = this->derivative(F, samples.direction());
    EXPECT_DOUBLE_EQ(J, s);
    EXPECT_TRUE(std::isfinite(contract(P, P))) << s;
    EXPECT_TRUE(std::isfinite(contract(dP, dP))) << s;
  }
}

template <class Real, class Case, class Test>
void expect_packs_equal_double() {
  using Pack = typename LaneTraits<Real>::Pack;
  constexpr int width = LaneTraits<Real>::width, count = Test::count;
  Samples samples;
  Mat3<Pack> F, D;
  Pack parameters[std::size_t(count)];
  std::vector<Mat3d> F_lane, D_lane;
  std::vector<std::vector<double>> parameters_lane;
  for (int lane = 0; lane < width; ++lane) {
    // Lane 0 is at rest, lane 1 nearly so: coincident eigenvalues; the others have some tens of percent.
    F_lane.push_back(combine(1.0, Mat3d::identity(), lane == 0 ? 0 : lane == 1 ? 1e-4 : 0.2, samples.direction()));
    D_lane.push_back(samples.direction());
    parameters_lane.push_back(Case::parameters());
    parameters_lane.back()[0] *= 1 + 0.1 * lane, parameters_lane.back()[1] -= lane;
    for (int i = 0; i < count; ++i) {
      parameters[i][lane] = Real(parameters_lane.back()[std::size_t(i)]);
      parameters_lane.back()[std::size_t(i)] = double(parameters[i][lane]);
    }
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) {
        F.m[i][j][lane] = Real(F_lane.back()[i][j]), D.m[i][j][lane] = Real(D_lane.back()[i][j]);
        F_lane.back()[i][j] = double(F.m[i][j][lane]), D_lane.back()[i][j] = double(D.m[i][j][lane]);
      }
  }
  typename Test::template Material<Pack> packed;
  memcpy(static_cast<void*>(&packed), parameters, sizeof packed);
  Pack J;
  const Mat3<Pack> P = packed.stress(F, J), dP = stress_derivative(packed, F, D);
  for (int lane = 0; lane < width; ++lane) {
    const auto reference = Test::make(parameters_lane[std::size_t(lane)]);
    double J_lane;
    const Mat3d P_lane = reference.stress(F_lane[std::size_t(lane)], J_lane), dP_lane = stress_derivative(reference, F_lane[std::size_t(lane)], D_lane[std::size_t(lane)]);
    // Some 30 roundings of terms of size k |F|^2; the divided differences of Ogden lose up to a fifth of the digits.
    const double unit = double(std::numeric_limits<Real>::epsilon()), rounding = 100 * unit * std::max(k, largest(P_lane));
    const double derivative_rounding = 1000 * unit * std::max(k, largest(dP_lane)) + 10 * std::pow(unit, 0.8) * mu;
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) {
        EXPECT_NEAR(double(P.m[i][j][lane]), P_lane[i][j], rounding);
        EXPECT_NEAR(double(dP.m[i][j][lane]), dP_lane[i][j], derivative_rounding);
      }
  }
}
TYPED_TEST(Materials, PacksOfFloatAgreeWithDouble) { expect_packs_equal_double<float, TypeParam, Materials<TypeParam>>(); }
TYPED_TEST(Materials, PacksOfDoubleAgreeWithDouble) { expect_packs_equal_double<double, TypeParam, Materials<TypeParam>>(); }

TEST(DualNumbers, GiveTheHandWrittenDerivativeOfNeoHookean) {
  Samples samples;
  const NeoHookean<double> material{mu, k};
  for (int n = 0; n < 50; ++n) {
    const Mat3d F = samples.deformation(), D = samples.direction(), expected = material.stress_derivative(F, D);
    const Mat3d dual = stress_derivative<NeoHookean, double>(material, F, D);  // the general one
    EXPECT_LT(largest(combine(1.0, dual, -1.0, expected)), 1e-13 * std::max(k, largest(expected)));
  }
}

/// Both stresses at deformations of some tens of percent.
template <class A, class B>
void expect_equal(const A& a, const B& b) {
  Samples samples;
  for (int n = 0; n < 20; ++n) {
    const Mat3d F = samples.deformation();
    double J;
    const Mat3d P = a.stress(F, J), Q = b.stress(F, J);
    EXPECT_LT(largest(combine(1.0, P, -1.0, Q)), 1e-12 * std::max(k, largest(P)));
    EXPECT_NEAR(a.energy(F), b.energy(F), 1e-12 * std::max(k, a.energy(F)));
  }
}

TEST(SpecialCases, AreNeoHookeanOrMooneyRivlin) {
  const NeoHookean<double> solid{mu, k};
  expect_equal(MooneyRivlin<double>{mu, k, 0}, solid);
  expect_equal(Yeoh<double>{mu, k, 0, 0}, solid);
  expect_equal(TransverselyIsotropic<double>{mu, k, 0, {0, 0, 1}}, solid);
  expect_equal(Ogden<double>{mu, k, 2}, solid);
  expect_equal(Ogden<double>{mu, k, -2}, MooneyRivlin<double>{mu, k, mu / 2});  // I2~ = sum of lambda~^-2
}

/// sigma_11 - sigma_22 of the isochoric stretch diag(l, l^-1/2, l^-1/2): the Cauchy stress of an incompressible bar.
template <class Material>
double bar_stress(const Material& material, double l) {
  Mat3d F;
  F[0][0] = l, F[1][1] = F[2][2] = 1 / std::sqrt(l);
  double J;
  const Mat3d P = material.stress(F, J);
  return P[0][0] * F[0][0] - P[1][1] * F[1][1];
}

TEST(UniaxialStretch, HasTheClosedFormsOfTextbooks) {
  for (double l : {0.6, 0.9, 1.2, 1.8}) {
    const double y = l * l + 2 / l - 3, isotropic = l * l - 1 / l;
    const auto expect = [&](double measured, double formula) { EXPECT_NEAR(measured, formula, 1e-12 * k) << l; };
    expect(bar_stress(MooneyRivlin<double>{mu, k, 0.2}, l), 2 * isotropic * (mu / 2 - 0.2 + 0.2 / l));
    expect(bar_stress(Yeoh<double>{mu, k, 0.3, 0.05}, l), 2 * isotropic * (mu / 2 + 2 * 0.3 * y + 3 * 0.05 * y * y));
    for (double a : {-4.7, 3.5}) expect(bar_stress(Ogden<double>{mu, k, a}, l), 2 * mu / a * (std::pow(l, a) - std::pow(l, -a / 2)));
    expect(bar_stress(TransverselyIsotropic<double>{mu, k, 2.5, {1, 0, 0}}, l), mu * isotropic + 2 * 2.5 * (l * l - 1) * l * l);
    expect(bar_stress(TransverselyIsotropic<double>{mu, k, 0, {1, 0, 0}}, l), mu * isotropic);
  }
}

TEST(OgdenAtCoincidence, StressAndDerivativeAreThoseOfPrincipalStretches) {
  // P_i = (2 mu / a) (l_i~^a - mean) / l_i + k (J - 1) J / l_i, in rotated axes; stretches apart by 0 to some percent.
  Samples samples;
  const double a = -4.7;
  const Ogden<double> material{mu, k, a};
  for (double gap : {0.0, 1e-12, 1e-9, 1e-7, 1e-5, 3e-4, 7e-4, 1e-3, 1e-2}) {
    const Mat3d R = samples.rotation(), Q = samples.rotation();
    const double l[3] = {1.2, 1.2 * (1 + gap), 0.8 * (1 - gap)}, J = l[0] * l[1] * l[2];
    Mat3d stretch, principal;
    double mean = 0;
    for (double s : l) mean += std::pow(s / std::cbrt(J), a) / 3;
    for (int i = 0; i < 3; ++i) {
      stretch[i][i] = l[i];
      principal[i][i] = (2 * mu / a * (std::pow(l[i] / std::cbrt(J), a) - mean) + k * (J - 1) * J) / l[i];
    }
    const Mat3d F = R * stretch * Q, D = samples.direction();
    double unused;
    EXPECT_LT(largest(combine(1.0, material.stress(F, unused), -1.0, R * principal * Q)), 1e-13 * k) << gap;
    const Mat3d up = material.stress(combine(1.0, F, difference_step, D), unused), down = material.stress(combine(1.0, F, -difference_step, D), unused);
    const Mat3d expected = combine(0.5 / difference_step, up, -0.5 / difference_step, down);
    EXPECT_LT(largest(combine(1.0, stress_derivative(material, F, D), -1.0, expected)), difference_tolerance * k) << gap;
  }
}

}  // namespace
}  // namespace mtled
