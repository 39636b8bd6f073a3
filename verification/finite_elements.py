#!/usr/bin/env python3
"""Compare the meshless solution with our own finite elements on the same nodes, and both with the reference solution.

This is how the method's authors verify it: the same body by MTLED and by total Lagrangian explicit 8-node hexahedra, the
difference per node. The elements are the lattice cells wholly inside the body; nodes, constraints, material, relaxation
and tolerance are the same.

examples:
  finite_elements.py            both problems, tables
  finite_elements.py --write    the same, and docs/verification/finite_elements.md with its figure (needs Matplotlib)
  finite_elements.py --cases l_shape --check    exit 1 where the two differ by more than a tenth more than they should (a test)
"""
import argparse
import json
import pathlib
import subprocess
import sys
import tempfile

from run import conditions, np  # says that the comparison is skipped where there is no NumPy

from compare import Comparison, read_probes, vectors
from make_case import cells_between, evaluate, make_case, material_at, subsamples, write_csv

HERE = pathlib.Path(__file__).resolve().parent
REPORT = HERE.parent / "docs" / "verification" / "finite_elements.md"
FIGURE = REPORT.with_suffix(".png")
PROBLEMS = {"l_shape": 5, "spine_in_block": 4}  # node spacing that meets every face [mm]
CHECK_MM = {"l_shape": (0.064, 0.157, 0.296), "spine_in_block": (0.086, 0.213, 0.308)}  # measured median, 95 %, 99.5 % of the difference
LIMITS_MM = (0.1, 0.25, 0.5, 1.0)
CORNERS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]])  # as in VTK


def hexahedra(problem, nodes, h):
    """[n, 8] node numbers of the lattice cells wholly inside the body."""
    low = np.array(problem["geometry"]["bounding_box"][0], float)
    position = np.rint((nodes - low) / h).astype(int)
    number = np.full(position.max(0) + 2, -1)
    number[tuple(position.T)] = np.arange(len(nodes))
    cells = cells_between(*[np.arange(n - 1) for n in number.shape])
    elements = number[tuple(np.moveaxis(cells[:, None] + CORNERS, -1, 0))]
    keep = (elements >= 0).all(1)
    for s in subsamples():
        keep &= evaluate(problem["geometry"]["inside"], low + h * (cells + s))
    elements = elements[keep]
    if len(np.unique(elements)) != len(nodes):
        sys.exit(f"{len(nodes) - len(np.unique(elements))} nodes belong to no cell wholly inside the body; choose a spacing that meets its faces")
    return elements


def make_element_case(source, h, folder):
    """Writes case.toml (meshless) and elements.toml (the same with hexahedra) and their tables to `folder`."""
    make_case(source, h, folder)
    problem = json.loads((source / "problem.json").read_text())
    nodes = np.loadtxt(folder / "nodes.csv", delimiter=",", skiprows=1)
    elements = hexahedra(problem, nodes, h)
    materials = [problem["materials"][m] for m in material_at(problem, nodes[elements].mean(1))]
    write_csv(folder / "elements.csv", [f"n{c}" for c in range(8)] + ["shear_modulus_kpa", "bulk_modulus_kpa"],
              [[*e, float(m["shear_modulus_kpa"]), float(m["bulk_modulus_kpa"])] for e, m in zip(elements.tolist(), materials)])
    meshless, points = (folder / "case.toml").read_text(), '[points]\nfile = "points.csv"\n'
    if points not in meshless:
        sys.exit(f"{folder / 'case.toml'} has no [points] as expected")
    (folder / "elements.toml").write_text(meshless.replace(points, '[elements]\nfile = "elements.csv"\n'))


