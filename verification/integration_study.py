#!/usr/bin/env python3
"""Which integration of which cells matters: reference problems with variants of their integration points, as a table.

Every variant is used as it is given (`points.align = false`); shapes of supports and everything else stay the same.
"""
import argparse
import json
import pathlib
import subprocess
import tempfile

import numpy as np

from compare import Comparison
from make_case import cells_between, evaluate, make_case, material_at, write_csv, CELLS_PER_NODE, SMALLEST_PART

HERE = pathlib.Path(__file__).resolve().parent
CASES = (("l_shape", 5), ("two_material_bar", 5), ("cube_extension", 5), ("spine_in_block", 4))
SAMPLES = 12  # per axis and cell; lattice planes that cut background cells then fall between samples here
NEGLIGIBLE = 1e-6  # of a modulus: points that carry only shear or only change of volume


class Lattice:
    """Lattice cells by number: all corners are nodes and some are prescribed (`coupled`), all are (`rigid`), or a node is missing in a support (`one_sided`)."""

    def __init__(self, problem, spacing, folder):
        read = lambda name: np.genfromtxt(folder / name, delimiter=",", names=True, dtype=None, encoding=None)
        nodes = np.column_stack([read("nodes.csv")[a] for a in "xyz"])
        self.low, self.spacing = np.array(problem["geometry"]["bounding_box"], float)[0], spacing
        ijk = np.round((nodes - self.low) / spacing).astype(int)
        self.cells = ijk.max(0)
        is_node, prescribed = (np.zeros(self.cells + 1, bool) for _ in range(2))
        is_node[tuple(ijk.T)] = True
        prescribed[tuple(ijk[read("constraints.csv")["node"]].T)] = True
        around = lambda flags, reach: [np.pad(flags, 1)[tuple(slice(s, s + n) for s, n in zip(shift, self.cells))] for shift in cells_between(*[reach] * 3)]
        full = np.all(around(is_node, [1, 2]), 0)
        self.coupled = full & np.any(around(prescribed, [1, 2]), 0)
        self.rigid = np.all(around(prescribed, [1, 2]), 0)
        self.one_sided = ~np.all(around(is_node, range(4)), 0)
        self.every = np.ones(self.cells, bool)

    def holds(self, mask, X):
        ijk = np.clip(np.floor((X - self.low) / self.spacing + 1e-9).astype(int), 0, self.cells - 1)
        return mask[tuple(ijk.T)]


def points_in(problem, lattice, mask, per_cell, shear=1, volumetric=1):
    """[n, 6] x, y, z, volume, moduli in the lattice cells of `mask`: per_cell^3 points each, or (0) those of a background lattice."""
    low, high = np.array(problem["geometry"]["bounding_box"], float)
    cells = lattice.cells * per_cell if per_cell else np.maximum(np.round((high - low) / (lattice.spacing / CELLS_PER_NODE ** (1 / 3))).astype(int), 1)
    edge = np.full(3, lattice.spacing / per_cell) if per_cell else (high - low) / cells
    samples = (cells_between(*[np.arange(SAMPLES)] * 3) + 0.5) / SAMPLES
    rows = []
    for i in range(cells[0]):
        P = low + edge * (cells_between([i], np.arange(cells[1]), np.arange(cells[2]))[:, None] + samples)
        flat = P.reshape(-1, 3)
        inside = evaluate(problem["geometry"]["inside"], flat) & lattice.holds(mask, flat)
        number = material_at(problem, flat)
        for m, material in enumerate(problem["materials"]):
            here = (inside & (number == m)).reshape(P.shape[:2])
            keep = here.mean(1) > SMALLEST_PART
            centroid = (P * here[..., None]).sum(1)[keep] / here.sum(1)[keep, None]
            moduli = np.broadcast_to([shear * material["shear_modulus_kpa"], volumetric * material["bulk_modulus_kpa"]], (keep.sum(), 2))
            rows.append(np.column_stack([centroid, here.mean(1)[keep] * edge.prod(), moduli]))
    return np.concatenate(rows)


def variants(lattice):
    """Name and list of arguments for points_in(); cells that are wholly prescribed have one point each in all but the first."""
    soft, free = lattice.coupled & ~lattice.rigid, ~lattice.coupled
    rigid = (lattice.rigid, 1)
    cut = (lattice.one_sided | lattice.coupled) & ~lattice.rigid
    shear, volumetric = (1, NEGLIGIBLE), (NEGLIGIBLE, 1)
    yield "background cells everywhere (what make_case.py gives)", [(lattice.every, 0)]
    yield "coupled cells: 1 point", [(free, 0), (soft, 1), rigid]
    yield "coupled cells: 2 x 2 x 2", [(free, 0), (soft, 2), rigid]
    yield "coupled cells: 2 x 2 x 2 for shear, 1 for volume", [(free, 0), (soft, 2, *shear), (soft, 1, *volumetric), rigid]
    yield "cells with one-sided supports, and coupled ones: 2 x 2 x 2", [(~cut & ~lattice.rigid, 0), (cut, 2), rigid]
    yield "every cell: 2 x 2 x 2", [(~lattice.rigid, 2), rigid]
    yield "every cell: 1 for volume; shear: background cells, coupled ones 2 x 2 x 2", [
        (free, 0, *shear), (soft, 2, *shear), (~lattice.rigid, 1, *volumetric), rigid]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mtled", default=HERE.parent / "build" / "bin" / "mtled", type=pathlib.Path, metavar="PROGRAM", help="default: build/bin/mtled")
    a = parser.parse_args()
    print("| case | points | number | median mm | 95 % mm | 99.5 % mm | within 1 %: interior, all | energy | reaction |\n" + "|---" * 9 + "|")
    for case, spacing in CASES:
        with tempfile.TemporaryDirectory(prefix="mtled-integration-") as scratch:
            folder = pathlib.Path(scratch)
            make_case(HERE / case, spacing, folder)
            settings = (folder / "case.toml").read_text()
            (folder / "case.toml").write_text(settings.replace('file = "points.csv"', 'file = "points.csv"\nalign = false'))
            problem = json.loads((HERE / case / "problem.json").read_text())
            lattice = Lattice(problem, spacing, folder)
            for name, parts in variants(lattice):
                points = np.concatenate([points_in(problem, lattice, *part) for part in parts])
                write_csv(folder / "points.csv", ["x", "y", "z", "volume", "shear_modulus_kpa", "bulk_modulus_kpa"], points.tolist())
                subprocess.run([a.mtled, "solve", folder / "case.toml", "--output", folder / "result", "--force", "--quiet"], check=True, stdout=subprocess.DEVNULL)
                c = Comparison(HERE / case, folder / "result")
                print(f"| {case}, {spacing} mm | {name} | {len(points)} | " + " | ".join(f"{q:.3f}" for q in c.percentiles()[:3])
                      + f" | {c.within(0.01 * c.largest, 'interior'):.1f} %, {c.within(0.01 * c.largest):.1f} % | {c.energy_percent():+.2f} % "
                      f"| {max(c.reaction_percents().values()):.2f} % |", flush=True)


if __name__ == "__main__":
    main()
