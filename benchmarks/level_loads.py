"""How well sticking levels are known under a slow load that nobody recorded.

Random integrating loops under PI from brisk to slow, with Stenman and two-parameter valves that set off at least ten
times, noise of up to 10 % of what the band does to PV, and a load that drifts by 5 to 25 % of it. Without setpoint
moves, so that in a plain cycle gain and jump make up for each other: what counts then is whether the ranges hold them.

Printed for each record: verdict, stick band and gain as shares of the true ones; at last how many are right.

Run: python benchmarks/level_loads.py [LOOPS [FIRST [SAMPLES]]]
"""

from __future__ import annotations

import math
import sys
import time
from collections import Counter
from collections.abc import Callable

import numpy as np
from detection import ENOUGH, drift

import workbench as wb


def drawn(seed: int, samples: int) -> tuple[wb.Loop, wb.Record, int]:
    """Return a random loop, its record, and how often its stem set off."""
    rng = np.random.default_rng([seed, 7])
    gain = math.exp(rng.uniform(math.log(0.003), math.log(0.1))) * float(rng.choice([1, 1, 1, -1]))
    plant = wb.Integrating(gain, float(rng.uniform(0.5, 8.0)))
    speed = max(plant.dead_time, 2.0) * rng.uniform(2.0, 10.0)
    Kc = 1.0 / abs(gain) / (speed + plant.dead_time)
    Ti = 4.0 * (speed + plant.dead_time) * rng.uniform(0.7, 2.0)
    S = float(rng.uniform(1.0, 10.0))
    jump = S * float(rng.uniform(0.3, 1.5))
    valve = (wb.Stenman(S), wb.Choudhury(S, S), wb.Choudhury(S, jump))[int(rng.integers(3))]
    load = rng.uniform(0.05, 0.25) * S * drift(rng, samples, rng.uniform(10.0, 40.0) * speed)
    noise = wb.Noise(float(rng.uniform(0.0, 0.1)) * S * abs(gain) * speed, seed)
    controller = wb.PID(float(Kc), float(Ti), action="reverse" if gain > 0.0 else "direct")
    loop = wb.Loop(plant, valve, controller, 1.0)
    run = wb.simulate(loop, wb.Experiment(float(samples), None, wb.Series(load.tolist()), noise))
    moving = np.diff(run.valve) != 0.0
    moves = int((moving[1:] & ~moving[:-1]).sum())
    return loop, wb.Record(run.pv + 50.0, run.op + 50.0, 1.0, sp=run.sp + 50.0), moves


def scored(
    kind: type[wb.FOPDT | wb.Integrating],
    draw: Callable[[int, int], tuple[wb.Loop, wb.Record, int]],
    loops: int,
    first: int,
    samples: int,
) -> None:
    """Print each record's figures, and how many are right.

    draw: gives a loop with that kind of plant by a seed, its record of so many samples, and how often its stem set off.
    """
    right: Counter[str] = Counter()
    seed, took = first, 0.0
    while loops > right["records"]:
        loop, record, moves = draw(seed, samples)
        seed += 1
        if moves < ENOUGH:
            continue
        began = time.process_time()
        found = wb.estimate(record)
        took += time.process_time() - began
        told, known = isinstance(found.plant, kind), found.intervals.gain
        S, gain = found.valve.stick_band / loop.valve.stick_band, found.plant.gain / loop.plant.gain
        right["records"] += 1
        right[found.verdict] += 1
        right[f"told as {kind.__name__}"] += told
        right["S within 5 %"] += abs(S - 1.0) <= 0.05
        right["gain within 5 %"] += told and abs(gain - 1.0) <= 0.05
        right["gain within 20 %"] += told and abs(gain - 1.0) <= 0.2
        right["gain held"] += told and known is not None and known[0] <= loop.plant.gain <= known[1]
        right["identified"] += found.identifiable
        right["of these right"] += found.identifiable and max(abs(S - 1.0), abs(gain - 1.0)) <= 0.05
        ratio = f"gain x {gain:.3f}" if told else type(found.plant).__name__
        print(
            f"{seed - 1:5} {type(loop.valve).__name__:9} {moves:4} moves {found.verdict:12} S x {S:.3f} {ratio}",
            flush=True,
        )
    print(f"{dict(right)}, {took / loops:.1f} s of processor time each")


def asked() -> tuple[int, int, int]:
    """LOOPS, FIRST and SAMPLES of the command, or what they are without."""
    words = sys.argv[1:] + ["24", "0", "1500"][len(sys.argv) - 1 :]
    return int(words[0]), int(words[1]), int(words[2])


if __name__ == "__main__":
    scored(wb.Integrating, drawn, *asked())
