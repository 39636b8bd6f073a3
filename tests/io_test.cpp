#include <sys/resource.h>

#include <cmath>
#include <csignal>
#include <cstring>
#include <limits>

#include "io/input.hpp"
#include "io/output.hpp"
#include "io/tables.hpp"
#include "temporary_folder.hpp"

namespace mtled {
namespace {

namespace fs = std::filesystem;
using OutputTest = TemporaryFolder;
using TableTest = TemporaryFolder;
using MotionsTest = TemporaryFolder;
using VtuTest = TemporaryFolder;

TEST_F(OutputTest, FolderIsCreatedWithItsParents) {
  const OutputDirectory output(file("a") / "b", false);
  EXPECT_TRUE(fs::is_directory(output.path()));
}

TEST_F(OutputTest, FolderThatStaysEmptyIsRemovedAgain) {
  fs::create_directory(file("old"));
  { const OutputDirectory output(file("old") / "a" / "b", false); }
  EXPECT_TRUE(fs::is_directory(file("old"))) << "it was there before";
  EXPECT_FALSE(fs::exists(file("old") / "a"));
  {
    const OutputDirectory output(file("old") / "a" / "b", false);
    write_text(output / "result", "x");
  }
  EXPECT_TRUE(fs::exists(file("old") / "a" / "b" / "result"));
}

TEST_F(OutputTest, FolderWithResultsNeedsForce) {
  file("old.csv", "x");
  expect_failure(Failure::output, {"not empty", "--force"}, [&] { OutputDirectory(folder(), false); });
  EXPECT_NO_THROW(OutputDirectory(folder(), true));
}

TEST_F(OutputTest, FolderThatIsAFileIsRefused) {
  file("taken", "x");
  expect_failure(Failure::output, {"taken", "cannot create"}, [&] { OutputDirectory(file("taken"), true); });
}

TEST_F(OutputTest, TextReplacesTheOldFile) {
  file("a.txt", "old and longer");
  write_text(file("a.txt"), "new");
  EXPECT_EQ(read_file(file("a.txt")), "new");
  EXPECT_EQ(entries(), 1);
}

TEST_F(OutputTest, TemporaryKeepsFolderAndExtension) {
  write_atomically(file("a.nii.gz"), [&](const fs::path& temporary) {
    EXPECT_EQ(temporary.parent_path(), folder());
    EXPECT_TRUE(temporary.string().ends_with(".nii.gz"));
    EXPECT_FALSE(fs::exists(file("a.nii.gz")));
    std::ofstream(temporary) << "x";
  });
  EXPECT_TRUE(fs::exists(file("a.nii.gz")));
}

TEST_F(OutputTest, FailedWriteLeavesTheOldFileAlone) {
  file("a.txt", "old");
  EXPECT_THROW(write_atomically(file("a.txt"),
                                [](const fs::path& temporary) {
                                  std::ofstream(temporary) << "half";
                                  throw std::runtime_error("stop");
                                }),
               std::runtime_error);
  EXPECT_EQ(read_file(file("a.txt")), "old");
  EXPECT_EQ(entries(), 1);
}

TEST_F(OutputTest, MissingFolderAndFolderAsFileAreRefused) {
  expect_failure(Failure::output, {"there is no folder", "create it"}, [&] { write_text(file("no") / "a.txt", "x"); });
  expect_failure(Failure::output, {"it is a folder"}, [&] { write_text(folder(), "x"); });
}

TEST_F(OutputTest, FullDiskIsAnErrorAndLeavesNothing) {
  const auto before = std::signal(SIGXFSZ, SIG_IGN);
  rlimit limit{};
  getrlimit(RLIMIT_FSIZE, &limit);
  const rlimit small{4096, limit.rlim_max};
  setrlimit(RLIMIT_FSIZE, &small);
  expect_failure(Failure::output, {"big.txt", "free space"},
                 [&] { write_text(file("big.txt"), std::string(100000, 'x')); });
  setrlimit(RLIMIT_FSIZE, &limit);
  std::signal(SIGXFSZ, before);
  EXPECT_EQ(entries(), 0);
}

class InterruptTest : public TemporaryFolder, public testing::WithParamInterface<int> {};
TEST_P(InterruptTest, RemovesTemporariesAndEnds) {
  const auto interrupted = [&] {
    install_interrupt_handler();
    write_atomically(file("a.txt"), [](const fs::path& temporary) {
      std::ofstream(temporary) << "half";
      std::raise(GetParam());
    });
  };
  EXPECT_EXIT(interrupted(), testing::ExitedWithCode(128 + GetParam()), "");
  EXPECT_EQ(entries(), 0);
}
INSTANTIATE_TEST_SUITE_P(Signals, InterruptTest, testing::Values(SIGINT, SIGTERM));

TEST_F(TableTest, PlainCellsAreNumbers) {
  const Table table = Table::read(file("a.csv", "x,y,name\n1,-2.5e3,a b\n+.5, 7 ,\n"));
  ASSERT_EQ(table.rows(), 2u);
  EXPECT_TRUE(table.has("name"));
  EXPECT_FALSE(table.has("z"));
  EXPECT_EQ(table.number(0, table.column("x")), 1);
  EXPECT_EQ(table.number(0, table.column("y")), -2500);
  EXPECT_EQ(table.number(1, 0), 0.5);
  EXPECT_EQ(table.number(1, 1), 7);
  EXPECT_EQ(table.text(0, 2), "a b");
  EXPECT_EQ(table.text(1, 2), "");
  EXPECT_EQ(table.optional_number(1, 2), std::nullopt);
  EXPECT_EQ(table.optional_number(1, 1), 7);
}

TEST_F(TableTest, QuotesByteOrderMarkAndLineEndsOfEveryKind) {
  const Table table = Table::read(
      file("a.csv", "\xEF\xBB\xBF\"x\",\"the \"\"y\"\"\"\r\n\r\n\"1\",\"a,b\nc\"\r2,\"\"\n  \n3, \"q\" \n\n"));
  ASSERT_EQ(table.rows(), 3u);
  EXPECT_EQ(table.column("the \"y\""), 1);
  EXPECT_EQ(table.number(0, 0), 1);
  EXPECT_EQ(table.text(0, 1), "a,b\nc");
  EXPECT_EQ(table.text(1, 1), "");
  EXPECT_EQ(table.text(2, 1), "q");
  EXPECT_NE(table.place(0).find("a.csv, line 3"), std::string::npos);
  EXPECT_NE(table.place(1).find("line 5"), std::string::npos);
  EXPECT_NE(table.place(2).find("line 7"), std::string::npos);
}

TEST_F(TableTest, LastLineNeedsNoLineEnd) {
  EXPECT_EQ(Table::read(file("a.csv", "x\n1\n2")).number(1, 0), 2);
  EXPECT_EQ(Table::read(file("b.csv", "x,y\n1,")).text(0, 1), "");
  EXPECT_EQ(Table::read(file("c.csv", "x,y")).rows(), 0u);
}

TEST_F(TableTest, ErrorsNameFileLineAndRemedy) {
  const auto refused = [&](const std::string& content, const std::vector<std::string>& parts) {
    expect_failure(Failure::input, parts, [&] { Table::read(file("bad.csv", content)); });
  };
  refused("", {"bad.csv", "empty"});
  refused("\n \n", {"empty"});
  refused("x;y\n1;2\n", {"separated by commas"});
  refused("x,y\n1,2\n3\n", {"bad.csv, line 3", "1 cells", "header has 2"});
  refused("x,y\n1,2,3\n", {"line 2", "3 cells"});
  refused("x,y\n1,\"2\n3,4\n", {"line 2", "never closed"});
  refused("x,y\n1,\"2\"3\n", {"line 2", "follows a closing quote"});
  refused(std::string("x\0y\0", 4), {"not a text file"});
  expect_failure(Failure::input, {"missing.csv", "no such file"}, [&] { Table::read(file("missing.csv")); });
  expect_failure(Failure::input, {"it is a folder"}, [&] { Table::read(folder()); });
}

TEST_F(TableTest, CellsThatAreNoNumbersAreErrors) {
  const Table table = Table::read(file("a.csv", "x,y\n1,2\n,nan\ninf,1e999\n1x,0x10\n1 2,+-1\n"));
  for (std::size_t row = 1; row < table.rows(); ++row)
    for (int column = 0; column < 2; ++column)
      expect_failure(Failure::input, {concatenate("a.csv, line ", row + 2), column ? "column 'y'" : "column 'x'"},
                     [&] { table.number(row, column); });
}

TEST_F(TableTest, UnknownAndAmbiguousColumnsAreErrors) {
  const Table table = Table::read(file("a.csv", "x,y,y\n1,2,3\n"));
  expect_failure(Failure::input, {"no column 'z'", "'x', 'y'"}, [&] { table.column("z"); });
  expect_failure(Failure::input, {"two columns are named 'y'"}, [&] { table.column("y"); });
}

TEST_F(TableTest, PointsRoundTripToNineDigits) {
  const std::vector<Vec3d> points{{-194.825, 1e-7, 1234.56789}, {0, -0.333333333333, 2e5}};
  write_points(file("p.csv"), points);
  const auto back = read_points(file("p.csv"));
  ASSERT_EQ(back.size(), 2u);
  constexpr double half_of_ninth_digit = 5e-9;
  for (std::size_t i = 0; i < 2; ++i)
    for (int j = 0; j < 3; ++j) EXPECT_NEAR(back[i][j], points[i][j], half_of_ninth_digit * std::abs(points[i][j]));
}

TEST_F(TableTest, UnknownDisplacementIsAnEmptyCell) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  write_displacements(file("u.csv"), {{1, 2, 3}, {4, 5, 6.5}}, {{0.25, -1, 1e-9}, {nan, nan, nan}});
  EXPECT_EQ(read_file(file("u.csv")), "x,y,z,ux,uy,uz\n1,2,3,0.25,-1,1e-09\n4,5,6.5,,,\n");
  EXPECT_EQ(Table::read(file("u.csv")).optional_number(1, 3), std::nullopt);
  EXPECT_EQ(read_points(file("u.csv"), {"z", "y", "x"})[1], (Vec3d{6.5, 5, 4}));
}

RigidMotion some_motion() { return {{2.387220457395699, -8, -137.5}, rotation_matrix({0.1, -0.2, 0.05}), {3, 2, 2.5}}; }

TEST_F(MotionsTest, RoundTripIsExact) {
  write_motions(file("m.json"), {{7, some_motion()}, {1, {}}});
  const auto back = read_motions(file("m.json"));
  ASSERT_EQ(back.size(), 2u);
  EXPECT_EQ(back[0].label, 7);
  EXPECT_EQ(back[1].label, 1);
  EXPECT_EQ(back[0].motion.center, some_motion().center);
  EXPECT_EQ(back[0].motion.translation, some_motion().translation);
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) EXPECT_EQ(back[0].motion.rotation[i][j], some_motion().rotation[i][j]);
}

