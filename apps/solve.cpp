#include <algorithm>
#include <cstdio>

#include "command.hpp"
#include "core/coupled_integration.hpp"
#include "core/error.hpp"
#include "core/parallel.hpp"
#include "core/stabilisation.hpp"
#include "io/case_file.hpp"
#include "io/dynamics_output.hpp"
#include "io/output.hpp"
#include "io/solution_output.hpp"
#include "io/tables.hpp"

namespace mtled {
namespace {

struct SolveOptions : CommonOptions {
  std::filesystem::path case_file, output;
};

std::vector<Vec3d> displacement_at_probes(const Approximation& field, const Solution& solution, const std::vector<Vec3d>& probes) {
  std::vector<Vec3d> u(probes.size());
  std::size_t outside = 0, first = 0;
  for (std::size_t p = 0; p < probes.size(); ++p)
    if (!displacement_at(field, solution.parameter, probes[p], u[p]) && outside++ == 0) first = p;
  require(outside == 0, outside, " of ", probes.size(), " probes lie outside the body, the first (row ", first, ") at (", probes[first].x, ", ",
          probes[first].y, ", ", probes[first].z, ") mm; remove them");
  return u;
}

/// Far from all nodes there is no displacement that a point could feel.
void require_nodes_at_points(const Approximation& field, const std::vector<Vec3d>& points) {
  std::vector<std::uint8_t> stray(points.size(), 0);
  parallel_for(points.size(), [&](std::size_t p) {
    thread_local ShapeFunctions shapes;
    stray[p] = !field.touches(points[p]) && !field.at(points[p], shapes);
  }, 256);
  const auto count = std::count(stray.begin(), stray.end(), 1);
  if (count == 0) return;
  const auto first = std::size_t(std::find(stray.begin(), stray.end(), 1) - stray.begin());
  const Vec3d& x = points[first];
  fail(Failure::input, count, " of ", points.size(), " integration points lie where there are no nodes, the first (row ", first, ") at (", x.x, ", ", x.y, ", ", x.z,
       ") mm; remove them, or put nodes around them");
}

void warn_of_few_points(const SolveCase& problem, const Solution& solution) {
  std::size_t few = 0, worst = 0;
  for (std::size_t n = 0; n < solution.points_per_node.size(); ++n) {
    const double here = solution.points_per_node[n];
    if (here == 0 || here >= enough_points_per_node) continue;
    if (few++ == 0 || here < solution.points_per_node[worst]) worst = n;
  }
  if (few == 0) return;
  const Vec3d& x = problem.cloud.nodes[worst];
  warn(concatenate(few, " of ", problem.cloud.size(), " nodes have fewer than ", enough_points_per_node, " integration points per node around them (fewest: ",
                   solution.points_per_node[worst], ", at (", x.x, ", ", x.y, ", ", x.z, ") mm): the displacement may be too large and rough there; ",
                   problem.solver.stabilisation > 0 ? "solver.stabilisation is on and helps, more points are better" : "use about two points per node, or set solver.stabilisation = 2"));
}

void run_in_time(const OutputDirectory& output, const Discretisation& discretisation, SolveCase& problem) {
  DynamicsWriter writer(output.path(), *discretisation.field, problem.constraints, problem.probes);
  problem.dynamics->progress = problem.solver.progress;
  problem.dynamics->observe = [&](const DynamicsFrame& frame) { writer.write(frame); };
  const DynamicsResult result = run_dynamics(*discretisation.field, problem.points, problem.constraints, discretisation.springs, problem.loads, *problem.dynamics);
  const Json summary = summary_of(result);
  write_text(output / "summary.json", summary.dump(1) + "\n");
  std::printf("%d steps of %.3g s, largest energy balance error %.2g %%, %.3g s\n", result.steps, result.time_step, 100 * result.largest_balance_error,
              summary["seconds"].get<double>());
}

void run(const SolveOptions& options) {
  const auto limit = start(options);
  SolveCase problem = read_case(options.case_file);
  const OutputDirectory output(options.output, options.force);
  if (problem.cloud.lattice && problem.cloud.lattice->body_cell.empty()) mark_body_cells(problem.cloud, problem.points);
  problem.solver.progress = progress_printer(options.quiet);
  const Discretisation discretisation = discretise(problem);
  const Approximation& field = *discretisation.field;
  for (std::size_t p = 0; p < problem.probes.size(); ++p)
    require(field.touches(problem.probes[p]), "probe ", p, " at (", problem.probes[p].x, ", ", problem.probes[p].y, ", ", problem.probes[p].z,
            ") mm lies outside the body; remove it");
  if (!problem.merge_points_outside) require_nodes_at_points(field, problem.points.position);
  if (problem.align_points && problem.elements.size() == 0)
    problem.points = reduce_volumetric_integration(field, align_with_coupled_cells(field, problem.points));
  if (problem.dynamics) return run_in_time(output, discretisation, problem);
  Solution solution = solve(field, problem.points, problem.constraints, problem.solver, discretisation.springs, problem.loads);
  if (problem.elements.size() > 0) solution.points_per_node.clear();  // one point per element is right, whatever that is per node
  if (!problem.probes.empty()) write_displacements(output / "probes.csv", problem.probes, displacement_at_probes(field, solution, problem.probes));
  write_nodes(output.path(), problem.cloud, problem.constraints, solution);
  const Json summary = summary_of(solution);
  warn_of_few_points(problem, solution);
  write_text(output / "summary.json", summary.dump(1) + "\n");
  std::printf("%s after %d steps (%d force evaluations), estimated error %.3g mm, strain energy %.6g mN mm, %.3g s\n",
              solution.converged ? "converged" : "NOT CONVERGED", solution.steps, solution.force_evaluations, solution.error_estimate_mm,
              solution.strain_energy, summary["seconds"].get<double>());
  if (!solution.converged)
    fail(Failure::numerical, "no convergence within ", problem.solver.max_steps, " steps (estimated error ", solution.error_estimate_mm,
         " mm, tolerance ", problem.solver.tolerance_mm, " mm); the results so far are in '", options.output.string(), "'. Raise solver.max_steps or the tolerance");
}

}  // namespace

void add_solve(CLI::App& program) {
  auto options = std::make_shared<SolveOptions>();
  CLI::App* verb = program.add_subcommand("solve", "Solve a mechanical problem given as tables, without images");
  verb->add_option("case", options->case_file, "case.toml (see docs/solve.md)")->type_name("FILE")->required();
  verb->add_option("--output,-o", options->output, "folder for summary.json, nodes.csv, nodes.vtu and probes.csv, or the motion in time")->type_name("DIR")->required();
  add_common(*verb, *options, false);
  verb->callback([options] { run(*options); });
}

}  // namespace mtled
