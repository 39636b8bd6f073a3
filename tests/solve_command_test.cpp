#include <nlohmann/json.hpp>

#include <cmath>
#include <functional>
#include <sstream>

#include "core/error.hpp"
#include "core/material.hpp"
#include "cuda/device_choice.hpp"
#include "io/tables.hpp"
#include "program.hpp"
#include "temporary_folder.hpp"

namespace mtled {
namespace {

using program::expect_refusal;
using program::Outcome;
using Strings = std::vector<std::string>;
namespace fs = std::filesystem;

constexpr int usage = 2, input = 3, numerical = 4, device = 5, output = 7;
constexpr int cells = 6;              ///< along each edge of the cube
constexpr double spacing = 5;         ///< [mm]
constexpr double side = cells * spacing;
constexpr double shear_modulus = 2, bulk_modulus = 20;  ///< [kPa]

/// The cube of the tests: its lower and upper faces are held and moved, the sides are free or follow.
class Solve : public TemporaryFolder {
 protected:
  Solve() {
    std::ofstream nodes(file("nodes.csv")), points(file("points.csv"));
    nodes << "x,y,z\n";
    for (int k = 0; k <= cells; ++k)
      for (int j = 0; j <= cells; ++j)
        for (int i = 0; i <= cells; ++i) nodes << i * spacing << ',' << j * spacing << ',' << k * spacing << '\n';
    points << "x,y,z,volume\n";
    for (int k = 0; k < 2 * cells; ++k)
      for (int j = 0; j < 2 * cells; ++j)
        for (int i = 0; i < 2 * cells; ++i) points << (i + 0.5) * spacing / 2 << ',' << (j + 0.5) * spacing / 2 << ',' << (k + 0.5) * spacing / 2 << ',' << 15.625 << '\n';
    file("probes.csv", "x,y,z\n15,15,15\n7,9,12\n3.5,16,6\n");
    std::ofstream constraints(file("constraints.csv"));
    constraints << "node,ux,uy,uz,set\n";
    for (const int k : {0, cells})
      for (int j = 0; j <= cells; ++j)
        for (int i = 0; i <= cells; ++i) constraints << node(i, j, k) << ",0,0," << (k ? "1,upper" : "0,lower") << '\n';
    constraints.close();
    write_case("");
  }
  static int node(int i, int j, int k) { return i + (cells + 1) * (j + (cells + 1) * k); }
  static bool on_surface(int i) { return i == 0 || i == cells; }

