#!/usr/bin/env python3
"""Compare shape functions on the reference problems: errors and solver seconds, on lattices and irregular clouds.

examples:
  shape_functions.py            prints the table
  shape_functions.py --write    and puts it into docs/verification/shape_functions.md
"""
import argparse
import pathlib
import subprocess
import tempfile

import make_case as cases
import run
from compare import Comparison

HERE = pathlib.Path(__file__).resolve().parent
REPORT = HERE.parent / "docs" / "verification" / "shape_functions.md"

SHAPES = {"linear 1.6": 'dilatation = 1.6', "linear 1.75": 'dilatation = 1.75', "linear 2.0": 'dilatation = 2.0',
          "quadratic 2.5": 'basis = "quadratic"\ndilatation = 2.5', "modified 2.25": 'basis = "modified-quadratic"\ndilatation = 2.25',
          **{f"count {n}": f'support = "count"\ncount = {n}' for n in (16, 20, 25)}}
LATTICES = [("cube_extension", 10), ("cube_extension", 5), ("l_shape", 5), ("two_material_bar", 5), ("twisted_cylinder", 5)]
# name, spacing mm, jitter, surface nodes, integration cells per node
IRREGULAR = [("cube_extension", 10, 0.3, False, 2), ("cube_extension", 5, 0.3, False, 2), ("cube_extension", 5, 0.3, False, 4),
             ("l_shape", 5, 0.3, False, 2), ("l_shape", 5, 0.3, False, 4), ("twisted_cylinder", 5, 0.2, True, 2), ("twisted_cylinder", 5, 0.2, True, 4)]
COLUMNS = ("cloud", "shape functions", "median mm", "95 % mm", "99.5 % mm", "energy", "enlarged", "steps", "s")


def row(program, scratch, cloud, label, problem):
    """Solves the case in `scratch`; one row of the table."""
    done = subprocess.run([program, "solve", scratch / "case.toml", "-o", scratch / "out", "--force", "--quiet"], capture_output=True, text=True)
    if done.returncode:
        return [cloud, label, "failed: " + done.stderr.strip().splitlines()[-1][:60], *[""] * (len(COLUMNS) - 3)]
    c = Comparison(HERE / problem, scratch / "out")
    return [cloud, label, *(f"{q:.3f}" for q in c.percentiles()[:3]), f"{c.energy_percent():+.2f} %", c.summary["enlarged_supports"], c.summary["steps"],
            f"{c.summary['seconds']:.2f}"]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mtled", default=HERE.parent / "build" / "bin" / "mtled", type=pathlib.Path, metavar="PROGRAM")
    parser.add_argument("--write", action="store_true", help=f"put the table into {REPORT.relative_to(HERE.parent)}")
    a = parser.parse_args()
    rows = []
    with tempfile.TemporaryDirectory() as scratch:
        scratch = pathlib.Path(scratch)
        for problem, spacing, jitter, surface, per_node in [(*l, 0, False, 2) for l in LATTICES] + IRREGULAR:
            cases.CELLS_PER_NODE = per_node
            cases.make_case(HERE / problem, spacing, scratch, jitter, surface)
            toml = (scratch / "case.toml").read_text()
            lattice = not jitter
            cloud = f"{problem} {spacing} mm, " + ("lattice" if lattice else f"jitter {jitter}{', surface nodes' if surface else ''}, {per_node} points per node")
            for label, settings in SHAPES.items():
                if lattice and "count" in label:
                    continue  # on a lattice the radius gives the count
                (scratch / "case.toml").write_text(f"{toml}\n[shape_functions]\n{settings}\n")
                rows.append(row(a.mtled, scratch, cloud, label, problem))
                print(*rows[-1], sep="; ", flush=True)
    line = lambda columns: "| " + " | ".join(str(c) for c in columns) + " |"
    table = "\n".join([line(COLUMNS), "|" + "---|" * len(COLUMNS), *map(line, rows)])
    text = f"{run.conditions(a.mtled, 0)}\n\n{table}"
    if a.write:
        before, _, rest = REPORT.read_text().partition("<!-- begin: written by verification/shape_functions.py -->")
        after = rest.partition("<!-- end -->")[2]
        REPORT.write_text(f"{before}<!-- begin: written by verification/shape_functions.py -->\n{text}\n<!-- end -->{after}")


if __name__ == "__main__":
    main()
