"""From unrounded tunings to the one to type in: the worst case within the digits, searched on the digits themselves."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from workbench.model.record import FloatArray
from workbench.model.tuning import DigitStep
from workbench.model.valve import Ideal, Kano, Positional
from workbench.simulate.coefficients import valve_law
from workbench.tune.limits import WORN
from workbench.tune.problem import NAMES, Problem, unit_of
from workbench.tune.refine import path
from workbench.tune.scan import spread

__all__ = ["Choice", "choose", "digit_steps", "stem_guard"]

# Steps of the last search, in units of the last digit.
STEPS = (64, 16, 4, 1)
# A derivative time below this many sample times does nothing but look odd; it is left out where the worst case grows by
# less than NO_LOSS without it.
NEGLIGIBLE, NO_LOSS = 0.02, 1e-3
# Samples of runs, one for each candidate, that may be looked at densely; candidates that get the last word.
CANDIDATE_SAMPLES, FINALISTS = 1_000_000, 600
# Those, so far apart in the unit cube, from which that leads a walk where it finds more than a dense look.
LED, APART = 8, 3e-3
# Tunings of which other points than those that chose them may be asked.
PROVED = 10
# At most this many rounds for each step: each round improves the worst case, so this is only a guard.
ROUNDS = 50


_Result = tuple[float, float, FloatArray]  # worst J, J and tuning


@dataclass(frozen=True, eq=False)
class Choice:
    """A rounded tuning (Kc, Ti, Td), its exact J and the worst J in its neighbourhood."""

    tuning: FloatArray
    cost: float
    worst: float


def choose(problem: Problem, candidates: FloatArray, *, stop: Callable[[], bool] = lambda: False) -> Choice:
    """Return the rounded tuning of the least worst case near the candidates, shape (M, 3), M >= 1.

    Every candidate is rounded and judged by a dense sample of its neighbourhood; the best are then improved step by
    step on the lattice of their digits, and the last word is a still closer look at these and the next best, which
    thin cliffs cannot hide from so easily; where it finds them, it leads further walks itself. As that many looks at
    the same points choose what these do not show, the best are proved at others, until the best of all is a proved one.
    A candidate with a negligible derivative is also judged without it, and its derivative is left out where that costs
    next to nothing.
    """
    tried = problem.rounded(candidates)
    if problem.low[2] == 0.0:
        small = tried[tried[:, 2] < NEGLIGIBLE * problem.loop.sample_time]
        tried = np.concatenate([tried, small * np.array([1.0, 1.0, 0.0])])
    tried = np.unique(tried, axis=0)
    few = problem.worst_below(tried, np.full(tried.shape[0], np.inf))
    tried = tried[np.argsort(few, kind="stable")[: max(4, CANDIDATE_SAMPLES // problem.samples)]]
    worst = problem.worst_below(tried, np.full(tried.shape[0], np.inf), dense=True)
    order = np.argsort(worst, kind="stable")
    plain = order[tried[order, 2] == 0.0][:1]
    starts = dict.fromkeys([*order[:3].tolist(), *plain.tolist()])
    dense = partial(_dense, problem)
    walked = [_improved(problem, tried[index], float(worst[index]), dense, stop)[0] for index in starts]
    ends = np.unique(np.concatenate([np.array(walked), tried[order[:FINALISTS]]]), axis=0)
    # The likeliest first: what they reach lets the others be given up early.
    looked = problem.worst_below(ends, np.full(ends.shape[0], np.inf), dense=True)
    ends = ends[np.argsort(looked, kind="stable")]
    results: list[_Result] = []
    for end in ends:
        stop()  # ends the choice by an exception where the time is up; the last look has no budget of its own
        ceiling = (1.0 + NO_LOSS) * min((item[0] for item in results), default=math.inf)
        results.append((problem.last_word(end, ceiling), float(problem.exact(end[None, :])[0]), end))
    last = min(results, key=lambda item: item[0])
    if last[0] > (1.0 + NO_LOSS) * dense(last[2], math.inf):
        # Where a closer look finds more, there are thin cliffs everywhere: the closer look itself leads out of them.
        values = np.array([item[0] for item in results])
        for index in spread(problem.cube(ends), values, LED, APART):
            end, value = _improved(problem, ends[index], float(values[index]), problem.last_word, stop)
            results.append((value, float(problem.exact(end[None, :])[0]), end))
    if min(item[0] for item in results) >= WORN:
        # The valve of a rough loop may travel further at one point in a thousand, whatever the tuning.
        results = [(dense(end, math.inf), cost, end) for _, cost, end in results]
    return _proved(problem, results, stop)


def _proved(problem: Problem, results: list[_Result], stop: Callable[[], bool]) -> Choice:
    """Return the best tuning whose worst case other points confirm, or the best of those that were tried so."""
    first = results[_picked(problem, results)]
    sure: list[int] = []
    while len(sure) < PROVED:
        stop()
        at = _picked(problem, results)
        if at in sure:
            break
        worst, cost, tuning = results[at]
        ceiling = (1.0 + NO_LOSS) * min((results[i][0] for i in sure), default=math.inf)
        results[at] = max(worst, problem.last_word(tuning, ceiling, proof=True)), cost, tuning
        sure.append(at)
    kept = [results[i] for i in sure]
    worst, cost, tuning = kept[_picked(problem, kept)]
    if worst >= WORN:
        worst, cost, tuning = first
        if worst < WORN:
            worst = max(worst, problem.unconstrained().last_word(tuning, proof=True))
    return Choice(tuning, cost, worst)


def _picked(problem: Problem, results: list[_Result]) -> int:
    """The place of the best result: worst cases that are as good as equal leave the choice to J itself."""
    least = min(item[0] for item in results)
    near = [i for i, item in enumerate(results) if item[0] <= (1.0 + NO_LOSS) * least] or list(range(len(results)))
    best = min(near, key=lambda i: (results[i][1], results[i][0]))
    if problem.low[2] == 0.0 and results[best][2][2] < NEGLIGIBLE * problem.loop.sample_time:
        plain = (i for i, item in enumerate(results) if item[2][2] == 0.0)
        without = min(plain, key=lambda i: results[i][:2], default=best)
        if results[without][0] <= (1.0 + NO_LOSS) * results[best][0]:
            return without
    return best


def _dense(problem: Problem, tuning: FloatArray, ceiling: float) -> float:
    """The densely sampled worst case of one tuning, shape (3,), inf above the ceiling."""
    return float(problem.worst_below(tuning[None, :], np.array([ceiling]), dense=True)[0])


def _improved(
    problem: Problem,
    tuning: FloatArray,
    value: float,
    judged: Callable[[FloatArray, float], float],
    stop: Callable[[], bool],
) -> tuple[FloatArray, float]:
    """Walk on the lattice of digits as long as the worst case falls, as it is judged: (tuning, ceiling) -> value."""
    moves = np.array([m for m in itertools.product((-1.0, 0.0, 1.0), repeat=problem.free.size) if any(m)])
    if not moves.size:
        return tuning, value
    for step in STEPS:
        for _ in range(ROUNDS):
            if stop():
                return tuning, value
            near = np.tile(tuning, (moves.shape[0], 1))
            near[:, problem.free] += step * moves * unit_of(tuning, problem.digits)[problem.free]
            near = problem.rounded(np.clip(near, problem.low, problem.high))
            # The sparse sample sorts out most of them; its worst case is never above that of a closer look.
            likely = problem.worst_below(near, np.full(near.shape[0], value))
            better = False
            for index in np.argsort(likely, kind="stable"):
                if not likely[index] < value:
                    break
                closer = judged(near[index], value)
                if closer < value:
                    tuning, value, better = near[index], closer, True
                    break
            if not better:
                break
    return tuning, value


def digit_steps(
    problem: Problem, tuning: FloatArray, value: Callable[[FloatArray], FloatArray]
) -> tuple[DigitStep, ...]:
    """Return what one unit of the last digit of each free parameter does; value: (M, 3) -> J, shape (M,)."""
    units = unit_of(tuning, problem.digits)
    near = np.tile(tuning, (2 * problem.free.size, 1))
    for i, k in enumerate(problem.free):
        near[2 * i, k] -= units[k]
        near[2 * i + 1, k] += units[k]
    inside = ((near >= problem.low) & (near <= problem.high)).all(axis=1)
    costs = np.full(near.shape[0], math.nan)
    if inside.any():
        costs[inside] = value(problem.rounded(near[inside]))
    return tuple(
        DigitStep(NAMES[k], float(units[k]), float(costs[2 * i]), float(costs[2 * i + 1]))
        for i, k in enumerate(problem.free)
    )


def stem_guard(problem: Problem, tuning: FloatArray) -> float:
    """Return the least distance (%) of the run to a decision between stem at rest and slip; inf without stiction."""
    valve = problem.loop.valve
    if isinstance(valve, Ideal):
        return math.inf
    law = valve_law(valve)
    run = path(problem, tuning)
    # A run that overflows has no distances after that.
    with np.errstate(invalid="ignore", over="ignore"):
        before = np.append(0.0, run.x[:-1])
        lead, band, band_down = run.u - before, np.full(run.u.size, law.band), np.full(run.u.size, law.band_down)
        if isinstance(valve, Positional):
            at, bands, _ = np.array(law.table).reshape(3, -1)
            band = band_down = np.interp(before, at, bands)
        motion = run.branch % 3 - 1
        lower = np.zeros(lead.size)
        if isinstance(valve, Kano):
            # Up to its first move the band lies lower.
            lower[np.cumsum(np.append(0, motion[:-1] != 0)) == 0] = law.offset
        distance = np.minimum(np.abs(lead - band + lower), np.abs(lead + band_down + lower))
    if not valve.sticks_at_once:
        # While the stem goes on moving it is the input's direction that decides, not its distance.
        before = np.append(0, motion[:-1])
        distance = distance[~((motion != 0) & (motion == before))]
    return float(distance[np.isfinite(distance)].min(initial=math.inf))
