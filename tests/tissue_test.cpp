#include "imaging/tissue.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numeric>
#include <random>

#include "core/error.hpp"

namespace mtled {
namespace {

constexpr double tight = 1e-9;

Image image_of(const std::vector<float>& values) {
  Image image(Grid{{int(values.size()), 1, 1}});
  image.data = values;
  return image;
}

Mask everywhere(const Image& image) { return Mask(image.grid, 1); }

/// Whole intensities of three tissues, as in a CT.
Image three_tissues() {
  std::mt19937 random(3);
  std::normal_distribution<float> noise(0, 25);
  std::vector<float> values;
  for (const float mean : {-800.0F, 40.0F, 500.0F})
    for (int i = 0; i < 400; ++i) values.push_back(std::round(mean + noise(random)));
  return image_of(values);
}

/// Fuzzy C-means voxel by voxel, from the formulas of Bezdek.
std::vector<double> centers_by_voxel(const Image& image, std::vector<double> centers, double q, int iterations) {
  for (int it = 0; it < iterations; ++it) {
    std::vector<double> above(centers.size()), below(centers.size());
    for (const double x : image.data)
      for (std::size_t j = 0; j < centers.size(); ++j) {
        double sum = 0;
        for (const double other : centers) sum += std::pow(std::abs(x - centers[j]) / std::abs(x - other), 2 / (q - 1));
        const double w = std::pow(1 / sum, q);
        above[j] += w * x;
        below[j] += w;
      }
    for (std::size_t j = 0; j < centers.size(); ++j) centers[j] = above[j] / below[j];
  }
  return centers;
}

FuzzyClasses classes_at(std::vector<double> centers) {
  FuzzyClasses classes;
  classes.centers = std::move(centers);
  return classes;
}

template <class Work>
std::string error_of(Work&& work) {
  try {
    work();
  } catch (const Error& error) {
    EXPECT_EQ(error.failure(), Failure::input);
    return error.what();
  }
  return "no error";
}

TEST(Histogram, CountsRoundedIntensitiesInsideTheMask) {
  const Image image = image_of({-1.4F, -0.6F, 2.2F, 1.8F, 100.0F});
  Mask mask = everywhere(image);
  mask.data[4] = 0;
  const Histogram h = histogram(image, mask, 1);
  EXPECT_EQ(h.values, (std::vector<double>{-1, 2}));
  EXPECT_EQ(h.counts, (std::vector<double>{2, 2}));
}

class FuzzinessTest : public testing::TestWithParam<double> {};
INSTANTIATE_TEST_SUITE_P(Exponents, FuzzinessTest, testing::Values(1.5, 2.0, 3.0));

TEST_P(FuzzinessTest, HistogramGivesTheCentersOfTheVoxels) {
  const Image image = three_tissues();
  FuzzyCMeansOptions options{.classes = 3, .fuzziness = GetParam(), .initial_centers = {-700.3, 0.4, 300.7}};
  options.max_iterations = 6;
  options.tolerance = 0;
  const FuzzyClasses found = fuzzy_c_means(histogram(image, everywhere(image), 1), options);
  const auto expected = centers_by_voxel(image, options.initial_centers, GetParam(), options.max_iterations);
  for (int j = 0; j < 3; ++j) EXPECT_NEAR(found.centers[j], expected[j], tight * 1000);
}

TEST_P(FuzzinessTest, ObjectiveFallsMonotonously) {
  const Image image = three_tissues();
  const Histogram samples = histogram(image, everywhere(image), 1);
  double last = INFINITY;
  for (int iterations = 0; iterations < 12; ++iterations) {
    FuzzyCMeansOptions options{.classes = 3, .fuzziness = GetParam(), .initial_centers = {-500, -400, -300}};
    options.max_iterations = iterations;
    const double now = fuzzy_c_means(samples, options).objective;
    EXPECT_LE(now, last * (1 + tight));
    last = now;
  }
}

TEST(FuzzyCMeans, TwoValuesAreTheirOwnClasses) {
  const Image image = image_of({-100, -100, -100, 50, 50});
  const FuzzyClasses found = fuzzy_c_means(histogram(image, everywhere(image), 1), {.classes = 2});
  EXPECT_TRUE(found.converged);
  EXPECT_NEAR(found.centers[0], -100, 1e-3);
  EXPECT_NEAR(found.centers[1], 50, 1e-3);
  EXPECT_NEAR(found.objective, 0, 1e-3);
}

TEST(FuzzyCMeans, SymmetricThreeValuesHaveAClosedForm) {
  // Values -1, 0, 1 (equal counts), centres -c and c, q = 2. u of the value 1 in the class of c is (1+c)^2 / (2
  // (1+c^2)), and 1/2 for the value 0; the fixed point of the update solves c = ((1+c)^4 - (1-c)^4) / ((1+c)^4 +
  // (1-c)^4 + (1+c^2)^2).
  double c = 0.8;
  for (int i = 0; i < 200; ++i) {
    const double p = std::pow(1 + c, 4), m = std::pow(1 - c, 4), s = 1 + c * c;
    c = (p - m) / (p + m + s * s);
  }
  const Image image = image_of({-1, 0, 1});
  const FuzzyClasses found = fuzzy_c_means(histogram(image, everywhere(image), 1), {.classes = 2, .tolerance = 1e-12});
  EXPECT_NEAR(found.centers[0], -c, 1e-8);
  EXPECT_NEAR(found.centers[1], c, 1e-8);
}

TEST(FuzzyCMeans, FixedCentersAreSortedAndKept) {
  const Image image = three_tissues();
  const FuzzyClasses found =
      fuzzy_c_means(histogram(image, everywhere(image), 1), {.classes = 3, .fixed_centers = {500, -800, 40}});
  EXPECT_EQ(found.centers, (std::vector<double>{-800, 40, 500}));
  EXPECT_EQ(found.iterations, 0);
  EXPECT_TRUE(found.converged);
  EXPECT_GT(found.objective, 0);
}

TEST(FuzzyCMeans, EightClassesStartFromCtAnchorsOrQuantiles) {
  std::vector<float> ct, mr;
  for (int i = 0; i < 2000; ++i) ct.push_back(float(-1000 + i)), mr.push_back(float(i));
  for (const auto& values : {ct, mr}) {
    const Image image = image_of(values);
    const FuzzyClasses found = fuzzy_c_means(histogram(image, everywhere(image), 1), {});
    EXPECT_TRUE(found.converged);
    for (int j = 1; j < 8; ++j) EXPECT_GT(found.centers[j], found.centers[j - 1] + 50);
    const FuzzyClasses again = fuzzy_c_means(histogram(image, everywhere(image), 1), {});
    EXPECT_EQ(found.centers, again.centers);
  }
}

TEST(FuzzyCMeans, ExplainsWhatCannotBeClassified) {
  const Image constant = image_of({7, 7, 7, 7}), image = three_tissues();
  const Histogram flat = histogram(constant, everywhere(constant), 1), samples = histogram(image, everywhere(image), 1);
  EXPECT_NE(
      error_of([&] { fuzzy_c_means(flat, {.classes = 2}); }).find("fewer distinct intensities (1) than classes (2)"),
      std::string::npos);
  EXPECT_NE(error_of([&] { fuzzy_c_means(samples, {.classes = 1}); }).find("at least 2"), std::string::npos);
  EXPECT_NE(error_of([&] { fuzzy_c_means(samples, {.fuzziness = 1}); }).find("greater than 1"), std::string::npos);
  EXPECT_NE(error_of([&] {
              fuzzy_c_means(samples, {.classes = 3, .fixed_centers = {1, 2}});
            }).find("one per class"),
            std::string::npos);
  EXPECT_NE(error_of([&] { histogram(image, Mask(image.grid), 1); }).find("mask is empty"), std::string::npos);
  EXPECT_NE(error_of([&] { histogram(image, everywhere(image), 1e-9); }).find("larger bin width"), std::string::npos);
  EXPECT_NE(error_of([&] { histogram(image, everywhere(constant), 1); }).find("another voxel grid"), std::string::npos);
}

TEST(Memberships, AddUpToOneAndAreClampedToTheCenters) {
  const FuzzyClasses classes = classes_at({-800, 0, 500});
  double u[3];
  for (const double x : {-3000.0, -800.0, -799.999, -300.0, 250.0, 500.0, 4000.0}) {
    memberships(classes, x, u);
    EXPECT_NEAR(u[0] + u[1] + u[2], 1, tight);
  }
  memberships(classes, -3000, u);
  EXPECT_EQ(u[0], 1);
  memberships(classes, 4000, u);
  EXPECT_EQ(u[2], 1);
  memberships(classes, -400, u);  // equally far from the first two, 900 from the third
  EXPECT_NEAR(u[0], 1 / (2 + std::pow(400.0 / 900, 2)), tight);
}

TEST(Memberships, CoincidentCentersShare) {
  double u[3];
  memberships(classes_at({10, 10, 20}), 10, u);
  EXPECT_EQ(u[0], 0.5);
  EXPECT_EQ(u[1], 0.5);
}

TEST(ShearModulus, IsTheMembershipWeightedMean) {
  const Image image = image_of({-2000, -350.7F, 43, 100.25F, 3000, 0});
  Mask mask = everywhere(image);
  mask.data[5] = 0;
  const FuzzyClasses classes = classes_at({-826, -537, -326, -90, -32, 43, 274, 661});
  const auto table = default_tissue_table();
  const Image modulus = shear_modulus_map(image, mask, classes, table);
  for (int v = 0; v < 5; ++v) {
    double u[8], expected = 0;
    memberships(classes, image.data[v], u);
    for (int j = 0; j < 8; ++j) expected += u[j] * table[j].shear_modulus_kpa;
    EXPECT_NEAR(modulus.data[v], expected, 1e-3 * expected) << image.data[v];
  }
  EXPECT_FLOAT_EQ(modulus.data[0], 0.53F);
  EXPECT_FLOAT_EQ(modulus.data[4], 40.5F);
  EXPECT_EQ(modulus.data[5], 0);
}

TEST(ShearModulus, ResolvesSmallAndLargeIntensityRanges) {
  const std::vector<TissueProperties> table{{"soft", 1, false}, {"hard", 5, false}};
  for (const float scale : {1e-3F, 1.0F, 1e5F}) {
    const Image image = image_of({0, 0.25F * scale, 0.5F * scale, scale});
    const Image modulus = shear_modulus_map(image, everywhere(image), classes_at({0, scale}), table);
    EXPECT_FLOAT_EQ(modulus.data[0], 1);
    EXPECT_NEAR(modulus.data[1], 1 + 4 * 0.1, 1e-3);  // u = (1/4)^2 / ((1/4)^2 + (3/4)^2) = 0.1
    EXPECT_NEAR(modulus.data[2], 3, 1e-3);
    EXPECT_FLOAT_EQ(modulus.data[3], 5);
  }
}

TEST(BulkModulus, IsTheMembershipWeightedMeanOfTheClasses) {
  const std::vector<TissueProperties> table{{"lung", 1, false, 0.2}, {"muscle", 4, false, 0.49}};
  const Image image = image_of({0, 25, 100});
  const Image bulk = bulk_modulus_map(image, everywhere(image), classes_at({0, 100}), table);
  const double lung = 2 * 1.2 / (3 * 0.6), muscle = 2 * 4 * 1.49 / (3 * 0.02);
  EXPECT_NEAR(bulk.data[0], lung, 1e-6 * lung);
  EXPECT_NEAR(bulk.data[1], 0.9 * lung + 0.1 * muscle, 1e-6 * muscle);  // u as above
  EXPECT_NEAR(bulk.data[2], muscle, 1e-6 * muscle);
  const std::string message = error_of([&] { bulk_modulus_map(image, everywhere(image), classes_at({0, 100}), {{"lung", 1, false, 0.2}, {"muscle", 4}}); });
  EXPECT_NE(message.find("tissue 'muscle' has no Poisson ratio"), std::string::npos) << message;
}

TEST(ShearModulus, ExplainsBadTables) {
  const Image image = image_of({0, 1});
  const auto map = [&](const std::vector<TissueProperties>& table) {
    return error_of([&] { shear_modulus_map(image, everywhere(image), classes_at({0, 1}), table); });
  };
  EXPECT_NE(map({{"soft", 1, false}}).find("1 rows for 2 classes"), std::string::npos);
  EXPECT_NE(map({{"soft", 1, false}, {"void", 0, false}}).find("tissue 'void'"), std::string::npos);
}

TEST(HardClasses, TakeTheLargestMembership) {
  const Image image = image_of({-900, -390, -410, 30, 5000, 0});
  Mask mask = everywhere(image);
  mask.data[5] = 0;
  EXPECT_EQ(hard_classes(image, mask, classes_at({-800, 0, 500})).data, (std::vector<std::uint16_t>{1, 2, 1, 2, 3, 0}));
}

}  // namespace
}  // namespace mtled
