"""How well slow random loops of known truth are estimated from long records, and how long it takes.

Random plants (FOPDT and integrating), PI controllers and valves (Stenman, two-parameter, dead band); 4,000 to 20,000
samples of noise of 1 to 5 % of PV's swing, time constants and dead times of up to 100 samples, most with a second
setpoint move; ten slips or more, and so few that a window of the record holds one or two.

Printed for each valve: S (d) and K within 3 %, coverage of the 95 % intervals, how many are called identified and how
many of them wrongly (S or K more than 5 % off), the verdicts, and the mean of the processor time.

Run: python benchmarks/long_records.py [LOOPS [SEED [SAMPLES ...]]]
"""

from __future__ import annotations

import sys
import time
from collections import Counter
from collections.abc import Sequence

import numpy as np

import workbench as wb

SAMPLES = (4000, 8000, 20_000)
NOISE = (0.01, 0.02, 0.05)  # of PV's swing
CLOSE, WRONG = 0.03, 0.05
FEWEST = 10  # slips


def drawn(rng: np.random.Generator, kind: str, lengths: Sequence[int]) -> tuple[wb.Loop, wb.Experiment, float]:
    """A random loop, how it is recorded, without noise, and its first setpoint move (EU)."""
    S, tau = float(rng.uniform(0.5, 4.0)), float(np.exp(rng.uniform(np.log(10.0), np.log(100.0))))
    theta, samples = float(np.exp(rng.uniform(np.log(4.0), np.log(80.0)))), int(rng.choice(lengths))
    valve: wb.Stenman | wb.Choudhury | wb.Deadband = {
        "stenman": wb.Stenman(S),
        "choudhury": wb.Choudhury(S, S * rng.uniform(0.1, 1.2)),
        "deadband": wb.Deadband(S),
    }[kind]
    plant: wb.FOPDT | wb.Integrating = wb.FOPDT(1.2, tau, theta)
    controller, size = wb.PID(Kc=tau / (1.2 * (2.0 * theta + tau)), Ti=tau), 2.4 * S
    if rng.random() < 0.4:
        slow = theta + 0.5 * tau
        plant, controller = wb.Integrating(0.01, theta), wb.PID(Kc=40.0 / slow, Ti=8.0 * slow)
        size = 0.01 * S * tau
    moves = [wb.Step(size, at=100.0)]
    moves += [wb.Step(-1.5 * size, at=0.45 * samples)] if rng.random() < 0.7 else []
    return wb.Loop(plant, valve, controller, 1.0), wb.Experiment(float(samples), setpoint=moves), size


def slips(stem: np.ndarray, kind: str) -> int:
    """How often a stem sets off."""
    moving = np.diff(stem) != 0.0
    return int(moving.sum() if kind == "stenman" else (moving[1:] & ~moving[:-1]).sum())


def measured(kind: str, loops: int, seed: int, lengths: Sequence[int]) -> None:
    """Print the figures of one valve."""
    rng, verdicts, spent = np.random.default_rng([seed, len(kind)]), Counter[str](), 0.0
    close, said, wrong, held = 0, 0, 0, {"S": [0, 0], "K": [0, 0]}
    done = 0
    while done < loops:
        loop, plain, size = drawn(rng, kind, lengths)
        noise, number = float(rng.choice(NOISE)), int(rng.integers(2**31))
        quiet = wb.simulate(loop, plain)
        swing = float(np.ptp(quiet.pv))
        if not 1e-6 < swing < 100.0 * size or slips(quiet.valve, kind) < FEWEST:
            continue
        done += 1
        run = wb.simulate(loop, wb.Experiment(plain.duration, plain.setpoint, noise=wb.Noise(noise * swing, number)))
        record = wb.Record(run.pv, run.op, 1.0, sp=run.sp)
        began = time.process_time()
        found = wb.estimate(record, plant="fopdt" if isinstance(loop.plant, wb.FOPDT) else "integrating")
        spent += time.process_time() - began
        truth = {"S": loop.valve.stick_band, "K": loop.plant.gain}
        off = max(abs(found.valve.stick_band / truth["S"] - 1.0), abs(found.plant.gain / truth["K"] - 1.0))
        close, said, wrong = (
            close + (off <= CLOSE),
            said + found.identifiable,
            wrong + (found.identifiable and off > WRONG),
        )
        for name, pair in (("S", found.intervals.S or found.intervals.d), ("K", found.intervals.gain)):
            if pair is not None:
                held[name][0] += pair[0] <= truth[name] <= pair[1]
                held[name][1] += 1
        verdicts[found.verdict] += 1
    covered = ", ".join(f"{name} {hits} of {many}" for name, (hits, many) in held.items())
    print(
        f"{kind:9} S and K within 3 % in {close} of {loops}; ranges hold {covered}; identified {said}, {wrong} wrongly"
    )
    print(f"          {dict(verdicts)}; {spent / loops:.2f} s", flush=True)


if __name__ == "__main__":
    for name in ("stenman", "choudhury", "deadband"):
        loops, seed, *lengths = [int(one) for one in sys.argv[1:]] + [20, 0][len(sys.argv) - 1 :]
        measured(name, loops, seed, lengths or SAMPLES)
