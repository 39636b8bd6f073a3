#!/usr/bin/env python3
"""Tests scripts/compare.py on a small pair: the table against the evaluations, what is not done twice, and refusals."""
import array
import importlib.util
import json
import math
import pathlib
import subprocess
import sys
import tempfile
import unittest

PROGRAM = sys.argv.pop(1)
SCRIPT = pathlib.Path(__file__).resolve().parent.parent / "scripts" / "compare.py"
SIZE, SPACING = (40, 34, 32), 4.0  # voxels, mm
SHIFT = 8.0  # mm to the left of the upper vertebra, and of all that lies at its height
LEAST_DICE = 0.95  # of the vertebrae after mechanics; 1.000 was measured
MOST_LEFT = 0.5  # of the mean distance of the landmarks after mechanics, which knows the vertebrae alone; 0.49 was measured
ROWS = ["none", "rigid", "B-spline", "mechanics", "mechanics then B-spline"]


def shift(z):
    """Displacement along x [mm] at height z: 0 below 45 mm, SHIFT above 80 mm."""
    t = min(1.0, max(0.0, (z - 45) / 35))
    return SHIFT * t * t * (3 - 2 * t)


def intensity(x, y, z):
    """A trunk with two vertebrae and round organs in air, with some texture, HU."""
    if math.hypot((x - 78) / 60, (y - 66) / 50) > 1:
        return -1000
    texture = round(15 * (math.sin(x / 7) + math.cos(y / 9) + math.sin(z / 8)))
    if vertebra(x, y, z):
        return 700 + texture
    for cx, cy, cz, radius, value in ((50, 55, 40, 18, -90), (105, 55, 85, 20, 120), (60, 45, 95, 14, -300), (100, 60, 30, 16, 200)):
        if math.dist((x, y, z), (cx, cy, cz)) < radius:
            return value + texture
    return 40 + texture


def vertebra(x, y, z):
    if abs(x - 78) > 12 or abs(y - 92) > 10:
        return 0
    return 1 if 14 < z < 42 else 2 if 82 < z < 110 else 0


def voxels(value, moved):
    """value(x, y, z) at every voxel, x fastest; of the fixed image where `moved`."""
    return [value(i * SPACING - (shift(k * SPACING) if moved else 0), j * SPACING, k * SPACING) for k in range(SIZE[2]) for j in range(SIZE[1]) for i in range(SIZE[0])]


def write_nrrd(path, values, code, kind):
    header = f"NRRD0004\ntype: {kind}\ndimension: 3\nspace: left-posterior-superior\nsizes: {SIZE[0]} {SIZE[1]} {SIZE[2]}\n"
    header += f"space directions: ({SPACING},0,0) (0,{SPACING},0) (0,0,{SPACING})\nkinds: domain domain domain\nendian: little\nencoding: raw\nspace origin: (0,0,0)\n\n"
    data = array.array(code, values)
    if sys.byteorder == "big":
        data.byteswap()
    path.write_bytes(header.encode() + data.tobytes())


