#!/usr/bin/env python3
"""Write the shear modulus map of the simulated truth, derived from moving.nii.gz and moving_body_mask.nii.gz.

The map is the one the finite-element truth was computed with, to single precision: for `mtled register
--shear-modulus`. Membership-weighted mean of class moduli, mu = sum(mu_k w_k) / sum(w_k) with w_k = 1 / (HU - HU_k)^2,
where HU is the mean over the part of a 6 mm cube inside the mask. Needs NumPy.
"""
import argparse
import gzip
import pathlib
import struct

import numpy as np

CLASS_HU = np.array([-826, -537, -326, -90, -32, 43, 274, 661.0])
CLASS_MODULUS_KPA = np.array([0.53, 0.53, 0.53, 1.07, 3.57, 4.05, 40.5, 40.5])
CUBE_MM = 6.0
SMALLEST_SQUARED_DISTANCE = 1e-6  # [HU^2] of an intensity to a class centre

TYPES = {2: "u1", 4: "<i2", 16: "<f4"}  # NIfTI data types in use here


def read(path):
    """(header up to the voxels, voxels [i, j, k], spacing [mm]) of a little-endian NIfTI-1 file."""
    content = gzip.open(path).read()
    size = struct.unpack_from("<3h", content, 42)
    spacing = struct.unpack_from("<3f", content, 80)
    start = int(struct.unpack_from("<f", content, 108)[0])
    kind = TYPES[struct.unpack_from("<h", content, 70)[0]]
    voxels = np.frombuffer(content, kind, int(np.prod(size)), start).reshape(size, order="F")
    return content[:start], voxels, spacing


def write(path, header, voxels):
    """Single precision, on the grid of `header`."""
    header = bytearray(header)
    struct.pack_into("<2h", header, 70, 16, 32)
    with gzip.open(path, "wb") as f:
        f.write(bytes(header) + voxels.astype("<f4").tobytes(order="F"))


def sum_over_cube(values, spacing):
    """Weighted sum over a cube around each voxel; voxels that it cuts count with the part inside."""
    for axis, step in enumerate(spacing):
        reach = int(np.ceil(CUBE_MM / (2 * step) - 0.5))
        at = np.arange(-reach, reach + 1)
        part = np.clip(CUBE_MM / (2 * step) - np.abs(at) + 0.5, 0, 1)
        padded = np.pad(values, [(reach, reach) if a == axis else (0, 0) for a in range(3)])
        count = values.shape[axis]
        values = sum(w * np.take(padded, range(reach + d, reach + d + count), axis) for d, w in zip(at, part))
    return values


def main():
    here = pathlib.Path(__file__).resolve().parent
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("output", nargs="?", default="shear_modulus.nii.gz", help="default: shear_modulus.nii.gz in the current folder")
    output = parser.parse_args().output
    header, hu, spacing = read(here / "moving.nii.gz")
    inside = read(here / "moving_body_mask.nii.gz")[1] > 0
    weight = sum_over_cube(inside.astype(float), spacing)
    mean = sum_over_cube(np.where(inside, hu, 0).astype(float), spacing) / np.maximum(weight, 1e-9)
    w = 1 / np.maximum((mean[..., None] - CLASS_HU) ** 2, SMALLEST_SQUARED_DISTANCE)
    write(output, header, np.where(inside, (w * CLASS_MODULUS_KPA).sum(-1) / w.sum(-1), 0))
    print(f"wrote {output}")


if __name__ == "__main__":
    main()
