#!/usr/bin/env python3
"""Seconds and peak memory of `mtled evaluate` on a pair of 512 x 512 x 300 voxels made from the thorax in data/, as
Markdown in perf/results/evaluate.md.

usage: perf/evaluate_perf.py --folder DIR [--program build/bin/mtled] [--threads N] [--no-itk]

DIR keeps the pair (4 GB), which later runs use again. Beside it, ITK's own filters find the edges of two of the images and
the distance maps of both. Needs SimpleITK and NumPy.
"""
import argparse, json, multiprocessing, os, pathlib, platform, subprocess, sys, time

import numpy as np
import SimpleITK as sitk

SIZE, SPACING = (512, 512, 300), (0.78, 0.78, 1.0667)  # voxels; mm: 399 x 399 x 320 mm, all of the thorax and air around it
NOISE = 20  # HU, standard deviation
CANNY = dict(variance=[4.0] * 3, lowerThreshold=12.0, upperThreshold=31.0)  # those of `evaluate`: 2 mm, 15 and 40 HU/mm, per voxel of 0.78 mm

root = pathlib.Path(__file__).resolve().parent.parent
data = root / "data/thorax_flex"


def make_pair(folder, program, threads):
    """The thorax on the fine grid with noise, and the field that `mtled register` finds between its postures."""
    for name in ("plain", "packed"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    registered = folder / "registered"
    subprocess.run([program, "register", "--quiet", "-m", data / "moving.nii.gz", "-f", data / "fixed.nii.gz", "--moving-labels", data / "moving_vertebrae.nii.gz",
                    "--node-spacing", "6.25", "--no-evaluation", "--threads", str(threads), "--force", "-o", registered], check=True, stdout=subprocess.DEVNULL)
    old = sitk.ReadImage(str(data / "fixed.nii.gz"))
    middle = np.array(old.TransformContinuousIndexToPhysicalPoint([(n - 1) / 2 for n in old.GetSize()]))
    grid = sitk.Image(SIZE, sitk.sitkUInt8)
    grid.SetSpacing(SPACING)
    grid.SetOrigin((middle - (np.array(SIZE) - 1) / 2 * SPACING).tolist())
    random = np.random.default_rng(1)

    def write(name, image):
        sitk.WriteImage(image, str(folder / f"plain/{name}.nii"))
        sitk.WriteImage(image, str(folder / f"packed/{name}.nii.gz"), useCompression=True, compressionLevel=1)

    for name in ("fixed", "moving"):
        image = sitk.Resample(sitk.ReadImage(str(data / f"{name}.nii.gz"), sitk.sitkFloat32), grid, sitk.Transform(), sitk.sitkLinear, -1000.0)
        values = sitk.GetArrayViewFromImage(image) + NOISE * random.standard_normal(SIZE[::-1], dtype=np.float32)
        noisy = sitk.GetImageFromArray(np.clip(np.rint(values), -1024, 3071).astype(np.int16))
        noisy.CopyInformation(grid)
        write(name, noisy)
        write(f"{name}_labels", sitk.Resample(sitk.ReadImage(str(data / f"{name}_vertebrae.nii.gz")), grid, sitk.Transform(), sitk.sitkNearestNeighbor))
    write("mask", sitk.Resample(sitk.ReadImage(str(registered / "warped_body.nii.gz")), grid, sitk.Transform(), sitk.sitkNearestNeighbor))
    for name in ("fixed_to_moving", "moving_to_fixed"):
        field = sitk.Resample(sitk.ReadImage(str(registered / f"{name}.nrrd")), grid, sitk.Transform(), sitk.sitkLinear, 0.0, sitk.sitkVectorFloat32, True)
        sitk.WriteImage(field, str(folder / f"plain/{name}.nrrd"))
        sitk.WriteImage(field, str(folder / f"packed/{name}.nii.gz"), useCompression=True, compressionLevel=1)
    (folder / "complete").touch()


def run(command):
    """Wall seconds, processor seconds and peak memory [MB] of a program."""
    start = time.time()
    process = subprocess.Popen([str(c) for c in command], stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    if status != 0:
        sys.exit(f"evaluate_perf: {' '.join(map(str, command))} failed")
    return time.time() - start, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024


def cases(folder):
    """Arguments of `mtled evaluate` by what is measured."""
    def given(place, images, field):
        place = folder / place
        return ["-f", place / f"fixed{images}", "-m", place / f"moving{images}", "-t", place / f"fixed_to_moving{field}", "--fixed-labels", place / f"fixed_labels{images}",
                "--moving-labels", place / f"moving_labels{images}", "--landmarks", data / "landmarks.csv"]
    plain, packed = given("plain", ".nii", ".nrrd"), given("packed", ".nii.gz", ".nii.gz")
    return {"whole image": plain, "mask of the body": plain + ["--mask", folder / "plain/mask.nii"], "whole image, all files packed (.nii.gz)": packed,
            "mask of the body, all files packed (.nii.gz)": packed + ["--mask", folder / "packed/mask.nii.gz"],
            "whole image, with the inverse field": plain + ["--inverse-transform", folder / "plain/moving_to_fixed.nrrd"]}


def itk(folder, threads):
    """ITK's filters one after another: edges of the fixed and the moving image, and the distance map of each."""
    sitk.ProcessObject.SetGlobalDefaultNumberOfThreads(threads)
    filters = []
    for name in ("fixed", "moving"):
        image = sitk.ReadImage(str(folder / f"plain/{name}.nii"), sitk.sitkFloat32)
        start, used = time.time(), time.process_time()
        edges = sitk.Cast(sitk.CannyEdgeDetection(image, **CANNY), sitk.sitkUInt8)
        found, used_for_edges = time.time(), time.process_time()
        sitk.SignedMaurerDistanceMap(edges, squaredDistance=False, useImageSpacing=True)
        filters.append((f"edges of the {name} image, CannyEdgeDetectionImageFilter", found - start, used_for_edges - used))
        filters.append(("distances from them, SignedMaurerDistanceMapImageFilter", time.time() - found, time.process_time() - used_for_edges))
    return filters


def main():
    a = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    a.add_argument("--folder", type=pathlib.Path, required=True)
    a.add_argument("--program", default=str(root / "build/bin/mtled"))
    a.add_argument("--threads", type=int, default=os.cpu_count())
    a.add_argument("--no-itk", action="store_true")
    a = a.parse_args()
    if not (a.folder / "complete").exists():
        make_pair(a.folder, a.program, a.threads)
    processor = next((line.split(":")[1].strip() for line in open("/proc/cpuinfo") if line.startswith("model name")), platform.machine())
    commit = subprocess.run(["git", "-C", root, "rev-parse", "--short", "HEAD"], capture_output=True, text=True).stdout.strip()
    text = [f"# `mtled evaluate` on a pair of {' x '.join(map(str, SIZE))} voxels\n\n{a.threads} threads of {processor}, commit {commit}, load of the machine at the start {os.getloadavg()[0]:.1f}. "
            "Written by `perf/evaluate_perf.py`; peak memory is that of the whole process up to the end of the stage. Files were in the page cache.\n\n| case | s | processor s | peak MB |\n|---|---|---|---|"]
    stages = {}
    for number, (name, arguments) in enumerate(cases(a.folder).items(), 1):
        output = a.folder / f"evaluated_{number}"
        seconds, used, peak = run([a.program, "evaluate", "--quiet", "--threads", a.threads, *arguments, "--force", "-o", output])
        text.append(f"| {name} | {seconds:.1f} | {used:.1f} | {peak:.0f} |")
        print(text[-1], flush=True)
        stages[name] = json.load(open(output / "evaluation.json"))["stages"]
    text.append("\nSeconds and peak MB of the stages:\n\n| stage | " + " | ".join(stages) + " |\n|---" + "|---" * len(stages) + "|")
    for stage in next(iter(stages.values())):
        text.append(f"| {stage} | " + " | ".join(f"{s[stage]['seconds']:.2f}, {s[stage]['peak_memory_MB']:.0f}" for s in stages.values()) + " |")
    if not a.no_itk:
        text.append(f"\n## ITK {sitk.Version.ITKVersionString()} on the same images, threads and machine\n\n| filter | s | processor s |\n|---|---|---|")
        with multiprocessing.get_context("spawn").Pool(1) as one:  # in a process of its own
            filters = one.apply(itk, (a.folder, a.threads))
        text += [f"| {name} | {seconds:.1f} | {used:.1f} |" for name, seconds, used in filters]
        text.append(f"| **all** | **{sum(f[1] for f in filters):.1f}** | **{sum(f[2] for f in filters):.1f}** |")
    results = root / "perf/results/evaluate.md"
    results.write_text("\n".join(text) + "\n")
    print("\n".join(text))


if __name__ == "__main__":
    main()
