#!/usr/bin/env python3
"""Run the reference problems through `mtled solve` and compare with their reference solutions.

examples:
  run.py                                  every case at its coarse and fine spacing, results as a table
  run.py --write                          the same, and the table goes into docs/verification.md
  run.py --cases l_shape --spacings 6     one case at a spacing of your own
  run.py --coarse --check                 every case at its coarse spacing; exit 1 when a limit is exceeded (a test)
  run.py --coarse --check --spoil         the same with spoilt results; exit 1 unless each of them is noticed (a test)
"""
import argparse
import collections
import copy
import json
import os
import pathlib
import platform
import subprocess
import sys
import tempfile

HERE = pathlib.Path(__file__).resolve().parent
REPORT = HERE.parent / "docs" / "verification.md"
BEGIN, END = "<!-- begin: written by verification/run.py -->", "<!-- end: written by verification/run.py -->"
SKIPPED = 77  # exit code that CTest takes for "skipped"

try:
    import numpy as np
    from compare import Comparison
    from make_case import make_case
except ImportError as error:
    print(f"SKIPPED: the comparison with the reference solutions needs NumPy ({error}); install python3-numpy")
    sys.exit(SKIPPED)

SPACINGS = {"cube_extension": (10, 5), "l_shape": (10, 5), "two_material_bar": (10, 5), "twisted_cylinder": (10, 5),
            "spine_in_block": (8, 4)}  # coarse, fine [mm]

# What a coarse solution may differ from the reference by: 1.1 times what was measured. The solver gives the same result in
# every run and processors differ in the last digits only, so the discretisation error of that spacing passes, and a defect
# that adds a tenth anywhere (median, tail, energy, reactions) does not. mm, mm, mm, %, % of the largest reaction.
Limits = collections.namedtuple("Limits", "median p95 p995 energy reaction")
COARSE_LIMITS = {"cube_extension": Limits(0.064, 0.55, 0.91, 0.3, 0.1),
                 "l_shape": Limits(0.079, 0.45, 0.84, 7.0, 7.2),
                 "two_material_bar": Limits(0.19, 0.77, 1.05, 4.0, 4.2),
                 "twisted_cylinder": Limits(0.032, 0.09, 0.137, 2.8, 1.6),
                 "spine_in_block": Limits(0.44, 0.97, 1.55, 16.4, 16.9)}
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
    limits = COARSE_LIMITS[case]
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


def true_error_at_stop(program, case, spacing, folder, threads, comparison):
    """Largest difference at the probes to the same problem converged a hundred times further, in double precision [mm]."""
    strict = {"tolerance_mm": 0.0005, "precision": "double"}
    further = solve(program, case, spacing, folder, threads, strict)
    return float(np.linalg.norm(comparison.displacement - further.displacement, axis=1).max())


COLUMNS = ("case", "spacing mm", "nodes", "points", "median mm", "95 % mm", "99.5 % mm", "max mm", "within 2 % of largest",
           "energy", "largest reaction difference", "steps", "force evaluations", "s", "estimated error mm", "true error at the stop mm")


def table_row(case, spacing, c, true_error):
    s = c.summary
    return (case, f"{spacing:g}", s["nodes"], s["integration_points"], *(f"{q:.3f}" for q in c.percentiles()),
            f"{c.within(0.02 * c.largest):.2f} %", f"{c.energy_percent():+.2f} %",
            f"{max(c.reaction_percents().values()):.2f} %", s["steps"], s["force_evaluations"], f"{s['seconds']:.2f}",
            f"{s['error_estimate_mm']:.4f}", f"{true_error:.4f}" if true_error is not None else "-")


def markdown(rows):
    line = lambda cells: "| " + " | ".join(str(c) for c in cells) + " |"
    return "\n".join([line(COLUMNS), "|" + "---|" * len(COLUMNS), *map(line, rows)])


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


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mtled", default=HERE.parent / "build" / "bin" / "mtled", type=pathlib.Path, metavar="PROGRAM", help="default: build/bin/mtled")
    parser.add_argument("--cases", nargs="+", choices=SPACINGS, default=list(SPACINGS), metavar="CASE", help=f"default: all of {', '.join(SPACINGS)}")
    parser.add_argument("--spacings", nargs="+", type=float, metavar="MM", help="node spacings; default: the coarse and the fine one of each case")
    parser.add_argument("--coarse", action="store_true", help="the coarse spacing only")
    parser.add_argument("--threads", type=int, default=0, help="default: all processors")
    parser.add_argument("--check", action="store_true", help="compare with the limits of the coarse spacings")
    parser.add_argument("--spoil", action="store_true", help="with --check: spoil the results, which must be noticed")
    parser.add_argument("--no-true-error", action="store_true", help="leave out the comparison with a further converged solution")
    parser.add_argument("--write", action="store_true", help="put the table into docs/verification.md")
    parser.add_argument("--keep", type=pathlib.Path, metavar="DIR", help="keep cases and results there")
    a = parser.parse_args()
    if a.check and not a.coarse:
        parser.error("--check needs --coarse: the limits are those of the coarse spacings")
    if not a.mtled.is_file():
        parser.error(f"there is no program '{a.mtled}'; build it with scripts/build.sh, or name it with --mtled")

    rows, good = [], True
    with tempfile.TemporaryDirectory(prefix="mtled-verification-") as scratch:
        base = a.keep or pathlib.Path(scratch)
        for case in a.cases:
            for spacing in a.spacings or SPACINGS[case][:1 if a.coarse else 2]:
                folder = base / f"{case}_{spacing:g}"
                comparison = solve(a.mtled, case, spacing, folder, a.threads)
                if a.check:
                    good = check(case, spacing, comparison, a.spoil) and good
                    continue
                true_error = None if a.no_true_error else true_error_at_stop(a.mtled, case, spacing, base / f"{folder.name}_further", a.threads, comparison)
                rows.append(table_row(case, spacing, comparison, true_error))
                print(*(f"{name} {value}" for name, value in zip(COLUMNS, rows[-1])), sep="; ", flush=True)
    if rows:
        report = f"{conditions(a.mtled, a.threads)}\n\n{markdown(rows)}"
        print("\n" + report)
        if a.write:
            write_report(report)
    sys.exit(not good)


if __name__ == "__main__":
    main()
