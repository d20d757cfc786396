"""Verdicts on simulated loops of known truth and, where given, on labelled records; and how they move with the rule.

    python benchmarks/detection.py [--loops 40] [--first 0] [--records DIR]...

Loops are random: first-order and integrating plants, PI tuned from brisk to slow, 750 to 3,000 samples, measurement
noise of 2 to 20 % of the disturbance's effect. Healthy classes: noise alone; fast, slow and sinusoidal load; tight
tuning; setpoint steps; a nonlinear gain (the static square law that the PV of an orifice without a square root has);
one to three load steps; and, counted by themselves, square, rectangular and triangular loads of steady period.
Sticky ones: every valve type, the load a slow drift of up to a quarter of the stick band; those whose stem set off less
than ten times in the record are counted by themselves: nothing tells them from a healthy loop at rest. And, by
themselves too, sticky loops under load steps or a sinusoid of half to twice the stick band. Labelled records
are looked at whole, and cut, thinned, late, noisier, rounded and kept by exception, some of the simulated ones rounded
and kept so. Each threshold is then moved by a fifth down and up on
the same records.
"""

from __future__ import annotations

import argparse
import csv
import math
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import fields, replace
from pathlib import Path

import numpy as np

import workbench as wb
from workbench.detect.verdict import Thresholds, decide

HEALTHY = (
    "noise",
    "fast load",
    "slow load",
    "sinusoidal load",
    "tight tuning",
    "setpoint steps",
    "nonlinear gain",
    "load steps",
)
ENOUGH = 10  # moves of the stem
KEPT = 5  # loops of each class that are looked at as historians keep them too
STICKY = ("Stenman", "S = J", "S > J", "S < J", "dead band")
HIDDEN = ("stiction under load steps", "stiction under a sinusoid")
APART = ("stuck fast", "large setpoint moves", "wave load", *HIDDEN, "uneven wave load")
SEEDED = (*HEALTHY[:7], *STICKY, *APART[:2], *HEALTHY[7:], *APART[2:])  # a class keeps its loops where another joins


def drift(rng: np.random.Generator, n: int, correlation: float) -> np.ndarray:
    """A unit-variance first-order drift of the given correlation time, samples."""
    pole = math.exp(-1.0 / max(correlation, 0.2))
    out = np.empty(n)
    value = rng.normal()
    for k, kick in enumerate(rng.normal(size=n).tolist()):
        value = pole * value + math.sqrt(1.0 - pole * pole) * kick
        out[k] = value
    return out


