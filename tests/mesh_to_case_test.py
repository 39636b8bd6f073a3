#!/usr/bin/env python3
"""Tests scripts/mesh_to_case.py: volumes, refusals, and a patch test through `mtled solve`. Exit 77: skipped, no meshio."""
import pathlib
import subprocess
import sys
import tempfile
import unittest

PROGRAM = sys.argv.pop(1)
SCRIPT = pathlib.Path(__file__).resolve().parent.parent / "scripts" / "mesh_to_case.py"

try:
    import meshio
    import numpy as np
except ImportError as error:
    print(f"SKIPPED: the conversion of meshes needs meshio and NumPy ({error}); install python3-meshio")
    sys.exit(77)

CELLS, SIDE = 5, 30.0  # mm


def cube():
    """Vertices and tetrahedra of a cube, six to a cell around its diagonal."""
    grid = np.stack(np.meshgrid(*[np.arange(CELLS + 1)] * 3, indexing="ij"), -1).reshape(-1, 3)
    index = lambda c: c @ [(CELLS + 1) ** 2, CELLS + 1, 1]
    tetrahedra = []
    for cell in grid[(grid < CELLS).all(1)]:
        for order in ((0, 1, 2), (1, 2, 0), (2, 0, 1), (0, 2, 1), (2, 1, 0), (1, 0, 2)):
            path = [cell]
            for axis in order:
                path.append(path[-1] + np.eye(3, dtype=int)[axis])
            corners = [index(p) for p in path]
            if order in ((0, 2, 1), (2, 1, 0), (1, 0, 2)):
                corners[1], corners[2] = corners[2], corners[1]
            tetrahedra.append(corners)
    return grid * SIDE / CELLS, np.array(tetrahedra)


class MeshToCase(unittest.TestCase):
    def setUp(self):
        scratch = tempfile.TemporaryDirectory()
        self.addCleanup(scratch.cleanup)
        self.folder = pathlib.Path(scratch.name)
        self.vertices, self.tetrahedra = cube()

    def convert(self, *more, vertices=None, cells=None, name="mesh.vtk", **how):
        mesh = meshio.Mesh(self.vertices if vertices is None else vertices, cells or [("tetra", self.tetrahedra)])
        mesh.write(self.folder / name, **how)
        return subprocess.run([sys.executable, SCRIPT, self.folder / name, self.folder / "case", *more], capture_output=True, text=True)

    def table(self, name):
        return np.loadtxt(self.folder / "case" / name, delimiter=",", skiprows=1, ndmin=2)

    def test_volume_and_points(self):
        for name, how in (("mesh.vtk", {}), ("mesh.msh", {"file_format": "gmsh22"})):
            for count in (1, 4, 5):
                done = self.convert("--points", str(count), name=name, **how)
                self.assertEqual(done.returncode, 0, done.stderr)
                points, nodes = self.table("points.csv"), self.table("nodes.csv")
                self.assertEqual(len(points), count * len(self.tetrahedra))
                self.assertAlmostEqual(points[:, 3].sum() / SIDE ** 3, 1, 6)
                np.testing.assert_allclose(points[:, :3].T @ points[:, 3] / SIDE ** 3, [SIDE / 2] * 3, rtol=1e-6)
                np.testing.assert_allclose(nodes, self.vertices, rtol=1e-8)
                np.testing.assert_array_equal(self.table("elements.csv"), self.tetrahedra)
                if count == 4:  # degree 2
                    self.assertAlmostEqual((points[:, 0] * points[:, 1]) @ points[:, 3] / (SIDE ** 5 / 4), 1, 6)
                    self.assertAlmostEqual(points[:, 2] ** 2 @ points[:, 3] / (SIDE ** 5 / 3), 1, 6)

    def test_scale_and_the_other_order_of_corners(self):
        done = self.convert("--scale", "1000", vertices=self.vertices / 1000, cells=[("tetra", self.tetrahedra[:, [1, 0, 2, 3]])])
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertAlmostEqual(self.table("points.csv")[:, 3].sum() / SIDE ** 3, 1, 6)

    def test_refusals(self):
        triangles = self.tetrahedra[:, :3]
        inverted = self.tetrahedra.copy()
        inverted[7] = inverted[7, [1, 0, 2, 3]]
        flat = self.tetrahedra.copy()
        flat[3, 3] = flat[3, 0]
        extra = np.vstack([self.vertices, [[99, 99, 99]]])
        for message, vertices, cells in (("no tetrahedra, it holds triangle", None, [("triangle", triangles)]),
                                         ("1 of 750 tetrahedra are inverted (negative volume), the first is number 7", None, [("tetra", inverted)]),
                                         ("1 tetrahedra are flat, the first is number 3", None, [("tetra", flat)]),
                                         ("1 of 217 vertices belong to no tetrahedron, the first is number 216", extra, None)):
            done = self.convert(vertices=vertices, cells=cells)
            self.assertEqual(done.returncode, 1)
            self.assertIn(message, done.stderr)
            self.assertFalse((self.folder / "case").exists())
        self.assertEqual(self.convert("--drop-unused", vertices=extra).returncode, 0)
        self.assertEqual(len(self.table("nodes.csv")), 216)
        (self.folder / "text.vtk").write_text("not a mesh")
        done = subprocess.run([sys.executable, SCRIPT, self.folder / "text.vtk", self.folder / "no"], capture_output=True, text=True)
        self.assertEqual(done.returncode, 1)
        self.assertIn("cannot be read as a mesh", done.stderr)

    def test_solved_patch(self):
        self.assertEqual(self.convert("--points", "4").returncode, 0)
        nodes = self.table("nodes.csv")
        gradient = np.array([[0.03, 0.05, 0], [0, -0.02, 0], [-0.02, 0, 0.01]])
        surface = np.flatnonzero(((nodes < 1e-6) | (nodes > SIDE - 1e-6)).any(1))
        case = self.folder / "case"
        (case / "constraints.csv").write_text("node,ux,uy,uz\n" + "".join(f"{n},{','.join(f'{v:.9g}' for v in gradient @ nodes[n])}\n" for n in surface))
        (case / "case.toml").write_text('[nodes]\nfile = "nodes.csv"\n[points]\nfile = "points.csv"\n[constraints]\nfile = "constraints.csv"\n[solver]\ntolerance_mm = 0.001\n')
        done = subprocess.run([PROGRAM, "solve", case / "case.toml", "-o", self.folder / "out", "--quiet"], capture_output=True, text=True)
        self.assertEqual(done.returncode, 0, done.stderr)
        solved = np.loadtxt(self.folder / "out" / "nodes.csv", delimiter=",", skiprows=1)
        error = np.linalg.norm(solved[:, 3:] - nodes @ gradient.T, axis=1).max()
        print(f"largest error of the patch {error:.4f} mm")
        self.assertLess(error, 0.02)


if __name__ == "__main__":
    unittest.main()
