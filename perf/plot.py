#!/usr/bin/env python3
"""Draws results of step_perf: time per step and node steps per second over the number of nodes, as PNG.

usage: perf/plot.py step_perf.json [more.json ...] [--output step_perf.png]

Needs matplotlib (`pip install matplotlib`). Several files, of several devices or clouds, go into one figure.
"""
import argparse, json, pathlib, sys

try:
    import matplotlib
except ImportError:
    sys.exit("plot.py: matplotlib is missing; pip install matplotlib")
matplotlib.use("Agg")
import matplotlib.pyplot as plt

a = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
a.add_argument("results", nargs="+", type=pathlib.Path)
a.add_argument("--output", type=pathlib.Path, help="default: the first result with the extension png")
a = a.parse_args()

figure, (time, rate) = plt.subplots(1, 2, figsize=(11, 4.5), layout="constrained")
for colour, path in enumerate(a.results):
    result = json.loads(path.read_text())
    conditions = result["conditions"]
    for relaxation, style in (("plain", "o-"), ("two-level", "s--")):
        runs = [r for r in result["runs"] if r["relaxation"] == relaxation and "skipped" not in r]
        if not runs:
            continue
        nodes = [r["nodes"] for r in runs]
        ms = [{key: r["microseconds_per_step"][key] / 1000 for key in ("min", "median", "max")} for r in runs]
        spread = [[m["median"] - m["min"] for m in ms], [m["max"] - m["median"] for m in ms]]
        look = dict(color=f"C{colour}", label=f"{conditions['device']}, {conditions['cloud']}, {relaxation}", capsize=2)
        time.errorbar(nodes, [m["median"] for m in ms], spread, fmt=style, **look)
        rate.errorbar(nodes, [n / m["median"] / 1000 for n, m in zip(nodes, ms)],
                      [[n / m["median"] / 1000 - n / m["max"] / 1000 for n, m in zip(nodes, ms)],
                       [n / m["min"] / 1000 - n / m["median"] / 1000 for n, m in zip(nodes, ms)]], fmt=style, **look)
time.set(title="Time per step (median, smallest to largest)", ylabel="ms", yscale="log")
rate.set(title="Throughput", ylabel="million node steps per second", ylim=(0, None))
for axes in (time, rate):
    axes.set(xlabel="nodes", xscale="log")
    axes.grid(alpha=0.3)
time.legend(fontsize=8)
output = a.output or a.results[0].with_suffix(".png")
figure.savefig(output, dpi=110)
print(output)
