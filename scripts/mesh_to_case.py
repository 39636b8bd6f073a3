#!/usr/bin/env python3
"""Turn a tetrahedral mesh (VTK, VTU, Gmsh, ... : all that meshio reads) into the tables of a case for `mtled solve`.

Writes to OUT_DIR:
  nodes.csv     x,y,z [mm]: the vertices that tetrahedra use, in the order of the mesh
  points.csv    x,y,z [mm], volume [mm^3]: 1, 4 or 5 integration points per tetrahedron
  elements.csv  n0,n1,n2,n3: the rows of nodes.csv that each tetrahedron joins

One point is the centroid; four are the quadrature of degree 2. The usual five points, of degree 3, have a negative weight,
but a point here stands for a piece of the body: each of the five gets a fifth of the volume, exact for linear functions.
A mesh in metres needs --scale 1000.
"""
import argparse
import csv
import pathlib
import sys

SKIPPED = 77
FLAT = 1e-9  # of the cube of the longest edge: a tetrahedron of less volume is flat
NEAR, FAR = 0.5854101966249685, 0.1381966011250105  # (5 + 3 sqrt 5) / 20, (5 - sqrt 5) / 20
RULES = {1: [[0.25] * 4],
         4: [[NEAR if i == j else FAR for i in range(4)] for j in range(4)],
         5: [[0.25] * 4] + [[0.5 if i == j else 1 / 6 for i in range(4)] for j in range(4)]}


def stop(problem):
    sys.exit(f"mesh_to_case: {problem}")


def read_tetrahedra(path):
    """Vertices [n, 3] and tetrahedra [m, 4] of a mesh file, the corners of curved ones."""
    import meshio
    import numpy as np
    try:
        mesh = meshio.read(path)
    except (Exception, SystemExit) as error:  # meshio ends the program for files that it does not know
        stop(f"'{path}' cannot be read as a mesh ({error}); is it a VTK or Gmsh file?")
    blocks = [block.data[:, :4] for block in mesh.cells if block.type in ("tetra", "tetra10")]
    if not blocks:
        kinds = ", ".join(sorted({block.type for block in mesh.cells})) or "nothing"
        stop(f"'{path}' has no tetrahedra, it holds {kinds}; mesh the volume, not only its surface")
    return np.asarray(mesh.points, float), np.concatenate(blocks).astype(int)


def convert(vertices, tetrahedra, per_tetrahedron, drop_unused):
    """Nodes [n, 3], points [k, 4] with their volume, and elements [m, 4]; stops where the mesh cannot be used."""
    import numpy as np
    if vertices.shape[1] != 3 or not np.isfinite(vertices).all():
        stop("the vertices are not finite places in three dimensions; repair the mesh")
    corners = vertices[tetrahedra]
    edges = corners[:, 1:] - corners[:, :1]
    volume = np.linalg.det(edges) / 6
    longest = np.linalg.norm(corners[:, :, None] - corners[:, None], axis=3).max((1, 2))
    flat = np.flatnonzero(np.abs(volume) <= FLAT * longest ** 3)
    if len(flat):
        stop(f"{len(flat)} tetrahedra are flat, the first is number {flat[0]}; remove or repair them in the mesher")
    inverted = np.flatnonzero(volume < 0)
    if len(inverted) == len(volume):
        tetrahedra, volume = tetrahedra[:, [0, 2, 1, 3]], -volume  # the other convention of order
        corners = vertices[tetrahedra]
    elif len(inverted):
        stop(f"{len(inverted)} of {len(volume)} tetrahedra are inverted (negative volume), the first is number {inverted[0]}; repair the mesh")
    used = np.unique(tetrahedra)
    unused = len(vertices) - len(used)
    if unused and not drop_unused:
        stop(f"{unused} of {len(vertices)} vertices belong to no tetrahedron, the first is number {np.setdiff1d(np.arange(len(vertices)), used)[0]}; "
             "remove them in the mesher, or use --drop-unused (this changes the numbers of the nodes)")
    number = np.full(len(vertices), -1)
    number[used] = np.arange(len(used))
    rule = np.array(RULES[per_tetrahedron])
    places = np.einsum("pc,tcx->tpx", rule, corners).reshape(-1, 3)
    return vertices[used], np.column_stack([places, np.repeat(volume / per_tetrahedron, per_tetrahedron)]), number[tetrahedra]


def write_csv(path, header, rows, form):
    with open(path, "w", newline="") as f:
        writer = csv.writer(f)
        writer.writerow(header)
        writer.writerows([[form(v) for v in row] for row in rows])


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("mesh", type=pathlib.Path)
    parser.add_argument("out", type=pathlib.Path, metavar="OUT_DIR")
    parser.add_argument("--points", type=int, choices=sorted(RULES), default=4, help="integration points per tetrahedron (default: 4; already 1 is about five per node)")
    parser.add_argument("--scale", type=float, default=1.0, metavar="FACTOR", help="of all coordinates, to mm (default: 1)")
    parser.add_argument("--drop-unused", action="store_true", help="leave out vertices that belong to no tetrahedron")
    a = parser.parse_args()
    try:
        import meshio, numpy  # noqa: F401
    except ImportError as error:
        print(f"SKIPPED: reading meshes needs meshio and NumPy ({error}); install python3-meshio, or meshio with pip", file=sys.stderr)
        sys.exit(SKIPPED)
    if not a.mesh.is_file():
        stop(f"'{a.mesh}' is not a file")
    if not a.scale > 0:
        stop(f"--scale is {a.scale}; it must be positive")
    vertices, tetrahedra = read_tetrahedra(a.mesh)
    nodes, points, elements = convert(a.scale * vertices, tetrahedra, a.points, a.drop_unused)
    a.out.mkdir(parents=True, exist_ok=True)
    real = lambda v: f"{v:.9g}"
    write_csv(a.out / "nodes.csv", ["x", "y", "z"], nodes, real)
    write_csv(a.out / "points.csv", ["x", "y", "z", "volume"], points, real)
    write_csv(a.out / "elements.csv", ["n0", "n1", "n2", "n3"], elements, str)
    print(f"{len(nodes)} nodes, {len(points)} points ({len(points) / len(nodes):.2f} per node), {len(elements)} tetrahedra, volume {points[:, 3].sum():.6g} mm^3")


if __name__ == "__main__":
    main()
