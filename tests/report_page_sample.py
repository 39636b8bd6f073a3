#!/usr/bin/env python3
"""Sample data for the page of report.html, of a torso phantom with a known displacement. As a program: report_page_sample.py FILE [register|evaluate|compared|minimal]."""
import base64
import io
import json
import pathlib
import sys

import numpy as np
from PIL import Image

PAGE = pathlib.Path(__file__).resolve().parent.parent / "src" / "report" / "page"
SPACING = 4.0  # mm
SIZE = (88, 60, 104)  # voxels, x y z
ORIGIN = (-174.0, -120.0, -90.0)  # mm
LOW, HIGH = -1000, 400  # HU
FOLDED = (slice(30, 33), slice(28, 31), slice(50, 53))  # voxels z y x that fold
KNOWN = (slice(48, 57), slice(18, 27), slice(30, 39))  # voxels z y x of known intensity
CUT = (slice(4, 100), slice(3, 60), slice(2, 84))  # voxels z y x of the moving image: its grid is another
OTHERS = ("B-spline", "ANTs", "elastix", "Demons", "Optimum")  # as many as `evaluate` compares
KNOWN_HU = {"fixed": 80, "mtled": -20}
NODE_LABELS = [*range(8, 16), 1300]  # of the vertebrae, from the feet; one of them does not fit in a byte


def assemble(report):
    """The page with its style, scripts and data in place of the markers, as the program does it."""
    scripts = "".join((PAGE / name).read_text() for name in (PAGE / "scripts.txt").read_text().split())
    page = (PAGE / "page.html").read_text()
    for marker, text in {"/*STYLE*/": (PAGE / "page.css").read_text(), "/*SCRIPT*/": scripts, "/*DATA*/": json.dumps(report, allow_nan=False).replace("</", "<\\/")}.items():
        assert page.count(marker) == 1, marker
        page = page.replace(marker, text)
    return page


def grid():
    """Positions [mm] of all voxels, x y z, each [z, y, x]."""
    z, y, x = np.meshgrid(*(ORIGIN[a] + SPACING * np.arange(SIZE[a]) for a in (2, 1, 0)), indexing="ij")
    return np.array([x, y, z])


def torso(p):
    """Hounsfield units at points: heart and stomach on the patient's left, liver on the right, spine at the back, neck at the head."""
    x, y, z = p
    hu = np.full(x.shape, -1000.0)
    inside = lambda cx, cy, cz, rx, ry, rz, power=2: (np.abs((x - cx) / rx) ** power + np.abs((y - cy) / ry) ** power + np.abs((z - cz) / rz) ** power) < 1
    wide = np.where(z > 240, 58, 140 - 0.0009 * (z - 110) ** 2)
    body = ((x / wide) ** 2 + (y / (0.62 * wide)) ** 2 < 1) & (z > -80)
    hu[body] = -90  # fat
    hu[body & ((x / (wide - 12)) ** 2 + (y / (0.62 * wide - 12)) ** 2 < 1)] = 45
    for side in (-1, 1):
        hu[body & inside(side * 58, -4, 165, 42, 58, 75, 3)] = -830
    hu[inside(24, -22, 150, 46, 38, 44)] = 40  # heart
    hu[inside(-52, -8, 62, 62, 58, 38)] = 75  # liver
    hu[inside(58, -20, 60, 34, 30, 30)] = 10  # stomach
    hu[inside(52, -42, 68, 18, 10, 14)] = -950  # gas in it
    spine = ((x / 17) ** 2 + ((y - 52) / 15) ** 2 < 1) & (z > -70)
    hu[spine] = np.where((z[spine] + 100) % 32 < 26, 330, 90)
    hu[inside(0, 76, 100, 5, 12, 500) & body] = 300
    for angle in np.linspace(0.5, 2 * np.pi - 0.5, 15):
        hu[inside((wide.max() - 16) * np.sin(angle) * 0.93, 0.6 * (wide.max() - 14) * np.cos(angle), 150, 6, 6, 80) & body & ((z + 100) % 26 < 11)] = 320
    for side in (-1, 1):
        hu[inside(side * 82, 16, -35, 34, 26, 36) & ~inside(side * 76, 6, -25, 30, 22, 34)] = 310
    return hu


def displacement(p):
    """v(y) [mm]: the point y of the fixed image came from y + v(y) of the moving one."""
    x, y, z = p
    s = (z + 80) / 330
    return np.array([22 * np.sin(np.pi * s) * (1 - 0.15 * np.cos(y / 50)), 14 * s**2 + 3 * np.sin(x / 40), -9 * s - 0.07 * x * np.cos(np.pi * s)])