def random_record(kind: str, level: bool, seed: int) -> tuple[wb.Record, int]:
    """Return one random loop's record and how often its stem set off; kind: an entry of HEALTHY, STICKY or APART."""
    rng = np.random.default_rng([seed, int(level), SEEDED.index(kind)])
    n = int(rng.choice([750, 1500, 3000]))
    gain = float(np.exp(rng.uniform(math.log(0.3), math.log(3.0)))) * float(rng.choice([1, 1, 1, -1]))
    action = "reverse" if gain > 0.0 else "direct"
    slack = rng.uniform(1.0, 5.0)
    if level:
        plant = wb.Integrating(gain / float(np.exp(rng.uniform(3.0, 5.7))), float(rng.uniform(0.5, 8.0)))
        speed = max(plant.dead_time, 2.0) * slack * 2.0
        Kc = 1.0 / abs(plant.gain) / (speed + plant.dead_time)
        Ti = 4.0 * (speed + plant.dead_time) * rng.uniform(0.7, 2.0)
        effect = abs(plant.gain) * speed
    else:
        tau = float(np.exp(rng.uniform(0.0, 3.7)))
        plant = wb.FOPDT(gain, tau, max(0.2, tau * float(rng.uniform(0.1, 1.0))))
        speed = plant.dead_time * slack + 0.3 * tau
        Kc = tau / abs(gain) / (speed + plant.dead_time)
        Ti = min(tau, 4.0 * (speed + plant.dead_time)) * rng.uniform(0.6, 1.6)
        effect = abs(gain)
    controller = wb.PID(Kc=float(Kc), Ti=float(Ti), action=action)
    size = float(rng.uniform(1.0, 10.0))
    noise = float(rng.uniform(0.02, 0.2)) * size * effect
    valve: object = wb.Ideal()
    load, setpoint = None, None
    if kind == "noise":
        noise = 0.3 * size * effect
    elif kind == "fast load":
        load = size * drift(rng, n, rng.uniform(0.3, 2.0) * max(speed, 1.0))
    elif kind == "slow load":
        load = size * drift(rng, n, rng.uniform(10.0, 40.0) * speed)
    elif kind in ("sinusoidal load", HIDDEN[1]):
        period = max(min(rng.uniform(2.0, 40.0) * speed, n / 4.0), 6.0)
        load = size * np.sin(2.0 * math.pi * np.arange(n) / period + rng.uniform(0.0, 6.0))
    elif kind == "wave load":
        # Another loop whose valve sticks sends a square or a triangle.
        phase = (np.arange(n) / max(min(rng.uniform(2.0, 40.0) * speed, n / 4.0), 6.0) + rng.uniform()) % 1.0
        load = size * (np.where(phase < 0.5, 1.0, -1.0) if rng.random() < 0.5 else 1.0 - 4.0 * np.abs(phase - 0.5))
    elif kind == "uneven wave load":
        # A heater that is switched, or a tank that is filled by turns.
        phase = (np.arange(n) / max(min(rng.uniform(2.0, 40.0) * speed, n / 4.0), 8.0) + rng.uniform()) % 1.0
        first = 0.5 + float(rng.choice([-1.0, 1.0])) * rng.uniform(0.1, 0.4)
        saw = np.where(phase < first, 2.0 * phase / first - 1.0, 1.0 - 2.0 * (phase - first) / (1.0 - first))
        load = size * (np.where(phase < first, 1.0, -1.0) if rng.random() < 0.5 else saw)
    elif kind in ("load steps", HIDDEN[0]):
        load = np.zeros(n)
        for at in rng.integers(10, n - 10, int(rng.integers(1, 4))).tolist():
            load[at:] += size * rng.normal()
    elif kind == "tight tuning":
        loop = wb.Loop(plant=plant, valve=wb.Ideal(), controller=controller, sample_time=1.0)
        margin = wb.margins(loop).gain_margin
        if 1.0 < margin < math.inf:
            controller = replace(controller, Kc=controller.Kc * margin / rng.uniform(1.05, 1.4))
        load = 0.3 * size * drift(rng, n, rng.uniform(0.5, 5.0) * max(speed, 1.0))
    elif kind in ("setpoint steps", "nonlinear gain"):
        at = np.sort(rng.choice(np.arange(10, n - 10), int(rng.integers(1, 6)), replace=False))
        setpoint = [wb.Step(float(rng.normal()) * 1.5 * size * effect, float(t)) for t in at]
        load = 0.1 * size * drift(rng, n, rng.uniform(10.0, 40.0) * speed)
    elif kind == "stuck fast":
        noise = float(rng.uniform(0.0, 0.05)) * size * effect
        load = size * drift(rng, n, rng.choice([1.0, 20.0]) * speed)
        # A level with a stuck valve runs away from any load that lasts.
        load = load - load.mean()
        valve = wb.Stenman(1e9)
    elif kind == "large setpoint moves":
        at = np.sort(rng.choice(np.arange(20, n - 100), 4, replace=False))
        setpoint = [wb.Step(20.0 * size * effect * float(rng.normal()), float(t)) for t in at]
        noise = 0.03 * size * effect
        valve = (wb.Stenman(size), wb.Deadband(size), wb.Choudhury(size, 0.3 * size))[int(rng.integers(3))]
    else:
        noise = float(rng.uniform(0.0, 0.1)) * size * effect
        load = rng.uniform(0.0, 0.25) * size * drift(rng, n, rng.uniform(10.0, 40.0) * speed)
        valve = {
            "Stenman": wb.Stenman(size),
            "S = J": wb.Choudhury(size, size),
            "S > J": wb.Choudhury(size, size * float(rng.uniform(0.05, 0.5))),
            "S < J": wb.Choudhury(size, size * float(rng.uniform(1.1, 1.8))),
            "dead band": wb.Deadband(size),
        }[kind]
    if kind in HIDDEN:
        noise, load = float(rng.uniform(0.0, 0.1)) * size * effect, rng.uniform(0.5, 2.0) * load
        valve = (wb.Stenman(size), wb.Deadband(size), wb.Choudhury(size, 0.3 * size))[int(rng.integers(3))]
    loop = wb.Loop(plant=plant, valve=valve, controller=controller, sample_time=1.0)
    disturbance = None if load is None else wb.Series(load.tolist())
    run = wb.simulate(loop, wb.Experiment(float(n), setpoint, disturbance, wb.Noise(noise, seed)))
    pv = run.pv
    if kind == "nonlinear gain":
        # The slope changes by half to threefold over the range that PV moves in.
        reach = float(np.abs(pv).max())
        pv = pv + rng.choice([-1.0, 1.0]) * rng.uniform(0.2, 0.5) * pv * pv / (2.0 * reach)
    moving = np.diff(run.valve) != 0.0
    moves = int((moving[1:] & ~moving[:-1]).sum())
    return wb.Record(pv + 50.0, run.op + 50.0, 1.0, sp=run.sp + 50.0), moves


