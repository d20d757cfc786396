"""The complementarity form of estimation against the exact profile, the two-step algorithm and the joint refinement.

LOOPS random FOPDT loops with a Stenman valve under PI, started from rest, two setpoint steps, ten slips or more, N =
600, once without noise and once with noise of 5 % of PV's swing. All know that the valve is Stenman's. The
complementarity program is solved

- warm: from the profile's best path, as `wb.estimate(record, method="complementarity")` does, the profile's time in it;
- near: from the exact stem of a d 5 % above the profile's, with the plant fitted to it;
- cold: from OP as the stem and the linear fit's plant, d a tenth of OP's range, given the profile's whole dead time.

Printed for each: how many programs were solved; errors of d, K and tau at the program's end, median and worst; the
exact cost of its d by the valve's own law over the profile's, likewise; and processor time a record.

Run: python benchmarks/estimation_complementarity.py [LOOPS [SEED]]
"""

from __future__ import annotations

import itertools
import math
import sys
import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from estimation_joint import stenman_loop

import workbench as wb
from workbench.estimate.fits.data import Centred, centre
from workbench.estimate.fits.fit import Fit, Limits, fit_linear, fit_path, start_range
from workbench.estimate.methods.complementarity import COLD, WARM, Found, cold, solved, warm
from workbench.estimate.search.paths import Path
from workbench.estimate.search.stems import path_of
from workbench.model.results import Estimate

SAMPLES = 600
SLIPS = 10
NOISE = (0.0, 0.05)
OFF = 1.05
DELAYS = 30.0


@dataclass(frozen=True)
class Answer:
    """What one method gave: whether it was solved, (d, K, tau), and its exact cost over the profile's or None."""

    solved: bool
    values: tuple[float, float, float]
    ratio: float | None


def loop_of(seed: int, noise: float) -> tuple[tuple[float, float, float], wb.Record] | None:
    """A loop's (d, K, tau) and its record; None where its stem slips less than ten times."""
    rng = np.random.default_rng(seed)
    loop, truth = stenman_loop(rng)
    K, d, tau = truth["gain"], truth["d"], truth["time_constant"]
    size = K * d * rng.uniform(0.7, 3.0)
    later = round(rng.uniform(0.4, 0.7) * SAMPLES)
    steps = [wb.Step(size), wb.Step(-1.5 * size, float(later))]
    experiment = wb.Experiment(float(SAMPLES), setpoint=steps)
    quiet = wb.simulate(loop, experiment)
    run = wb.simulate(loop, replace(experiment, noise=wb.Noise(noise * float(np.ptp(quiet.pv)), seed)))
    if np.count_nonzero(np.diff(run.valve)) < SLIPS:
        return None
    return (d, K, tau), wb.Record(run.pv + 50.0, run.op + 40.0, 1.0, sp=run.sp + 50.0)


def of_estimate(found: Estimate) -> Answer:
    d = found.valve.d if isinstance(found.valve, wb.Stenman) else 0.0
    tau = found.plant.time_constant if isinstance(found.plant, wb.FOPDT) else math.nan
    return Answer(solved=True, values=(d, found.plant.gain, tau), ratio=None)


def of_program(data: Centred, found: Found, profile: Estimate) -> Answer:
    fit = found.point.fit
    least = max(profile.residual_variance, data.floor)
    exact = math.inf if found.exact is None else max(found.exact.fit.sse / data.samples, data.floor)
    return Answer(found.result.status.success, (found.point.d, fit.gain, fit.tau), exact / least)


def near(data: Centred, profile: Estimate, limits: Limits) -> Path:
    """The exact stem of a d that is `OFF` times the profile's, with the plant fitted to it."""
    d = OFF * of_estimate(profile).values[0]
    first = int(np.flatnonzero(np.abs(data.u - (profile.valve_position[0] - data.op_middle)) > d)[0])
    x, slips = path_of(data.u, d, first)
    bounds = start_range(data.u, first, d, d)
    fit = fit_path(data, x, first, bounds, limits, min(profile.plant.dead_time, DELAYS))
    return Path(wb.Stenman(d), x, first, bounds, fit, slips, (d, d))


def measure(record: wb.Record) -> dict[str, tuple[Answer, float]]:
    """What each method makes of a record, with the processor time that it took, s."""
    done: dict[str, tuple[Answer, float]] = {}

    def timed(name: str, work: Callable[[], Answer]) -> None:
        began = time.process_time()
        answer = work()
        done[name] = (answer, time.process_time() - began)

    # Compiles, too, where it is the first.
    profile = wb.estimate(record, valve="stenman")
    timed("profile", lambda: of_estimate(wb.estimate(record, valve="stenman")))
    timed("two-step", lambda: of_estimate(wb.estimate(record, method="two_step")))
    timed("joint", lambda: of_estimate(wb.estimate(record, method="joint", valve="stenman")))
    data = centre(record, "fopdt")
    limits = Limits((0.05, float(SAMPLES)), (0.0, DELAYS))
    m = math.floor(profile.plant.dead_time + 1e-9)

    def by_method() -> Answer:
        found = wb.estimate(record, method="complementarity")
        program = found.complementarity
        if program is None or not isinstance(program.plant, wb.FOPDT):
            return Answer(solved=False, values=of_estimate(found).values, ratio=None)
        exact = math.inf if program.exact_cost is None else max(program.exact_cost, data.floor)
        values = (program.d, program.plant.gain, program.plant.time_constant)
        return Answer(program.status.success, values, exact / max(program.profile_cost, data.floor))

    timed("warm", by_method)
    path = near(data, profile, limits)
    at = math.floor(path.fit.theta)
    timed("near", lambda: of_program(data, solved(data, warm(data, path), limits, at, WARM), profile))

    def from_cold() -> Answer:
        linear: Fit = fit_linear(data, DELAYS)
        start = cold(data, replace(linear, theta=float(m)), 0.1 * data.op_range)
        return of_program(data, solved(data, start, limits, m, COLD), profile)

    timed("cold", from_cold)
    return done


def main() -> None:
    loops = int(sys.argv[1]) if len(sys.argv) > 1 else 8
    seed = int(sys.argv[2]) if len(sys.argv) > 2 else 0
    for noise in NOISE:
        answers: dict[str, list[Answer]] = defaultdict(list)
        errors: dict[str, list[list[float]]] = defaultdict(list)
        seconds: dict[str, list[float]] = defaultdict(list)
        made = (loop_of(i, noise) for i in itertools.count(seed))
        for truth, record in itertools.islice((one for one in made if one is not None), loops):
            for name, (answer, took) in measure(record).items():
                answers[name].append(answer)
                errors[name].append([abs(v / t - 1.0) for v, t in zip(answer.values, truth, strict=True)])
                seconds[name].append(took)
        print(f"noise {noise:.0%} of the swing, {loops} loops")
        for name, given in answers.items():
            middle, worst = np.median(errors[name], axis=0), np.max(errors[name], axis=0)
            text = ", ".join(f"{q} {a:.2%} / {b:.2%}" for q, a, b in zip(("d", "K", "tau"), middle, worst, strict=True))
            ratios = [a.ratio for a in given if a.ratio is not None]
            cost = f"; exact cost {np.median(ratios):.4g} / {max(ratios):.4g} of the profile's" if ratios else ""
            took = f"{np.median(seconds[name]):.2f} / {max(seconds[name]):.2f} s"
            print(f"  {name:<9} solved {sum(a.solved for a in given)}: {text}{cost}; {took}")


if __name__ == "__main__":
    main()
