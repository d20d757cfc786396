"""What an OP that is recorded in steps costs: the same random loops with OP in full and in steps of .1 %.

Loops of `benchmarks/estimation.py`'s kind (three valves, two plants, no load, PV in full), 1,000 samples, noise up to
5 % of PV's swing, ten slips or more, a band S of .5 to 5 %. Printed for each way of recording: how many have S (d) and
K within 5 %, how many of those called identified, and how many 95 % intervals hold the truth.

Run: python benchmarks/estimation_resolution.py [LOOPS [SEED]]
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
from estimation import Case, case, covered, errors, share, within

import workbench as wb

STEP = 0.1  # %
NAMES = ("S", "K", "tau", "theta")


def main(loops: int, seed: int) -> None:
    """Print a line for each kind of valve and plant and way of recording, and the sums."""
    told: dict[str, list[tuple[Case, wb.Estimate]]] = {"in full": [], "in steps": []}
    for kind in ("stenman", "choudhury", "deadband"):
        for plant in ("fopdt", "integrating"):
            rng = np.random.default_rng([seed, len(kind), len(plant)])
            cases: list[Case] = []
            while len(cases) < loops:
                one = case(rng, kind, plant)
                plain = one is not None and one.experiment.load is None and not one.quantised and one.noise <= 0.05
                cases += [one] if one is not None and plain and one.slips >= 10 else []
            for name, step in (("in full", 0.0), ("in steps", STEP)):
                records = [
                    replace(c.record, op=np.round(c.record.op / step) * step) if step else c.record for c in cases
                ]
                rows = [(c, wb.estimate(r, plant=plant)) for c, r in zip(cases, records, strict=True)]
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
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 6, int(sys.argv[2]) if len(sys.argv) > 2 else 0)