def mosaic(volume, form):
    """The mosaic of axial slices of bytes [z, y, x]; tiles are wider than slices."""
    nz, ny, nx = volume.shape
    columns, (tw, th) = 10, (nx + 2, ny + 1)
    sheet = np.zeros((-(-nz // columns) * th, columns * tw), np.uint8)
    for k in range(nz):
        r, c = divmod(k, columns)
        sheet[r * th : r * th + ny, c * tw : c * tw + nx] = volume[k]
    file = io.BytesIO()
    Image.fromarray(sheet).save(file, form, **({"quality": 92} if form == "JPEG" else {}))
    return {"tile": [tw, th], "columns": columns, "picture": f"data:image/{form.lower()};base64,{base64.b64encode(file.getvalue()).decode()}"}


def byte_of(hu):
    return np.clip(np.rint((hu - LOW) / (HIGH - LOW) * 255), 0, 255).astype(np.uint8)


def grey(name, title, hu, space="fixed", form="JPEG"):
    return {"id": name, "name": title, "space": space, "kind": "grey", "low": LOW, "high": HIGH, "unit": "HU", "mosaic": mosaic(byte_of(hu), form),
            "windows": [{"name": "Soft tissue", "low": -160, "high": 240}, {"name": "Lung", "low": -1000, "high": 0}, {"name": "Bone", "low": -100, "high": 400}]}


def scalar(name, title, values, known, low, high, unit, **more):
    bytes_ = np.where(known, np.clip(np.rint((values - low) / (high - low) * 254) + 1, 1, 255), 0).astype(np.uint8)
    return {"id": name, "name": title, "space": "fixed", "kind": "scalar", "low": low, "high": high, "unit": unit, "map": "sequential", "mosaic": mosaic(bytes_, "PNG"), **more}


def edge_voxels(hu):
    """Where a step of more than 60 HU lies between a voxel and the next along an axis."""
    found = np.zeros(hu.shape, bool)
    for axis in range(3):
        step = np.abs(np.diff(hu, axis=axis)) > 60
        found |= np.pad(step, [(0, int(a == axis)) for a in range(3)])
    return found


def base64_of(array):
    return base64.b64encode(np.ascontiguousarray(array).tobytes()).decode()


class Phantom:
    """Images, displacement, volume ratio and edges on the grid of the page, [z, y, x]."""

    def __init__(self):
        y = grid()
        self.v = displacement(y)
        rigid = np.array([15.0, 5.0, -4.5])[:, None, None, None]
        nearly = self.v + 2.5 * np.sin(y[[1, 2, 0]] / 23) * (np.abs(y[2] - 60) < 70)
        noise = np.random.default_rng(3).normal(0, 12, y.shape[1:])
        self.hu = {name: torso(p) + noise for name, p in {"fixed": y + self.v, "before": y, "rigid": y + rigid, "mtled": y + nearly}.items()}
        for name, hu in KNOWN_HU.items():
            self.hu[name][KNOWN] = hu
        self.body = torso(y + self.v) > -1000
        gradient = np.array([[np.gradient(self.v[a], SPACING, axis=2 - b) for b in range(3)] for a in range(3)])
        f = np.moveaxis(gradient, (0, 1), (-2, -1)) + np.eye(3)
        self.jacobian = np.linalg.det(f)
        self.jacobian[FOLDED] = -0.2
        self.edges = {name: edge_voxels(torso(p)) for name, p in {"fixed": y + self.v, "before": y, "rigid": y + rigid, "mtled": y + nearly}.items()}
        self.kpa = np.select([self.hu["before"] < -500, self.hu["before"] > 200, self.hu["before"] < -40], [0.5, 40.0, 1.0], 3.4)


def view(phantom, names, mechanics=True):
    titles = {"fixed": "Fixed image", "before": "Before", "rigid": "Rigid", "mtled": "mtled", "after": "After"}
    hu = {**{n: phantom.hu["rigid"] for n in OTHERS}, "after": phantom.hu["mtled"], **phantom.hu}
    volumes = [grey(n, titles.get(n, n), hu[n], form="PNG" if n in KNOWN_HU else "JPEG") for n in names]
    bits = {str(1 << i): n for i, n in enumerate(names)}
    edges = {**{n: phantom.edges["rigid"] for n in OTHERS}, "after": phantom.edges["mtled"], **phantom.edges}
    volumes.append({"id": "edges", "space": "fixed", "kind": "bits", "bits": bits, "mosaic": mosaic(sum((edges[n].astype(np.uint8) << i for i, n in enumerate(names)), np.zeros(phantom.body.shape, np.uint8)), "PNG")})
    space = {"size": list(SIZE), "spacing_mm": SPACING, "origin_mm": list(ORIGIN)}
    made = {"spaces": {"fixed": space}, "volumes": volumes}
    if not mechanics:
        return made
    size = np.linalg.norm(phantom.v, axis=0)
    volumes += [scalar("displacement", "Displacement", size, phantom.body, 0, float(size[phantom.body].max()), "mm"),
                scalar("jacobian", "Volume ratio", phantom.jacobian, phantom.body, -0.4, 1.4, "moving / fixed", map="diverging", middle=1),
                grey("moving", "Moving image", phantom.hu["before"][CUT], "moving"),
                {**scalar("shear_modulus", "Shear modulus", phantom.kpa[CUT], phantom.hu["before"][CUT] > -950, 0, 5, "kPa", open_end=True), "space": "moving"}]
    made["spaces"]["moving"] = {"size": [s.stop - s.start for s in CUT[::-1]], "spacing_mm": SPACING, "origin_mm": [o + SPACING * s.start for o, s in zip(ORIGIN, CUT[::-1])]}
    coarse, step = [n // 4 for n in SIZE], 4
    at = phantom.v[:, ::step, ::step, ::step][:, : coarse[2], : coarse[1], : coarse[0]]
    there = phantom.body[::step, ::step, ::step][: coarse[2], : coarse[1], : coarse[0]]
    numbers = np.where(there, np.rint(at / 0.01), -32768).astype("<i2")
    made["arrows"] = {"space": "fixed", "size": coarse, "spacing_mm": SPACING * step, "origin_mm": list(ORIGIN), "scale_mm": 0.01, "data": base64_of(np.moveaxis(numbers, 0, -1))}
    return made


def edge_figures(scale):
    """Curves like those of a registration whose edges are `scale` mm off in the median."""
    p = np.arange(1, 101) / 100
    everything = scale * np.maximum(0, np.tan(1.49 * p**1.3) - 0.15)
    consistent = 0.7 * scale * np.maximum(0, np.tan(1.45 * p**1.4) - 0.2)
    at = lambda curve: [float(curve[q - 1]) for q in (60, 75, 85, 95)]
    share = lambda curve: float((curve <= 5).mean())
    return {"hausdorff_1_to_100_mm": consistent.tolist(), "hausdorff_1_to_100_all_edges_mm": everything.tolist(), "percent": [60, 75, 85, 95], "hausdorff_mm": at(consistent), "hausdorff_all_edges_mm": at(everything),
            "mean_mm": float(consistent.mean()), "modified_hausdorff_mm": float(consistent.mean()), "within_two_voxels": share(consistent), "within_two_voxels_all_edges": share(everything), "two_voxels_mm": 5.0,
            "consistent_fraction": [0.9 - 0.05 * scale, 0.88 - 0.05 * scale], "edge_voxels": [182345, 179021]}


def contour_figures(scale):
    """Distances of two outlines in both directions; more voxels than distances, as some slices show one outline only."""
    return {direction: {"voxels": 8120, "unmatched_voxels": unmatched, "mean_mm": far * scale, "median_mm": 0.8 * far * scale, "percentile_95_mm": 2.5 * far * scale, "max_mm": 6 * far * scale}
            for direction, unmatched, far in (("from_fixed", 412, 1.0), ("to_fixed", 0, 1.1))}


def landmark_figures(scale, points=100):
    d = np.sort(scale * np.random.default_rng(1).gamma(2.2, 0.45, points))
    return {"points": points, "mean_mm": d.mean(), "median_mm": float(np.median(d)), "percentile_95_mm": float(np.percentile(d, 95)), "max_mm": d.max(), "distances_mm": d.tolist()}


def label_figures(dice):
    return [{"label": n, "dice": dice - 0.01 * (n % 3), "hausdorff_95_mm": 14 * (1 - dice) + 0.1 * n / 8, "average_surface_distance_mm": 5 * (1 - dice), "voxels": [4210 + 37 * n, 4195 + 35 * n]} for n in range(8, 16)]


def cloud(phantom):
    rng = np.random.default_rng(2)
    there = np.argwhere(phantom.hu["before"] > -950)
    there = there[rng.choice(len(there), 12000, replace=False)]
    rest = np.array(ORIGIN) + SPACING * (there[:, ::-1] + rng.uniform(-0.5, 0.5, there.shape))
    u = -displacement(rest.T).T
    kpa, bone = (field[tuple(there.T)] for field in (phantom.kpa, phantom.hu["before"] > 200))
    label = np.where(bone & (np.abs(rest[:, 0]) < 22), 1 + np.clip((rest[:, 2] + 80) // 40, 0, 8), 0)
    return {"count": 535565, "shown": len(rest), "origin_mm": list(ORIGIN), "scale_mm": 0.02, "rest": base64_of(np.rint((rest - ORIGIN) / 0.02).astype("<i2")),
            "displacement": base64_of(np.rint(u / 0.02).astype("<i2")), "scalars": [{"name": "Shear modulus", "unit": "kPa", "low": 0, "high": 5, "open_end": True, "data": base64_of(np.clip(np.rint(kpa / 5 * 255), 0, 255).astype(np.uint8))}],
            "labels": NODE_LABELS, "label": base64_of(label.astype(np.uint8))}


def history(steps=60):
    at = np.arange(steps) * 10
    error = [None if i < 3 else float(30 * 0.9**i + 0.002) for i in range(steps)]
    return {"step": at.tolist(), "error_mm": error, "rate": [None if i < 3 else float(0.9 + 0.05 * np.sin(i / 5)) for i in range(steps)], "energy_mN_mm": (5200 * (1 - np.exp(-at / 90.0))).tolist()}


def register_report(phantom):
    names = ["before", "rigid", "mtled"]
    labels = {"before": 0.46, "rigid": 0.56, "mtled": 0.98}
    figure = io.BytesIO()
    Image.fromarray((phantom.body[::-1, 30].astype(np.uint8) * 200)).resize((352, 416)).save(figure, "PNG")
    return {
        "version": 1, "kind": "register", "program": "mtled 0.1.0", "created": "2026-11-27 19:40 UTC",
        "inputs": [{"role": "moving image", "path": "/data/patients/0017/2024-03-02/supine.nii.gz", "md5": "9e107d9d372bb6826bd81d3542a419d6", "size": [512, 512, 203], "spacing_mm": [0.977, 0.977, 2.5]},
                   {"role": "fixed image", "path": "/data/patients/0017/2024-05-21/prone.nii.gz", "md5": "e4d909c290d0fb1ca068ffaddf22cbd0", "size": [512, 512, 198], "spacing_mm": [0.977, 0.977, 2.5]},
                   {"role": "moving labels", "path": "/data/patients/0017/2024-03-02/vertebrae.nii.gz", "md5": "d41d8cd98f00b204e9800998ecf8427e", "size": [512, 512, 203], "spacing_mm": [0.977, 0.977, 2.5]}],
        "settings": [{"name": "node spacing", "value": "3.5 mm"}, {"name": "tolerance", "value": "0.05 mm"}, {"name": "body threshold", "value": "-500 HU"}, {"name": "device", "value": "cpu, 2 threads"}],
        "verdict": {"level": "check", "headline": "The images are aligned to within two voxels at 97 % of the edges; one vertebra and a fold need a look.",
                    "items": [{"level": "good", "label": "Edges within two voxels", "value": "97.1 %", "compared": "84.6 % before, 93.8 % rigid", "detail": "All edges, consistent or not."},
                              {"level": "good", "label": "Landmarks, mean", "value": "0.16 mm", "compared": "10.4 mm before, 5.1 mm rigid"},
                              {"level": "check", "label": "Vertebrae off their motion", "value": "1 of 8", "detail": "Label 11 is 0.62 mm rms off its rigid motion."},
                              {"level": "bad", "label": "Folded voxels", "value": "27", "detail": "det J must be positive everywhere in the body."},
                              {"level": "info", "label": "Largest displacement", "value": "31.2 mm"}]},
        "warnings": ["Label 11 lies partly outside the body: 62 of 4617 voxels.", "The moving image is cut at the arms; the cut is free of load."],
        "candidates": [{"id": "before", "name": "Before"}, {"id": "rigid", "name": "Rigid"}, {"id": "mtled", "name": "mtled"}],
        "edges": {n: edge_figures(s) for n, s in zip(names, (3.2, 1.6, 0.35))}, "edge_settings": {"canny_sigma_mm": 2, "canny_lower_per_mm": 15, "canny_upper_per_mm": 40, "edges": "3-D"},
        "landmarks": {n: landmark_figures(s) for n, s in zip(names, (10.4, 5.1, 0.16))},
        "labels": {n: label_figures(labels[n]) for n in names},
        "rigidity": [{"label": n, "voxels": 4200 + 37 * n, "rms_mm": 0.62 if n == 11 else 0.05, "largest_mm": 1.9 if n == 11 else 0.2} for n in range(8, 16)],
        "jacobian": {"min": -0.2, "percentile_1": 0.93, "median": 1.0, "percentile_99": 1.08, "max": 1.21, "folded_voxels": 27, "voxels": 1834221, "sd_log": 0.0218},
        "inverse_consistency": {"voxels": 1834221, "mean_mm": 0.011, "percentile_95_mm": 0.034, "max_mm": 0.31},
        "motions": [{"label": n, "angle_deg": 2.1 * (n - 6), "shift_mm": 3.3 * (n - 5), "similarity_before": 0.41 + 0.01 * n, "similarity_after": 0.99 - 0.002 * n, "inverse_consistency_mm": None if n == 9 else 0.04,
                     "rms_deviation_mm": 0.62 if n == 11 else 0.05, "largest_deviation_mm": 1.9 if n == 11 else 0.21, "voxels": 4200 + 37 * n} for n in range(8, 16)],
        "tissue": {"body_litres": 34.6, "classes": [{"center": c, "tissue": t, "shear_modulus_kpa": k} for c, t, k in ((-852, "gas, lung", 0.53), (-96, "fat", 1.07), (12, "fluid", 2.8), (52, "muscle, organs", 3.57), (218, "cancellous bone", 40.0), (480, "bone", 1200.0))]},
        "solver": {"tolerance_mm": 0.05, "steps": 590, "error_estimate_mm": 0.041, "converged": True, "nodes": 535565, "points": 1043221, "device": "CPU, AVX-512, 2 threads", "history": history()},
        "stages": [{"name": n, "seconds": s, "peak_memory_MB": m} for n, s, m in (("read", 1.2, 410), ("tissue", 0.8, 455), ("motions", 9.4, 520), ("cloud", 2.9, 610), ("mechanics", 52.1, 800), ("warp", 4.4, 800), ("evaluation", 12.6, 812))],
        "figures": [{"title": "Body mask", "caption": "A coronal slice of the body mask.", "picture": "data:image/png;base64," + base64.b64encode(figure.getvalue()).decode()}],
        "view": view(phantom, ["fixed", *names]), "nodes": cloud(phantom)}


def evaluate_report(phantom, others=()):
    names = ["before", *others, "after"]
    scales = np.linspace(3.2, 0.35, len(names))
    return {"version": 1, "kind": "evaluate", "program": "mtled 0.1.0", "created": "2026-11-27 19:40 UTC",
            "inputs": [{"role": "fixed image", "path": "fixed.nii.gz"}, {"role": "warped image", "path": "C:\\results\\warped.nii.gz"}],
            "verdict": {"level": "good", "headline": "Edges agree to within two voxels at 97 % of all places.", "items": []}, "warnings": [],
            "candidates": [{"id": n, "name": n if n in others else n.capitalize()} for n in names], "edges": {n: edge_figures(s) for n, s in zip(names, scales)},
            "landmarks": {n: {"points": 3, "mean_mm": None, "median_mm": None, "percentile_95_mm": None, "max_mm": None} for n in names},
            "contours": {"lungs": {n: contour_figures(s) for n, s in zip(names, scales)}}, "view": view(phantom, ["fixed", *names], mechanics=False)}


def minimal_report(phantom):
    """Only what every report has: a fixed image and one that was warped elsewhere."""
    return {"version": 1, "kind": "evaluate", "program": "mtled 0.1.0", "created": "2026-11-27 19:40 UTC", "inputs": [{"role": "fixed image", "path": "fixed.nii.gz"}],
            "verdict": {"level": "check", "headline": "There is nothing to compare with.", "items": None}, "warnings": None, "candidates": [{"id": "after", "name": "After"}], "landmarks": None, "nodes": None,
            "view": view(phantom, ["fixed", "after"], mechanics=False)}


if __name__ == "__main__":
    kinds = {"register": register_report, "evaluate": evaluate_report, "compared": lambda phantom: evaluate_report(phantom, OTHERS), "minimal": minimal_report}
    pathlib.Path(sys.argv[1]).write_text(assemble(kinds[(sys.argv[2:] or ["register"])[0]](Phantom())))
