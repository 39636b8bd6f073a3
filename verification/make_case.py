#!/usr/bin/env python3
"""Discretise a reference problem on a node lattice and write it as a case for `mtled solve`.

Nodes are all corners of the lattice cells that reach into the solid (with --surface only those inside it), the lattice
aligned with the bounding box; integration points are the cells of a finer lattice (about two per node), each at the
centroid of its part inside the solid and weighted by that part's volume; a cell on the interface of two materials gives
a point for each (with --unsplit one, of the material at its centroid).
--jitter moves interior nodes at random by up to FRACTION of the spacing, --surface adds nodes on a curved surface, where
the lattice lines leave the solid (in both cases the cloud is no lattice).
"""
import argparse
import csv
import json
import pathlib

import numpy as np

CELLS_PER_NODE = 2.0   # integration cells per node
SUBSAMPLES = 6         # per axis and cell, for the inside fraction
SMALLEST_CELL = 0.1    # share of a lattice cell inside the solid for its corners to be nodes
SMALLEST_PART = 0.02   # of a cell; smaller parts are left out
CLOSEST = 0.4          # of the spacing: no lattice node stays nearer to a surface node


def evaluate(expression, X):
    """Value of a NumPy expression in x, y, z at the rows of X."""
    names = {"x": X[:, 0], "y": X[:, 1], "z": X[:, 2], "np": np, "bool": bool, "sin": np.sin, "cos": np.cos,
             "sqrt": np.sqrt, "pi": np.pi, "abs": np.abs, "hypot": np.hypot}
    return np.broadcast_to(eval(str(expression), {"__builtins__": {}}, names), (len(X),))


def cells_between(*numbers):
    """[n, 3] lattice positions, one range or list per axis."""
    return np.stack(np.meshgrid(*numbers, indexing="ij"), -1).reshape(-1, 3)


def subsamples():
    """[n, 3] sample positions in a unit cell."""
    return (cells_between(*[np.arange(SUBSAMPLES)] * 3) + 0.5) / SUBSAMPLES


def lattice_nodes(problem, h, jitter, outer, rng):
    """All corners of the lattice cells that are at least a tenth inside the solid; only those inside it unless `outer`."""
    inside = lambda X: evaluate(problem["geometry"]["inside"], X)
    low, high = np.array(problem["geometry"]["bounding_box"], float)
    cells = cells_between(*[np.arange(n) for n in np.ceil((high - low) / h - 1e-9).astype(int)])
    share = np.zeros(len(cells))
    for s in subsamples():
        share += inside(low + h * (cells + s)) / SUBSAMPLES ** 3
    corners = (cells[share >= SMALLEST_CELL, None] + cells_between([0, 1], [0, 1], [0, 1])).reshape(-1, 3)
    X = low + h * np.unique(corners, axis=0)
    if not outer:
        X = X[inside(X)]
    if jitter:
        deep = np.ones(len(X), bool)
        for step in np.concatenate([h * np.eye(3), -h * np.eye(3)]):
            deep &= inside(X + step)
        for c in problem["geometry"]["constraints"]:
            deep &= ~evaluate(c["where"], X)
        X[deep] += h * jitter * rng.uniform(-1, 1, (deep.sum(), 3))
    return X, low


def with_surface_nodes(problem, X, h):
    """X and the points where lattice lines leave the solid, found by bisection; nodes that lie too close are dropped."""
    inside = lambda P: evaluate(problem["geometry"]["inside"], P)
    found = np.empty((0, 3))
    for step in np.concatenate([h * np.eye(3), -h * np.eye(3)]):
        a = X[~inside(X + step)]
        b = a + step
        for _ in range(50):
            middle = (a + b) / 2
            here = inside(middle)[:, None]
            a, b = np.where(here, middle, a), np.where(here, b, middle)
        for p in a:
            if not len(found) or np.linalg.norm(found - p, axis=1).min() > CLOSEST * h:
                found = np.vstack([found, p])
    far = np.array([np.linalg.norm(found - p, axis=1).min() > CLOSEST * h for p in X])
    return np.vstack([X[far], found])


def material_at(problem, X):
    """Number of the material at each row of X, -1 where there is none."""
    number = np.full(len(X), -1)
    for m, material in enumerate(problem["materials"]):
        number[evaluate(material.get("where", "x==x"), X)] = m
    return number


