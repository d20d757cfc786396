"""How well valves are known that do not stick alike at every slip, as real ones do not.

Random loops in their cycle, one- and two-parameter valves that set off at least ten times, first-order and integrating
plants, noise of 1 to 5 % of what the band does to PV. Each slip has a band of its own, of a normal distribution with a
standard deviation of 0, 1, 3 or 10 % of its mean. Printed for each: how many have S (d) and K within 5 %, how many are
called identified and how many of those are right, how many ranges hold the truth, and the processor time of each.

Run: python benchmarks/uneven_valves.py [LOOPS [FIRST [SAMPLES]]]
"""

from __future__ import annotations

import math
import sys
import time
from collections import Counter

import numpy as np
from numpy.typing import NDArray

import workbench as wb

LEAD = 600  # samples left out, in which the cycle settles
SPREADS = (0.0, 0.01, 0.03, 0.1)
ENOUGH, NEAR = 10, 0.05


def cycled(
    plant: wb.FOPDT | wb.Integrating,
    valve: wb.Stenman | wb.Choudhury,
    pi: tuple[float, float],
    spread: float,
    samples: int,
    noise: float,
    rng: np.random.Generator,
    memory: float = 0.0,
) -> tuple[wb.Record, NDArray[np.float64]]:
    """Return a record of a cycle and its stem (%, shape (N,)); samples of 1 s, the dead time in whole ones.

    pi: Kc and Ti, s; spread: standard deviation of the bands, %; noise: of PV, EU; memory: what a sample's noise keeps
    of the last one's. Written from the published laws, as a sample-by-sample loop: no valve of the package sticks
    unevenly.
    """
    Kc, Ti = pi
    first_order = isinstance(plant, wb.FOPDT)
    pole = math.exp(-1.0 / plant.time_constant) if first_order else 1.0
    share = plant.gain * (1.0 - pole) if first_order else plant.gain
    delay, sticks = round(plant.dead_time), isinstance(valve, wb.Stenman)
    jump, gap = (valve.d, 0.0) if sticks else (valve.J, valve.S - valve.J)
    least, n = 0.02 * valve.stick_band, samples + LEAD

    def drawn() -> float:
        return max(jump + spread * rng.normal(), least)

    y = total = led = before = disturbed = 0.0
    sense, moving, band, setpoint = 1.0, False, drawn(), 0.5 * valve.stick_band * share / max(1.0 - pole, 0.1)
    stem, rows = np.zeros(n + delay + 1), []
    for k in range(n):
        disturbed = memory * disturbed + rng.normal()
        pv = y + noise * disturbed
        total += Kc * (setpoint - pv) / Ti
        op = Kc * (setpoint - pv) + total
        on = op - led if sticks else (op - led) * sense
        if not sticks and moving and (op - before) * sense > 0.0:
            led = op
        else:
            moving = abs(on) > band if sticks else on > band or -on > gap + band
            if moving:
                sense = sense if sticks or on > 0.0 else -sense
                led, band = op, drawn()
        before, stem[k + delay] = op, led - 0.5 * sense * gap
        rows.append((pv, op, stem[k + delay]))
        y = pole * y + share * stem[k]
    pv, op, x = np.array(rows[LEAD:]).T
    return wb.Record(pv + 50.0, op + 40.0, 1.0, sp=np.full(samples, 50.0 + setpoint)), x + 40.0


def drawn_loop(
    seed: int, samples: int, share: float
) -> tuple[wb.FOPDT | wb.Integrating, wb.Stenman | wb.Choudhury, wb.Record, int]:
    """Return a random plant and valve, its record, and how often its stem set off; share: of the bands' spread."""
    rng = np.random.default_rng([seed, 77])
    tau, theta, S = float(rng.uniform(4.0, 20.0)), float(rng.integers(1, 6)), float(rng.uniform(0.5, 5.0))
    valve = wb.Stenman(S) if rng.integers(2) else wb.Choudhury(S, S * float(rng.uniform(0.2, 0.9)))
    plant: wb.FOPDT | wb.Integrating
    if rng.integers(2):
        plant = wb.FOPDT(float(rng.uniform(0.5, 2.0)), tau, theta)
        pi = float(rng.uniform(0.3, 0.8)) / plant.gain, tau * float(rng.uniform(0.5, 1.2))
        swing = S * plant.gain
    else:
        plant = wb.Integrating(float(rng.uniform(0.02, 0.1)), theta)
        pi = 0.35 / (plant.gain * (theta + 3.0)) * float(rng.uniform(0.4, 1.0)), 8.0 * (theta + 3.0)
        swing = S * plant.gain * (theta + 6.0)
    record, stem = cycled(plant, valve, pi, share * S, samples, float(rng.uniform(0.01, 0.05)) * swing, rng)
    moves = np.diff(stem) != 0.0
    return plant, valve, record, int((moves[1:] & ~moves[:-1]).sum())


def holds(pair: tuple[float, float] | None, value: float) -> bool:
    """Whether there is a range and it holds a value."""
    return pair is not None and pair[0] <= value <= pair[1]


def main(loops: int, first: int, samples: int) -> None:
    """Print a line for each spread."""
    for share in SPREADS:
        told: Counter[str] = Counter()
        took, seed = 0.0, first
        while told["loops"] < loops:
            plant, valve, record, slips = drawn_loop(seed, samples, share)
            seed += 1
            if slips < ENOUGH or not float(np.ptp(record.pv)) < 1e3:
                continue
            kind = "fopdt" if isinstance(plant, wb.FOPDT) else "integrating"
            begun = time.process_time()
            found = wb.estimate(record, plant=kind)
            took += time.process_time() - begun
            S = abs(found.valve.stick_band / valve.stick_band - 1.0) < NEAR
            K = abs(found.plant.gain / plant.gain - 1.0) < NEAR
            band = found.intervals.d or found.intervals.S
            told.update(
                loops=1,
                stiction=int(found.verdict == "stiction"),
                S=int(S),
                K=int(K),
                identified=int(found.identifiable),
                right=int(found.identifiable and S and K),
                held_K=int(holds(found.intervals.gain, plant.gain)),
                held_S=int(holds(band, valve.stick_band)),
                ranges=int(found.intervals.gain is not None),
            )
        print(f"spread {share:.0%}: {dict(told)}, {took / loops:.1f} s each", flush=True)


if __name__ == "__main__":
    given = [int(value) for value in sys.argv[1:]]
    main(*(given + [24, 0, 1000][len(given) :]))
