#!/usr/bin/env python3
"""Plots of docs/verification/results.csv (written by run.py --write): convergence.png and forces.png beside it."""
import argparse
import pathlib

import matplotlib
matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

FOLDER = pathlib.Path(__file__).resolve().parent.parent / "docs" / "verification"
# Colours that differ for every kind of colour vision (Okabe and Ito 2008), and markers that differ without colour.
DIFFERENCES = (("converged_interior_median_mm", "interior, median", "#0072B2", "o", "--"), ("converged_interior_p95_mm", "interior, 95 %", "#0072B2", "o", "-"),
               ("converged_near_boundary_p95_mm", "near boundary, 95 %", "#009E73", "s", "-"), ("converged_near_singularity_p95_mm", "near singularity, 95 %", "#D55E00", "^", "-"))
FORCES = (("energy_percent", "strain energy", "#0072B2", "o", "-"), ("reaction_percent", "largest reaction", "#D55E00", "^", "-"))
TARGETS = {"energy_percent": 2, "reaction_percent": 3}  # percent


def panels(results, curves, label):
    """One panel per case, difference over spacing on logarithmic axes; the sixth place is left for the legend."""
    figure, axes = plt.subplots(2, 3, figsize=(11, 7), sharey=True, constrained_layout=True)
    cases = list(dict.fromkeys(results["case"]))
    for axis, case in zip(axes.flat, cases):
        runs = results[results["case"] == case]
        for column, name, colour, marker, style in curves:
            axis.plot(runs["spacing_mm"], np.abs(runs[column]), style, color=colour, marker=marker, label=name)
        axis.set(xscale="log", yscale="log", title=case.replace("_", " "), xlabel="node spacing [mm]")
        axis.set_xticks(runs["spacing_mm"], [f"{h:.3g}" for h in runs["spacing_mm"]])
        axis.minorticks_off()
        axis.grid(alpha=0.3)
    for axis in axes[:, 0]:
        axis.set_ylabel(label)
    axes.flat[-1].axis("off")
    return figure, axes


def main():
    argparse.ArgumentParser(description=__doc__).parse_args()
    results = np.genfromtxt(FOLDER / "results.csv", delimiter=",", names=True, dtype=None, encoding=None)
    figure, axes = panels(results, DIFFERENCES, "difference to the reference [mm]")
    for axis, case in zip(axes.flat, dict.fromkeys(results["case"])):
        runs = results[results["case"] == case]
        axis.axhline(0.01 * runs["largest_mm"][0], color="black", linestyle=":", label="1 % of the largest displacement")
        h = np.array([runs["spacing_mm"].min(), runs["spacing_mm"].max()])
        middle = np.exp(np.log(runs["converged_interior_median_mm"]).mean())
        for order, grey in ((1, "0.75"), (2, "0.5")):
            axis.plot(h, 0.5 * middle * (h / np.sqrt(h.prod())) ** order, color=grey, linewidth=1, label=f"slope of order {order}")
    axes.flat[-1].legend(*axes.flat[0].get_legend_handles_labels(), loc="center", frameon=False)
    figure.savefig(FOLDER / "convergence.png", dpi=120)

    figure, axes = panels(results, FORCES, "difference to the reference [%]")
    for axis in axes.flat[:-1]:
        for column, _, colour, _, _ in FORCES:
            axis.axhline(TARGETS[column], color=colour, linestyle=":", label=f"{TARGETS[column]} %")
    axes.flat[-1].legend(*axes.flat[0].get_legend_handles_labels(), loc="center", frameon=False)
    figure.savefig(FOLDER / "forces.png", dpi=120)


if __name__ == "__main__":
    main()
