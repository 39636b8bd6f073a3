#include <nlohmann/json.hpp>

#include "program.hpp"
#include "temporary_folder.hpp"

namespace mtled {
namespace {

using Json = nlohmann::json;
using StepPerf = TemporaryFolder;

/// Everything that is counted must fit together; how long a step takes is nobody's business here.
TEST_F(StepPerf, WritesResultsThatFitTogether) {
  for (const std::string cloud : {"lattice", "general"}) {
    const auto outcome = program::run({"--sizes", "1000", "--repetitions", "3", "--cloud", cloud, "--threads", "2", "--output", file(cloud)}, file("log"));
    ASSERT_EQ(outcome.code, 0) << outcome.err;
    const Json result = Json::parse(program::content(file(cloud) / "step_perf.json"));
    EXPECT_EQ(result["conditions"]["cloud"], cloud);
    EXPECT_EQ(result["conditions"]["host threads"], 2);
    const double copy = result["conditions"]["copy GB/s"];
    EXPECT_GT(copy, 0);
    ASSERT_EQ(result["runs"].size(), 2u);
    EXPECT_EQ(result["runs"][0]["relaxation"], "plain");
    EXPECT_EQ(result["runs"][0]["coarse_unknowns"], 0);
    EXPECT_EQ(result["runs"][1]["relaxation"], "two-level");
    EXPECT_GT(result["runs"][1]["coarse_unknowns"], 0);
    for (const Json& r : result["runs"]) {
      const double nodes = r["nodes"], points = r["points"], share = r["share_of_single_supports"], us = r["microseconds_per_step"]["median"], bytes = r["bytes_per_step"]["total"];
      EXPECT_NEAR(nodes, 1000, 50);
      EXPECT_GT(points, nodes);
      EXPECT_EQ(share == 1, cloud == "general");
      EXPECT_LE(r["microseconds_per_step"]["min"], us);
      EXPECT_GE(r["microseconds_per_step"]["max"], us);
      EXPECT_NEAR(r["node_steps_per_s"], nodes / us * 1e6, 1e-9 * nodes / us * 1e6);
      EXPECT_NEAR(r["GB_per_s"], bytes / us * 1e-3, 1e-9 * bytes / us);
      EXPECT_NEAR(r["share_of_copy_bandwidth"], bytes / us * 1e-3 / copy, 1e-9 * bytes / us);
      EXPECT_GT(r["backend_bytes"], 0);
    }
    EXPECT_NE(outcome.out.find("us per step"), std::string::npos);
    EXPECT_EQ(program::content(file(cloud) / "step_perf.md"), outcome.out);
  }
}

TEST_F(StepPerf, SaysWhatIsWrong) {
  program::expect_refusal(program::run({"--sizes", "10", "--output", file("out")}, file("log")), 3, {"10 nodes", "at least 500"});
  program::expect_refusal(program::run({"--device", "abacus", "--output", file("out")}, file("log")), 2, {"'abacus'", "cuda:N"});
  program::expect_refusal(program::run({"--device", "cuda:9999", "--output", file("out")}, file("log")), 5, {"cuda:9999", "--device cpu"});
}

}  // namespace
}  // namespace mtled
