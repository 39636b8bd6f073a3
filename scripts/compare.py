#!/usr/bin/env python3
"""Registers a pair rigidly, with B-splines, with mechanics, and with B-splines after mechanics, and judges all alike.

usage: scripts/compare.py --moving M --fixed F --moving-labels VM --output DIR [--fixed-labels VF] [--landmarks L]
                          [--baseline-config TOML] [--program build/bin/mtled] [-- further options of `mtled register`]

Each registration goes into a folder of its own under DIR; all are judged by one `mtled evaluate` in one mask, the body
that mechanics deformed. Writes DIR/comparison.md (a table and the commands), DIR/evaluation/report.html (curves, tables
and pictures of all in one page) and, where matplotlib is installed, DIR/percentiles.png (Hausdorff distance over
percentile). Registrations that are there already, made by the same commands, are not done again.
"""
import argparse, json, pathlib, shlex, subprocess, sys

arguments, further = sys.argv[1:], []
if "--" in arguments:
    cut = arguments.index("--")
    arguments, further = arguments[:cut], arguments[cut + 1:]
parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
for name in ("moving", "fixed", "moving-labels", "output"):
    parser.add_argument("--" + name, required=True)
parser.add_argument("--fixed-labels")
parser.add_argument("--landmarks", help="CSV with mx,my,mz,fx,fy,fz")
parser.add_argument("--baseline-config", help="settings of `mtled baseline`, a TOML file")
parser.add_argument("--program", default="build/bin/mtled")
a = parser.parse_args(arguments)
out = pathlib.Path(a.output)
out.mkdir(parents=True, exist_ok=True)
commands = []


def run(*command, into):
    """Runs a verb with its output in a folder, unless the same command has filled that already."""
    commands.append(shlex.join(["mtled", *map(str, command), "--output", str(into)]))
    record = into / "command.txt"
    if record.exists() and any((into / end).exists() for end in ("manifest.json", "summary.json")):
        if record.read_text().strip() == commands[-1]:
            return
        sys.exit(f"compare: {into} holds the results of another command:\n  {record.read_text().strip()}\nnot of\n  {commands[-1]}\nRemove that folder, or choose another --output")
    print(commands[-1], file=sys.stderr)
    command = [*command, "--output", into, "--force"]
    done = subprocess.run([a.program, *map(str, command)], stdout=subprocess.PIPE, text=True)
    if done.returncode:
        sys.exit(f"compare: `{commands[-1]}` ended with code {done.returncode}; its message is above")
    record.write_text(commands[-1] + "\n")


images = ["--moving", a.moving, "--fixed", a.fixed]
labels = ["--fixed-labels", a.fixed_labels] if a.fixed_labels else []
landmarks = ["--landmarks", a.landmarks] if a.landmarks else []
baseline = ["--config", a.baseline_config] if a.baseline_config else []
ways = {
    "mechanics": ["register", *images, "--moving-labels", a.moving_labels, *labels, *landmarks, *further],
    "rigid": ["baseline", "rigid", *images, *baseline],
    "B-spline": ["baseline", "bspline", *images, *baseline],
    "mechanics then B-spline": ["baseline", "bspline", *images, "--start", out / "mechanics", *baseline],
}
folders = {name: out / name.replace(" then ", "_").lower() for name in ways}
for name, command in ways.items():
    run(*command, into=folders[name])
beside = [part for name in ways if name != "mechanics" for part in ("--beside", f"{name}={folders[name]}")]
run("evaluate", "--fixed", a.fixed, "--moving", a.moving, "--result", folders["mechanics"], *beside, "--mask", folders["mechanics"] / "warped_body.nii.gz",
    "--moving-labels", a.moving_labels, *labels, *landmarks, into=out / "evaluation")
report = json.loads((out / "evaluation" / "evaluation.json").read_text())


def row(name):
    key = {"none": "before", "mechanics": "after"}.get(name, name)
    edges = report["edges"][key]
    cells = [name] + ["-" if not edges["hausdorff_all_edges_mm"] else f"{h:.2f}" for h in edges["hausdorff_all_edges_mm"] or [0] * 4]
    cells.append("-" if edges["within_two_voxels_all_edges"] is None else f"{100 * edges['within_two_voxels_all_edges']:.1f}")
    errors = report.get("landmarks", {}).get(key)
    cells += [f"{errors[measure]:.2f}" for measure in ("mean_mm", "median_mm", "percentile_95_mm", "max_mm")] if errors else ["-"] * 4
    dice = [l["dice"] for l in report.get("labels", {}).get(key, []) if l["dice"] is not None]
    cells.append(f"{sum(dice) / len(dice):.3f}" if dice else "-")
    field = {"rigidity": report.get("rigidity", []), "jacobian": report["field"]["jacobian"]} if key == "after" else report["beside"].get(key, {})
    rigid, jacobian = [r["rms_mm"] for r in field.get("rigidity", [])], field.get("jacobian")
    cells.append(f"{max(rigid):.2f}" if rigid else "-")
    cells += [str(jacobian["folded_voxels"]), f"{jacobian['sd_log']:.3f}" if jacobian["sd_log"] is not None else "-"] if jacobian else ["-", "-"]
    return "| " + " | ".join(cells) + " |"


lines = ["| registration | H60 mm | H75 mm | H85 mm | H95 mm | edges within two voxels % | landmarks: mean mm | median | 95 % | max | Dice (mean) | labels: worst rms from rigid mm | folded voxels | SDlogJ |",
         "|---" * 14 + "|"]
lines += [row(name) for name in ("none", "rigid", "B-spline", "mechanics", "mechanics then B-spline")]
table = "\n".join(lines)
(out / "comparison.md").write_text(table + "\n\nCommands:\n\n" + "".join(f"    {c}\n" for c in commands))
print(table)

try:
    import matplotlib
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
except ImportError:
    sys.exit(0)
figure, axes = plt.subplots(figsize=(7, 4.5), layout="constrained")
styles = {"rigid": ("#D55E00", ":"), "B-spline": ("#0072B2", "--"), "mechanics": ("#000000", "-"), "mechanics then B-spline": ("#009E73", "-.")}
for name, (colour, style) in styles.items():
    curve = report["edges"]["after" if name == "mechanics" else name]["hausdorff_1_to_100_all_edges_mm"]
    if curve:
        axes.plot(range(1, 101), curve, color=colour, linestyle=style, label=name)
axes.set(xlabel="percentile of the edges", ylabel="Hausdorff distance [mm]", yscale="symlog", xlim=(1, 100), title="Edges of the warped and the fixed image")
axes.grid(alpha=0.3)
axes.legend()
figure.savefig(out / "percentiles.png", dpi=120)
