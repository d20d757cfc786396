"""How well random loops of known truth are estimated, and what the time taken grows like.

Random plants (FOPDT and integrating), PI controllers and valves (Stenman, two-parameter, dead band); records of 1,000
samples, from rest or from within the cycle, with and without setpoint moves, load steps, a quantised PV, and noise of 0
to 20 % of PV's swing. A record is identifiable by the truth if the stem slips ten times or more in it, and either a
setpoint move lies in it or the same loop without noise gives a range of d (S) under 5 % wide.

Printed for each class: shares of S (d), K, both, tau and theta within their limits, coverage of the 95 % intervals, and
the share said to be identified; beside it the paper's two-step algorithm and the linear fit that ignores stiction.

Run: python benchmarks/estimation.py [LOOPS [SEED]]     or     python benchmarks/estimation.py speed
or, of the kind of plant where it is not named: python benchmarks/estimation.py plants [LOOPS [SEED]]
"""

from __future__ import annotations

import math
import resource
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

import workbench as wb
from workbench.estimate.fits.data import centre
from workbench.estimate.kernels.walk import COST, ROW, at_delays, walk
from workbench.estimate.search.stems import LEAST_D

SAMPLES = 1000
NOISE = (0.0, 0.01, 0.02, 0.05, 0.1, 0.2)  # of PV's swing
CLOSE = {"S": 0.05, "K": 0.05, "tau": 0.15}


@dataclass(frozen=True)
class Case:
    """A random loop, how it is recorded, and what its record holds."""

    loop: wb.Loop
    experiment: wb.Experiment
    skip: int
    noise: float
    moved: bool
    quantised: bool
    record: wb.Record
    slips: int


def measured(loop: wb.Loop, experiment: wb.Experiment, skip: int, quantum: float) -> tuple[wb.Record, int]:
    """The record from sample `skip` on, and the slips of the true stem in it."""
    run = wb.simulate(loop, experiment)
    pv = run.pv[skip:]
    if quantum > 0.0:
        pv = np.round(pv / quantum) * quantum
    stem = run.valve[skip:]
    still = np.diff(stem, prepend=stem[0]) == 0.0
    slips = int(np.count_nonzero(still[:-1] & ~still[1:]))
    if isinstance(loop.valve, wb.Stenman):
        slips = int(np.count_nonzero(~still))
    return wb.Record(pv + 50.0, run.op[skip:] + 40.0, 1.0, sp=run.sp[skip:] + 50.0), slips


def drawn(rng: np.random.Generator, kind: str, plant: str) -> tuple[wb.Loop, float, float]:
    """A random loop, its stick band S (%), and the size of a setpoint move that suits it (EU)."""
    S = float(np.exp(rng.uniform(np.log(0.5), np.log(5.0))))
    valve: wb.Stenman | wb.Choudhury | wb.Deadband = {
        "stenman": wb.Stenman(S),
        "choudhury": wb.Choudhury(S, S * rng.uniform(0.1, 1.2)),
        "deadband": wb.Deadband(S),
    }[kind]
    tau, theta = float(np.exp(rng.uniform(np.log(3.0), np.log(40.0)))), float(rng.uniform(0.0, 10.0))
    slow = tau * rng.uniform(0.8, 3.0)
    if plant == "fopdt":
        gain = float(np.exp(rng.uniform(np.log(0.3), np.log(3.0))))
        model: wb.FOPDT | wb.Integrating = wb.FOPDT(gain, tau, theta)
        controller = wb.PID(Kc=tau / (gain * (slow + theta)), Ti=tau * rng.uniform(0.5, 2.0))
        size = S * gain * rng.uniform(0.7, 3.0)
    else:
        gain = float(np.exp(rng.uniform(np.log(0.003), np.log(0.03))))
        model = wb.Integrating(gain, theta)
        controller = wb.PID(Kc=1.0 / (gain * (slow + theta)), Ti=4.0 * (slow + theta))
        size = S * gain * tau * rng.uniform(0.3, 1.5)
    return wb.Loop(model, valve, controller, 1.0), S, size


