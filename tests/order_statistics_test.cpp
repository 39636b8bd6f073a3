#include "imaging/order_statistics.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <random>

#include "imaging/percentile.hpp"

namespace mtled {
namespace {

TEST(OrderStatistics, AreThoseOfTheSortedNumbers) {
  std::mt19937 random(5);
  std::vector<float> values;
  for (int n = 0; n < 20000; ++n) values.push_back(n % 3 == 0 ? std::normal_distribution<float>(1, 0.1f)(random) : n % 3 == 1 ? std::normal_distribution<float>(0, 1e-30f)(random) : std::normal_distribution<float>(0, 1e5f)(random));
  for (const float v : {0.0f, -0.0f, 1.0f, 1.0f, std::numeric_limits<float>::max(), std::numeric_limits<float>::lowest(), std::numeric_limits<float>::denorm_min(), INFINITY, -INFINITY}) values.push_back(v);
  std::vector<float> sorted = values;
  std::sort(sorted.begin(), sorted.end());
  for (int n = 0; n < 30; ++n) values.insert(values.begin() + 7 * n, n % 2 ? NAN : -NAN);
  OrderStatistics order(values);
  ASSERT_EQ(order.count(), sorted.size());
  for (std::size_t rank = 0; rank < sorted.size(); rank += rank < 20 || rank + 20 > sorted.size() ? 1 : 397) ASSERT_EQ(order.at(rank), sorted[rank]) << rank;
  for (const double percent : {0.5, 1.0, 50.0, 77.7, 99.0}) EXPECT_EQ(order.percentile(percent), percentile(sorted, percent)) << percent;
}

TEST(OrderStatistics, CountEqualNumbersBeforeARank) {
  const std::vector<float> values{3, 1, 2, 2, 1, NAN, 2};  // 1 1 2 2 2 3
  OrderStatistics order(values);
  const std::size_t expected[] = {0, 1, 0, 1, 2, 0};
  for (std::size_t rank = 0; rank < 6; ++rank) EXPECT_EQ(order.equals_before(rank), expected[rank]) << rank;
}

TEST(OrderStatistics, OfOneNumberAndOfNone) {
  const std::vector<float> one{NAN, 2.5f}, none{NAN, NAN}, empty;
  EXPECT_EQ(OrderStatistics(one).percentile(37), 2.5);
  for (const auto* values : {&none, &empty}) {
    OrderStatistics order(*values);
    EXPECT_EQ(order.count(), 0u);
    EXPECT_TRUE(std::isnan(order.percentile(50)));
  }
}

}  // namespace
}  // namespace mtled