class Pair:
    """Both solutions of a problem: comparisons with the reference, and the difference at the nodes that are free [mm]."""

    def __init__(self, program, case, h, folder, threads):
        make_element_case(HERE / case, h, folder)
        self.case, self.h = case, h
        self.meshless, u = self.solve(program, HERE / case, folder, "case", threads)
        self.elements, v = self.solve(program, HERE / case, folder, "elements", threads)
        prescribed = np.unique(read_probes(folder / "constraints.csv")["node"])
        self.difference = np.delete(np.linalg.norm(u - v, axis=1), prescribed)

    def solve(self, program, source, folder, name, threads):
        out = folder / name
        command = [program, "solve", folder / f"{name}.toml", "--output", out, "--force", "--quiet"] + (["--threads", threads] if threads else [])
        done = subprocess.run([str(part) for part in command], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        if done.returncode:
            sys.exit(f"{' '.join(map(str, command))} ended with {done.returncode}:\n{done.stdout}")
        return Comparison(source, out), vectors(read_probes(out / "nodes.csv"), ("ux", "uy", "uz"))


def table(header, rows):
    line = lambda cells: "| " + " | ".join(str(c) for c in cells) + " |"
    return "\n".join([line(header), "|" + "---|" * len(header), *map(line, rows)])


def difference_table(pairs):
    header = ("case", "spacing mm", "largest displacement mm", "free nodes", "median mm", "95 % mm", "99.5 % mm", "max mm", *(f"within {limit:g} mm" for limit in LIMITS_MM))
    return table(header, [(p.case, f"{p.h:g}", f"{p.meshless.largest:.1f}", len(p.difference), *(f"{q:.3f}" for q in np.percentile(p.difference, (50, 95, 99.5, 100))),
                           *(f"{100 * (p.difference <= limit).mean():.2f} %" for limit in LIMITS_MM)) for p in pairs])


def reference_table(pairs):
    header = ("case", "by", "points", "median mm", "95 % mm", "99.5 % mm", "max mm", "energy", "largest reaction difference", "force evaluations", "s")
    rows = []
    for p in pairs:
        for by, c in (("MTLED", p.meshless), ("hexahedra", p.elements)):
            s = c.summary
            rows.append((p.case, by, s["integration_points"], *(f"{q:.3f}" for q in c.percentiles()), f"{c.energy_percent():+.2f} %",
                         f"{max(c.reaction_percents().values()):.2f} %", s["force_evaluations"], f"{s['seconds']:.2f}"))
    return table(header, rows)


def draw(pairs, path):
    """Histogram of the difference per node: share of the free nodes per bin, on a logarithmic scale."""
    import matplotlib
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    figure, axes = plt.subplots(1, len(pairs), figsize=(5.5 * len(pairs), 3.8), squeeze=False)
    for axis, p in zip(axes[0], pairs):
        top = max(LIMITS_MM[1], float(p.difference.max()))
        axis.hist(p.difference, bins=np.linspace(0, top, 41), weights=np.full(len(p.difference), 100 / len(p.difference)), color="#4878a8")
        axis.set_yscale("log")
        axis.set_xlabel("|MTLED - finite elements| at a node, mm")
        axis.set_ylabel("share of the free nodes, %")
        axis.set_title(f"{p.case}, {p.h:g} mm, {len(p.difference)} nodes")
        for percent, style in ((95, "--"), (99.5, ":")):
            x = np.percentile(p.difference, percent)
            axis.axvline(x, color="black", linestyle=style, label=f"{percent:g} %: {x:.2f} mm")
        axis.legend()
    figure.tight_layout()
    figure.savefig(path, dpi=110)


def within_limits(pair):
    """Prints the verdict; the limits are 1.1 times what was measured, as in run.py."""
    found = [f"{name} is {value:.4g} mm, limit {1.1 * measured:.4g}" for name, value, measured
             in zip(("median", "95 %", "99.5 %"), np.percentile(pair.difference, (50, 95, 99.5)), CHECK_MM[pair.case]) if not value <= 1.1 * measured]
    print(f"{pair.case}: {'; '.join(found) if found else 'within all limits'}")
    return not found


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mtled", default=HERE.parent / "build" / "bin" / "mtled", type=pathlib.Path, metavar="PROGRAM", help="default: build/bin/mtled")
    parser.add_argument("--cases", nargs="+", choices=PROBLEMS, default=list(PROBLEMS), metavar="CASE", help=f"default: {' '.join(PROBLEMS)}")
    parser.add_argument("--check", action="store_true", help="compare with the differences that were measured")
    parser.add_argument("--threads", type=int, default=0, help="default: all processors")
    parser.add_argument("--write", action="store_true", help="put tables and figure into docs/verification")
    a = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="mtled-verification-") as scratch:
        pairs = [Pair(a.mtled, case, h, pathlib.Path(scratch) / case, a.threads) for case, h in PROBLEMS.items() if case in a.cases]
    tables = {"differences": difference_table(pairs), "reference": reference_table(pairs)}
    for text in tables.values():
        print(text + "\n")
    if a.check:
        sys.exit(not all([within_limits(p) for p in pairs]))
    if a.write:
        text = REPORT.read_text()
        for name, written in {"conditions": conditions(a.mtled, a.threads), **tables}.items():
            before, begin, rest = text.partition(f"<!-- begin {name} -->")
            _, end, after = rest.partition(f"<!-- end {name} -->")
            text = f"{before}{begin}\n{written}\n{end}{after}"
        REPORT.write_text(text)
        draw(pairs, FIGURE)


if __name__ == "__main__":
    main()