  /// case.toml with lines replaced that begin with the same key, or added below their [section].
  fs::path write_case(const std::string& more, const std::string& lattice = "lattice = { origin = [0.0, 0.0, 0.0], spacing = 5.0 }\n", const std::string& material = "shear_modulus_kpa = 2.0\nbulk_modulus_kpa = 20.0\n") const {
    return file("case.toml", "[nodes]\nfile = \"nodes.csv\"\n" + lattice + "[points]\nfile = \"points.csv\"\n[material]\n" + material +
                                 "[constraints]\nfile = \"constraints.csv\"\n[probes]\nfile = \"probes.csv\"\n" + more);
  }
  /// elements.csv with the cells of the cube, and a case of finite elements; `row` replaces the second element, `more` follows in [elements].
  void write_elements(const std::string& row = "", const std::string& more = "") const {
    std::ofstream elements(file("elements.csv"));
    elements << "n0,n1,n2,n3,n4,n5,n6,n7\n";
    for (int k = 0; k < cells; ++k)
      for (int j = 0; j < cells; ++j)
        for (int i = 0; i < cells; ++i) {
          if (!row.empty() && i == 1 && j == 0 && k == 0) {
            elements << row << '\n';
            continue;
          }
          elements << node(i, j, k) << ',' << node(i + 1, j, k) << ',' << node(i + 1, j + 1, k) << ',' << node(i, j + 1, k) << ',' << node(i, j, k + 1) << ',' << node(i + 1, j, k + 1) << ','
                   << node(i + 1, j + 1, k + 1) << ',' << node(i, j + 1, k + 1) << '\n';
        }
    write_case("");
    std::string text = program::content(file("case.toml"));
    text.replace(text.find("[points]\nfile = \"points.csv\"\n"), 29, "[elements]\nfile = \"elements.csv\"\n" + more);
    file("case.toml", text);
  }
  /// A second, smaller cube of nodes and points 30 mm beside the first.
  void add_island() const {
    std::string nodes = program::content(file("nodes.csv")), points = program::content(file("points.csv"));
    for (int n = 0; n < 27; ++n) nodes += concatenate(60 + spacing * (n % 3), ',', spacing * (n / 3 % 3), ',', spacing * (n / 9), '\n');
    for (int n = 0; n < 64; ++n) points += concatenate(60 + spacing * (n % 4 + 0.5) / 2, ',', spacing * (n / 4 % 4 + 0.5) / 2, ',', spacing * (n / 16 + 0.5) / 2, ",15.625\n");
    file("nodes.csv", nodes), file("points.csv", points);
  }
  /// The faces of the cube brought nearer [mm].
  void squeeze(double by) const {
    std::string text = program::content(file("constraints.csv"));
    for (std::size_t at; (at = text.find(",1,upper")) != std::string::npos;) text.replace(at, 8, concatenate(',', -by, ",upper"));
    file("constraints.csv", text);
  }
  /// Of the constraints, in the case that was written last.
  void choose_scheme(const std::string& scheme) const {
    std::string text = program::content(file("case.toml"));
    const std::size_t table = text.find("file = \"constraints.csv\""), before = text.rfind("[constraints]", table);
    text.replace(before, table - before, "[constraints]\nscheme = \"" + scheme + "\"\n");
    file("case.toml", text);
  }
  fs::path out(const std::string& name = "") const { return name.empty() ? file("out") : file("out") / name; }
  Outcome run(const Strings& more = {}) const {
    Strings arguments{"solve", file("case.toml"), "-o", out()};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return program::run(arguments, file("log"));
  }
  void refused(int code, const Strings& parts, const Strings& more = {}) const {
    expect_refusal(run(more), code, parts);
    EXPECT_FALSE(fs::exists(out())) << "an output folder was left";
  }
  nlohmann::json summary() const { return nlohmann::json::parse(program::content(out("summary.json"))); }
};

TEST_F(Solve, StretchedCubeIsInBalance) {
  const Outcome outcome = run();
  ASSERT_EQ(outcome.code, 0) << outcome.err;
  EXPECT_NE(outcome.out.find("converged after"), std::string::npos);
  EXPECT_EQ(program::listing(out()), (Strings{"nodes.csv", "nodes.vtu", "probes.csv", "summary.json"}));
  const nlohmann::json s = summary();
  for (const char* key : {"converged", "steps", "error_estimate_mm", "strain_energy_mN_mm", "reactions_mN", "seconds", "nodes", "history"}) EXPECT_TRUE(s.contains(key)) << key;
  EXPECT_TRUE(s["converged"]);
  EXPECT_EQ(s["nodes"], (cells + 1) * (cells + 1) * (cells + 1));
  const double pull = s["reactions_mN"]["upper"][2];
  // Between free sides (Young's modulus) and held sides (modulus of confined stretch); force = modulus * area * strain.
  const double young = 9 * bulk_modulus * shear_modulus / (3 * bulk_modulus + shear_modulus), confined = bulk_modulus + 4 * shear_modulus / 3;
  EXPECT_GT(pull, young * side * 1);
  EXPECT_LT(pull, confined * side * 1);
  for (int c = 0; c < 3; ++c) EXPECT_NEAR(s["reactions_mN"]["upper"][c].get<double>(), -s["reactions_mN"]["lower"][c].get<double>(), 1e-2 * pull);
  EXPECT_NEAR(s["strain_energy_mN_mm"].get<double>(), pull * 1 / 2, 0.1 * pull) << "work of a nearly linear spring";
}

TEST_F(Solve, PrescribedNodesAreWherePrescribed) {
  ASSERT_EQ(run().code, 0);
  const std::vector<Vec3d> x = read_points(out("nodes.csv")), u = read_points(out("nodes.csv"), {"ux", "uy", "uz"});
  for (std::size_t n = 0; n < x.size(); ++n) {
    if (x[n].z == 0 || x[n].z == side) {
      EXPECT_LT(norm(u[n] - Vec3d{0, 0, x[n].z / side}), 1e-5) << "node " << n;
    }
  }
  const std::vector<Vec3d> at = read_points(out("probes.csv")), moved = read_points(out("probes.csv"), {"ux", "uy", "uz"});
  EXPECT_EQ(at[2].y, 16);
  EXPECT_LT(norm(moved[0] - Vec3d{0, 0, 0.5}), 0.02) << "the centre moves half way, by symmetry";
}

TEST_F(Solve, LinearFieldOnTheSurfaceContinuesInside) {
  Mat3d F = Mat3d::identity();
  F[0][0] = 1.03, F[0][1] = 0.05, F[2][2] = 0.98, F[2][0] = -0.02;
  std::ofstream constraints(file("constraints.csv"));
  constraints << "node,ux,uy,uz,set\n";
  for (int k = 0; k <= cells; ++k)
    for (int j = 0; j <= cells; ++j)
      for (int i = 0; i <= cells; ++i) {
        if (!on_surface(i) && !on_surface(j) && !on_surface(k)) continue;
        const Vec3d X = spacing * Vec3d{double(i), double(j), double(k)}, u = F * X - X;
        constraints << node(i, j, k) << ',' << u.x << ',' << u.y << ',' << u.z << ",surface\n";
      }
  constraints.close();
  write_case("[solver]\ntolerance_mm = 0.001\n");
  ASSERT_EQ(run().code, 0);
  const std::vector<Vec3d> X = read_points(out("probes.csv")), u = read_points(out("probes.csv"), {"ux", "uy", "uz"});
  for (std::size_t p = 0; p < X.size(); ++p) EXPECT_LT(norm(u[p] - (F * X[p] - X[p])), 0.01) << p;
  const double energy = side * side * side * NeoHookean<double>{shear_modulus, bulk_modulus}.energy(F);
  EXPECT_NEAR(summary()["strain_energy_mN_mm"].get<double>(), energy, 0.01 * energy);
}

TEST_F(Solve, SameBitsForAnyThreadsAndWithoutTheLatticePromise) {
  const Outcome one = run({"--threads", "1"});
  ASSERT_EQ(one.code, 0) << one.err;
  const std::string nodes = program::content(out("nodes.csv")), probes = program::content(out("probes.csv"));
  ASSERT_EQ(run({"--threads", "2", "--force", "--quiet"}).code, 0);
  EXPECT_EQ(program::content(out("nodes.csv")), nodes);
  const std::vector<Vec3d> with = read_points(out("probes.csv"), {"ux", "uy", "uz"});
  write_case("", "");
  ASSERT_EQ(run({"--force"}).code, 0);
  const std::vector<Vec3d> without = read_points(out("probes.csv"), {"ux", "uy", "uz"});
  for (std::size_t p = 0; p < with.size(); ++p) EXPECT_LT(norm(with[p] - without[p]), 0.03) << "other coupling, nearly the same field";
}

TEST_F(Solve, SaysOnWhichDeviceUnlessQuiet) {
  const Outcome outcome = run({"--device", "cpu"});
  ASSERT_EQ(outcome.code, 0) << outcome.err;
  EXPECT_NE(outcome.err.find("device: cpu, "), std::string::npos) << outcome.err;
  EXPECT_NE(outcome.err.find(" GB for 343 nodes"), std::string::npos) << outcome.err;
  EXPECT_EQ(summary()["device"], "cpu");
  const Outcome quiet = run({"--quiet", "--force"});
  EXPECT_EQ(quiet.code, 0);
  EXPECT_EQ(quiet.err, "");
}

TEST_F(Solve, DevicesThatAreNotThereAreRefused) {
  refused(device, {"--device cuda:9999: ", "--device cpu"}, {"--device", "cuda:9999"});
  for (const char* nonsense : {"gpu", "cuda:", "cuda:-1", "cuda:one"}) refused(usage, {"--device is '" + std::string(nonsense) + "'", "auto, cpu, cuda or cuda:N"}, {"--device=" + std::string(nonsense)});
}

TEST_F(Solve, MotionInTimeIsRefusedOnADevice) {
  write_case("[dynamics]\nduration_s = 0.1\n");
  const bool there = !choose_device({DeviceRequest::automatic}, cuda_status()).on_cpu();
  refused(device, {there ? "motion in time is computed on the CPU only" : "--device cuda: ", "--device cpu"}, {"--device", "cuda"});
}

TEST_F(Solve, PlainRelaxationInDoubleAgrees) {
  ASSERT_EQ(run().code, 0);
  const std::vector<Vec3d> two_level = read_points(out("probes.csv"), {"ux", "uy", "uz"});
  write_case("[solver]\nrelaxation = \"plain\"\nprecision = \"double\"\ntolerance_mm = 0.001\n");
  ASSERT_EQ(run({"--force"}).code, 0);
  const std::vector<Vec3d> plain = read_points(out("probes.csv"), {"ux", "uy", "uz"});
  for (std::size_t p = 0; p < plain.size(); ++p) EXPECT_LT(norm(plain[p] - two_level[p]), 0.05) << "the tolerance of the coarser one";
}

TEST_F(Solve, PointsInCoupledCellsAreRearrangedUnlessToldNotTo) {
  constexpr int given = 8 * cells * cells * cells, coupled = 2 * cells * cells;  // cells at the lower and upper face
  ASSERT_EQ(run().code, 0);
  EXPECT_EQ(summary()["integration_points"], given + coupled);
  const double rearranged = summary()["reactions_mN"]["upper"][2];
  std::string text = program::content(file("case.toml"));
  text.insert(text.find("[material]"), "align = false\n");
  file("case.toml", text);
  ASSERT_EQ(run({"--force"}).code, 0);
  EXPECT_EQ(summary()["integration_points"], given);
  EXPECT_LT(rearranged, summary()["reactions_mN"]["upper"][2]) << "fewer constraints of volume make it softer";
}

TEST_F(Solve, SchemeOfConstraintsCanBeChosen) {
  ASSERT_EQ(run().code, 0);
  const std::string coupled = program::content(out("nodes.csv"));
  choose_scheme("coupling");
  ASSERT_EQ(run({"--force"}).code, 0);
  EXPECT_EQ(program::content(out("nodes.csv")), coupled) << "the default on a lattice";
  choose_scheme("collocation");
  ASSERT_EQ(run({"--force"}).code, 0);
  EXPECT_EQ(summary()["integration_points"], 8 * cells * cells * cells) << "there are no coupled cells to rearrange points in";
  EXPECT_NE(program::content(out("nodes.csv")), coupled);
  const std::vector<Vec3d> x = read_points(out("nodes.csv")), u = read_points(out("nodes.csv"), {"ux", "uy", "uz"});
  for (std::size_t n = 0; n < x.size(); ++n) {
    if (x[n].z == 0 || x[n].z == side) {
      EXPECT_LT(norm(u[n] - Vec3d{0, 0, x[n].z / side}), 1e-6) << "node " << n;
    }
  }
  write_case("", "");
  ASSERT_EQ(run({"--force"}).code, 0);
  const std::string general = program::content(out("nodes.csv"));
  choose_scheme("collocation");
  ASSERT_EQ(run({"--force"}).code, 0);
  EXPECT_EQ(program::content(out("nodes.csv")), general) << "the only scheme where there is no lattice";
  fs::remove_all(out());
  choose_scheme("coupling");
  refused(input, {"constraints.scheme", "lattice", "choose collocation"});
  choose_scheme("penalty");
  refused(input, {"constraints.scheme", "'penalty'", "choose coupling or collocation"});
}

TEST_F(Solve, ConstraintsThatMakeNoSense) {
  file("constraints.csv", "node,ux,uy,uz,set\n343,0,0,0,a\n");
  refused(input, {"constraints.csv, line 2", "node 343 does not exist", "0 to 342"});
  file("constraints.csv", "node,ux,uy,uz,set\n-1,0,0,0,a\n");
  refused(input, {"line 2", "does not exist"});
  file("constraints.csv", "node,ux,uy,uz,set\n3,0,0,0,a\n3,0,1,0,b\n");
  refused(input, {"line 3", "node 3", "twice with different values", "0 and 1 mm", "keep one"});
  file("constraints.csv", "node,ux,uy,uz,set\n3,0,0,,a\n3,2,,0,a\n");
  refused(input, {"line 3", "node 3", "twice with different values", "0 and 2 mm", "keep one"});
  file("constraints.csv", "node,ux,uy,uz,set\n1.5,0,0,0,a\n");
  refused(input, {"line 2", "node 1.5 does not exist"});
  file("constraints.csv", "node,ux,uy,uz,set\n3,,,,a\n");
  refused(input, {"line 2", "no displacement component"});
  file("constraints.csv", "node,ux,uy,uz,set\n");
  refused(input, {"constraints.csv", "no constraints"});
  file("constraints.csv", "node,ux,uy,uz,set\n0,0,0,0,a\n1,0,0,0,a\n2,0,0,0,a\n");  // on one line
  refused(input, {"1 rigid motions", "free", "three components at three nodes"});
  file("constraints.csv", "node,ux,uy,uz,set\n0,,,0,a\n6,,,0,a\n42,,,0,a\n");  // slides and turns on the lower face
  refused(input, {"3 rigid motions", "free", "three components at three nodes"});
  file("constraints.csv", "node,ux,uy\n0,0,0\n");
  refused(input, {"no column 'uz'"});
}

TEST_F(Solve, MaterialsThatMakeNoSense) {
  for (const char* ratio : {"0.5", "0.7", "-0.1", "nan"}) {
    write_case("", "", std::string("poisson_ratio = ") + ratio + "\n");
    refused(input, {"material.poisson_ratio", "below 0.5"});
  }
  for (const char* key : {"shear_modulus_kpa", "bulk_modulus_kpa", "density_kg_mm3"})
    for (const char* value : {"-1.0", "0.0", "nan", "inf"}) {
      write_case("", "", std::string(key) + " = " + value + "\n");
      refused(input, {key, "positive"});
    }
  const auto refuse = [&](const std::string& material, const Strings& parts) {
    write_case("", "", material);
    refused(input, parts);
  };
  refuse("model = \"steel\"\n", {"steel", "neo-hookean", "ogden"});
  refuse("model = \"ogden\"\n", {"needs ogden_exponent", "column"});
  refuse("model = \"ogden\"\nogden_exponent = 0.0\n", {"ogden_exponent is 0", "from 0.1"});
  refuse("model = \"ogden\"\nogden_exponent = nan\n", {"ogden_exponent is nan"});
  refuse("model = \"neo-hookean\"\nogden_exponent = 2.0\n", {"ogden_exponent", "not a known setting"});
  refuse("model = \"mooney-rivlin\"\nc10_kpa = 1.0\nc01_kpa = -0.5\n", {"c01_kpa -0.5", "negative"});
  refuse("model = \"mooney-rivlin\"\nc10_kpa = 0.0\nc01_kpa = 0.0\n", {"c10_kpa is 0", "positive"});
  refuse("model = \"yeoh\"\nc1_kpa = 1.0\nc2_kpa = -0.4\nc3_kpa = 0.05\n", {"c2 above", "softens"});
  refuse("model = \"yeoh\"\nc1_kpa = -1.0\nc2_kpa = 0.0\n", {"c1 must be positive"});
  const std::string fibres = "model = \"transversely-isotropic\"\nfibre_modulus_kpa = ";
  refuse(fibres + "1.0\n", {"needs fibre_x", "fibre = [x, y, z]"});
  refuse(fibres + "1.0\nfibre = [0, 0, 0]\n", {"fibre", "no direction"});
  refuse(fibres + "1.0\nfibre = [0, 1]\n", {"fibre", "three numbers"});
  refuse(fibres + "-1.0\nfibre = [0, 0, 1]\n", {"fibre_modulus_kpa is -1"});
  refuse("prony = [{ alpha = 1.0, tau_s = 1.0 }]\n", {"prony[0].alpha", "below 1"});
  refuse("prony = [{ alpha = nan, tau_s = 1.0 }]\n", {"prony[0].alpha", "below 1"});
  refuse("prony = [{ alpha = 0.5, tau_s = 1.0 }, { alpha = 0.5, tau_s = 2.0 }]\n", {"sum to 1", "below 1"});
  refuse("prony = [{ alpha = 0.5 }]\n", {"prony[0].tau_s", "positive"});
  refuse("prony = [{ alpha = 0.5, tau_s = -1.0 }]\n", {"prony[0].tau_s", "positive"});
  refuse("prony = [{ alpha = 0.5, tau_s = 1.0, beta = 2.0 }]\n", {"beta", "not a known setting"});
  refuse("prony = []\n", {"0 terms"});
}

TEST_F(Solve, ColumnsOfThePointsOverrideTheMaterial) {
  // All ways of saying mu = 2, k = 2 mu (1 + 0.3) / (3 (1 - 0.6)): the same bits.
  const std::string plain = program::content(file("points.csv"));
  const auto with_columns = [&](const std::string& names, const std::string& values) {
    std::string text;
    std::istringstream lines(plain);
    for (std::string line; std::getline(lines, line);) text += line + "," + (text.empty() ? names : values) + "\n";
    file("points.csv", text);
  };
  const auto result = [&](const std::string& material) {
    write_case("", "lattice = { origin = [0.0, 0.0, 0.0], spacing = 5.0 }\n", material);
    const Outcome outcome = run({"--force"});
    EXPECT_EQ(outcome.code, 0) << outcome.err;
    return program::content(out("nodes.csv"));
  };
  const std::string expected = result("shear_modulus_kpa = 2.0\npoisson_ratio = 0.3\n");
  with_columns("poisson_ratio", "0.3");
  EXPECT_EQ(result("shear_modulus_kpa = 2.0\n"), expected);
  EXPECT_EQ(result("shear_modulus_kpa = 2.0\nbulk_modulus_kpa = 70.0\n"), expected);
  with_columns("shear_modulus_kpa,poisson_ratio", "2,0.3");
  EXPECT_EQ(result(""), expected);
  with_columns("c10_kpa,c01_kpa,poisson_ratio", "0.5,0.5,0.3");
  const std::string mooney = result("model = \"mooney-rivlin\"\n");
  EXPECT_EQ(result("model = \"mooney-rivlin\"\nc10_kpa = 7.0\nc01_kpa = 0.0\n"), mooney);
  EXPECT_NE(mooney, expected);
  with_columns("fibre_modulus_kpa,fibre_x,fibre_y,fibre_z", "4,0,0,2");
  const std::string fibres = "model = \"transversely-isotropic\"\nshear_modulus_kpa = 2.0\n";
  const std::string along_z = result(fibres);
  file("points.csv", plain);
  EXPECT_EQ(result(fibres + "fibre_modulus_kpa = 4.0\nfibre = [0, 0, 1]\n"), along_z);
  EXPECT_NE(result(fibres + "fibre_modulus_kpa = 4.0\nfibre = [1, 0, 0]\n"), along_z);
  // Memory with the same share in both parts scales the forces alone.
  const nlohmann::json elastic = (result("shear_modulus_kpa = 2.0\n"), summary());
  result("shear_modulus_kpa = 2.0\nprony = [{ alpha = 0.25, alpha_volumetric = 0.25, tau_s = 1.0 }, { alpha = 0.25, alpha_volumetric = 0.25, tau_s = 10.0 }]\n");
  EXPECT_NEAR(summary()["strain_energy_mN_mm"].get<double>(), 0.5 * elastic["strain_energy_mN_mm"].get<double>(), 1e-4 * elastic["strain_energy_mN_mm"].get<double>());
}

TEST_F(Solve, MaterialsOfPointsThatMakeNoSense) {
  const auto refuse = [&](const std::string& columns, const std::string& row, const std::string& material, const Strings& parts) {
    file("points.csv", "x,y,z,volume," + columns + "\n1,1,1,1," + row + "\n");
    write_case("", "", material);
    refused(input, parts);
  };
  for (const char* column : {"shear_modulus_kpa", "bulk_modulus_kpa", "density_kg_mm3"}) {
    for (const char* value : {"0", "-1"}) refuse(column, value, "", {"points.csv, line 2", column, value, "positive"});
    for (const char* value : {"nan", "inf", ""}) refuse(column, value, "", {"points.csv, line 2", column});
  }
  for (const char* ratio : {"0.5", "-0.1"}) refuse("poisson_ratio", ratio, "", {"points.csv, line 2", "poisson_ratio", "below 0.5"});
  refuse("poisson_ratio,bulk_modulus_kpa", "0.3,5", "", {"points.csv", "same thing", "keep one"});
  refuse("ogden_exponent", "0", "model = \"ogden\"\n", {"points.csv, line 2", "ogden_exponent is 0"});
  refuse("c01_kpa", "-1", "model = \"mooney-rivlin\"\nc10_kpa = 2.0\n", {"points.csv, line 2", "c01_kpa -1"});
  refuse("c2_kpa", "-1", "model = \"yeoh\"\nc1_kpa = 2.0\n", {"points.csv, line 2", "c2_kpa"});
  refuse("fibre_x,fibre_y,fibre_z", "0,0,0", "model = \"transversely-isotropic\"\nfibre_modulus_kpa = 2.0\n", {"points.csv, line 2", "no direction"});
}

TEST_F(Solve, AFloatingPartIsNamedBySizeAndPlace) {
  add_island();
  for (const std::string& lattice : {std::string(), std::string("lattice = { origin = [0.0, 0.0, 0.0], spacing = 5.0 }\n")}) {
    write_case("", lattice);
    refused(input, {"64 integration points", "around (68.75, 8.75, 8.75) mm", "float away", "leave it out", "prescribe its motion"});
  }
}

TEST_F(Solve, PointsWhereThereAreNoNodes) {
  file("points.csv", program::content(file("points.csv")) + "15,15,1000,1\n1000,15,15,1\n");
  for (const std::string& lattice : {std::string(), std::string("lattice = { origin = [0.0, 0.0, 0.0], spacing = 5.0 }\n")}) {
    write_case("", lattice);
    refused(input, {"2 of 1730 integration points", "no nodes", "row 1728", "(15, 15, 1000) mm", "remove them"});
  }
}

TEST_F(Solve, NotANumberInAnyColumn) {
  file("forces.csv", "x,y,z,fx,fy,fz\n15,15,15,1,0,0\n15,15,15,2,0,0\n");
  file("pressure.csv", "x,y,z,ax,ay,az,pressure_kpa\n30,15,15,1,0,0,1\n30,10,15,1,0,0,1\n");
  write_elements();  // leaves the other tables alone
  write_case("[loads]\nforces = \"forces.csv\"\npressure = \"pressure.csv\"\n");
  const std::string with_points = program::content(file("case.toml"));
  const auto try_columns = [&](const std::string& name, int columns) {
    const std::string plain = program::content(file(name));
    for (int column = 0; column < columns; ++column) {
      std::istringstream lines(plain);
      std::string text, line;
      for (int row = 0; std::getline(lines, line); ++row) {
        std::size_t begin = 0;
        for (int c = 0; c < column; ++c) begin = line.find(',', begin) + 1;
        if (row == 2) line.replace(begin, line.find(',', begin) == std::string::npos ? std::string::npos : line.find(',', begin) - begin, "nan");
        text += line + "\n";
      }
      file(name, text);
      refused(input, {name + ", line 3", "'nan' is not a finite number"});
    }
    file(name, plain);
  };
  for (const auto& [name, columns] : {std::pair("nodes.csv", 3), {"points.csv", 4}, {"constraints.csv", 4}, {"probes.csv", 3}, {"forces.csv", 6}, {"pressure.csv", 7}}) try_columns(name, columns);
  write_elements();
  try_columns("elements.csv", 8);
}

TEST_F(Solve, TablesThatMakeNoSense) {
  for (const char* row : {"1,1,1,0,1", "1,1,1,-2,1", "1,1,1,nan,1", "1,1,1,,1"}) {
    file("points.csv", std::string("x,y,z,volume,shear_modulus_kpa\n") + row + "\n");
    refused(input, {"points.csv, line 2", "volume"});
  }
  file("points.csv", "x,y,z,volume,shear_modulus_kpa\n1,1,1,1,-5\n");
  refused(input, {"points.csv, line 2", "shear_modulus_kpa is -5", "positive"});
  file("points.csv", "x,y,z,volume\n");
  refused(input, {"points.csv", "no integration points"});
  file("points.csv", "x;y;z;volume\n1;2;3;4\n");
  refused(input, {"points.csv", "commas"});
  file("nodes.csv", "x,y,z\n");
  refused(input, {"nodes.csv", "no nodes"});
  fs::remove(file("nodes.csv"));
  refused(input, {"nodes.csv", "no such file"});
}

TEST_F(Solve, ProbesOutsideTheBody) {
  file("probes.csv", "x,y,z\n10,10,10\n10,10,40\n");
  refused(input, {"probe 1", "(10, 10, 40)", "outside the body", "remove it"});
}

TEST_F(Solve, CasesThatMakeNoSense) {
  write_case("[solver]\ntolerance = 0.1\n");
  refused(input, {"solver.tolerance", "not a known setting", "tolerance_mm"});
  for (const char* section : {"nodes", "points", "material", "constraints", "probes"}) {
    write_case("");
    std::string text = program::content(file("case.toml"));
    text.insert(text.find(concatenate('[', section, "]\n")) + std::string(section).size() + 3, "colour = 1\n");
    file("case.toml", text);
    refused(input, {concatenate('`', section, ".colour`"), "not a known setting", "known here"});
  }
  for (const char* section : {"loads", "shape_functions"}) {
    write_case(concatenate('[', section, "]\ncolour = 1\n"));
    refused(input, {concatenate('`', section, ".colour`"), "not a known setting", "known here"});
  }
  write_case("[solver]\nprecision = 2\n");
  refused(input, {"solver.precision", "wrong type", "a text in quotes"});
  write_case("[mesh]\nfile = \"x\"\n");
  refused(input, {"mesh", "not a known setting"});
  for (const char* setting : {"tolerance_mm = 0.0", "tolerance_mm = nan", "tolerance_mm = inf", "max_steps = 0", "max_steps = -5", "max_steps = 99999999999", "load_steps = -1", "stabilisation = -1.0", "stabilisation = inf", "coarse_unknowns = 0", "relaxation = \"fast\"", "precision = \"half\"",
                              "tolerance_mm = \"small\""}) {
    write_case(std::string("[solver]\n") + setting + "\n");
    const std::string text = setting;
    refused(input, {"solver." + text.substr(0, text.find(' '))});
  }
  write_case("[shape_functions]\ndilatation = 1.0\n");
  refused(input, {"shape_functions.dilatation"});
  for (const char* setting : {"support = \"area\"", "count = 20", "support = \"count\"", "support = \"count\"\ncount = 20\ndilatation = 1.75"}) {
    write_case(std::string("[shape_functions]\n") + setting + "\n", "");
    refused(input, {std::string("shape_functions.") + (setting[0] == 'c' ? "count" : "support")});
  }
  for (const char* count : {"9", "201", "-1"}) {
    write_case(std::string("[shape_functions]\nsupport = \"count\"\ncount = ") + count + "\n", "");
    refused(input, {"shape_functions.count"});
  }
  write_case("[shape_functions]\nsupport = \"count\"\ncount = 20\n");
  refused(input, {"shape_functions.support", "no lattice"});
  write_case("", "lattice = { origin = [0.0, 0.0, 0.0], spacing = 4.0 }\n");
  refused(input, {"not on the promised lattice"});
  write_case("", "lattice = { origin = [0.0, 0.0], spacing = 5.0 }\n");
  refused(input, {"nodes.lattice.origin", "three numbers"});
  file("case.toml", "[nodes\n");
  refused(input, {"case.toml, line 1"});
  file("case.toml", "");
  refused(input, {"nodes", "file"});
  fs::remove(file("case.toml"));
  refused(input, {"case.toml"});
}

TEST_F(Solve, MotionInTime) {
  file("forces.csv", "x,y,z,fx,fy,fz,set\n15,15,15,5,0,0,push\n");
  file("pressure.csv", "x,y,z,ax,ay,az,pressure_kpa\n30,15,15,100,0,0,0.05\n");
  file("histories.csv", "set,time_s,factor\nupper,0,0\nupper,0.05,1\npush,0.02,0\npush,0.03,1\n");
  const std::string motion = "[loads]\ngravity_mm_s2 = [0.0, 0.0, -9810.0]\nforces = \"forces.csv\"\npressure = \"pressure.csv\"\n"
                             "[dynamics]\nduration_s = 0.1\noutput_every_s = 0.025\ndamping_per_s = 5\nhistories = \"histories.csv\"\ninterpolation = \"smooth\"\n";
  write_case(motion);
  const Outcome outcome = run({"--threads", "1"});
  ASSERT_EQ(outcome.code, 0) << outcome.err;
  EXPECT_NE(outcome.out.find("energy balance"), std::string::npos);
  EXPECT_EQ(program::listing(out()), (Strings{"history.csv", "motion.pvd", "motion_000000.vtu", "motion_000001.vtu", "motion_000002.vtu", "motion_000003.vtu", "motion_000004.vtu", "probe_history.csv", "summary.json"}));
  const nlohmann::json s = summary();
  EXPECT_LT(s["time_step_s"].get<double>(), s["stable_time_step_s"].get<double>());
  EXPECT_NEAR(s["mass_kg"].get<double>(), 1e-6 * side * side * side, 1e-9 * side * side);
  EXPECT_NEAR(s["steps"].get<int>() * s["time_step_s"].get<double>(), 0.1, 1e-12);
  const Table history = Table::read(out("history.csv"));
  ASSERT_EQ(history.rows(), 5u);
  for (std::size_t r = 0; r < history.rows(); ++r) {
    const auto value = [&](const char* column) { return history.number(r, history.column(column)); };
    const double work = value("work_of_loads_mN_mm") + value("work_of_motions_mN_mm");
    EXPECT_NEAR(value("kinetic_mN_mm") + value("strain_mN_mm") + value("springs_mN_mm") + value("dissipated_mN_mm"), work + value("balance_error_mN_mm"), 1e-6 * std::abs(work));
  }
  EXPECT_LT(s["largest_balance_error"].get<double>(), 0.01);
  const Table probes = Table::read(out("probe_history.csv"));
  ASSERT_EQ(probes.rows(), 15u);
  EXPECT_GT(probes.number(12, probes.column("ux")), 0) << "the push acts";
  EXPECT_NE(program::content(out("motion.pvd")).find("file=\"motion_000004.vtu\""), std::string::npos);

  const std::string first = program::content(out("history.csv"));
  ASSERT_EQ(run({"--threads", "2", "--force"}).code, 0);
  EXPECT_EQ(program::content(out("history.csv")), first);
}

TEST_F(Solve, AFreeBodyMayFallInTimeButNotRest) {
  const std::string free_case = "[nodes]\nfile = \"nodes.csv\"\n[points]\nfile = \"points.csv\"\n[loads]\ngravity_mm_s2 = [0.0, 0.0, -9810.0]\n";
  file("case.toml", free_case + "[probes]\nfile = \"probes.csv\"\n[dynamics]\nduration_s = 0.05\n");
  const Outcome outcome = run();
  ASSERT_EQ(outcome.code, 0) << outcome.err;
  const Table probes = Table::read(out("probe_history.csv"));
  EXPECT_NEAR(probes.number(3, probes.column("uz")), -9810 * 0.05 * 0.05 / 2, 1e-6);
  fs::remove_all(out());
  file("case.toml", free_case);
  refused(input, {"constraints", "file"});
}

TEST_F(Solve, WeightInEquilibrium) {
  write_case("[loads]\ngravity_mm_s2 = [0.0, 0.0, -9810.0]\n");
  ASSERT_EQ(run().code, 0);
  const nlohmann::json reactions = summary()["reactions_mN"];
  const double weight = 1e-6 * side * side * side * 9810;
  EXPECT_NEAR(reactions["upper"][2].get<double>() + reactions["lower"][2].get<double>(), weight, 0.01 * weight);
}

TEST_F(Solve, MotionsThatMakeNoSense) {
  for (const auto& [settings, parts] : std::vector<std::pair<std::string, Strings>>{
           {"", {"dynamics.duration_s", "missing"}},
           {"duration_s = 0.0", {"dynamics.duration_s", "positive"}},
           {"duration_s = inf", {"dynamics.duration_s", "finite"}},
           {"duration_s = -0.1", {"dynamics.duration_s` is -0.1", "positive"}},
           {"duration_s = \"long\"", {"dynamics.duration_s", "must be a number"}},
           {"duration_s = 0.1\ntime_step_s = -0.001", {"dynamics.time_step_s", "positive"}},
           {"duration_s = 0.1\ntime_step_s = 0.05", {"time step of 0.05 s is not stable", "below"}},
           {"duration_s = 0.1\ntime_step_s = 0.0001\nsafety = 0.5", {"dynamics.time_step_s", "keep one"}},
           {"duration_s = 0.1\nsafety = 1.5", {"dynamics.safety", "at most 1"}},
           {"duration_s = 0.1\ndamping_per_s = -1.0", {"dynamics.damping_per_s", "at least 0"}},
           {"duration_s = 0.1\noutput_every_s = 0.0", {"dynamics.output_every_s", "positive"}},
           {"duration_s = 0.1\ninterpolation = \"cubic\"", {"cubic", "linear or smooth"}},
           {"duration_s = 0.1\nhistories = \"none.csv\"", {"none.csv", "no such file"}},
           {"duration_s = 0.1\nsteps = 5", {"dynamics.steps", "not a known setting"}},
           {"duration_s = 0.1\n[solver]\ntolerance_mm = 0.1", {"[solver]", "[dynamics]", "remove one"}}}) {
    write_case("[dynamics]\n" + settings + "\n");
    refused(input, parts);
  }
  for (const auto& [rows, parts] : std::vector<std::pair<std::string, Strings>>{{"upper,0,0\nupper,0,1\n", {"histories.csv, line 3", "does not come after"}},
                                                                                {"upper,0,1\n", {"'upper' begins with a jump"}},
                                                                                {"lid,0,0\n", {"history of 'lid'", "no set"}},
                                                                                {"upper,0,\n", {"histories.csv, line 2", "factor"}}}) {
    file("histories.csv", "set,time_s,factor\n" + rows);
    write_case("[dynamics]\nduration_s = 0.1\nhistories = \"histories.csv\"\n");
    refused(input, parts);
  }
}

TEST_F(Solve, LoadsThatMakeNoSense) {
  for (const char* gravity : {"[1.0, 2.0]", "[1.0, 2.0, nan]", "[1.0, 2.0, \"x\"]", "9.81"}) {
    write_case(std::string("[loads]\ngravity_mm_s2 = ") + gravity + "\n");
    refused(input, {"loads.gravity_mm_s2", "must be"});
  }
  write_case("[loads]\nforces = \"forces.csv\"\n");
  file("forces.csv", "x,y,z,fx,fy,fz\n");
  refused(input, {"forces.csv", "no rows"});
  file("forces.csv", "x,y,z,fx,fy,fz\n1,1,99,0,0,1\n");
  refused(input, {"row 0", "(1, 1, 99)", "outside the body"});
  write_case("[loads]\nforces = \"forces.csv\"\n[dynamics]\nduration_s = 0.01\n");
  refused(input, {"row 0", "(1, 1, 99)", "outside the body"});
  write_case("[loads]\nforces = \"forces.csv\"\n");
  file("forces.csv", "x,y,z,fx,fy,fz,set\n1,1,1,0,0,1,gravity\n");
  refused(input, {"forces.csv, line 2", "'gravity'"});
  write_case("[loads]\npressure = \"forces.csv\"\n");
  refused(input, {"forces.csv", "no column 'ax'"});
}

TEST_F(Solve, MotionThatGrowsWithoutBoundKeepsTheOutputsSoFar) {
  write_case("[loads]\ngravity_mm_s2 = [0.0, 0.0, 3e7]\n[dynamics]\nduration_s = 0.2\noutput_every_s = 0.0005\n");
  expect_refusal(run(), numerical, {"grows without bound at step", "time", "safety"});
  EXPECT_GE(Table::read(out("history.csv")).rows(), 1u);
  EXPECT_FALSE(fs::exists(out("summary.json")));
}

TEST_F(Solve, ElementsThatMakeNoSense) {
  for (const auto& [row, parts] : std::vector<std::pair<std::string, Strings>>{
           {"x,2,9,8,50,51,58,57", {"elements.csv, line 3", "'n0'", "'x'"}},
           {"1.5,2,9,8,50,51,58,57", {"elements.csv, line 3", "1.5 is no node number", "0, 1, 2"}},
           {"1e300,2,9,8,50,51,58,57", {"elements.csv, line 3", "no node number"}},
           {"343,2,9,8,50,51,58,57", {"element 1", "node 343 does not exist", "0 to 342"}},
           {"-1,2,9,8,50,51,58,57", {"element 1", "node -1 does not exist", "0 to 342"}},
           {"2,2,9,8,50,51,58,57", {"element 1", "flat", "correct its nodes"}},
           {"50,51,58,57,1,2,9,8", {"element 1", "(7.5, 2.5, 2.5) mm", "inside out", "other way round"}},
           {"0,1,8,7,49,50,57,56", {"elements 0 and 1 overlap", "remove one"}},
           {"1,2,9", {"elements.csv, line 3", "3 cells", "commas"}}}) {
    write_elements(row);
    refused(input, parts);
  }
  write_elements("", "colour = 1\n");
  refused(input, {"elements.colour", "not a known setting"});
}

TEST_F(Solve, OnePointPerElementIsEnough) {
  write_elements();
  Outcome outcome = run();
  ASSERT_EQ(outcome.code, 0) << outcome.err;
  EXPECT_EQ(outcome.err.find("integration points per node"), std::string::npos) << outcome.err;
  for (const char* key : {"fewest_points_per_node", "nodes_with_few_points"}) EXPECT_FALSE(summary().contains(key)) << key;
  EXPECT_EQ(program::content(out("nodes.vtu")).find("points_per_node"), std::string::npos);
  // The same places as points of the meshless method are too few.
  std::ofstream points(file("points.csv"));
  points << "x,y,z,volume\n";
  for (int n = 0; n < cells * cells * cells; ++n)
    points << spacing * (n % cells + 0.5) << ',' << spacing * (n / cells % cells + 0.5) << ',' << spacing * (n / (cells * cells) + 0.5) << ",125\n";
  points.close();
  write_case("", "");
  outcome = run({"--force"});
  ASSERT_EQ(outcome.code, 0) << outcome.err;
  EXPECT_NE(outcome.err.find("integration points per node"), std::string::npos) << outcome.err;
  EXPECT_LT(summary()["fewest_points_per_node"].get<double>(), 1);
  EXPECT_GT(summary()["nodes_with_few_points"], 0);
  EXPECT_NE(program::content(out("nodes.vtu")).find("points_per_node"), std::string::npos);
}

/// Extension [mm] of the cube between held sides when `stretch` [mm] is shared with springs of `compliance` [mm/mN] in series.
double extension_in_series(double stretch, double compliance) {
  const auto force = [](double extension) {  // area * dW/dl of the neo-Hookean law at F = diag(1, 1, l)
    const double l = 1 + extension / side;
    return side * side * (2.0 / 3 * shear_modulus * (std::cbrt(l) - 1 / std::pow(l, 5.0 / 3)) + bulk_modulus * (l - 1));
  };
  double low = 0, high = stretch;
  for (int i = 0; i < 60; ++i) {
    const double middle = (low + high) / 2;
    (middle + compliance * force(middle) < stretch ? low : high) = middle;
  }
  return low;
}

// Springs at the centres of the faces of elements give every node its share of a uniform traction, so that the field is linear.
TEST_F(Solve, SpringsAndBodyAreInSeries) {
  write_elements();
  constexpr double soft = 3, stiff = 8, pull = 5;  // [mN/mm] per spring below and above; [mm]
  constexpr int faces = cells * cells;
  const auto add_springs = [](std::ostream& table, double height, const std::string& rest) {
    for (int f = 0; f < faces; ++f) table << spacing * (f % cells + 0.5) << ',' << spacing * (f / cells + 0.5) << ',' << height << ',' << rest << '\n';
  };
  const auto write_constraints = [&](const std::string& upper) {  // no motion across the pull
    std::ofstream constraints(file("constraints.csv"));
    constraints << "node,ux,uy,uz,set\n";
    for (int n = 0; n < node(0, 0, cells + 1); ++n) constraints << n << ",0,0," << (n < node(0, 0, cells) ? "" : upper) << ",guide\n";
  };
  const std::string settings = "[springs]\nfile = \"springs.csv\"\n[solver]\nprecision = \"double\"\ntolerance_mm = 1e-6\n";
  file("case.toml", program::content(file("case.toml")) + settings);
  const auto largest_error = [&](double below, double extension) {
    const std::vector<Vec3d> x = read_points(out("nodes.csv")), u = read_points(out("nodes.csv"), {"ux", "uy", "uz"});
    double largest = 0;
    for (std::size_t n = 0; n < x.size(); ++n) largest = std::max(largest, norm(u[n] - Vec3d{0, 0, below + extension * x[n].z / side}));
    return largest;
  };

  write_constraints("");
  std::ofstream both(file("springs.csv"));
  both << "x,y,z,stiffness,ux,uy,uz,set\n";
  add_springs(both, 0, concatenate(soft, ",0,0,0,lower"));
  add_springs(both, side, concatenate(stiff, ",0,0,", pull, ",upper"));
  both.close();
  const Outcome outcome = run();
  ASSERT_EQ(outcome.code, 0) << outcome.err;
  const double extension = extension_in_series(pull, 1 / (faces * soft) + 1 / (faces * stiff)), force = (pull - extension) / (1 / (faces * soft) + 1 / (faces * stiff));
  EXPECT_LT(largest_error(force / (faces * soft), extension), 1e-6);
  EXPECT_NEAR(summary()["reactions_mN"]["upper"][2].get<double>(), force, 1e-6 * force);
  EXPECT_NEAR(summary()["reactions_mN"]["lower"][2].get<double>(), -force, 1e-6 * force);

  write_constraints("1");
  std::ofstream foundation(file("springs.csv"));
  foundation << "x,y,z,stiffness\n";
  add_springs(foundation, 0, concatenate(soft));
  foundation.close();
  ASSERT_EQ(run({"--force"}).code, 0);
  const double rest = extension_in_series(1, 1 / (faces * soft));
  EXPECT_LT(largest_error(1 - rest, rest), 1e-6);
  EXPECT_NEAR(summary()["reactions_mN"]["springs"][2].get<double>(), -(1 - rest) * faces * soft, 1e-6 * faces * soft);
}

TEST_F(Solve, SpringsThatMakeNoSense) {
  write_case("[springs]\nfile = \"springs.csv\"\n");
  const auto refuse = [&](const std::string& table, const Strings& parts) {
    file("springs.csv", table);
    refused(input, parts);
  };
  refuse("x,y,z,stiffness\n1,2,3,4\n1,2,3,0\n", {"springs.csv, line 3", "stiffness is 0 mN/mm", "positive"});
  refuse("x,y,z,stiffness\n1,2,3,-4\n", {"line 2", "stiffness is -4"});
  refuse("x,y,z\n1,2,3\n", {"no column 'stiffness'"});
  refuse("x,y,z,stiffness,ux,uy\n1,2,3,4,5,6\n", {"no column 'uz'"});
  refuse("x,y,z,stiffness,ux,uy,uz\n1,2,3,4,5,,6\n", {"line 2", "'uy'", "empty"});
  refuse("x,y,z,stiffness\n", {"springs.csv", "no rows"});
  refuse("x,y,z,stiffness\n15,15,15,4\n15,15,100,4\n", {"spring of row 1", "(15, 15, 100) mm", "no nodes", "remove it"});
  write_case("[springs]\nstiffness = 3.0\n");
  refused(input, {"[springs] lacks `file`"});
  file("case.toml", "[nodes]\nfile = \"nodes.csv\"\n[points]\nfile = \"points.csv\"\n[springs]\nfile = \"springs.csv\"\n");
  refuse("x,y,z,stiffness\n15,15,15,4\n", {"3 rigid motions", "free"});
}

TEST_F(Solve, BodyCellsThatAreGivenReplaceThoseOfThePoints) {
  const std::string sized = "lattice = { origin = [0.0, 0.0, 0.0], spacing = 5.0, size = [7, 7, 7] }\n", with_cells = sized + "body_cells = \"body_cells.csv\"\n";
  const auto write_cells = [&](const std::function<bool(int, int, int)>& body) {
    std::ofstream table(file("body_cells.csv"));
    table << "i,j,k\n";
    for (int k = 0; k < cells; ++k)
      for (int j = 0; j < cells; ++j)
        for (int i = 0; i < cells; ++i)
          if (body(i, j, k)) table << i << ',' << j << ',' << k << '\n';
  };
  ASSERT_EQ(run().code, 0);
  const std::string whole = program::content(out("nodes.csv"));
  write_cells([](int, int, int) { return true; });
  write_case("", with_cells);
  ASSERT_EQ(run({"--force"}).code, 0);
  EXPECT_EQ(program::content(out("nodes.csv")), whole);
  write_cells([](int i, int, int k) { return i != 3 || k > 3; });  // a slit
  ASSERT_EQ(run({"--force"}).code, 0);
  EXPECT_NE(program::content(out("nodes.csv")), whole);

  fs::remove_all(out());
  file("body_cells.csv", "i,j,k\n0,0,0\n0,6,0\n");
  refused(input, {"body_cells.csv, line 3", "6 is no cell", "0 to 5"});
  file("body_cells.csv", "i,j,k\n0,0.5,0\n");
  refused(input, {"line 2", "0.5 is no cell"});
  file("body_cells.csv", "i,j,k\n");
  refused(input, {"body_cells.csv", "no rows"});
  write_case("", "lattice = { origin = [0.0, 0.0, 0.0], spacing = 5.0 }\nbody_cells = \"body_cells.csv\"\n");
  refused(input, {"nodes.body_cells", "add size"});
  write_case("", "lattice = { origin = [0.0, 0.0, 0.0], spacing = 5.0, size = [7, 7, 6] }\n");
  refused(input, {"node 294", "outside the lattice of 6 positions", "axis 2"});
  for (const char* size : {"[7, 7]", "[7, 7, 7.5]", "[7, 7, 1]"}) {
    write_case("", std::string("lattice = { origin = [0.0, 0.0, 0.0], spacing = 5.0, size = ") + size + " }\n");
    refused(input, {"nodes.lattice.size", "three whole numbers"});
  }
}

TEST_F(Solve, PointsOutsideMayBeMerged) {
  ASSERT_EQ(run().code, 0);
  const double energy = summary()["strain_energy_mN_mm"];
  file("points.csv", program::content(file("points.csv")) + "500,15,15,15.625\n");
  write_case("");
  std::string text = program::content(file("case.toml"));
  text.insert(text.find("[material]"), "outside = \"merge\"\n");
  file("case.toml", text);
  const Outcome outcome = run({"--force"});
  ASSERT_EQ(outcome.code, 0) << outcome.err;
  EXPECT_EQ(summary()["dropped_points"], 1);
  EXPECT_GT(summary()["strain_energy_mN_mm"].get<double>(), energy) << "its volume is not lost";
  fs::remove_all(out());
  text.replace(text.find("merge"), 5, "leave");
  file("case.toml", text);
  refused(input, {"points.outside", "'leave'", "choose error or merge"});
}

TEST_F(Solve, StrongCompressionIsAppliedInSmallerSteps) {
  squeeze(0.5 * side);
  const Outcome outcome = run();
  ASSERT_EQ(outcome.code, 0) << outcome.err;
  EXPECT_GT(summary()["load_increments"], 1);
  EXPECT_GT(summary()["smallest_volume_ratio"], 0);
}

TEST_F(Solve, FacesThatPassThroughEachOtherAreANumericalFailure) {
  const Strings reason{"inside out", "volume ratio -", " mm)", "check the motions there", "smaller node spacing"};
  squeeze(1.5 * side);
  refused(numerical, reason);
  write_case("[solver]\nrelaxation = \"plain\"\n");
  refused(numerical, reason);
  write_elements();
  refused(numerical, reason);
}

TEST_F(Solve, CommandLineMistakes) {
  expect_refusal(program::run({"solve"}, file("log")), usage, {"case"});
  expect_refusal(program::run({"solve", "case.toml"}, file("log")), usage, {"--output"});
  refused(usage, {"--threads"}, {"--threads", "0"});
  fs::create_directory(out());
  file("out/precious.txt", "x");
  expect_refusal(run(), output, {"not empty", "--force"});
  EXPECT_EQ(program::listing(out()), Strings{"precious.txt"});
}

TEST_F(Solve, NoConvergenceKeepsTheResultsSoFar) {
  write_case("[solver]\nmax_steps = 2\n");
  expect_refusal(run(), numerical, {"no convergence within 2 steps", "max_steps"});
  EXPECT_FALSE(summary()["converged"]);
}

TEST_F(Solve, InterruptedRunLeavesNothing) {
  write_case("[solver]\nrelaxation = \"plain\"\ntolerance_mm = 1e-30\nmax_steps = 2000000000\n");
  program::Run solving({"solve", file("case.toml"), "-o", out() / "deeper"}, file("log"));
  EXPECT_TRUE(solving.wait_for("step")) << "it has begun";
  EXPECT_TRUE(fs::exists(out()));
  solving.interrupt();
  EXPECT_EQ(solving.finish().code, 130);
  EXPECT_FALSE(fs::exists(out()));
}

}  // namespace
}  // namespace mtled
