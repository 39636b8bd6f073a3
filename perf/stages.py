#!/usr/bin/env python3
"""Seconds and peak memory of every stage of `mtled register` on the thorax in data/, as JSON and Markdown in perf/results/.

usage: perf/stages.py [--program build/bin/mtled] [--node-spacing MM ...] [--threads N]
"""
import argparse, json, os, pathlib, platform, subprocess, tempfile

root = pathlib.Path(__file__).resolve().parent.parent
a = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
a.add_argument("--program", default=str(root / "build/bin/mtled"))
a.add_argument("--node-spacing", type=float, nargs="+", default=[6.25, 3.5])
a.add_argument("--threads", type=int, default=os.cpu_count())
a = a.parse_args()

data = root / "data/thorax_flex"
processor = next((line.split(":")[1].strip() for line in open("/proc/cpuinfo") if line.startswith("model name")), platform.machine())
commit = subprocess.run(["git", "-C", root, "rev-parse", "--short", "HEAD"], capture_output=True, text=True).stdout.strip()
text = [f"# Stages of `mtled register` on `data/thorax_flex`\n\n{a.threads} threads of {processor}, single precision, commit {commit}. "
        "Written by `perf/stages.py`; peak memory is that of the whole process up to the end of the stage.\n"]
for spacing in a.node_spacing:
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([a.program, "register", "--quiet", "--moving", data / "moving.nii.gz", "--fixed", data / "fixed.nii.gz", "--moving-labels",
                        data / "moving_vertebrae.nii.gz", "--fixed-labels", data / "fixed_vertebrae.nii.gz", "--node-spacing", str(spacing),
                        "--threads", str(a.threads), "--output", folder, "--force"], check=True, stdout=subprocess.DEVNULL)
        manifest = json.load(open(pathlib.Path(folder) / "manifest.json"))
    solver = manifest["solver"]
    per_step = solver["stage_seconds"]["relaxation"] / solver["steps"]
    text.append(f"## {spacing} mm: {solver['nodes']} nodes, {solver['integration_points']} integration points\n\n"
                f"{solver['steps']} steps, {1000 * per_step:.1f} ms per step, {solver['force_evaluations']} force evaluations in all.\n\n"
                "| stage | s | peak MB |\n|---|---|---|")
    for name, stage in manifest["stages"].items():
        text.append(f"| {name} | {stage['seconds']:.2f} | {stage['peak_memory_MB']:.0f} |")
        if name == "mechanics":
            text += [f"| &nbsp;&nbsp;{part} | {seconds:.2f} | |" for part, seconds in solver["stage_seconds"].items()]
    text.append(f"| **all** | **{sum(s['seconds'] for s in manifest['stages'].values()):.1f}** | |\n")
(root / "perf/results").mkdir(exist_ok=True)
(root / "perf/results/stages.md").write_text("\n".join(text))
print("\n".join(text))
