"""What the joint refinement, plant="auto" and the parts of a record are worth on random loops of known truth.

Three measurements, each over LOOPS random loops:

- joint: FOPDT loops with a Stenman valve, PI, two setpoint steps, noise of 1 to 10 % of K d, and a load that is AR(1)
  (coefficient 0.8 to 0.99, standard deviation 5 to 40 % of d), N = 1000. Error and coverage of the 95 % intervals of
  the profile and of the refinement, over the records whose verdict is "stiction".
- plants: both plants, all valves and none, with and without a slow load; share in which plant="auto" is right.
- parts: Stenman loops as in the first, with a constant d; how far the parts are from it, and how often a sentence
  claims a drift, a direction or a disagreement that is not there.

Run: python benchmarks/estimation_joint.py [LOOPS [SEED [joint|plants|parts]]]
"""

from __future__ import annotations

import math
import sys
import time
from collections import defaultdict

import numpy as np

import workbench as wb
from workbench.estimate.repeat import words_of

SAMPLES = 1000
TRUTHS = ("d", "gain", "time_constant", "dead_time")


def load_of(rng: np.random.Generator, a: float, sd: float) -> wb.Series:
    """An AR(1) load at the plant input, %."""
    v = np.zeros(SAMPLES)
    v[0] = rng.normal(0.0, sd)
    for k in range(1, SAMPLES):
        v[k] = a * v[k - 1] + rng.normal(0.0, sd * math.sqrt(1.0 - a * a))
    return wb.Series(tuple(v.tolist()))


def record_of(loop: wb.Loop, experiment: wb.Experiment) -> wb.Record:
    run = wb.simulate(loop, experiment)
    return wb.Record(run.pv + 50.0, run.op + 40.0, loop.sample_time)


def steps_of(rng: np.random.Generator, size: float) -> list[wb.Step]:
    return [
        wb.Step(size * rng.uniform(3.0, 8.0) * rng.choice([-1.0, 1.0]), float(rng.integers(100, 400))),
        wb.Step(size * rng.uniform(3.0, 8.0) * rng.choice([-1.0, 1.0]), float(rng.integers(500, 800))),
    ]


def stenman_loop(rng: np.random.Generator) -> tuple[wb.Loop, dict[str, float]]:
    """A loop with a Stenman valve, and its truth."""
    tau, theta = math.exp(rng.uniform(math.log(3.0), math.log(20.0))), rng.uniform(0.3, 4.0)
    K, d = math.exp(rng.uniform(math.log(0.5), math.log(3.0))), rng.uniform(0.8, 3.0)
    slow = rng.uniform(1.0, 3.0) * max(tau, theta)
    loop = wb.Loop(
        wb.FOPDT(K, tau, theta),
        wb.Stenman(d),
        wb.PID(Kc=tau / (K * (slow + theta)), Ti=tau * rng.uniform(0.8, 2.0)),
        1.0,
    )
    return loop, {"d": d, "gain": K, "time_constant": tau, "dead_time": theta}


def sticky(seed: int) -> tuple[dict[str, float], wb.Record]:
    """A Stenman loop under a coloured load, by its truth and its record."""
    rng = np.random.default_rng(seed)
    loop, truth = stenman_loop(rng)
    K, d = truth["gain"], truth["d"]
    experiment = wb.Experiment(
        float(SAMPLES),
        setpoint=steps_of(rng, K),
        load=load_of(rng, rng.uniform(0.8, 0.99), rng.uniform(0.05, 0.4) * d),
        noise=wb.Noise(K * d * rng.uniform(0.01, 0.1), seed),
    )
    return truth, record_of(loop, experiment)