TEST_F(MotionsTest, RowMajorRotationAboutTheCenter) {
  const auto motions = read_motions(file("m.json", R"({"convention": "LPS mm; as agreed", "extra": 1, "labels": [
    {"label": 3, "center": [10, 0, 0], "R": [[0, -1, 0], [1, 0, 0], [0, 0, 1]], "t": [0, 0, 5]}]})"));
  const Vec3d y = motions.at(0).motion.apply({11, 0, 0});  // a quarter turn about z takes +x to +y
  EXPECT_NEAR(norm(y - Vec3d{10, 1, 5}), 0, 1e-15);
}

TEST_F(MotionsTest, ErrorsNameEntryAndRemedy) {
  const auto refused = [&](const std::string& content, const std::vector<std::string>& parts) {
    expect_failure(Failure::input, parts, [&] { read_motions(file("bad.json", content)); });
  };
  const auto with_label = [](const std::string& label) {
    return R"({"convention": "LPS mm", "labels": [)" + label + "]}";
  };
  const std::string identity = R"("R": [[1,0,0],[0,1,0],[0,0,1]])", rest = R"("center": [0,0,0], "t": [0,0,0])";
  const std::string good = R"({"label": 1, )" + identity + ", " + rest + "}";
  refused("{", {"bad.json", "not valid JSON", "line 1"});
  refused("[]", {"\"convention\" is missing"});
  refused(R"({"convention": "RAS mm", "labels": []})", {"RAS mm", "convert"});
  refused(R"({"convention": "LPS mm"})", {"\"labels\" is missing"});
  refused(R"({"convention": "LPS mm", "labels": 3})", {"must be a list"});
  refused(with_label(R"({"label": 1})"), {"entry 1", "\"center\" is missing"});
  refused(with_label(R"({"label": 0, )" + identity + ", " + rest + "}"), {"\"label\" is 0", "1 to 65535"});
  refused(with_label(R"({"label": 1.5, )" + identity + ", " + rest + "}"), {"\"label\" is 1.5"});
  refused(with_label(R"({"label": 1, "R": [[1,0,0],[0,1,0]], )" + rest + "}"), {"label 1", "three rows"});
  refused(with_label(R"({"label": 1, "R": [[1,0,0],[0,1,0],[0,0,"1"]], )" + rest + "}"), {"three numbers"});
  refused(with_label(R"({"label": 1, "R": [[1.001,0,0],[0,1,0],[0,0,1]], )" + rest + "}"), {"not a rotation"});
  refused(with_label(R"({"label": 1, "R": [[-1,0,0],[0,1,0],[0,0,1]], )" + rest + "}"), {"reflection"});
  refused(with_label(R"({"label": 1, )" + identity + R"(, "center": [0,0], "t": [0,0,0]})"), {"\"center\""});
  refused(with_label(good + "," + good), {"label 1 has two motions"});
  EXPECT_NO_THROW(read_motions(file("good.json", with_label(good))));
}