def changed(record: wb.Record) -> Iterator[tuple[str, wb.Record]]:
    """A record cut, thinned, late, turned, without setpoint, noisier, rounded: what is true of it mostly stays true."""

    def part(begin: float, end: float, step: int = 1) -> wb.Record:
        at = slice(int(begin * len(record)), int(end * len(record)), step)
        sp = None if record.sp is None else record.sp[at]
        return wb.Record(record.pv[at], record.op[at], record.sample_time * step, sp=sp)

    whole = part(0.0, 1.0)
    for begin, end in ((0.0, 0.5), (0.25, 0.75), (0.5, 1.0), (0.0, 0.7), (0.3, 1.0)):
        yield f"{begin:.0%} to {end:.0%}", part(begin, end)
    yield "every second sample", part(0.0, 1.0, 2)
    last = len(record) - 2
    sp = None if record.sp is None else record.sp[2:]
    yield "PV two samples late", wb.Record(record.pv[:last], record.op[2:], record.sample_time, sp=sp)
    yield "turned over", replace(whole, pv=-whole.pv, sp=None if whole.sp is None else -whole.sp)
    yield "without setpoint", replace(whole, sp=None)
    noise = np.random.default_rng(1).normal(size=len(record)) * 0.5 * np.std(np.diff(record.pv))
    yield "noise of half its steps", replace(whole, pv=whole.pv + noise)
    for share in (0.01, 0.05):
        quantum = share * np.ptp(record.pv)
        yield f"PV in steps of {share:.0%} of its range", replace(whole, pv=np.round(whole.pv / quantum) * quantum)
    yield from kept(whole)


def kept(record: wb.Record) -> Iterator[tuple[str, wb.Record]]:
    """A record as historians keep it: OP in steps, PV where it has moved by a share of what it usually moves over.

    PV between the values that were kept is the last of them, or on a straight line from it to the next.
    """
    for step in (0.1, 0.25, 0.5):
        yield f"OP in steps of {step}", replace(record, op=np.round(record.op / step) * step)
    usual = float(np.ptp(np.percentile(record.pv, (2.5, 97.5))))
    for share in (0.05, 0.15, 0.3):
        pv = record.pv.copy()
        for k in range(1, pv.size):
            pv[k] = pv[k] if abs(pv[k] - pv[k - 1]) > share * usual else pv[k - 1]
        yield f"PV kept where it has moved by {share:.0%} of its swing", replace(record, pv=pv)
        at = np.flatnonzero(np.diff(pv, prepend=math.nan) != 0.0)
        lines = np.round(np.interp(np.arange(pv.size), at, pv[at]), 5)
        yield f"PV drawn between values {share:.0%} of its swing apart", replace(record, pv=lines)


