#!/usr/bin/env python3
"""Run the reference problems through `mtled solve` and compare with their reference solutions.

examples:
  run.py                                  every case at all its spacings but the extended one, results as a table
  run.py --write                          the same and the extended ones; tables and plots go into docs/verification/
  run.py --cases l_shape --spacings 6     one case at a spacing of your own
  run.py --check                          every case at the spacing of its test; exit 1 when a limit is exceeded (a test)
  run.py --check --spoil                  the same with spoilt results; exit 1 unless each of them is noticed (a test)
"""
import argparse
import collections
import copy
import csv
import json
import os
import pathlib
import platform
import subprocess
import sys
import tempfile

HERE = pathlib.Path(__file__).resolve().parent
REPORT = HERE.parent / "docs" / "verification" / "README.md"
BEGIN, END = "<!-- begin: written by verification/run.py -->", "<!-- end: written by verification/run.py -->"
SKIPPED = 77  # exit code that CTest takes for "skipped"

try:
    import numpy as np
    from compare import Comparison
    from make_case import make_case
except ImportError as error:
    print(f"SKIPPED: the comparison with the reference solutions needs NumPy ({error}); install python3-numpy")
    sys.exit(SKIPPED)

SPACINGS = {"cube_extension": (20, 10, 5, 2.5), "l_shape": (10, 5, 10 / 3, 2.5, 2), "two_material_bar": (10, 5, 10 / 3, 2.5, 2),
            "twisted_cylinder": (10, 5, 2.5, 2), "spine_in_block": (8, 4)}  # [mm]
EXTENDED = {"spine_in_block": (2,)}  # [mm]; half a million nodes
UNRESOLVED = {("spine_in_block", 8)}  # the lattice misses faces of the blocks: another problem, left out of fitted orders
TEST_SPACING = {"cube_extension": 10, "l_shape": 10, "two_material_bar": 10, "twisted_cylinder": 10, "spine_in_block": 4}  # [mm]

# What the solution of a test may differ from the reference by: 1.1 times what was measured. The solver gives the same result in
# every run and processors differ in the last digits only, so the discretisation error of that spacing passes, and a defect
# that adds a tenth anywhere (median, tail, energy, reactions) does not. mm, mm, mm, %, % of the largest reaction.
Limits = collections.namedtuple("Limits", "median p95 p995 energy reaction")
TEST_LIMITS = {"cube_extension": Limits(0.12, 0.32, 0.65, 1.6, 1.7),
               "l_shape": Limits(0.074, 0.38, 0.8, 3.3, 4.3),
               "two_material_bar": Limits(0.16, 0.83, 0.93, 1.8, 2.2),
               "twisted_cylinder": Limits(0.027, 0.08, 0.11, 2.9, 2.9),
               "spine_in_block": Limits(0.012, 0.062, 0.13, 0.89, 2.5)}
LARGEST_ERROR_ESTIMATE_MM = 0.05  # the tolerance of the cases


