"""How well sticking valves of self-regulating loops are known under a slow load that nobody recorded.

Random first-order loops under PI from brisk to slow, with Stenman and two-parameter valves that set off at least ten
times, noise of up to 10 % of what the band does to PV, and a load that drifts by 5 to 40 % of it; four in ten have a
setpoint move. In a plain cycle gain and jump make up for each other: what counts then is whether the ranges hold them.

Printed for each record: verdict, stick band and gain as shares of the true ones; at last how many are right.

Run: python benchmarks/lag_loads.py [LOOPS [FIRST [SAMPLES]]]
"""

from __future__ import annotations

import math
import sys
import time
from collections import Counter

import numpy as np
from detection import ENOUGH, drift

import workbench as wb


def drawn(seed: int, samples: int) -> tuple[wb.Loop, wb.Record, int]:
    """Return a random loop, its record, and how often its stem set off."""
    rng = np.random.default_rng([seed, 77])
    gain = math.exp(rng.uniform(math.log(0.3), math.log(5.0))) * float(rng.choice([1, 1, 1, -1]))
    tau = math.exp(rng.uniform(math.log(2.0), math.log(60.0)))
    theta = float(rng.uniform()) * min(tau, 15.0)
    speed = (tau + theta) * float(rng.uniform(0.3, 2.0))
    Kc, Ti = tau / abs(gain) / (speed + theta), tau * float(rng.uniform(0.6, 1.5))
    S = float(rng.uniform(1.0, 10.0))
    jump = S * float(rng.uniform(0.3, 1.5))
    valve = (wb.Stenman(S), wb.Choudhury(S, S), wb.Choudhury(S, jump))[int(rng.integers(3))]
    load = rng.uniform(0.05, 0.4) * S * drift(rng, samples, rng.uniform(5.0, 40.0) * speed)
    noise = wb.Noise(float(rng.uniform(0.0, 0.1)) * S * abs(gain), seed)
    loop = wb.Loop(wb.FOPDT(gain, tau, theta), valve, wb.PID(Kc, Ti, action="reverse" if gain > 0.0 else "direct"), 1.0)
    still = rng.random() < 0.6
    setpoint = None if still else wb.Step(S * abs(gain) * float(rng.uniform(0.5, 2.0)), at=0.3 * samples)
    run = wb.simulate(loop, wb.Experiment(float(samples), setpoint, wb.Series(load.tolist()), noise))
    moving = np.diff(run.valve) != 0.0
    moves = int((moving[1:] & ~moving[:-1]).sum())
    return loop, wb.Record(run.pv + 50.0, run.op + 50.0, 1.0, sp=run.sp + 50.0), moves


def main(loops: int, first: int, samples: int) -> None:
    """Print each record's figures, and how many are right."""
    right: Counter[str] = Counter()
    seed, took = first, 0.0
    while loops > right["records"]:
        loop, record, moves = drawn(seed, samples)
        seed += 1
        if moves < ENOUGH:
            continue
        began = time.process_time()
        found = wb.estimate(record)
        took += time.process_time() - began
        lag, known = isinstance(found.plant, wb.FOPDT), found.intervals.gain
        S, gain = found.valve.stick_band / loop.valve.stick_band, found.plant.gain / loop.plant.gain
        right["records"] += 1
        right[found.verdict] += 1
        right["told as first order"] += lag
        right["S within 5 %"] += abs(S - 1.0) <= 0.05
        right["gain within 5 %"] += lag and abs(gain - 1.0) <= 0.05
        right["gain within 20 %"] += lag and abs(gain - 1.0) <= 0.2
        right["gain held"] += lag and known is not None and known[0] <= loop.plant.gain <= known[1]
        right["identified"] += found.identifiable
        right["of these right"] += found.identifiable and max(abs(S - 1.0), abs(gain - 1.0)) <= 0.05
        told = f"gain x {gain:.3f}" if lag else "integrating"
        print(
            f"{seed - 1:5} {type(loop.valve).__name__:9} {moves:4} moves {found.verdict:12} S x {S:.3f} {told}",
            flush=True,
        )
    print(f"{dict(right)}, {took / loops:.1f} s of processor time each")


if __name__ == "__main__":
    main(*(int(word) for word in (sys.argv[1:] + ["24", "0", "1500"][len(sys.argv) - 1 :])))
