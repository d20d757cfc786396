"""Verdicts on loops under setpoint moves that make nearly all of PV, healthy and sticky.

    python benchmarks/detection_moves.py [LOOPS [FIRST]]

The loops are simulated here, apart from the product, with what its models do not have: plants of two lags, valves and
sensors with a curve. Each class is flow (self-regulating) and level, 600 to 2,000 samples, PI tuned from brisk to slow,
one to five setpoint moves, noise of .1 to 5 % and a slow load of .3 to 5 % ("drift": 15 %) of the largest move; stick
bands of 3 to 60 % of the OP that such a move takes. Last, one healthy loop, tuned briskly, with valves of several
curves, noises and dead times.
"""

from __future__ import annotations

import itertools
import math
import sys
from collections import Counter

import numba
import numpy as np

import workbench as wb

HEALTHY = ("plain", "two lags", "curved valve", "curved PV", "two lags, curved", "drift")
# Of a sticky class: the law, J as a share of S, and whether the plant has two lags.
STICKY = {
    "Stenman": ("stenman", 0.0, False),
    "dead band": ("dead band", 0.0, False),
    "S > J": ("two-parameter", 0.3, False),
    "S = J": ("two-parameter", 1.0, False),
    "dead band, two lags": ("dead band", 0.0, True),
    "S = J, two lags": ("two-parameter", 1.0, True),
}
LAWS = ("", "stenman", "dead band", "two-parameter")


@numba.njit(cache=True)
def moved(op: float, stem: float, law: int, S: float, J: float, turn: np.ndarray) -> float:
    """Return where the stem goes; turn: OP where a two-parameter stem last moved, and the sense of that."""
    if law == 0:
        return op
    if law == 1:
        return op if abs(op - stem) > S else stem
    if law == 2:
        return min(max(stem, op - 0.5 * S), op + 0.5 * S)
    on = (op - turn[0]) * turn[1]
    if on > J or on < -S:
        if on < -S:
            turn[1] = -turn[1]
        turn[0] = op
        return op - turn[1] * 0.5 * (S - J)
    return stem


