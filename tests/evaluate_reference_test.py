#!/usr/bin/env python3
"""Compares `mtled evaluate` with SimpleITK, SciPy, scikit-image and surface-distance on the same images. Exit 77: skipped, one is missing."""
import json
import pathlib
import subprocess
import sys
import tempfile
import unittest

PROGRAM = sys.argv.pop(1)

try:
    import numpy as np
    import SimpleITK as sitk
    from scipy import ndimage
    from scipy.spatial import cKDTree
    from skimage import feature, metrics
    import surface_distance
except ImportError as error:
    print(f"SKIPPED: the comparison of evaluate with other programs needs SimpleITK, SciPy, scikit-image and surface-distance ({error}); scripts/install_dependencies.sh --with-references installs them")
    sys.exit(77)

ROUNDING = 1e-6  # of numbers that both compute in double precision from the same voxels
# Canny edges of two programs: Gaussians by recursion and by sampling differ, and a few edges fall elsewhere by a voxel.
EDGE_COUNT = 0.03  # relative; measured 0.6 and 1.7 %
EDGE_DISTANCE = 0.3  # mm, of percentiles 60 to 95; measured 0.17
FLOAT_ROUNDING = 2e-5  # of determinants and distances of displacements kept in single precision
SPACING = (1.5, 1.2, 2.0)  # mm, x y z


def image_of(array, kind):
    """SimpleITK image of an array [z, y, x], oblique and off the origin."""
    image = sitk.GetImageFromArray(array.astype(kind), isVector=array.ndim == 4)
    image.SetSpacing(SPACING)
    image.SetOrigin((-31.0, 17.0, 240.0))
    image.SetDirection(DIRECTION)
    return image


turn = sitk.Euler3DTransform()
turn.SetRotation(0.2, -0.1, 0.3)
DIRECTION = turn.GetMatrix()


