"""How much of a tuning is luck: `wb.tune` from several seeds on random loops under noise and a load step.

Run by hand: `python benchmarks/tuning_seeds.py [--loops 24] [--seeds 2] [--pid] [--sensitivity 1.6] [--travel 1.5]`.
The last two are constraints: a maximum sensitivity, and valve travel as a share of the present tuning's. Loops are of
both plants and of one-parameter, two-parameter and dead-band valves, 400 to 1,500 samples, seven in ten with a setpoint
step, half with a price on the moves of the output. A line for each loop: the worst J within the digits that each seed
ends with, what no tuning within the bounds is below where that was proved, and the mean processor time of a seed. The
last line tells by how much seeds differ. To compare versions run each from its own checkout on the same machine.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

import workbench as wb

SEED = 77


def problem(number: int, *, pid: bool) -> tuple[wb.Loop, wb.Experiment, wb.Objective, wb.Bounds]:
    """Loop `number` with its experiment, objective and bounds."""
    rng = np.random.default_rng([SEED, number])
    Ts, samples = float(rng.choice([0.2, 1.0, 5.0])), int(rng.choice([400, 700, 1000, 1500]))
    tau = Ts * float(np.exp(rng.uniform(np.log(3.0), np.log(20.0))))
    theta, K = float(tau * rng.uniform(0.1, 1.5)), float(np.exp(rng.uniform(-1.0, 1.0)))
    plant = wb.Integrating(K / tau, theta) if rng.random() < 0.3 else wb.FOPDT(K, tau, theta)
    band = float(rng.uniform(0.3, 2.0))
    valves = [wb.Stenman(band), wb.Choudhury(band, band * float(rng.uniform(0.2, 1.5))), wb.Deadband(band)]
    valve = valves[int(rng.integers(3))]
    brisk = tau / K / (theta + Ts)
    setpoint = wb.Step(2.0 * K, Ts) if rng.random() < 0.7 else None
    load = wb.Step(float(rng.uniform(0.5, 2.0)), round(samples / 2) * Ts)
    noise = wb.Noise(float(rng.uniform(0.01, 0.15) * K), seed=number)
    return (
        wb.Loop(plant, valve, wb.PID(brisk / 4.0, 4.0 * tau), Ts),
        wb.Experiment(samples * Ts, setpoint, load, noise),
        wb.Objective(w1=0.5, w3=0.5, w4=0.2 * K * K if rng.random() < 0.5 else 0.0),
        wb.Bounds(
            Kc=(0.0, 4.0 * brisk),
            Ti=(0.5 * tau, 60.0 * (tau + theta)),
            Td=(0.0, 2.0 * (tau + theta) if pid else 0.0),
        ),
    )


def constraints(given: argparse.Namespace, number: int) -> wb.Constraints | None:
    """What is asked of loop `number`'s tunings."""
    if given.sensitivity is None and given.travel is None:
        return None
    loop, experiment, *_ = problem(number, pid=given.pid)
    travel = None if given.travel is None else given.travel * wb.simulate(loop, experiment).kpis.valve_travel
    return wb.Constraints(max_sensitivity=given.sensitivity, valve_travel=travel)


def main() -> None:
    """Tune, loop after loop."""
    parser = argparse.ArgumentParser(description="How much of a tuning is luck: several seeds on random loops.")
    parser.add_argument("--loops", type=int, default=24)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--pid", action="store_true", help="Kc, Ti and Td; by default Kc and Ti")
    parser.add_argument("--sensitivity", type=float, help="constraint: the maximum sensitivity Ms")
    parser.add_argument("--travel", type=float, help="constraint: valve travel, a share of the present tuning's")
    given = parser.parse_args()
    wb.tune(*problem(0, pid=given.pid), max_evaluations=3000)
    ratios = []
    for number in range(given.loops):
        loop, experiment, objective, bounds = problem(number, pid=given.pid)
        asked = constraints(given, number)
        began = time.process_time()
        found = [wb.tune(loop, experiment, objective, bounds, seed, constraints=asked) for seed in range(given.seeds)]
        used = (time.process_time() - began) / given.seeds
        values = [tuned.worst for tuned in found]
        proved = [tuned.worst_bound for tuned in found if getattr(tuned, "worst_bound", None) is not None]
        ratios += [value / min(values) for value in values]
        samples = round(experiment.duration / loop.sample_time)
        words = f"{type(loop.plant).__name__:11s} {type(loop.valve).__name__:9s} {samples:4d}"
        bound = f"not below {max(proved):.6g}" if proved else ""
        print(f"{number:3d} {words} {' '.join(f'{v:.6g}' for v in values)} {used:5.1f} s {bound}", flush=True)
    far = np.array(ratios)
    print(
        f"above the best of its loop's seeds: 1 % in {(far > 1.01).sum()} of {far.size}, at most {far.max():.3f} times"
    )


if __name__ == "__main__":
    main()
