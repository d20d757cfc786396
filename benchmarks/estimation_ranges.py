"""How honest the ranges of random sticking loops are, with and without a setpoint move in the record.

Loops of `benchmarks/estimation.py`'s kind (three valves, two plants, no load), five slips or more. By default records
from within a cycle, long after the setpoint moved: 300 to 2,000 samples, noise of 0.5 to 20 % of PV's swing, a quarter
of them quantised. With "moved": 1,000 samples with a setpoint move, noise of 1 to 5 %, twelve slips or more.

Printed for the verdict "stiction", and for what is called identified: how many 95 % intervals hold the truth, and how
wide those of S (d) and K are. A line for each loop whose intervals miss it.

Run: python benchmarks/estimation_ranges.py [LOOPS [SEED [moved]]]
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
from estimation import Case, covered, drawn, measured, share

import workbench as wb

KINDS, PLANTS = ("stenman", "choudhury", "deadband"), ("fopdt", "integrating")
SETTLED = 1000  # samples left out before a record from within the cycle
NAMES = ("S", "K", "tau", "theta")


def case(seed: int, moved: bool) -> tuple[Case, str]:
    """The random loop of a seed as it is recorded, and its kind of plant."""
    kind, plant = KINDS[seed % 3], PLANTS[seed // 3 % 2]
    rng = np.random.default_rng([9090, seed, int(moved)])
    while True:
        samples = 1000 if moved else int(rng.choice([300, 600, 1000, 1000, 2000]))
        loop, _, size = drawn(rng, kind, plant)
        skip = 0 if moved and rng.random() < 0.5 else SETTLED
        steps = [wb.Step(size)]
        if moved:
            steps.append(wb.Step(-1.5 * size, at=float(skip + rng.integers(300, 700))))
        noise = float(rng.choice((0.01, 0.02, 0.05) if moved else (0.005, 0.01, 0.02, 0.05, 0.05, 0.2)))
        quantised = bool(rng.random() < 0.25) and not moved
        plain = wb.Experiment(float(samples + skip), setpoint=steps)
        swing = float(np.ptp(measured(loop, plain, skip, 0.0)[0].pv))
        if not 1e-6 < swing < 20.0 * size:
            continue
        experiment = replace(plain, noise=wb.Noise(noise * swing, int(rng.integers(0, 2**31))))
        record, slips = measured(loop, experiment, skip, swing / 200.0 if quantised else 0.0)
        if slips >= (12 if moved else 5):
            return Case(loop, experiment, skip, noise, moved, quantised, record, slips), plant


def main(loops: int, seed: int, moved: bool) -> None:
    """Print the table."""
    told: dict[str, list[tuple[dict[str, bool], list[float]]]] = {"verdict stiction": [], "identified": []}
    for one in range(seed, seed + loops):
        c, plant = case(one, moved)
        found = wb.estimate(c.record, plant=plant)
        if found.verdict != "stiction":
            continue
        held, i = covered(c, found), found.intervals
        pairs = ((i.S or i.d, found.valve.stick_band), (i.gain, found.plant.gain))
        widths = [np.nan if pair is None else (pair[1] - pair[0]) / abs(value) for pair, value in pairs]
        told["verdict stiction"].append((held, widths))
        if found.identifiable:
            told["identified"].append((held, widths))
        if not all(held.values()):
            missed = ", ".join(name for name, holds in held.items() if not holds)
            print(
                f"seed {one}, {len(c.record)} samples, {c.slips} slips: {c.loop.valve} {c.loop.plant} misses {missed}"
            )
    for name, rows in told.items():
        text = "; ".join(f"{n} {share([held[n] for held, _ in rows if n in held])}" for n in NAMES)
        wide = np.nanmedian([widths for _, widths in rows], axis=0) if rows else (np.nan, np.nan)
        print(
            f"{name} {len(rows)} of {loops}: {text}; median width of S {wide[0]:.3f}, of K {wide[1]:.3f} of the value"
        )


if __name__ == "__main__":
    given = sys.argv[1:]
    main(int(given[0]) if given else 60, int(given[1]) if len(given) > 1 else 0, "moved" in given)
