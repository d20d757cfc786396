"""What an oscillation from outside does to the estimate: random loops of known truth under a sinusoidal load.

Loops as in `estimation.py`, with Stenman and two-parameter valves on both plants, N = 1000, noise of 1 to 5 % of PV's
swing, ten slips or more; the load is a sinusoid of 10 to 40 % of S with a period of 15 to 300 samples.

With "auto" the kind of plant is not named, and how often the right one is told is printed too.

Run: python benchmarks/estimation_swing.py [LOOPS [SEED [auto]]]
"""

from __future__ import annotations

import sys
import time

import numpy as np
from estimation import SAMPLES, drawn, measured

import workbench as wb
from workbench.estimate.loads.swing import SWINGS


def random_record(rng: np.random.Generator, kind: str, plant: str) -> tuple[wb.Loop, wb.Record]:
    """One random loop and its record."""
    while True:
        loop, S, size = drawn(rng, kind, plant)
        skip = 0 if rng.random() < 0.5 else SAMPLES
        steps = [wb.Step(size)]
        if rng.random() < 0.5:
            steps.append(wb.Step(-1.5 * size, at=float(skip + rng.integers(300, 700))))
        angle = 2.0 * np.pi / rng.uniform(15.0, 300.0)
        load = rng.uniform(0.1, 0.4) * S * np.sin(angle * np.arange(SAMPLES + skip) + rng.uniform(0.0, 6.0))
        quiet = wb.Experiment(float(SAMPLES + skip), setpoint=steps, load=wb.Series(tuple(load.tolist())))
        swing = float(np.ptp(measured(loop, quiet, skip, 0.0)[0].pv))
        if not 1e-6 < swing < 20.0 * size:
            continue
        noise = wb.Noise(float(rng.choice([0.01, 0.02, 0.05])) * swing, int(rng.integers(0, 2**31)))
        noisy = wb.Experiment(quiet.duration, setpoint=steps, load=quiet.load, noise=noise)
        record, slips = measured(loop, noisy, skip, 0.0)
        if slips >= 10:
            return loop, record


def main() -> None:
    """Print how many are right, identified and right, told, and held by the gain's range."""
    loops, seed = (int(a) for a in (sys.argv[1:3] + ["30", "0"][len(sys.argv[1:3]) :]))
    auto = "auto" in sys.argv[3:]
    counts = np.zeros(7, dtype=int)
    begin = time.process_time()
    for i in range(loops):
        plant = ("fopdt", "integrating")[i % 2]
        loop, record = random_record(np.random.default_rng([seed, i]), ("stenman", "choudhury")[i // 2 % 2], plant)
        found = wb.estimate(record, plant="auto" if auto else plant)
        kind = isinstance(found.plant, type(loop.plant))
        S, K = found.valve.stick_band / loop.valve.stick_band - 1.0, found.plant.gain / loop.plant.gain - 1.0
        right = kind and max(abs(S), abs(K)) <= 0.05
        low, high = found.intervals.gain or (-np.inf, np.inf)
        told = any("outside the loop" in reason for reason in found.reasons)
        ranged = found.intervals.gain is not None
        here = [right, found.identifiable, found.identifiable and right, told, ranged]
        counts += [*here, ranged and low <= loop.plant.gain <= high, kind]
        said = f"{found.verdict}, identified {found.identifiable}{'' if kind else ', OF THE OTHER KIND'}"
        print(f"{i} {plant}: S {S:+.1%}, K {K:+.1%}, {said}", flush=True)
    right, identified, both, told, ranged, held, kinds = counts.tolist()
    print(
        f"{loops} loops (at most {SWINGS} fits): S and K within 5 % in {right}; identified {identified}, right {both}"
    )
    print(f"of the right kind {kinds}")
    print(f"told of the oscillation {told}; the gain's range holds it in {held} of {ranged}")
    print(f"{(time.process_time() - begin) / loops:.1f} s of processor time a loop")


if __name__ == "__main__":
    main()