def case(rng: np.random.Generator, kind: str, plant: str) -> Case | None:
    """One random case; None where the loop does not move or runs away."""
    loop, S, size = drawn(rng, kind, plant)
    skip = 0 if rng.random() < 0.5 else SAMPLES
    moved = skip == 0 or bool(rng.random() < 0.5)
    steps = [wb.Step(size)]
    if moved:
        steps.append(wb.Step(-1.5 * size, at=float(skip + rng.integers(300, 700))))
    load = wb.Step(S * rng.uniform(-0.5, 0.5), at=float(skip + rng.integers(100, 900))) if rng.random() < 0.3 else None
    noise, quantised = float(rng.choice(NOISE)), bool(rng.random() < 0.25)
    plain = wb.Experiment(float(SAMPLES + skip), setpoint=steps, load=load)
    quiet, _ = measured(loop, plain, skip, 0.0)
    swing = float(np.ptp(quiet.pv))
    if not 1e-6 < swing < 20.0 * size:
        return None
    seed = int(rng.integers(0, 2**31))
    experiment = replace(plain, noise=wb.Noise(noise * swing, seed))
    record, slips = measured(loop, experiment, skip, swing / 200.0 if quantised else 0.0)
    return Case(loop, experiment, skip, noise, moved, quantised, record, slips)


def random_cases(
    loops: int, seed: int, wanted: Callable[[Case], bool] = lambda _: True
) -> Iterator[tuple[str, str, list[Case]]]:
    """Each kind of valve and of plant with so many of its random cases that are wanted."""
    for kind in ("stenman", "choudhury", "deadband"):
        for plant in ("fopdt", "integrating"):
            rng = np.random.default_rng([seed, len(kind), len(plant)])
            cases: list[Case] = []
            while len(cases) < loops:
                one = case(rng, kind, plant)
                cases += [one] if one is not None and wanted(one) else []
            yield kind, plant, cases


def identifiable(c: Case, plant: str) -> bool:
    """By the truth: enough slips, and excitation or a narrow range without noise."""
    if c.slips < 10:
        return False
    if c.moved:
        return True
    quiet, _ = measured(c.loop, replace(c.experiment, noise=None), c.skip, 0.0)
    found = wb.estimate(quiet, plant=plant)
    pair = found.intervals.d or found.intervals.S
    return pair is not None and pair[1] - pair[0] < 0.05 * c.loop.valve.stick_band


def errors(c: Case, found: object) -> dict[str, float]:
    """Relative errors of S (d), K and tau; of theta in samples."""
    true, plant = c.loop.plant, found.plant
    out = {"S": found.valve.stick_band / c.loop.valve.stick_band - 1.0, "K": plant.gain / true.gain - 1.0}
    if isinstance(true, wb.FOPDT):
        out["tau"] = plant.time_constant / true.time_constant - 1.0
    return out | {"theta": plant.dead_time - true.dead_time}


def covered(c: Case, found: object) -> dict[str, bool]:
    """Whether each interval that is given holds the truth."""
    true = c.loop.plant
    pairs = {
        "S": (found.intervals.S or found.intervals.d, c.loop.valve.stick_band),
        "K": (found.intervals.gain, true.gain),
        "tau": (found.intervals.time_constant, getattr(true, "time_constant", math.nan)),
        "theta": (found.intervals.dead_time, true.dead_time),
    }
    return {name: pair[0] <= value <= pair[1] for name, (pair, value) in pairs.items() if pair is not None}


def share(values: list[bool]) -> str:
    """A share in per cent, with the number it is of."""
    return f"{100.0 * np.mean(values):3.0f} % of {len(values)}" if values else "    –    "


