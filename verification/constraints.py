#!/usr/bin/env python3
"""Compare the two schemes for prescribed displacements on the reference problems: errors, forces and cost.

examples:
  constraints.py            prints the table
  constraints.py --write    and puts it into docs/verification/constraints.md
"""
import argparse
import pathlib
import subprocess
import sys
import tempfile

import run
from compare import Comparison
from make_case import make_case

HERE = pathlib.Path(__file__).resolve().parent
REPORT = HERE.parent / "docs" / "verification" / "constraints.md"
BEGIN, END = "<!-- begin: written by verification/constraints.py -->", "<!-- end -->"

SCHEMES = ("coupling", "collocation")
SPACINGS = {"cube_extension": (10, 5), "l_shape": (10, 5), "two_material_bar": (10, 5), "twisted_cylinder": (10, 5), "spine_in_block": (4,)}  # [mm]
COLUMNS = ("case", "spacing mm", "scheme", "median / 95 % / 99.5 % / max mm", "energy", "reaction", "steps", "force evaluations", "s")


def row(program, scratch, case, spacing, scheme, threads):
    """Solves one case; one row of the table."""
    make_case(HERE / case, spacing, scratch)
    toml = scratch / "case.toml"
    toml.write_text(toml.read_text().replace("[constraints]\n", f'[constraints]\nscheme = "{scheme}"\n'))
    command = [program, "solve", toml, "--output", scratch / "result", "--force", "--quiet", *(["--threads", str(threads)] if threads else [])]
    done = subprocess.run([str(part) for part in command], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    if done.returncode:
        sys.exit(f"{case} at {spacing:g} mm, {scheme}: ended with {done.returncode}:\n{done.stdout}")
    c = Comparison(HERE / case, scratch / "result")
    s = c.summary
    return (case, f"{spacing:g}", scheme, " / ".join(f"{q:.3f}" for q in c.percentiles()), f"{c.energy_percent():+.2f} %",
            f"{max(c.reaction_percents().values()):.2f} %", s["steps"], s["force_evaluations"], f"{s['seconds']:.2f}")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mtled", default=HERE.parent / "build" / "bin" / "mtled", type=pathlib.Path, metavar="PROGRAM", help="default: build/bin/mtled")
    parser.add_argument("--threads", type=int, default=0, help="default: all processors")
    parser.add_argument("--write", action="store_true", help=f"put the table into {REPORT.relative_to(HERE.parent)}")
    a = parser.parse_args()
    if not a.mtled.is_file():
        parser.error(f"there is no program '{a.mtled}'; build it with scripts/build.sh, or name it with --mtled")
    rows = []
    with tempfile.TemporaryDirectory(prefix="mtled-constraints-") as scratch:
        for case, spacings in SPACINGS.items():
            for spacing in spacings:
                for scheme in SCHEMES:
                    rows.append(row(a.mtled, pathlib.Path(scratch), case, spacing, scheme, a.threads))
                    print(*rows[-1], sep="; ", flush=True)
    if a.write:
        before, _, rest = REPORT.read_text().partition(BEGIN)
        after = rest.partition(END)[2]
        REPORT.write_text(f"{before}{BEGIN}\n{run.conditions(a.mtled, a.threads)}\n\n{run.markdown(COLUMNS, rows)}\n{END}{after}")


if __name__ == "__main__":
    main()