def tell_changed(
    rows: list[tuple[str, wb.Record]], views: Callable[[wb.Record], Iterator[tuple[str, wb.Record]]] = changed
) -> None:
    """Print the verdicts on all changed records by label; rows: label and record."""
    verdicts: dict[tuple[str, str], Counter[str]] = {}
    for label, record in rows:
        for name, other in views(record):
            verdicts.setdefault((label, name), Counter())[wb.detect(other).verdict] += 1
    for label in sorted({label for label, _ in verdicts}):
        mine = {name: counts for (one, name), counts in verdicts.items() if one == label}
        for name, counts in mine.items():
            print(f"{label}, {name}: {dict(counts)}")
        print(f"{label}, all: {dict(sum(mine.values(), Counter()))}", flush=True)


def main() -> None:
    """Print the rates by class, and what each threshold does to them."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--loops", type=int, default=40)
    parser.add_argument("--first", type=int, default=0, help="the first loop's seed")
    parser.add_argument("--records", type=Path, action="append", default=[])
    given = parser.parse_args()
    groups: dict[str, list[wb.Detection]] = {}
    simulated: list[tuple[str, wb.Record]] = []
    for kind in HEALTHY + STICKY + APART:
        for level in (False, True):
            name = f"{'level' if level else 'flow'}, {kind}"
            groups[name], seldom = [], []
            for seed in range(given.first, given.first + given.loops):
                record, moves = random_record(kind, level, seed)
                still = kind in STICKY + HIDDEN and moves < ENOUGH
                (seldom if still else groups[name]).append(wb.detect(record))
                if seed < given.first + KEPT and kind in HEALTHY + STICKY and not still:
                    simulated.append(("simulated, healthy" if kind in HEALTHY else "simulated, sticky", record))
            print(name, dict(Counter(found.verdict for found in groups[name])), end="")
            told = f", hardly moving {dict(Counter(found.verdict for found in seldom))}" if seldom else ""
            print(told, flush=True)
    labels: dict[str, list[str]] = {}
    read: list[tuple[str, wb.Record]] = []
    for folder in given.records:
        rows = list(csv.DictReader((folder / "labels.csv").open(encoding="utf-8")))
        labels[str(folder)] = [row["label"] for row in rows]
        records = [wb.read_record(folder / row["file"]) for row in rows]
        groups[str(folder)] = [wb.detect(record) for record in records]
        read += zip(labels[str(folder)], records, strict=True)
    tell_changed(simulated, kept)
    tell_changed(read)
    plain = Thresholds()
    trials = [("as they are", plain)]
    for field in fields(plain):
        for factor in (0.8, 1.2):
            value = getattr(plain, field.name) * factor
            trials.append((f"{field.name} x {factor}", replace(plain, **{field.name: value})))
    print("\nthresholds: healthy accused | sticky found, called healthy | records right, accused or acquitted wrongly")
    for words, limits in trials:
        rates = Counter()
        for name, founds in groups.items():
            for i, found in enumerate(founds):
                verdict = found.verdict
                # Signals that tell nothing about the valve are undecided whatever the thresholds are.
                if found.test is not None and decide(found.oscillation, found.test, found.stem)[0] == verdict:
                    verdict = decide(found.oscillation, found.test, found.stem, limits)[0]
                if name in labels:
                    rates[f"{name} right"] += verdict == labels[name][i]
                    rates[f"{name} wrong"] += verdict not in (labels[name][i], "undecided")
                else:
                    kind = name.partition(", ")[2]
                    side = "healthy" if kind in HEALTHY else "sticky" if kind in STICKY else "apart"
                    rates[side] += 1
                    rates[f"{side} {verdict}"] += 1
        told = [f"{rates['healthy stiction'] / rates['healthy']:.1%}"]
        told.append(
            f"{rates['sticky stiction'] / rates['sticky']:.1%}, {rates['sticky no_stiction'] / rates['sticky']:.1%}"
        )
        told += [f"{rates[f'{name} right']} of {len(labels[name])}, {rates[f'{name} wrong']}" for name in labels]
        print(f"{words:18}", " | ".join(told))


if __name__ == "__main__":
    main()