def within(found: list[dict[str, float]], names: tuple[str, ...]) -> list[bool]:
    """Whether all of some parameters lie within their limits."""
    return [all(abs(e[n]) <= CLOSE[n] for n in names) for e in found if all(n in e for n in names)]


def accuracy(loops: int, seed: int) -> None:
    """Print the tables of one valve and plant after the other."""
    for kind, plant, cases in random_cases(loops, seed):
        told: dict[bool, list[bool]] = {True: [], False: []}
        found: dict[bool, list[tuple[Case, wb.Estimate, wb.Estimate]]] = {True: [], False: []}
        for c in cases:
            truth = identifiable(c, plant)
            try:
                ours = wb.estimate(c.record, plant=plant)
                rival = wb.estimate(c.record, plant=plant, method="two_step")
            except wb.RecordError:
                continue
            told[truth].append(ours.identifiable)
            if truth and c.noise <= 0.05:
                found[c.experiment.load is not None].append((c, ours, rival))
        print(f"\n{kind}, {plant}: {len(cases)} loops")
        for load, rows in found.items():
            print(f"  {'with a load step' if load else 'without load'}: {len(rows)} identifiable, noise up to 5 %")
            table(rows)
        print(f"  said to be identified: {share(told[True])} that are, {share(told[False])} that are not", flush=True)


def table(rows: list[tuple[Case, wb.Estimate, wb.Estimate]]) -> None:
    """Print shares within the limits, coverage and kinds of (case, estimate, two-step estimate)."""
    ways = {
        "estimate": [errors(c, ours) for c, ours, _ in rows],
        "two-step": [errors(c, rival) for c, _, rival in rows],
        "linear": [errors(c, replace(ours, plant=ours.linear.plant)) for c, ours, _ in rows],
    }
    for name, those in ways.items():
        parts = [
            f"{'+'.join(names)} {share(within(those, names))}"
            for names in (("S",), ("K",), ("S", "K"), ("tau",))
            if name != "linear" or "S" not in names
        ]
        parts.append(f"theta to 1 sample {share([abs(e['theta']) <= 1.0 for e in those])}")
        print(f"    {name:9} within limits: {'; '.join(parts)}")
    held = [covered(c, ours) for c, ours, _ in rows]
    text = "; ".join(f"{n} {share([h[n] for h in held if n in h])}" for n in ("S", "K", "tau", "theta"))
    print(f"    coverage of the 95 % intervals: {text}")
    called = [errors(c, ours) for c, ours, _ in rows if ours.identifiable]
    print(f"    of those called identified: S+K {share(within(called, ('S', 'K')))}")
    kinds = [isinstance(ours.valve, type(c.loop.valve)) for c, ours, _ in rows]
    verdicts = [ours.verdict == "stiction" for _, ours, _ in rows]
    print(f"    the true kind of valve {share(kinds)}; verdict stiction {share(verdicts)}")


def plants(loops: int, seed: int) -> None:
    """Print how often the kind of plant is right where it is not named, and what finding it costs."""
    for kind, plant, cases in random_cases(loops, seed):
        right, took = [], {"auto": 0.0, plant: 0.0}
        for c in cases:
            for asked in took:
                began = time.process_time()
                found = wb.estimate(c.record, plant=asked)
                took[asked] += time.process_time() - began
                right += [isinstance(found.plant, type(c.loop.plant))] if asked == "auto" else []
        free, named = (total / len(cases) for total in took.values())
        print(f"{kind}, {plant}: right in {share(right)}; {free:.2f} s a record, {named:.2f} s where named", flush=True)