template <class T>
std::vector<T> appended(const std::string& file, const std::string& name, std::size_t count) {
  const std::size_t declared = file.find("Name=\"" + name + "\"");
  const std::size_t offset = std::stoul(file.substr(file.find("offset=\"", declared) + 8));
  const char* block = file.data() + file.find("encoding=\"raw\">\n_") + 17 + offset;
  std::uint64_t bytes = 0;
  std::memcpy(&bytes, block, sizeof bytes);
  EXPECT_EQ(bytes, count * sizeof(T)) << name;
  std::vector<T> values(count);
  std::memcpy(values.data(), block + sizeof bytes, count * sizeof(T));
  return values;
}

TEST_F(VtuTest, HoldsPointsVerticesAndData) {
  write_vtu(file("a.vtu"), {{1, 2, 3}, {4, 5, -6.5}}, {{"u", 3, {0, 1, 2, 3, 4, 5}}, {"a<b", 1, {-7, 8}}});
  const std::string content = read_file(file("a.vtu"));
  EXPECT_NE(content.find("NumberOfPoints=\"2\" NumberOfCells=\"2\""), std::string::npos);
  EXPECT_EQ(appended<float>(content, "Points", 6), (std::vector<float>{1, 2, 3, 4, 5, -6.5}));
  EXPECT_EQ(appended<std::int64_t>(content, "connectivity", 2), (std::vector<std::int64_t>{0, 1}));
  EXPECT_EQ(appended<std::int64_t>(content, "offsets", 2), (std::vector<std::int64_t>{1, 2}));
  EXPECT_EQ(appended<unsigned char>(content, "types", 2), (std::vector<unsigned char>{1, 1}));
  EXPECT_EQ(appended<float>(content, "u", 6), (std::vector<float>{0, 1, 2, 3, 4, 5}));
  EXPECT_EQ(appended<float>(content, "a&lt;b", 2), (std::vector<float>{-7, 8}));
}

TEST_F(VtuTest, DataOfAnotherLengthIsADefect) {
  expect_failure(Failure::internal, {"'u'"}, [&] { write_vtu(file("a.vtu"), {{1, 2, 3}}, {{"u", 3, {0, 1}}}); });
  EXPECT_EQ(entries(), 0);
}

}  // namespace
}  // namespace mtled