def integration_points(problem, h, split):
    """[n, 4] x, y, z, volume and [n] number of the material."""
    low, high = np.array(problem["geometry"]["bounding_box"], float)
    cells = np.maximum(np.round((high - low) / (h / CELLS_PER_NODE ** (1 / 3))).astype(int), 1)
    edge = (high - low) / cells
    samples, points, number = subsamples(), [], []

    def append(P, inside):
        """Points of the cells whose samples P [cells, samples, 3] are partly inside."""
        fraction = inside.mean(1)
        keep = fraction > SMALLEST_PART
        centroid = (P * inside[..., None]).sum(1)[keep] / inside.sum(1)[keep, None]
        points.append(np.column_stack([centroid, fraction[keep] * edge.prod()]))
        return centroid

    for i in range(cells[0]):
        P = low + edge * (cells_between([i], np.arange(cells[1]), np.arange(cells[2]))[:, None] + samples)
        inside = evaluate(problem["geometry"]["inside"], P.reshape(-1, 3)).reshape(P.shape[:2])
        if split:
            material = material_at(problem, P.reshape(-1, 3)).reshape(P.shape[:2])
            for m in range(len(problem["materials"])):
                number.append(np.full(len(append(P, inside & (material == m))), m))
        else:
            number.append(material_at(problem, append(P, inside)))
    return np.concatenate(points), np.concatenate(number)


def constraints(problem, nodes):
    """Rows node, ux, uy, uz, set; a node belongs to the first set that holds it, a free component is empty."""
    rows, taken = [], set()
    for c in problem["geometry"]["constraints"]:
        chosen = np.flatnonzero(evaluate(c["where"], nodes))
        u = [None if e is None else evaluate(e, nodes[chosen]) for e in c["displacement"]]
        for j, n in enumerate(chosen):
            if n not in taken:
                taken.add(n)
                rows.append([int(n)] + ["" if v is None else f"{v[j]:.9g}" for v in u] + [c["set"]])
    return rows


def write_csv(path, header, rows):
    with open(path, "w", newline="") as f:
        writer = csv.writer(f)
        writer.writerow(header)
        writer.writerows([[f"{v:.9g}" if isinstance(v, float) else v for v in r] for r in rows])


def make_case(source, spacing, out, jitter=0.0, surface=False, split=True, solver=None):
    """Writes case.toml and its tables to `out`; `solver`: keys of its [solver] table."""
    source, out = pathlib.Path(source), pathlib.Path(out)
    out.mkdir(parents=True, exist_ok=True)
    problem = json.loads((source / "problem.json").read_text())
    nodes, origin = lattice_nodes(problem, spacing, jitter, not surface, np.random.default_rng(1))
    if surface:
        nodes = with_surface_nodes(problem, nodes, spacing)
    points, number = integration_points(problem, spacing, split)
    assert (number >= 0).all(), "an integration point lies in no material"
    moduli = np.array([[m["shear_modulus_kpa"], m["bulk_modulus_kpa"]] for m in problem["materials"]])[number]
    held = constraints(problem, nodes)
    probes = np.genfromtxt(source / "probes.csv", delimiter=",", names=True, dtype=None, encoding=None)
    write_csv(out / "nodes.csv", ["x", "y", "z"], nodes.tolist())
    write_csv(out / "points.csv", ["x", "y", "z", "volume", "shear_modulus_kpa", "bulk_modulus_kpa"],
              np.column_stack([points, moduli]).tolist())
    write_csv(out / "constraints.csv", ["node", "ux", "uy", "uz", "set"], held)
    write_csv(out / "probes.csv", ["x", "y", "z"], [[float(r[c]) for c in "xyz"] for r in probes])
    lattice = "" if jitter or surface else f"lattice = {{ origin = {origin.tolist()}, spacing = {spacing} }}\n"
    settings = "\n".join(f"{key} = {json.dumps(value)}" for key, value in (solver or {"tolerance_mm": 0.05}).items())
    (out / "case.toml").write_text(
        f'[nodes]\nfile = "nodes.csv"\n{lattice}\n[points]\nfile = "points.csv"\n\n'
        f'[material]\nmodel = "neo-hookean"\ndensity_kg_mm3 = 1e-6\n\n[constraints]\nfile = "constraints.csv"\n\n'
        f'[probes]\nfile = "probes.csv"\n\n[solver]\n{settings}\n')
    return (f"{len(nodes)} nodes, {len(points)} points, {len(held)} constrained nodes, {len(probes)} probes, "
            f"volume {points[:, 3].sum():.6g} mm^3")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("problem", help="folder of a reference problem")
    parser.add_argument("spacing", type=float, help="of the nodes [mm]")
    parser.add_argument("out", help="folder for case.toml and its tables")
    parser.add_argument("--jitter", type=float, default=0.0, metavar="FRACTION", help="of the spacing")
    parser.add_argument("--surface", action="store_true")
    parser.add_argument("--unsplit", action="store_true")
    parser.add_argument("--tolerance", type=float, default=0.05, metavar="MM")
    a = parser.parse_args()
    print(make_case(a.problem, a.spacing, a.out, a.jitter, a.surface, not a.unsplit, {"tolerance_mm": a.tolerance}))


if __name__ == "__main__":
    main()