def joint(loops: int, seed: int) -> None:
    """Errors and coverage of both methods, and the seconds of each record."""
    errors, covered, seconds = defaultdict(list), defaultdict(list), defaultdict(float)
    for i in range(seed, seed + loops):
        truth, record = sticky(i)
        for method in ("profile", "joint"):
            began = time.perf_counter()
            found = wb.estimate(record, method=method, valve="stenman")
            seconds[method] += time.perf_counter() - began
            if found.verdict != "stiction" or not isinstance(found.valve, wb.Stenman):
                continue
            for name in TRUTHS:
                value = found.valve.d if name == "d" else getattr(found.plant, name)
                errors[method, name].append(abs(value / truth[name] - 1.0))
                pair = getattr(found.intervals, name)
                if pair is not None:
                    covered[method, name].append(pair[0] <= truth[name] <= pair[1])
    for (method, name), values in errors.items():
        held = covered[method, name]
        print(
            f"{method:<8} {name:<14} error median {np.median(values):.2%}, 90th percentile "
            f"{np.quantile(values, 0.9):.2%}; "
            f"covered {np.mean(held):.1%} of {len(held)}"
        )
    for method, total in seconds.items():
        print(f"{method:<8} {total / loops:.2f} s a record")


def plants(loops: int, seed: int) -> None:
    """Shares in which the plant chosen is the true one, by plant and by whether a slow load disturbs."""
    right = defaultdict(list)
    for i in range(seed, seed + loops):
        for kind in ("fopdt", "integrating"):
            rng = np.random.default_rng(10_000 + i)
            theta, d = rng.uniform(0.3, 4.0), rng.uniform(0.5, 3.0)
            tau = math.exp(rng.uniform(math.log(3.0), math.log(40.0)))
            if kind == "fopdt":
                K = size = math.exp(rng.uniform(math.log(0.5), math.log(3.0)))
                slow = rng.uniform(1.0, 4.0) * max(theta, tau / 3.0)
                plant, Kc, Ti = wb.FOPDT(K, tau, theta), tau / (K * (slow + theta)), tau * rng.uniform(0.8, 2.5)
            else:
                K = math.exp(rng.uniform(math.log(0.02), math.log(0.2)))
                size, slow = 10.0 * K, rng.uniform(2.0, 8.0) * max(theta, 2.0)
                plant = wb.Integrating(K, theta)
                Kc, Ti = (2.0 * slow + theta) / (K * (slow + theta) ** 2), (2.0 * slow + theta) * rng.uniform(1.0, 2.0)
            valves = (wb.Stenman(d), wb.Choudhury(d, d * rng.uniform()), wb.Deadband(d), wb.Ideal())
            loaded = bool(rng.random() < 0.5)
            experiment = wb.Experiment(
                float(SAMPLES),
                setpoint=steps_of(rng, 0.7 * size),
                load=load_of(rng, 0.98, 0.2 * d) if loaded else None,
                noise=wb.Noise(size * d * rng.uniform(0.005, 0.1), i),
            )
            loop = wb.Loop(plant, valves[int(rng.integers(4))], wb.PID(Kc=Kc, Ti=Ti), 1.0)
            found = wb.estimate(record_of(loop, experiment), plant="auto")
            right[kind, "slow load" if loaded else "no load"].append(type(found.plant) is type(plant))
    for (kind, load), values in sorted(right.items()):
        print(f"{kind:<12} {load:<10} right in {sum(values)} of {len(values)}")


def parts(loops: int, seed: int) -> None:
    """How far parts are from a constant d, and what is wrongly said of them."""
    away, said, records = [], 0, 0
    for i in range(seed, seed + loops):
        truth, record = sticky(i)
        found = wb.estimate(record, valve="stenman")
        if found.verdict != "stiction" or found.repeats is None:
            continue
        records += 1
        said += bool(words_of(found.repeats))
        away += [abs(part.band / truth["d"] - 1.0) for part in found.repeats.parts]
    print(
        f"parts        {len(away)} of {records} records: median {np.median(away):.2%} from d, 90th percentile ", end=""
    )
    print(f"{np.quantile(away, 0.9):.2%}; something is wrongly said of {said} records")


def main() -> None:
    loops = int(sys.argv[1]) if len(sys.argv) > 1 else 60
    seed = int(sys.argv[2]) if len(sys.argv) > 2 else 0
    chosen = sys.argv[3:] or ["joint", "plants", "parts"]
    for name, measure in (("joint", joint), ("plants", plants), ("parts", parts)):
        if name in chosen:
            measure(loops, seed)


if __name__ == "__main__":
    main()