class Compare(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        scratch = tempfile.TemporaryDirectory()
        cls.addClassCleanup(scratch.cleanup)
        cls.folder = pathlib.Path(scratch.name)
        for name, moved in (("moving", False), ("fixed", True)):
            write_nrrd(cls.folder / f"{name}.nrrd", voxels(intensity, moved), "h", "int16")
            write_nrrd(cls.folder / f"{name}_labels.nrrd", voxels(vertebra, moved), "B", "uint8")
        identity = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
        motions = [{"label": n, "center": [78, 92, z], "R": identity, "t": [x, 0, 0]} for n, z, x in ((1, 28, 0), (2, 96, SHIFT))]
        (cls.folder / "motions.json").write_text(json.dumps({"convention": "LPS mm; y = R (x - center) + center + t, moving to fixed", "labels": motions}))
        (cls.folder / "quick.toml").write_text("evaluations = 15\nsamples = 20000\n")
        places = [(50, 60, 20), (105, 60, 30), (60, 50, 100), (100, 70, 105)]
        (cls.folder / "landmarks.csv").write_text("mx,my,mz,fx,fy,fz\n" + "".join(f"{x},{y},{z},{x + shift(z)},{y},{z}\n" for x, y, z in places))

    def compare(self, *more, **named):
        files = {"moving": "moving.nrrd", "fixed": "fixed.nrrd", "moving-labels": "moving_labels.nrrd", "fixed-labels": "fixed_labels.nrrd", "landmarks": "landmarks.csv", "baseline-config": "quick.toml"} | named
        options = [text for name, file in files.items() for text in ("--" + name, str(self.folder / file))]
        return subprocess.run([sys.executable, "-B", SCRIPT, "--program", PROGRAM, *options, "--output", self.folder / "out", *more], capture_output=True, text=True)

    def test_table_of_all_registrations(self):
        mechanics = ["--", "--motions", self.folder / "motions.json", "--node-spacing", "8"]
        done = self.compare(*mechanics)
        self.assertEqual(done.returncode, 0, done.stderr)
        lines = [[cell.strip() for cell in line.strip("|").split("|")] for line in done.stdout.splitlines() if line.startswith("|")]
        head, table = lines[0], {line[0]: dict(zip(lines[0], line)) for line in lines[2:]}
        self.assertEqual(list(table), ROWS)
        self.assertTrue(all(len(line) == len(head) for line in lines))
        self.assertIn(done.stdout.strip(), (self.folder / "out" / "comparison.md").read_text())
        report = json.loads((self.folder / "out" / "evaluation" / "evaluation.json").read_text())
        self.assertTrue((self.folder / "out" / "evaluation" / "report.html").exists())
        for name in ROWS:
            key, row = {"none": "before", "mechanics": "after"}.get(name, name), table[name]
            self.assertEqual(row["H95 mm"], f"{report['edges'][key]['hausdorff_all_edges_mm'][3]:.2f}")
            self.assertEqual(row["max"], f"{report['landmarks'][key]['max_mm']:.2f}")
            dice = [label["dice"] for label in report["labels"][key]]
            self.assertEqual(row["Dice (mean)"], f"{sum(dice) / 2:.3f}")
            if name != "none":
                field = report["field"] if key == "after" else report["beside"][name]
                self.assertEqual(row["folded voxels"], str(field["jacobian"]["folded_voxels"]))
        self.assertEqual(table["none"]["max"], f"{SHIFT:.2f}")  # two landmarks move by all of it
        self.assertEqual(table["none"]["landmarks: mean mm"], f"{SHIFT / 2:.2f}")
        self.assertGreater(float(table["mechanics"]["Dice (mean)"]), LEAST_DICE)
        self.assertLess(float(table["mechanics"]["landmarks: mean mm"]), MOST_LEFT * SHIFT / 2)
        self.assertEqual((self.folder / "out" / "percentiles.png").exists(), importlib.util.find_spec("matplotlib") is not None)
        commands = (self.folder / "out" / "comparison.md").read_text()
        self.assertEqual(sum(commands.count(verb) for verb in ("mtled register", "mtled baseline", "mtled evaluate")), 5)
        times = {file: file.stat().st_mtime_ns for file in (self.folder / "out").glob("*/*.nrrd")}
        again = self.compare(*mechanics)
        self.assertEqual(again.returncode, 0, again.stderr)
        self.assertEqual(again.stdout, done.stdout)
        self.assertEqual((self.folder / "out" / "comparison.md").read_text(), commands)
        self.assertEqual({file: file.stat().st_mtime_ns for file in times}, times, "registrations that are there are not done again")
        other = self.compare(*mechanics[:-1], "9")
        self.assertNotEqual(other.returncode, 0)
        self.assertIn("results of another command", other.stderr)

    def test_refusals(self):
        done = self.compare(moving="absent.nrrd")
        self.assertNotEqual(done.returncode, 0)
        self.assertIn("ended with code 3", done.stderr)
        self.assertIn("absent.nrrd", done.stderr)


if __name__ == "__main__":
    unittest.main()
