"""Estimates and verdicts where the dead time is long: up to a fifth of the record, healthy loops and sticky ones.

    python benchmarks/dead_times.py [LOOPS [SEED]]

Each class holds LOOPS (8) loops of each kind: FOPDT and integrating plants with dead times of 12 to 28, 35 to 80 and 90
to 220 samples, time constants of .3 to 3 dead times, records of 1,000 to 2,000 samples with two setpoint moves, noise
of .5 to 5 % of what PV swings over. Sticky ones: each valve, PI from brisk to slow. Healthy ones: noise alone, a slow
load, tight tuning. Printed for each class: what `detect` and `estimate` say; how many have d and gain within 5 %, the
dead time within 2 samples, and the true gain and dead time in their ranges; how many were called identified, and how
many of these wrongly; and the processor time of `estimate`.
"""

from __future__ import annotations

import math
import sys
import time
from collections import Counter
from collections.abc import Iterator

import numpy as np

import workbench as wb
from workbench.model.plant import Plant
from workbench.model.valve import Valve

DEAD_TIMES = ((12.0, 28.0), (35.0, 80.0), (90.0, 220.0))  # samples
STICKY = ("stenman", "choudhury", "deadband")
HEALTHY = ("noise", "slow load", "tight tuning")
PLANTS = ("fopdt", "integrating")


def valve_of(kind: str, rng: np.random.Generator) -> Valve:
    S = float(rng.uniform(1.0, 4.0))
    if kind == "choudhury":
        return wb.Choudhury(S, S * float(rng.uniform(0.2, 0.9)))
    return wb.Stenman(S) if kind == "stenman" else wb.Deadband(S) if kind == "deadband" else wb.Ideal()


def loop_of(plant: str, kind: str, within: tuple[float, float], rng: np.random.Generator) -> tuple[wb.Loop, float]:
    """Return a random loop, and how large a setpoint move makes its valve slip a few times."""
    theta = float(rng.uniform(*within))
    tau = theta * math.exp(rng.uniform(math.log(0.3), math.log(3.0)))
    gain = math.exp(rng.uniform(math.log(0.5), math.log(3.0)))
    valve = valve_of(kind, rng)
    slow = theta * float(rng.uniform(-0.25, 0.0) if kind == "tight tuning" else rng.uniform(0.5, 1.5))
    model: Plant
    if plant == "fopdt":
        model = wb.FOPDT(gain, tau, theta)
        controller = wb.PID(Kc=tau / (gain * (slow + theta)), Ti=tau * float(rng.uniform(0.6, 1.5)))
        moved = gain
    else:
        model = wb.Integrating(gain / 50.0, theta)
        controller = wb.PID(Kc=50.0 / (gain * (slow + theta)), Ti=4.0 * (max(slow, 0.3 * theta) + theta))
        moved = gain / 50.0 * theta
    return wb.Loop(model, valve, controller, 1.0), (valve.stick_band or 2.0) * moved * float(rng.uniform(1.0, 4.0))


def records(plant: str, kind: str, within: tuple[float, float], seed: int) -> Iterator[tuple[wb.Loop, wb.Record]]:
    rng = np.random.default_rng([seed, PLANTS.index(plant), (*STICKY, *HEALTHY).index(kind), int(within[0])])
    while True:
        loop, size = loop_of(plant, kind, within, rng)
        samples = int(rng.choice([1000, 1500, 2000]))
        moves = [wb.Step(size, at=0.05 * samples), wb.Step(-1.5 * size, at=samples * float(rng.uniform(0.4, 0.6)))]
        load: list[wb.Step] | wb.Series = []
        if kind == "slow load":
            fades, kicks = math.exp(-1.0 / within[1]), rng.normal(size=samples) * rng.uniform(0.05, 0.3)
            values = [0.0]
            for kick in kicks[1:].tolist():
                values.append(fades * values[-1] + kick)
            load = wb.Series(values)
        quiet = wb.simulate(loop, wb.Experiment(float(samples), moves, load))
        span = float(np.ptp(quiet.pv))
        # A dead band that is not crossed, or a loop that swings up, shows nothing.
        if not 0.2 * abs(size) < span < 1e3 * abs(size):
            continue
        noise = wb.Noise(float(rng.choice([0.005, 0.01, 0.02, 0.05])) * span, int(rng.integers(2**31)))
        run = wb.simulate(loop, wb.Experiment(float(samples), moves, load, noise))
        yield loop, wb.Record(run.pv, run.op, 1.0, sp=run.sp)


def holds(pair: tuple[float, float] | None, value: float) -> bool:
    return pair is None or pair[0] <= value <= pair[1]


def main() -> None:
    loops = int(sys.argv[1]) if len(sys.argv) > 1 else 8
    seed = int(sys.argv[2]) if len(sys.argv) > 2 else 1
    for within in DEAD_TIMES:
        print("dead times of {:g} to {:g} samples".format(*within))
        for kind in (*STICKY, *HEALTHY):
            said, right, took = Counter[str](), Counter[str](), 0.0
            for plant in PLANTS:
                for (loop, record), _ in zip(records(plant, kind, within, seed), range(loops), strict=False):
                    said["detect " + wb.detect(record).verdict] += 1
                    began = time.process_time()
                    found = wb.estimate(record, plant=plant)
                    took += time.process_time() - began
                    said["estimate " + found.verdict] += 1
                    true = loop.plant
                    gain = abs(found.plant.gain / true.gain - 1.0) <= 0.05
                    band = abs(found.valve.stick_band - loop.valve.stick_band) <= 0.05 * loop.valve.stick_band
                    right["d and K"] += gain and band
                    right["dead time"] += abs(found.plant.dead_time - true.dead_time) <= 2.0
                    ranges = found.intervals
                    right["covered"] += holds(ranges.gain, true.gain) and holds(ranges.dead_time, true.dead_time)
                    right["identified"] += found.identifiable
                    right["wrongly"] += found.identifiable and not (gain and band)
            words = ", ".join(f"{what} {right[what]}" for what in ("d and K", "dead time", "covered", "identified"))
            print(f"  {kind:12} of {2 * loops}: {dict(sorted(said.items()))}")
            print(f"{'':15}{words} ({right['wrongly']} wrongly), {took / (2 * loops):.2f} s", flush=True)


if __name__ == "__main__":
    main()