@numba.njit(cache=True)
def simulated(
    sp: np.ndarray,
    load: np.ndarray,
    noise: np.ndarray,
    valve: tuple[int, float, float],
    plant: tuple[float, float, float, float],
    level: bool,
    controller: tuple[float, float],
    bend: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Return PV and OP. plant: gain, two time constants and dead time, s, of 0 where there is none; bend: of the valve,
    per %, whose flow is the stem's position and `bend` times half its square.
    """
    n, (gain, tau, second, theta), (Kc, Ti) = sp.size, plant, controller
    whole = int(theta)
    part = theta - whole
    flow, pv, op, turn = np.zeros(n + whole + 2), np.zeros(n), np.zeros(n), np.array([0.0, 1.0])
    first = math.exp(-1.0 / tau) if tau > 0.0 else 0.0
    further = math.exp(-1.0 / second) if second > 0.0 else 0.0
    stem = z = x = total = 0.0
    for k in range(n):
        pv[k] = x + noise[k]
        error = sp[k] - pv[k]
        total += Kc * error / Ti
        op[k] = Kc * error + total
        stem = moved(op[k], stem, valve[0], valve[1], valve[2], turn)
        through = stem + 0.5 * bend * stem * stem
        flow[k + whole] += (1.0 - part) * through
        flow[k + whole + 1] += part * through
        enters = flow[k] + load[k]
        z = first * z + (1.0 - first) * enters
        x = x + gain * z if level else further * x + (1.0 - further) * gain * z
    return pv, op


def drift(rng: np.random.Generator, n: int, correlation: float) -> np.ndarray:
    """A unit-variance first-order drift of the given correlation time, samples."""
    pole = math.exp(-1.0 / max(correlation, 0.2))
    value, out = rng.normal(), np.empty(n)
    for k, kick in enumerate(rng.normal(size=n)):
        value = pole * value + math.sqrt(1.0 - pole * pole) * kick
        out[k] = value
    return out


def record(kind: str, level: bool, seed: int) -> wb.Record | None:
    """Return one random loop's record; None where it runs away."""
    law, share, twice = STICKY.get(kind, ("", 0.0, kind.startswith("two lags")))
    rng = np.random.default_rng([seed, level, (*HEALTHY, *STICKY).index(kind), 77])
    n = int(rng.choice([600, 1000, 2000]))
    tau = float(np.exp(rng.uniform(1.0, 3.7)))
    theta, slack = max(0.3, tau * rng.uniform(0.05, 1.0)), rng.uniform(1.0, 4.0)
    second = tau * rng.uniform(0.1, 1.0) if twice else 0.0
    late, gain = theta + second, float(np.exp(rng.uniform(math.log(0.3), math.log(3.0))))
    if level:
        gain /= float(np.exp(rng.uniform(3.0, 5.7)))
        speed = max(late, 2.0) * slack * 2.0
        controller = 1.0 / gain / (speed + late), 4.0 * (speed + late) * rng.uniform(0.7, 2.0)
        tau, second, size = second, 0.0, gain * speed
    else:
        speed = late * slack + 0.3 * tau
        controller = tau / gain / (speed + late), min(tau, 4.0 * (speed + late)) * rng.uniform(0.6, 1.6)
        size = gain
    at = np.sort(rng.choice(np.arange(20, n - 60), int(rng.integers(1, 6)), replace=False))
    at[0] = 20 if rng.random() < 0.5 else at[0]
    sp = np.zeros(n)
    for t in at:
        sp[t:] = sp[t - 1] * rng.choice([0, 1]) + size * rng.normal() * (1.0 + 0.5 * rng.random())
    if np.ptp(sp) == 0.0:
        sp[n // 3 :] = size
    most = float(np.abs(np.diff(sp)).max())
    noise = rng.normal(size=n) * most * np.exp(rng.uniform(math.log(0.001), math.log(0.05)))
    rough = (
        0.0 if kind == "plain" else np.exp(rng.uniform(math.log(0.003), math.log(0.15 if kind == "drift" else 0.05)))
    )
    load = most / size * rough * drift(rng, n, rng.uniform(3.0, 40.0) * speed)
    S = most / size * np.exp(rng.uniform(math.log(0.03), math.log(0.6))) if law else 0.0
    reach = 2.0 * most / size if level else max(1e-9, float(np.abs(sp).max()) / gain)
    bend = rng.choice([-1, 1]) * rng.uniform(0.2, 0.5) / reach if kind in ("curved valve", "two lags, curved") else 0.0
    valve = LAWS.index(law), float(S), float(share * S)
    pv, op = simulated(sp, load, noise, valve, (gain, tau, second, theta), level, controller, float(bend))
    if kind in ("curved PV", "two lags, curved"):
        pv = pv + rng.choice([-1, 1]) * rng.uniform(0.1, 0.4) * pv * pv / (2.0 * np.abs(pv).max())
    if not np.isfinite(pv).all() or np.abs(pv).max() > 50.0 * np.abs(sp).max():
        return None
    return wb.Record(pv + 50.0, op + 50.0, 1.0, sp=sp + 50.0)


def brisk(seed: int, curve: float, noise: float, late: float) -> wb.Record | None:
    """Return the record of a brisk loop with a curved valve, per %; late: its dead time, s. None where it runs away."""
    rng, n = np.random.default_rng(seed), 600
    slow = np.convolve(rng.normal(size=n + 300), np.exp(-np.arange(300) / 60.0), "valid")[:n]
    sp = -0.55 * (np.arange(n) >= 306) + 0.89 * (np.arange(n) >= 357)
    plant, rough = (0.43, 2.9, 0.0, late), noise * rng.normal(size=n)
    pv, op = simulated(sp, 5.0 * noise / slow.std() * slow, rough, (0, 0.0, 0.0), plant, False, (3.6, 2.0), 2.0 * curve)
    if not np.isfinite(pv).all() or np.abs(pv).max() > 20.0:
        return None
    return wb.Record(pv + 50.0, op + 40.0, 1.0, sp=sp + 50.0)


def main(loops: int, first: int) -> None:
    """Print the verdicts by class, and of all that are healthy and all that stick."""
    total = {"healthy": Counter[str](), "sticky": Counter[str]()}
    for kind in (*HEALTHY, *STICKY):
        for level in (False, True):
            records = (record(kind, level, seed) for seed in range(first, first + loops))
            verdicts = Counter(wb.detect(one).verdict for one in records if one is not None)
            total["healthy" if kind in HEALTHY else "sticky"] += verdicts
            print(f"{'level' if level else 'flow'}, {kind}: {dict(verdicts)}", flush=True)
    for name, verdicts in total.items():
        print(f"{name}: {dict(verdicts)}")
    curves, noises = (-0.2, -0.14, -0.1, -0.05, 0.05, 0.1), (0.002, 0.004, 0.008, 0.016)
    cases = itertools.product(range(first, first + 6), curves, noises, (0.0, 1.0))
    records = (brisk(*case) for case in cases)
    verdicts = Counter(wb.detect(one).verdict for one in records if one is not None)
    print(f"one brisk loop with curved valves, healthy: {dict(verdicts)}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 30, int(sys.argv[2]) if len(sys.argv) > 2 else 0)