def solve(program, case, spacing, folder, threads, solver=None):
    """Discretises and solves; returns the comparison with the reference."""
    make_case(HERE / case, spacing, folder, solver=solver)
    command = [program, "solve", folder / "case.toml", "--output", folder / "result", "--force", "--quiet"]
    command += ["--threads", str(threads)] if threads else []
    done = subprocess.run([str(part) for part in command], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    if done.returncode:
        sys.exit(f"{case} at {spacing:g} mm: {' '.join(map(str, command))} ended with {done.returncode}:\n{done.stdout}")
    return Comparison(HERE / case, folder / "result")


def faults(comparison, limits):
    """What exceeds the limits, in words."""
    median, p95, p995, _ = comparison.percentiles()
    measured = {"median [mm]": (median, limits.median), "95 % [mm]": (p95, limits.p95), "99.5 % [mm]": (p995, limits.p995),
                "energy [%]": (abs(comparison.energy_percent()), limits.energy),
                "reaction [%]": (max(comparison.reaction_percents().values()), limits.reaction),
                "error estimate [mm]": (comparison.summary["error_estimate_mm"], LARGEST_ERROR_ESTIMATE_MM)}
    found = [f"{name} is {value:.4g}, limit {limit:g}" for name, (value, limit) in measured.items() if not value <= limit]
    return found + ([] if comparison.summary["converged"] else ["not converged"])


def spoilt(comparison):
    """Pairs of what was done and the comparison with that defect; the limits must notice each."""
    def changed(**values):
        other = copy.deepcopy(comparison)
        for name, value in values.items():
            setattr(other, name, value)
        return other

    summary, away = comparison.summary, np.sign(comparison.energy_percent())
    extra = 0.02 * np.linalg.norm(comparison.displacement, axis=1)
    yield "errors larger by 2 % of the displacement", changed(distance=comparison.distance + extra)
    yield "energy further off by 10 %", changed(
        summary={**summary, "strain_energy_mN_mm": (1 + 0.1 * away) * summary["strain_energy_mN_mm"]})
    yield "reactions of the wrong sign", changed(
        summary={**summary, "reactions_mN": {name: [-c for c in r] for name, r in summary["reactions_mN"].items()}})
    yield "not converged", changed(summary={**summary, "converged": False})


def check(case, spacing, comparison, spoil):
    """Prints the verdict; returns whether it is good."""
    limits = TEST_LIMITS[case]
    found = faults(comparison, limits)
    print(f"{case} at {spacing:g} mm: {'; '.join(found) if found else 'within all limits'}")
    if not spoil:
        return not found
    good = True
    for what, other in spoilt(comparison):
        noticed = faults(other, limits)
        print(f"  {what}: {'noticed: ' + '; '.join(noticed) if noticed else 'NOT NOTICED'}")
        good = good and bool(noticed)
    return good


def converged_further(program, case, spacing, folder, threads, comparison):
    """The same discrete problem in double precision, converged to a tenth of the estimated error."""
    return solve(program, case, spacing, folder, threads, {"tolerance_mm": comparison.summary["error_estimate_mm"] / 10, "precision": "double"})


ZONES = ("interior", "near_boundary", "near_singularity")
QUANTILES = ("median", "p95", "p995", "max")


def result_row(case, spacing, c, further):
    """One run in numbers: name of the figure -> value. `further`: converged_further(), or None."""
    s = c.summary
    row = {"case": case, "spacing_mm": spacing, "nodes": s["nodes"], "points": s["integration_points"], "largest_mm": c.largest}
    for zone in ZONES:
        row.update({f"{zone}_{q}_mm": value for q, value in zip(QUANTILES, c.percentiles(zone))})
    row["interior_within_1_percent"] = c.within(0.01 * c.largest, "interior")
    row["all_within_1_percent"] = c.within(0.01 * c.largest)
    row["energy_percent"], row["reaction_percent"] = c.energy_percent(), max(c.reaction_percents().values())
    row["steps"], row["seconds"], row["error_estimate_mm"] = s["steps"], s["seconds"], s["error_estimate_mm"]
    row["true_error_mm"] = None if further is None else float(np.linalg.norm(c.displacement - further.displacement, axis=1).max())
    for zone in ZONES:
        row.update({f"converged_{zone}_{q}_mm": value for q, value in zip(QUANTILES, (further or c).percentiles(zone))})
    return row


def markdown(header, rows):
    line = lambda cells: "| " + " | ".join(str(c) for c in cells) + " |"
    return "\n".join([line(header), "|" + "---|" * len(header), *map(line, rows)])


def table(rows):
    """Every run: the differences by zone, and the rest."""
    quantiles = lambda r, zone: " / ".join(f"{r[f'{zone}_{q}_mm']:.3f}" for q in QUANTILES)
    header = ("case", "spacing mm", "nodes", "points", *(f"{zone}: median / 95 % / 99.5 % / max mm" for zone in ZONES),
              "within 1 %: interior, all", "energy", "reaction", "steps", "s", "estimated error mm", "true error at the stop mm")
    return markdown(header, [(
        r["case"], f"{r['spacing_mm']:.3g}", r["nodes"], r["points"], *(quantiles(r, zone) for zone in ZONES),
        f"{r['interior_within_1_percent']:.2f} %, {r['all_within_1_percent']:.2f} %", f"{r['energy_percent']:+.2f} %",
        f"{r['reaction_percent']:.2f} %", r["steps"], f"{r['seconds']:.2f}", f"{r['error_estimate_mm']:.4f}",
        "-" if r["true_error_mm"] is None else f"{r['true_error_mm']:.4f}") for r in rows])


ORDER_COLUMNS = ("converged_interior_median_mm", "converged_interior_p95_mm", "converged_near_boundary_p95_mm", "converged_near_singularity_p95_mm")


def orders(rows):
    """Fitted exponents of the spacing, per case with three spacings or more; of the further converged solutions."""
    lines = []
    for case in dict.fromkeys(r["case"] for r in rows):
        runs = [r for r in rows if r["case"] == case and (case, r["spacing_mm"]) not in UNRESOLVED]
        if len(runs) < 3:
            continue
        h = np.log([r["spacing_mm"] for r in runs])
        lines.append((case, f"{runs[0]['spacing_mm']:.3g} to {runs[-1]['spacing_mm']:.3g}",
                      *(f"{np.polyfit(h, np.log([r[c] for r in runs]), 1)[0]:.2f}" for c in ORDER_COLUMNS)))
    return markdown(("case", "spacings mm", "interior, median", "interior, 95 %", "near boundary, 95 %", "near singularity, 95 %"), lines)


def conditions(program, threads):
    """Program, processor and threads of the run, in one line."""
    version = subprocess.run([program, "--version"], stdout=subprocess.PIPE, text=True, check=True).stdout.strip()
    cpu = platform.processor() or platform.machine()
    if os.path.exists("/proc/cpuinfo"):
        names = [line.split(":", 1)[1].strip() for line in open("/proc/cpuinfo") if line.startswith("model name")]
        cpu = names[0] if names else cpu
    return f"mtled {version}, CPU, {threads or len(os.sched_getaffinity(0))} threads of {cpu}, single precision, tolerance 0.05 mm."


def write_report(text):
    before, _, rest = REPORT.read_text().partition(BEGIN)
    _, _, after = rest.partition(END)
    REPORT.write_text(f"{before}{BEGIN}\n{text}\n{END}{after}")


def write_results(rows):
    with open(REPORT.parent / "results.csv", "w", newline="") as f:
        writer = csv.DictWriter(f, rows[0].keys())
        writer.writeheader()
        writer.writerows({k: f"{v:.6g}" if isinstance(v, float) else v for k, v in r.items()} for r in rows)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mtled", default=HERE.parent / "build" / "bin" / "mtled", type=pathlib.Path, metavar="PROGRAM", help="default: build/bin/mtled")
    parser.add_argument("--cases", nargs="+", choices=SPACINGS, default=list(SPACINGS), metavar="CASE", help=f"default: all of {', '.join(SPACINGS)}")
    parser.add_argument("--spacings", nargs="+", type=float, metavar="MM", help="node spacings; default: those of each case")
    parser.add_argument("--threads", type=int, default=0, help="default: all processors")
    parser.add_argument("--check", action="store_true", help="one spacing per case, compared with its limits")
    parser.add_argument("--spoil", action="store_true", help="with --check: spoil the results, which must be noticed")
    parser.add_argument("--no-true-error", action="store_true", help="leave out the comparison with a further converged solution")
    parser.add_argument("--write", action="store_true", help="extended spacings too; tables and plots into docs/verification/ (needs Matplotlib)")
    parser.add_argument("--keep", type=pathlib.Path, metavar="DIR", help="keep cases and results there")
    a = parser.parse_args()
    if a.check and a.spacings:
        parser.error("--check has spacings of its own, those of the limits; leave --spacings out")
    if a.write and (a.spacings or a.cases != list(SPACINGS)):
        parser.error("--write needs every case at every spacing; leave --cases and --spacings out")
    if not a.mtled.is_file():
        parser.error(f"there is no program '{a.mtled}'; build it with scripts/build.sh, or name it with --mtled")

    rows, good = [], True
    with tempfile.TemporaryDirectory(prefix="mtled-verification-") as scratch:
        base = a.keep or pathlib.Path(scratch)
        for case in a.cases:
            if a.check:
                spacing = TEST_SPACING[case]
                good = check(case, spacing, solve(a.mtled, case, spacing, base / case, a.threads), a.spoil) and good
                continue
            for spacing in a.spacings or SPACINGS[case] + (EXTENDED.get(case, ()) if a.write else ()):
                folder = base / f"{case}_{spacing:g}"
                comparison = solve(a.mtled, case, spacing, folder, a.threads)
                further = None if a.no_true_error else converged_further(a.mtled, case, spacing, base / f"{folder.name}_further", a.threads, comparison)
                rows.append(result_row(case, spacing, comparison, further))
                print(table(rows[-1:]).splitlines()[-1], flush=True)
    if rows:
        report = f"{conditions(a.mtled, a.threads)}\n\n{table(rows)}\n\nFitted orders of convergence:\n\n{orders(rows)}"
        print("\n" + report)
        if a.write:
            write_results(rows)
            write_report(report)
            subprocess.run([sys.executable, HERE / "plots.py"], check=True)
    sys.exit(not good)


if __name__ == "__main__":
    main()