class Evaluate(unittest.TestCase):
    def setUp(self):
        scratch = tempfile.TemporaryDirectory()
        self.addCleanup(scratch.cleanup)
        self.folder = pathlib.Path(scratch.name)
        z, y, x = np.mgrid[:30, :44, :40].astype(float)
        rng = np.random.default_rng(5)
        texture = ndimage.gaussian_filter(rng.normal(size=(30, 44, 40)), 2.5)
        self.moving = 400 * texture / texture.std() + 900 * (np.hypot(np.hypot(1.5 * (x - 20), 1.2 * (y - 22)), 2 * (z - 15)) < 16)
        self.labels = np.select([(x - 15) ** 2 + (y - 20) ** 2 + (1.4 * (z - 14)) ** 2 < 81, (x - 28) ** 2 + (y - 30) ** 2 + (z - 16) ** 2 < 36], [1, 2])
        self.field = np.stack([3 * np.sin(y / 9), 2 * np.cos(x / 8) + 1, 2.5 * np.sin(z / 7 + x / 11)], -1)  # mm, LPS
        self.transform = sitk.DisplacementFieldTransform(image_of(self.field, np.float64))
        image = image_of(self.moving, np.float32)
        self.fixed = sitk.Resample(image, image, self.transform, sitk.sitkLinear, 0.0)
        self.write("moving.nrrd", image)
        self.write("fixed.nrrd", self.fixed)
        self.write("moving_labels.nrrd", image_of(self.labels, np.uint8))
        self.fixed_labels = ndimage.shift(self.labels, (1, -2, 3), order=0)
        self.write("fixed_labels.nrrd", image_of(self.fixed_labels, np.uint8))
        for name in ("field.nrrd", "field.mha", "field.nii.gz"):
            self.write(name, image_of(self.field, np.float32))

    def write(self, name, image):
        sitk.WriteImage(image, str(self.folder / name))

    def evaluate(self, *arguments):
        paths = [str(self.folder / a) if (self.folder / a).is_file() else a for a in arguments]
        run = subprocess.run([PROGRAM, "evaluate", "-f", str(self.folder / "fixed.nrrd"), *paths, "--force", "-o", str(self.folder / "out")], capture_output=True, text=True)
        self.assertEqual(run.returncode, 0, run.stderr)
        return json.loads((self.folder / "out" / "evaluation.json").read_text())

    def points(self, mask):
        """Physical positions of marked voxels, up to the common rotation and origin."""
        return np.argwhere(mask)[:, ::-1] * SPACING

    def test_overlap_and_surface_distances(self):
        warped = sitk.Resample(image_of(self.labels, np.uint8), self.fixed, sitk.Transform(), sitk.sitkNearestNeighbor)
        labels = self.evaluate("-m", "moving.nrrd", "--moving-labels", "moving_labels.nrrd", "--fixed-labels", "fixed_labels.nrrd", "-w", "fixed.nrrd")["labels"]["before"]
        overlap = sitk.LabelOverlapMeasuresImageFilter()
        overlap.Execute(warped, image_of(self.fixed_labels, np.uint8))
        self.assertEqual([entry["label"] for entry in labels], [1, 2])
        for entry in labels:
            self.assertAlmostEqual(entry["dice"], overlap.GetDiceCoefficient(entry["label"]), delta=ROUNDING)
            surfaces = [mask & ~ndimage.binary_erosion(mask) for mask in (self.labels == entry["label"], self.fixed_labels == entry["label"])]
            a, b = (self.points(s) for s in surfaces)
            ab, ba = cKDTree(b).query(a)[0], cKDTree(a).query(b)[0]
            self.assertAlmostEqual(entry["hausdorff_95_mm"], max(np.percentile(ab, 95), np.percentile(ba, 95)), delta=ROUNDING)
            self.assertAlmostEqual(entry["hausdorff_95_pooled_mm"], np.percentile(np.r_[ab, ba], 95), delta=ROUNDING)
            self.assertAlmostEqual(entry["average_surface_distance_mm"], np.r_[ab, ba].mean(), delta=ROUNDING)
            distance = ndimage.distance_transform_edt(~surfaces[1], sampling=SPACING[::-1])[surfaces[0]]
            self.assertAlmostEqual(np.percentile(distance, 95), np.percentile(ab, 95), delta=ROUNDING)

    def test_surface_distances_by_area(self):
        """Learn2Reg's distance, also where a label touches the end of the image, and of many shapes at once."""
        speckles = np.random.default_rng(8).random(self.labels.shape) < 0.5  # all kinds of cells
        boxes = np.zeros(self.labels.shape, int)
        boxes[:12, :20, :17] = 1
        boxes[15:, 25:, 22:] = np.where(speckles, 2, 0)[15:, 25:, 22:]
        boxes[4:9, 30:40, 3:15] = 3
        for name, other in (("moved", np.roll(boxes, (3, -2, 1), (0, 1, 2))), ("others", self.labels), ("eroded", boxes * ndimage.binary_erosion(boxes > 0))):
            self.write("fixed_labels.nrrd", image_of(boxes, np.uint8))
            self.write("warped_labels.nrrd", image_of(other, np.uint8))
            labels = self.evaluate("-w", "fixed.nrrd", "--fixed-labels", "fixed_labels.nrrd", "--warped-labels", "warped_labels.nrrd", "--no-report")["labels"]["after"]
            self.assertEqual(len(labels), 3)
            for entry in labels:
                masks = [array == entry["label"] for array in (boxes, other)]
                surfaces = surface_distance.compute_surface_distances(*masks, SPACING[::-1])
                for mine, key in zip(entry["surface_area_mm2"], ("surfel_areas_pred", "surfel_areas_gt")):
                    self.assertAlmostEqual(mine, surfaces[key].sum(), delta=ROUNDING * max(1, mine), msg=f"{name}, label {entry['label']}")
                if not masks[1].any():
                    self.assertIsNone(entry["hausdorff_95_learn2reg_mm"])
                    continue
                expected = surface_distance.compute_robust_hausdorff(surfaces, 95)
                self.assertAlmostEqual(entry["hausdorff_95_learn2reg_mm"], expected, delta=ROUNDING, msg=f"{name}, label {entry['label']}")

    def test_edges_and_their_percentile_hausdorff_distances(self):
        report = self.evaluate("-m", "moving.nrrd", "-w", "fixed.nrrd", "--canny-sigma", "2.4")
        before = report["edges"]["before"]
        self.assertGreater(min(before["edge_voxels"]), 500)
        a, b = (self.canny(array, 2.4) for array in (sitk.GetArrayFromImage(self.fixed), self.moving))
        for mine, other in zip(before["edge_voxels"], (a, b)):
            self.assertLess(abs(mine - other.sum()) / other.sum(), EDGE_COUNT)
        reference = np.sort(cKDTree(self.points(b)).query(self.points(a))[0]), np.sort(cKDTree(self.points(a)).query(self.points(b))[0])
        for percent in (60, 75, 85, 95):
            mine = before["hausdorff_1_to_100_all_edges_mm"][percent - 1]
            self.assertLess(abs(mine - max(np.percentile(r, percent) for r in reference)), EDGE_DISTANCE)

    def canny(self, array, sigma):
        """3-D Canny edges by SciPy: gradient per mm, maximum along it, hysteresis."""
        width = [sigma / s for s in SPACING[::-1]]
        gradient = [ndimage.gaussian_filter(array.astype(float), width, order=[int(i == axis) for i in range(3)]) / SPACING[::-1][axis] for axis in range(3)]
        size = np.sqrt(sum(g * g for g in gradient))
        step = np.stack([g / s for g, s in zip(gradient, SPACING[::-1])])
        step = step / np.maximum(np.abs(step).max(0), 1e-12)
        here = np.indices(size.shape)
        ahead, behind = (ndimage.map_coordinates(size, here + sign * step, order=1, mode="constant", cval=1e9) for sign in (1, -1))
        ridge = (size > ahead) & (size >= behind)
        parts, _ = ndimage.label(ridge & (size >= 15), np.ones((3, 3, 3)))
        return np.isin(parts, np.unique(parts[ridge & (size >= 40)])) & (parts > 0)

    def test_hausdorff_of_skimage(self):
        """Round shapes of one intensity: the 100 per cent distance of their 2-D edges against scikit-image."""
        y, x = np.mgrid[:60, :60]
        stack = lambda cx: np.repeat((1000.0 * (np.hypot(x - cx, y - 30) < 14))[None], 3, 0)
        pair = [image_of(stack(c), np.float32) for c in (28, 31)]
        for name, image in zip(("fixed.nrrd", "other.nrrd"), pair):
            image.SetSpacing((1, 1, 3))
            self.write(name, image)
        edges = self.evaluate("-w", "other.nrrd", "--slices")["edges"]["after"]
        a, b = (feature.canny(stack(c)[0], sigma=2, low_threshold=15, high_threshold=40) for c in (28, 31))
        self.assertLessEqual(abs(edges["hausdorff_1_to_100_all_edges_mm"][99] - metrics.hausdorff_distance(a, b)), 1)  # a voxel

    def test_jacobian_and_warp(self):
        report = self.evaluate("-m", "moving.nrrd", "-t", "field.nrrd")
        along_axes = self.field @ np.reshape(DIRECTION, (3, 3))  # ITK's filter differentiates along the grid's axes and expects components along them
        determinant = sitk.GetArrayFromImage(sitk.DisplacementFieldJacobianDeterminant(image_of(along_axes, np.float64)))
        inner = determinant[2:-2, 2:-2, 2:-2]
        jacobian = report["field"]["jacobian"]
        self.assertAlmostEqual(jacobian["sd_log_learn2reg"], np.log(np.clip(inner + 3, 1e-9, 1e9)).std(), delta=FLOAT_ROUNDING)
        self.assertGreater(abs(jacobian["sd_log_learn2reg"] - jacobian["sd_log"]), 0.01)
        self.assertGreater(report["correlation"]["after"], 1 - ROUNDING)  # both warp linearly by the same field
        self.assertFalse(report["direction"]["reversed_fits_better"])

    def test_transforms_written_by_simpleitk(self):
        affine = sitk.AffineTransform((1.02, 0.05, 0, -0.03, 0.97, 0.02, 0, 0.01, 1), (2, -1, 3), self.fixed.TransformContinuousIndexToPhysicalPoint((20, 22, 15)))
        spline = sitk.BSplineTransformInitializer(self.fixed, (4, 4, 4))
        spline.SetParameters(np.random.default_rng(1).normal(scale=2, size=len(spline.GetParameters())))
        points = np.array([self.fixed.TransformContinuousIndexToPhysicalPoint(c) for c in np.random.default_rng(2).uniform(8, 20, (30, 3))])
        for name in ("field.nrrd", "field.mha", "field.nii.gz"):
            self.compare_with(name, self.transform, points)
        for name, transform in {"a.tfm": affine, "a.mat": affine, "a.h5": affine, "b.h5": spline, "b.tfm": spline, "f.h5": self.transform,
                                "c.h5": sitk.CompositeTransform([affine, spline]), "c.tfm": sitk.CompositeTransform([spline, affine])}.items():
            sitk.WriteTransform(transform, str(self.folder / name))
            self.compare_with(name, transform, points)

    def compare_with(self, name, transform, points):
        there = np.array([transform.TransformPoint(p) for p in points])
        for file, rows in {"fixed.csv": points, "there.csv": there}.items():
            np.savetxt(self.folder / file, rows, delimiter=",", header="x,y,z", comments="", fmt="%.12g")
        landmarks = self.evaluate("-t", name, "--fixed-landmarks", "fixed.csv", "--moving-landmarks", "there.csv")["landmarks"]
        self.assertEqual(landmarks["after"]["points"], len(points), name)
        self.assertLess(landmarks["after"]["max_mm"], FLOAT_ROUNDING, name)
        self.assertGreater(landmarks["before"]["mean_mm"], 0.5, name)


if __name__ == "__main__":
    unittest.main()
