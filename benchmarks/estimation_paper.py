"""How well the paper's benchmark loop is estimated: K = 2, tau = 5 s, theta = 1 s, Stenman d = 2 %, sampled every s.

Records of 1,000 samples from rest, under several PI controllers and setpoints, without noise and with noise of standard
deviation 0.1 over many seeds: the share of estimates within 1 % and 5 % of the truth, of intervals that hold the truth,
and the time taken; beside it the linear fit that ignores stiction (the paper's Fig. 3) and the two-step algorithm.

Run: python benchmarks/estimation_paper.py [SEEDS]
"""

from __future__ import annotations

import sys
import time

import numpy as np

import workbench as wb

CONTROLLERS = ((0.5, 20.0), (0.3, 10.0), (0.8, 30.0), (0.2, 5.0), (0.4, 15.0), (1.0, 20.0))
SETPOINTS = {
    "step 4": wb.Step(4.0),
    "step 8": wb.Step(8.0),
    "steps 4, -6": (wb.Step(4.0), wb.Step(-6.0, at=500.0)),
}


def record(Kc: float, Ti: float, setpoint: object, sd: float, seed: int, samples: int = 1000) -> wb.Record:
    """The benchmark record."""
    loop = wb.Loop(wb.FOPDT(2.0, 5.0, 1.0), wb.Stenman(2.0), wb.PID(Kc=Kc, Ti=Ti), 1.0)
    run = wb.simulate(loop, wb.Experiment(float(samples), setpoint=setpoint, noise=wb.Noise(sd, seed)))
    return wb.Record(run.pv, run.op, 1.0, sp=run.sp)


def errors(found: object) -> np.ndarray:
    """Relative errors of d, K, tau; absolute error of theta in s."""
    d = getattr(found.valve, "d", np.nan)
    plant = found.plant
    return np.array([d / 2.0 - 1.0, plant.gain / 2.0 - 1.0, plant.time_constant / 5.0 - 1.0, plant.dead_time - 1.0])


def holds(found: object) -> np.ndarray:
    """Whether the intervals hold the truth."""
    pairs = zip(
        (found.intervals.d, found.intervals.gain, found.intervals.time_constant, found.intervals.dead_time),
        (2.0, 2.0, 5.0, 1.0),
        strict=True,
    )
    return np.array([i is not None and i[0] <= truth <= i[1] for i, truth in pairs])


def main(seeds: int) -> None:
    """Print the tables."""
    print("controller, setpoint, noise: share within the limit (d, K, tau to 1 % or 5 %, theta to 0.25 s), all four;")
    print(
        "coverage of the intervals (d, K, tau, theta); verdict stiction, identifiable; slips; time; two-step from 1.5"
    )
    total, count = {0.0: np.zeros(5), 0.1: np.zeros(5)}, {0.0: 0, 0.1: 0}
    wb.estimate(record(0.5, 20.0, wb.Step(4.0), 0.1, 0))
    for Kc, Ti in CONTROLLERS:
        for name, setpoint in SETPOINTS.items():
            for sd in (0.0, 0.1):
                hits, cover, right, sure, slips, took, rival = [], [], 0, 0, [], [], 0
                for seed in range(seeds if sd else 1):
                    data = record(Kc, Ti, setpoint, sd, seed)
                    began = time.perf_counter()
                    found = wb.estimate(data)
                    took.append(time.perf_counter() - began)
                    off = np.abs(errors(found))
                    limit = 0.05 if sd else 0.01
                    near = np.append(off[:3] <= limit, off[3] <= 0.25)
                    hits.append(np.append(near, near.all()))
                    cover.append(holds(found))
                    right += found.verdict == "stiction"
                    sure += found.identifiable
                    slips.append(found.slips)
                    other = wb.estimate(data, method="two_step", start=1.5)
                    rival += bool((np.abs(errors(other))[:3] <= limit).all())
                n = len(hits)
                if np.median(slips) >= 10:
                    total[sd] += np.sum(hits, axis=0)
                    count[sd] += n
                print(
                    f"Kc {Kc:g} Ti {Ti:g} {name:12s} sd {sd:g}: hits {np.mean(hits, axis=0).round(2)} "
                    f"cover {np.mean(cover, axis=0).round(2)} stiction {right}/{n} identifiable {sure}/{n} "
                    f"slips {np.median(slips):.0f} time {np.median(took):.2f} s two-step {rival}/{n}"
                )
    for sd in total:
        print(f"all with at least 10 slips, sd {sd:g}: {(total[sd] / count[sd]).round(3)} of {count[sd]}")
    linear = wb.estimate(record(0.5, 20.0, wb.Step(4.0), 0.0, 0)).linear
    print("linear fit that ignores stiction:", linear.plant, f"AIC {linear.aic:.0f}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 20)
