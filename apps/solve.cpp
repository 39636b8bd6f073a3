#include <cstdio>

#include "command.hpp"
#include "core/error.hpp"
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

std::vector<Vec3d> displacement_at_probes(const Approximation& evaluator, const Solution& solution, const std::vector<Vec3d>& probes) {
  std::vector<Vec3d> u(probes.size());
  std::size_t outside = 0, first = 0;
  for (std::size_t p = 0; p < probes.size(); ++p)
    if (!displacement_at(evaluator, solution.parameter, probes[p], u[p]) && outside++ == 0) first = p;
  require(outside == 0, outside, " of ", probes.size(), " probes lie outside the body, the first (row ", first, ") at (", probes[first].x, ", ",
          probes[first].y, ", ", probes[first].z, ") mm; remove them");
  return u;
}

void run_in_time(const OutputDirectory& output, const Approximation& evaluator, SolveCase& problem) {
  DynamicsWriter writer(output.path(), evaluator, problem.constraints, problem.probes);
  problem.dynamics->progress = problem.solver.progress;
  problem.dynamics->observe = [&](const DynamicsFrame& frame) { writer.write(frame); };
  const DynamicsResult result = run_dynamics(evaluator, problem.points, problem.constraints, {}, problem.loads, *problem.dynamics);
  const Json summary = summary_of(result);
  write_text(output / "summary.json", summary.dump(1) + "\n");
  std::printf("%d steps of %.3g s, largest energy balance error %.2g %%, %.3g s\n", result.steps, result.time_step, 100 * result.largest_balance_error,
              summary["seconds"].get<double>());
}

void run(const SolveOptions& options) {
  const auto limit = start(options);
  SolveCase problem = read_case(options.case_file);
  const OutputDirectory output(options.output, options.force);
  problem.solver.progress = progress_printer(options.quiet);
  std::vector<std::uint8_t> prescribed(problem.cloud.size(), 0);
  for (int n : problem.constraints.node) prescribed[std::size_t(n)] = 1;
  const ShapeEvaluator evaluator(problem.cloud, std::move(prescribed), problem.shapes);
  for (std::size_t p = 0; p < problem.probes.size(); ++p)
    require(evaluator.touches(problem.probes[p]), "probe ", p, " at (", problem.probes[p].x, ", ", problem.probes[p].y, ", ", problem.probes[p].z,
            ") mm lies outside the body; remove it");
  if (problem.dynamics) return run_in_time(output, evaluator, problem);
  const Solution solution = solve(evaluator, problem.points, problem.constraints, problem.solver, {}, problem.loads);
  if (!problem.probes.empty()) write_displacements(output / "probes.csv", problem.probes, displacement_at_probes(evaluator, solution, problem.probes));
  write_nodes(output.path(), problem.cloud, problem.constraints, solution);
  const Json summary = summary_of(solution);
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
