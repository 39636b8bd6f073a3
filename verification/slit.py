#!/usr/bin/env python3
"""Two plates that are joined at one end, with a slit of 10 mm between them, are pulled apart at the other end; prints how
far the slit's opening is off, against the same problem at the finest spacing, for slits of 1 to 3 node spacings."""
import argparse
import json
import pathlib
import subprocess
import tempfile

import numpy as np

from make_case import make_case

SLIT, PLATE, LENGTH, DEPTH, PULL = 10.0, 20.0, 80.0, 20.0, 10.0  # mm
FINEST = 2.5  # mm; four spacings in the slit
PROBLEM = {
    "geometry": {
        "bounding_box": [[0, 0, 0], [LENGTH, DEPTH, 2 * PLATE + SLIT]],
        "inside": f"(x>=0)&(x<={LENGTH})&(y>=0)&(y<={DEPTH})&(z>=0)&(z<={2 * PLATE + SLIT})&((x<={PLATE})|(z<={PLATE})|(z>={PLATE + SLIT}))",
        "constraints": [{"set": "bottom", "where": "z<1e-6", "displacement": ["0*x", "0*x", "0*x"]},
                        {"set": "top", "where": f"(z>{2 * PLATE + SLIT}-1e-6)&(x>={LENGTH - PLATE})", "displacement": ["0*x", "0*x", f"{PULL}+0*x"]}]},
    "materials": [{"shear_modulus_kpa": 1.0, "bulk_modulus_kpa": 49.67}]}


def opening(program, spacing, folder, shift, general):
    """Displacements along both faces of the slit [mm]; the lattice is moved by `shift` spacings across the slit."""
    folder.mkdir()
    problem = json.loads(json.dumps(PROBLEM))
    problem["geometry"]["bounding_box"][0][2] -= shift * spacing
    (folder / "problem.json").write_text(json.dumps(problem))
    x = np.linspace(PLATE + 2, LENGTH, 30)
    rows = [f"{a:.9g},{DEPTH / 2},{z:.9g}" for z in (PLATE - 1, PLATE + SLIT + 1) for a in x]
    (folder / "probes.csv").write_text("x,y,z\n" + "\n".join(rows) + "\n")
    counts = make_case(folder, spacing, folder, solver={"tolerance_mm": 0.01})
    if general:
        case = folder / "case.toml"
        case.write_text("".join(line for line in case.read_text().splitlines(True) if not line.startswith("lattice")))
    subprocess.run([program, "solve", folder / "case.toml", "-o", folder / "out", "--force", "--quiet"], check=True, stdout=subprocess.DEVNULL)
    u = np.genfromtxt(folder / "out" / "probes.csv", delimiter=",", names=True)
    u = np.column_stack([u["ux"], u["uy"], u["uz"]])
    return u[30:] - u[:30], counts


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--mtled", default=pathlib.Path(__file__).resolve().parent.parent / "build" / "bin" / "mtled", type=pathlib.Path, metavar="PROGRAM")
    parser.add_argument("--general", action="store_true", help="leave out the promise of a lattice")
    a = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        scratch = pathlib.Path(scratch)
        truth, counts = opening(a.mtled, FINEST, scratch / "finest", 0, a.general)
        print(f"finest: {counts}; largest opening {np.linalg.norm(truth, axis=1).max():.3f} mm")
        for spacing, shift in ((10, 0), (10, 0.25), (10, 0.5), (20 / 3, 0), (20 / 3, 0.25), (20 / 3, 0.5), (5, 0), (5, 0.5), (10 / 3, 0)):
            here, _ = opening(a.mtled, spacing, scratch / f"{spacing:.3f}_{shift}", shift, a.general)
            error = np.linalg.norm(here - truth, axis=1)
            print(f"slit of {SLIT / spacing:.3g} spacings, lattice moved by {shift:g}: opening off by {np.sqrt((error ** 2).mean()):.2f} (rms), {error.max():.2f} (max) mm")


if __name__ == "__main__":
    main()
