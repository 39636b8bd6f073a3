#!/usr/bin/env python3
"""Compare what `mtled solve` wrote with a reference solution; exit 1 if fewer than P % of the probes lie within MM."""
import argparse
import json
import pathlib
import sys

import numpy as np


def read_probes(path):
    return np.genfromtxt(path, delimiter=",", names=True, dtype=None, encoding=None)


def vectors(table, names):
    return np.column_stack([table[n] for n in names])


class Comparison:
    """Differences of a result to the reference. `distance` [probes] mm, `largest` displacement of the reference mm."""

    def __init__(self, problem_dir, result_dir):
        problem_dir, result_dir = pathlib.Path(problem_dir), pathlib.Path(result_dir)
        reference, result = read_probes(problem_dir / "probes.csv"), read_probes(result_dir / "probes.csv")
        if len(reference) != len(result):
            sys.exit(f"{len(result)} probes in the result, {len(reference)} in the reference")
        if np.abs(vectors(reference, "xyz") - vectors(result, "xyz")).max() > 1e-4:
            sys.exit("the probes are not the reference's, or in another order")
        wanted, u = (vectors(t, ("ux", "uy", "uz")) for t in (reference, result))
        if not np.isfinite(u).all():
            sys.exit(f"{(~np.isfinite(u).all(1)).sum()} probes have no finite displacement")
        self.zone = reference["zone"]
        self.displacement = u
        self.distance = np.linalg.norm(wanted - u, axis=1)
        self.largest = float(np.linalg.norm(wanted, axis=1).max())
        self.reference = json.loads((problem_dir / "problem.json").read_text())["reference"]
        self.summary = json.loads((result_dir / "summary.json").read_text())

    def percentiles(self, zone=None):
        """Median, 95 %, 99.5 % and maximum [mm]."""
        d = self.distance if zone is None else self.distance[self.zone == zone]
        return *np.percentile(d, (50, 95, 99.5)), d.max()

    def within(self, mm, zone=None):
        """Percent of the probes (of a zone)."""
        d = self.distance if zone is None else self.distance[self.zone == zone]
        return 100 * float((d <= mm).mean())

    def energy_percent(self):
        return 100 * (self.summary["strain_energy_mN_mm"] / self.reference["strain_energy_mNmm"] - 1)

    def reaction_percents(self):
        """Per set, in percent of the largest reaction."""
        wanted = self.reference["reaction_force_mN"]
        scale = max(np.linalg.norm(r) for r in wanted.values())
        return {name: 100 * float(np.linalg.norm(np.subtract(self.summary["reactions_mN"][name], r))) / scale
                for name, r in wanted.items()}


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("problem", help="folder of a reference problem")
    parser.add_argument("result", help="folder that `mtled solve` wrote")
    parser.add_argument("--percent", type=float, metavar="P")
    parser.add_argument("--within", type=float, metavar="MM", help="default: 2 %% of the largest displacement")
    a = parser.parse_args()
    c = Comparison(a.problem, a.result)
    print(f"{'zone':18s} {'probes':>6s} {'median':>8s} {'95 %':>8s} {'99.5 %':>8s} {'max':>8s} mm   "
          f"(largest displacement {c.largest:.3f} mm)")
    for zone in [None] + sorted(set(c.zone)):
        count = len(c.zone) if zone is None else (c.zone == zone).sum()
        print(f"{zone or 'all':18s} {count:6d} " + " ".join(f"{q:8.4f}" for q in c.percentiles(zone)))
    s = c.summary
    print(f"strain energy {s['strain_energy_mN_mm']:.6g} mN mm (reference {c.reference['strain_energy_mNmm']:.6g}, "
          f"{c.energy_percent():+.2f} %)")
    for name, percent in c.reaction_percents().items():
        print(f"reaction {name}: {np.round(s['reactions_mN'][name], 3).tolist()} mN "
              f"(reference {np.round(c.reference['reaction_force_mN'][name], 3).tolist()}, "
              f"difference {percent:.2f} % of the largest)")
    print(f"converged {s['converged']}, {s['steps']} steps, estimated error {s['error_estimate_mm']:.4g} mm, "
          f"{s['seconds']:.3g} s")
    limit = 0.02 * c.largest if a.within is None else a.within
    print(f"{c.within(limit):.2f} % of the probes within {limit:.4g} mm")
    if a.percent is not None and (c.within(limit) < a.percent or not s["converged"]):
        sys.exit(f"asked: {a.percent} %, converged")


if __name__ == "__main__":
    main()
