"""Describing function against exact limit cycles on random sticky loops: verdicts, errors, times.

Run by hand: `python benchmarks/limit_cycles.py [--loops 60] [--seed 0] [--long]`. Self-regulating plants with PI,
stable with an ideal valve; half Stenman, half two-parameter valves. `--long` also follows the first start of every
loop to the whole budget and compares the late period and swing with it.
"""

from __future__ import annotations

import argparse
import math
import time
from collections import Counter

import numpy as np

import workbench as wb
from workbench.analyze.frequency import linear_stable
from workbench.analyze.half_cycles import Block
from workbench.analyze.limit_cycle import standard_starts
from workbench.analyze.long_run import BUDGET, LONGEST_CHUNK, _Follower
from workbench.analyze.relaxation import relaxation_condition


def random_loop(rng: np.random.Generator, stenman: bool) -> wb.Loop:
    """One loop: gain .3 .. 3, time constant 5 .. 60 samples, dead time 0 .. 1.5 of it, J/S .05 .. 1, stable tuning."""

    def log_uniform(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(math.log(low), math.log(high))))

    Ts = log_uniform(0.2, 5.0)
    tau = log_uniform(5.0, 60.0) * Ts
    plant = wb.FOPDT(log_uniform(0.3, 3.0), tau, float(rng.uniform(0.0, 1.5)) * tau)
    S = log_uniform(0.3, 8.0)
    valve = wb.Stenman(S) if stenman else wb.Choudhury(S, S * log_uniform(0.05, 1.0))
    while True:
        controller = wb.PID(Kc=log_uniform(0.1, 10.0) / plant.gain, Ti=tau * log_uniform(0.3, 30.0))
        loop = wb.Loop(plant, valve, controller, Ts)
        if linear_stable(loop):
            return loop


def long_block(loop: wb.Loop) -> Block | None:
    """The second half of all reversals within the budget, from the first standard start."""
    run = _Follower(loop, standard_starts(loop)[0])
    while run.samples < BUDGET:
        run.advance(LONGEST_CHUNK)
    half = run.halves.shape[0] // 4 * 2
    return Block(run.halves[-half:], loop.sample_time) if half >= 4 else None


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--loops", type=int, default=60)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--long", action="store_true")
    given = parser.parse_args()
    rng = np.random.default_rng(given.seed)
    loops = [random_loop(rng, i % 2 == 0) for i in range(given.loops)]
    wb.limit_cycle(loops[0])  # compile before timing
    wb.describing_function(loops[0])
    for sampled in (False, True):
        print(f"\nL {'of the sampled loop' if sampled else 'continuous'}")
        table: Counter[tuple[str, bool, str]] = Counter()
        ratios, df_times, cycle_times, late = [], [], [], []
        closed: dict[str, list[float]] = {}
        blind, blind_found = 0, 0
        for loop in loops:
            begin = time.perf_counter()
            df = wb.describing_function(loop, sampling_delay=sampled)
            df_times.append(time.perf_counter() - begin)
            begin = time.perf_counter()
            cycle = wb.limit_cycle(loop)
            cycle_times.append(time.perf_counter() - begin)
            predicted = math.isfinite(df.period)
            table[type(loop.valve).__name__, predicted, cycle.outcome] += 1
            if cycle.outcome in ("cycles", "depends"):
                if predicted:
                    ratios.append((df.period / cycle.period, 2.0 * df.pv_amplitude / cycle.pv_peak_to_peak))
                if relaxation_condition(loop):
                    blind, blind_found = blind + 1, blind_found + predicted
                    shortest = min(start.period for start in cycle.starts if start.outcome == "cycles")
                    closed.setdefault(type(loop.valve).__name__, []).append(shortest / cycle.closed_form_period)
            if given.long and not sampled and cycle.starts[0].outcome == "cycles":
                block = long_block(loop)
                if block is not None:
                    first = cycle.starts[0]
                    late.append((first.period / block.period, first.pv_peak_to_peak / block.pv_peak_to_peak))
        print(f"{'valve':10} {'predicted':10} {'exact':10} loops")
        for (valve, predicted, outcome), count in sorted(table.items()):
            print(f"{valve:10} {'cycle' if predicted else 'no cycle':10} {outcome:10} {count:5d}")
        right = sum(
            n for (_, predicted, outcome), n in table.items() if predicted == (outcome in ("cycles", "depends"))
        )
        print(f"right verdicts: {right} of {given.loops}; relaxation loops found: {blind_found} of {blind}")
        for name, column in (("predicted / exact period", 0), ("predicted / exact PV swing", 1)):
            if ratios:
                low, high = np.percentile([pair[column] for pair in ratios], (5, 95))
                print(f"{name}: {low:.2f} .. {high:.2f} (5th to 95th percentile)")
        for kind, values in closed.items():
            low, high = np.percentile(values, (5, 95))
            print(f"shortest exact period / closed form, {kind}: {low:.3f} .. {high:.3f}, {len(values)} loops")
        if late:
            off = np.abs(np.array(late) - 1.0)
            print(
                f"late figures against the whole budget ({len(late)} loops): period within 5 % in "
                f"{(off[:, 0] < 0.05).mean():.0%}, swing within 2 % in {(off[:, 1] < 0.02).mean():.0%}"
            )
        for name, times in (("describing function", df_times), ("limit cycle, 8 starts", cycle_times)):
            print(f"{name}: median {1e3 * np.median(times):.0f} ms, worst {1e3 * max(times):.0f} ms a loop")


if __name__ == "__main__":
    main()