def long_record(samples: int, seed: int = 1) -> wb.Record:
    """A Stenman loop under noise with six setpoint moves."""
    every = max(samples // 6, 500)
    steps = [wb.Step(8.0 * (-1) ** i, at=float(t)) for i, t in enumerate(range(0, samples, every))]
    loop = wb.Loop(wb.FOPDT(2.0, 5.0, 1.0), wb.Stenman(2.0), wb.PID(Kc=0.5, Ti=20.0), 1.0)
    run = wb.simulate(loop, wb.Experiment(float(samples), setpoint=steps, noise=wb.Noise(0.1, seed)))
    return wb.Record(run.pv, run.op, 1.0)


def day_of(valve: wb.Valve, plant: wb.FOPDT | wb.Integrating, controller: wb.PID, samples: int = 86_400) -> wb.Record:
    """A loop under noise with two setpoint moves."""
    moves = [wb.Step(8.0), wb.Step(-6.0, at=0.6 * samples)]
    experiment = wb.Experiment(float(samples), setpoint=moves, noise=wb.Noise(0.1, 1))
    run = wb.simulate(wb.Loop(plant, valve, controller, 1.0), experiment)
    return wb.Record(run.pv, run.op, 1.0)


def days() -> None:
    """Print processor time of 24 h at 1 s of other loops, and what was found."""
    loops = {
        "flow, 5 s": (wb.FOPDT(2.0, 5.0, 1.0), wb.PID(Kc=0.5, Ti=20.0)),
        "temperature, 60 s": (wb.FOPDT(1.2, 60.0, 20.0), wb.PID(Kc=0.7, Ti=60.0)),
        "level": (wb.Integrating(0.01, 10.0), wb.PID(Kc=2.0, Ti=200.0)),
    }
    valves = (wb.Stenman(2.0), wb.Choudhury(3.0, 1.0), wb.Choudhury(3.0, 3.5), wb.Deadband(3.0))
    wb.estimate(day_of(valves[1], *loops["level"], samples=30_000))
    print("24 h of a loop      valve                     estimate, s  found")
    for name, loop in loops.items():
        for valve in valves:
            record = day_of(valve, *loop)
            began = time.process_time()
            found = wb.estimate(record)
            took = time.process_time() - began
            print(f"{name:19} {valve!s:25} {took:11.2f}  {found.verdict}, {found.valve}, {found.plant}", flush=True)


def speed() -> None:
    """Print processor time against N: the estimate, and every path from one start enumerated at 31 dead times."""
    wb.estimate(long_record(300))
    wb.estimate(long_record(1600))
    print("samples  estimate, s  enumeration, s  paths  200-point grid, s  its least cost over the true least")
    for samples in (300, 1000, 3000, 10_000, 30_000, 86_400):
        record = long_record(samples)
        began = time.process_time()
        wb.estimate(record)
        took = time.process_time() - began
        data = centre(record, "fopdt")
        shifted, low = at_delays(data.sums, np.arange(31)), LEAST_D * data.op_range
        rows = np.empty((6 * samples + 1000, ROW))
        counts, times, least = [], [], []
        for step in (0.0, (data.op_range / low) ** (1.0 / 200.0) - 1.0):
            began = time.process_time()
            counts.append(
                walk(
                    data.sums,
                    data.squares,
                    data.products,
                    data.u,
                    0,
                    low,
                    data.op_range,
                    step,
                    shifted,
                    math.nan,
                    data.sign,
                    rows,
                )
            )
            times.append(time.process_time() - began)
            least.append(float(rows[: counts[-1], COST].min()))
        print(
            f"{samples:7} {took:12.3f} {times[0]:15.4f} {counts[0]:6} {times[1]:18.4f} {least[1] / least[0]:.3f}",
            flush=True,
        )
    print(f"peak memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0:.0f} MiB")


if __name__ == "__main__":
    if sys.argv[1:2] == ["speed"]:
        speed()
        days()
    elif sys.argv[1:2] == ["plants"]:
        plants(int(sys.argv[2]) if len(sys.argv) > 2 else 20, int(sys.argv[3]) if len(sys.argv) > 3 else 0)
    else:
        accuracy(int(sys.argv[1]) if len(sys.argv) > 1 else 60, int(sys.argv[2]) if len(sys.argv) > 2 else 0)
