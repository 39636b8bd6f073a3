#include "core/lanes.hpp"  // first: the functions of packs must be known where material.hpp calls them
#include "core/material.hpp"

#include <gtest/gtest.h>

#include <limits>

#include "deformations.hpp"

namespace mtled {
namespace {

constexpr double mu = 1.3, k = 40;  ///< [kPa]; about nu = 0.485
const NeoHookean<double> solid{mu, k};

// Central differences with step 1e-5 of smooth functions of size k: truncation 1e-10 k, rounding 1e-16 k / 1e-5.
constexpr double difference_step = 1e-5;
constexpr double difference_tolerance = 1e-8 * k;

Mat3d stress(const NeoHookean<double>& material, const Mat3d& F) {
  double J;
  return material.stress(F, J);
}

Mat3d stress_from_energy(const NeoHookean<double>& material, const Mat3d& F) {
  Mat3d P;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) {
      Mat3d up = F, down = F;
      up[i][j] += difference_step, down[i][j] -= difference_step;
      P[i][j] = (material.energy(up) - material.energy(down)) / (2 * difference_step);
    }
  return P;
}

TEST(BulkModulus, FollowsFromThePoissonRatio) {
  EXPECT_NEAR(bulk_modulus(1, 0.49), 49.0 + 2.0 / 3, 1e-12);  // 2 * 1.49 / (3 * 0.02)
  EXPECT_NEAR(bulk_modulus(3, 0), 2, 1e-12);                  // nu = 0: lambda = 0, k = 2 mu / 3
}

template <class Real>
class InverseCubeRoot : public testing::Test {};
using Reals = testing::Types<float, double>;
TYPED_TEST_SUITE(InverseCubeRoot, Reals);

TYPED_TEST(InverseCubeRoot, OfPacksIsThatOfTheStandardLibrary) {
  using Real = TypeParam;
  using Pack = typename LaneTraits<Real>::Pack;
  constexpr int width = LaneTraits<Real>::width;
  const double few_roundings = 4 * double(std::numeric_limits<Real>::epsilon());  // of the last Newton step
  double worst = 0;
  // Volume ratios are at least the floor of the isochoric part; the range leaves ample room on both sides.
  for (int e = -2000; e < 2000; e += width) {
    Pack x;
    for (int lane = 0; lane < width; ++lane) x[lane] = Real(std::pow(10.0, (e + lane + 0.37) / 500));
    const Pack y = inverse_cube_root(x);
    for (int lane = 0; lane < width; ++lane) worst = std::max(worst, std::abs(double(y[lane]) * std::cbrt(double(x[lane])) - 1));
  }
  EXPECT_LT(worst, few_roundings);
}

TYPED_TEST(InverseCubeRoot, OfOneIsOne) {
  typename LaneTraits<TypeParam>::Pack one{};
  one += 1;
  EXPECT_NEAR(double(inverse_cube_root(one)[0]), 1, 2 * double(std::numeric_limits<TypeParam>::epsilon()));
}

TEST(NeoHookean, RestIsFreeOfStressAndEnergy) {
  double J = 0;
  EXPECT_LT(largest(solid.stress(Mat3d::identity(), J)), 1e-14 * k);
  EXPECT_DOUBLE_EQ(J, 1);
  EXPECT_NEAR(solid.energy(Mat3d::identity()), 0, 1e-14 * k);
}

TEST(NeoHookean, DilationHasClosedForm) {
  // F = s I: I1 J^(-2/3) = 3, so W = k/2 (s^3 - 1)^2 and P = k (s^3 - 1) s^2 I.
  for (double s : {0.8, 1.1, 1.5}) {
    const Mat3d F = combine(s, Mat3d::identity(), 0.0, Mat3d::identity());
    const double p = k * (s * s * s - 1) * s * s;
    EXPECT_LT(largest(combine(1.0, stress(solid, F), -p, Mat3d::identity())), 1e-13 * k);
    EXPECT_NEAR(solid.energy(F), k / 2 * std::pow(s * s * s - 1, 2), 1e-13 * k);
  }
}

TEST(NeoHookean, SimpleShearHasClosedForm) {
  // F = I + g e_x e_y: J = 1, I1 = 3 + g^2, W = mu g^2 / 2; Cauchy shear stress mu g.
  const double g = 0.6;
  Mat3d F = Mat3d::identity();
  F[0][1] = g;
  EXPECT_NEAR(solid.energy(F), mu * g * g / 2, 1e-14 * k);
  const Mat3d cauchy = stress(solid, F) * transpose(F);
  EXPECT_NEAR(cauchy[0][1], mu * g, 1e-14 * k);
  EXPECT_NEAR(cauchy[0][0] - cauchy[1][1], mu * g * g, 1e-14 * k);
}

TEST(NeoHookean, StressIsEnergyGradient) {
  Samples samples;
  for (int n = 0; n < 50; ++n) {
    const Mat3d F = samples.deformation();
    const Mat3d expected = stress_from_energy(solid, F);
    EXPECT_LT(largest(combine(1.0, stress(solid, F), -1.0, expected)), difference_tolerance);
    // Plausible bugs that must be seen: a bulk modulus wrong by 1 %, and F^-1 in place of F^-T.
    EXPECT_GT(largest(combine(1.0, stress({mu, 1.01 * k}, F), -1.0, expected)), 10 * difference_tolerance);
    EXPECT_GT(largest(combine(1.0, transpose(stress(solid, F)), -1.0, expected)), 10 * difference_tolerance);
  }
}

TEST(NeoHookean, StressDerivativeIsTheDifferenceOfStress) {
  Samples samples;
  for (int n = 0; n < 50; ++n) {
    const Mat3d F = samples.deformation(), D = samples.direction();
    const Mat3d up = stress(solid, combine(1.0, F, difference_step, D)), down = stress(solid, combine(1.0, F, -difference_step, D));
    const Mat3d expected = combine(0.5 / difference_step, up, -0.5 / difference_step, down);
    EXPECT_LT(largest(combine(1.0, solid.stress_derivative(F, D), -1.0, expected)), 10 * difference_tolerance);  // second derivatives are larger
    EXPECT_GT(largest(combine(1.0, solid.stress_derivative(Mat3d::identity(), D), -1.0, expected)), 100 * difference_tolerance);
  }
}

TEST(NeoHookean, StressDerivativeIsSymmetric) {
  Samples samples;
  for (int n = 0; n < 50; ++n) {
    const Mat3d F = samples.deformation(), A = samples.direction(), B = samples.direction();
    EXPECT_NEAR(contract(solid.stress_derivative(F, A), B), contract(solid.stress_derivative(F, B), A), 1e-11 * k);
  }
}

TEST(NeoHookean, StressDerivativeAtRestIsLinearElasticity) {
  // dP = lambda tr(e) I + 2 mu e with lambda = k - 2 mu / 3 and e the symmetric part.
  Samples samples;
  const double lambda = k - 2 * mu / 3;
  for (int n = 0; n < 20; ++n) {
    const Mat3d D = samples.direction(), e = combine(0.5, D, 0.5, transpose(D));
    const Mat3d expected = combine(2 * mu, e, lambda * (e[0][0] + e[1][1] + e[2][2]), Mat3d::identity());
    EXPECT_LT(largest(combine(1.0, solid.stress_derivative(Mat3d::identity(), D), -1.0, expected)), 1e-13 * k);
  }
}

TEST(NeoHookean, RigidRotationIsStressFree) {
  Samples samples;
  for (int n = 0; n < 20; ++n) {
    const Mat3d R = samples.rotation();
    EXPECT_LT(largest(stress(solid, R)), 1e-14 * k);
    EXPECT_NEAR(solid.energy(R), 0, 1e-14 * k);
  }
}

TEST(NeoHookean, IsObjectiveAndIsotropic) {
  Samples samples;
  for (int n = 0; n < 20; ++n) {
    const Mat3d F = samples.deformation(), R = samples.rotation();
    EXPECT_LT(largest(combine(1.0, stress(solid, R * F), -1.0, R * stress(solid, F))), 1e-12 * k);
    EXPECT_LT(largest(combine(1.0, stress(solid, F * R), -1.0, stress(solid, F) * R)), 1e-12 * k);
    EXPECT_NEAR(solid.energy(R * F), solid.energy(F), 1e-12 * k);
  }
}

TEST(NeoHookean, InvertedPointsKeepFiniteStress) {
  for (double s : {0.04, 0.0, -0.5}) {
    Mat3d F = Mat3d::identity();
    F[2][2] = s;
    double J;
    const Mat3d P = solid.stress(F, J);
    EXPECT_DOUBLE_EQ(J, s);
    EXPECT_TRUE(std::isfinite(contract(P, P))) << s;
    EXPECT_LT(P[2][2], 0) << "the stress must push the point back at J = " << s;
  }
}

template <class Real>
class PackedMaterial : public testing::Test {};
TYPED_TEST_SUITE(PackedMaterial, Reals);

TYPED_TEST(PackedMaterial, EveryLaneAgreesWithDouble) {
  using Real = TypeParam;
  using Pack = typename LaneTraits<Real>::Pack;
  constexpr int width = LaneTraits<Real>::width;
  // Some 30 roundings of terms of size k |F|^2.
  const double rounding = 100 * k * double(std::numeric_limits<Real>::epsilon());
  Samples samples;
  Mat3<Pack> F, D;
  std::vector<Mat3d> F_lane, D_lane;
  NeoHookean<Pack> packed;
  for (int lane = 0; lane < width; ++lane) {
    F_lane.push_back(samples.deformation()), D_lane.push_back(samples.direction());
    packed.shear_modulus[lane] = Real(mu + lane), packed.bulk_modulus[lane] = Real(k - lane);
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) {
        F.m[i][j][lane] = Real(F_lane.back()[i][j]), D.m[i][j][lane] = Real(D_lane.back()[i][j]);
        F_lane.back()[i][j] = double(F.m[i][j][lane]), D_lane.back()[i][j] = double(D.m[i][j][lane]);
      }
  }
  Pack J;
  const Mat3<Pack> P = packed.stress(F, J), dP = packed.stress_derivative(F, D);
  for (int lane = 0; lane < width; ++lane) {
    const NeoHookean<double> reference{mu + lane, k - lane};
    double J_lane;
    const Mat3d P_lane = reference.stress(F_lane[std::size_t(lane)], J_lane);
    const Mat3d dP_lane = reference.stress_derivative(F_lane[std::size_t(lane)], D_lane[std::size_t(lane)]);
    EXPECT_NEAR(double(J[lane]), J_lane, rounding / k);
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) {
        EXPECT_NEAR(double(P.m[i][j][lane]), P_lane[i][j], rounding);
        EXPECT_NEAR(double(dP.m[i][j][lane]), dP_lane[i][j], 10 * rounding);
      }
  }
}

}  // namespace
}  // namespace mtled
