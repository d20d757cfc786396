"""What an OP that is recorded in steps costs: the same random loops with OP in full and in steps of .1 %.

Loops of `benchmarks/estimation.py`'s kind (three valves, two plants, no load, PV in full), 1,000 samples, noise up to
5 % of PV's swing, ten slips or more, a band S of .5 to 5 %. Printed for each way of recording: how many have S (d) and
K within 5 %, how many of those called identified, and how many 95 % intervals hold the truth.

Run: python benchmarks/estimation_resolution.py [LOOPS [SEED [METHOD]]]
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
from estimation import Case, covered, errors, random_cases, share, within

import workbench as wb

STEP = 0.1  # %
NAMES = ("S", "K", "tau", "theta")


def plain(c: Case) -> bool:
    """Whether a case has no load, a PV in full, little noise and slips enough."""
    return c.experiment.load is None and not c.quantised and c.noise <= 0.05 and c.slips >= 10


def main(loops: int, seed: int, method: str) -> None:
    """Print a line for each kind of valve and plant and way of recording, and the sums."""
    told: dict[str, list[tuple[Case, wb.Estimate]]] = {"in full": [], "in steps": []}
    for kind, plant, cases in random_cases(loops, seed, plain):
        for name, step in (("in full", 0.0), ("in steps", STEP)):
            records = [replace(c.record, op=np.round(c.record.op / step) * step) if step else c.record for c in cases]
            rows = [(c, wb.estimate(r, plant=plant, method=method)) for c, r in zip(cases, records, strict=True)]
            show(f"{kind}, {plant}, OP {name}", rows)
            told[name] += rows
    for name, rows in told.items():
        show(f"all, OP {name}", rows)


def show(what: str, rows: list[tuple[Case, wb.Estimate]]) -> None:
    """Print the shares of some estimates."""
    right = within([errors(c, e) for c, e in rows], ("S", "K"))
    known = within([errors(c, e) for c, e in rows if e.identifiable], ("S", "K"))
    held = [covered(c, e) for c, e in rows]
    spans = "; ".join(f"{n} {share([h[n] for h in held if n in h])}" for n in NAMES)
    print(f"{what}: S and K {share(right)}; of those called identified {share(known)}; intervals {spans}", flush=True)


if __name__ == "__main__":
    loops = int(sys.argv[1]) if len(sys.argv) > 1 else 6
    seed = int(sys.argv[2]) if len(sys.argv) > 2 else 0
    main(loops, seed, sys.argv[3] if len(sys.argv) > 3 else "profile")
