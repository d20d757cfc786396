"""How well healthy loops are known under load steps that nobody recorded, and how seldom their valves are doubted.

Random plants and PI controllers of `estimation.py`, first order and integrating in turn, valves that do not stick;
records of 1,000 samples from rest, with one setpoint move or two, noise of 0.5 to 5 % of PV's swing, and from no load
step to four at random times, each of a fifth to all of what OP moves for the setpoint.

Printed for each number of steps: the share of gains within 5 %, of 95 % ranges of the gain that hold the truth, of
records in which just those steps are found, the verdicts, and the mean processor time.

Run: python benchmarks/load_steps.py [LOOPS [SEED]]
"""

from __future__ import annotations

import sys
import time
from collections import Counter
from dataclasses import dataclass, field, replace

import numpy as np
from estimation import SAMPLES, drawn

import workbench as wb

MOST = 4  # load steps
NOISE = (0.005, 0.01, 0.02, 0.05)  # of PV's swing
CLOSE = 0.05  # of the gain
BESIDE, ALIKE = 5.0, 0.15  # s after the dead time, share: a step that was found is the loop's


@dataclass
class Tally:
    """What came of the records with one number of load steps."""

    close: list[bool] = field(default_factory=list)
    held: list[bool] = field(default_factory=list)
    found: list[bool] = field(default_factory=list)
    took: list[float] = field(default_factory=list)
    verdicts: Counter[str] = field(default_factory=Counter)


def healthy(rng: np.random.Generator, plant: str, many: int) -> tuple[wb.Loop, list[wb.Step], wb.Record]:
    """A random loop whose valve does not stick, its load steps, and its record."""
    while True:
        loop, _, size = drawn(rng, "stenman", plant)
        loop = replace(loop, valve=wb.Ideal())
        moves = [wb.Step(size)]
        if rng.random() < 0.7:
            moves.append(wb.Step(-1.5 * size, at=float(rng.integers(300, 700))))
        times = sorted(rng.choice(np.arange(40, SAMPLES - 40), many, replace=False).tolist())
        moved = size * loop.controller.Kc if plant == "integrating" else size / abs(loop.plant.gain)
        sizes = moved * rng.uniform(0.2, 1.0, many) * rng.choice([-1.0, 1.0], many)
        noise, seed = float(rng.choice(NOISE)), int(rng.integers(2**31))
        load = [wb.Step(float(by), at=float(at)) for by, at in zip(sizes, times, strict=True)]
        swing = float(np.ptp(wb.simulate(loop, wb.Experiment(float(SAMPLES), moves)).pv))
        if 1e-6 < swing < 20.0 * size:
            experiment = wb.Experiment(float(SAMPLES), moves, load or None, wb.Noise(noise * swing, seed))
            run = wb.simulate(loop, experiment)
            return loop, load, wb.Record(run.pv + 50.0, run.op + 40.0, 1.0, sp=run.sp + 50.0)


def same(found: wb.Estimate, load: list[wb.Step], dead_time: float) -> bool:
    """Whether the load steps that were found are the loop's."""
    return len(found.load_steps) == len(load) and all(
        abs(one.at - step.at - dead_time) <= BESIDE and abs(one.size / step.size - 1.0) <= ALIKE
        for one, step in zip(found.load_steps, load, strict=True)
    )


def main(loops: int, seed: int) -> None:
    """Print the table."""
    rng = np.random.default_rng(seed)
    for many in range(MOST + 1):
        tally = Tally()
        for i in range(loops):
            plant = ("fopdt", "integrating")[i % 2]
            loop, load, record = healthy(rng, plant, many)
            began = time.process_time()
            found = wb.estimate(record, plant=plant)
            tally.took.append(time.process_time() - began)
            gain, known = loop.plant.gain, found.intervals.gain
            tally.close.append(abs(found.plant.gain / gain - 1.0) <= CLOSE)
            tally.held += [] if known is None else [known[0] <= gain <= known[1]]
            tally.found.append(same(found, load, loop.plant.dead_time))
            tally.verdicts[found.verdict] += 1
        print(
            f"{many} load steps: gain within 5 % in {sum(tally.close)} of {loops}, held by its range in "
            f"{sum(tally.held)} of {len(tally.held)}; just these steps found in {sum(tally.found)}; "
            f"{dict(tally.verdicts.most_common())}; {np.mean(tally.took):.2f} s",
            flush=True,
        )


if __name__ == "__main__":
    main(*(int(word) for word in (sys.argv[1:] + ["24", "11"][len(sys.argv) - 1 :])))
