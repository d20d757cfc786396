"""Many runs at once: their sums, their objectives and their worst cases, over the machine's cores.

The kernel works without Python's lock, so that threads share the rows out; each row is the same run on any of them.
"""

from __future__ import annotations

import itertools
import os
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache

import numpy as np
from numpy.typing import NDArray

from workbench.model.record import FloatArray
from workbench.model.tuning import Objective
from workbench.simulate import batch_kernel, kernel
from workbench.simulate.signals import Signals
from workbench.simulate.sums import FEW_SUMS, SUMS, weigh_all

__all__ = ["FIRST_LOOK", "cores", "kernel_weights", "price", "shared_out", "sums", "weigh", "worst"]

# Fewer samples than this, some milliseconds, are not worth a second thread.
WORTH_SHARING = 1_000_000
# After so many samples `worst` first looks whether a run has passed its ceiling.
FIRST_LOOK = batch_kernel.CHUNK
# What a sample costs of a loop that runs alone, of one with what few loops have, and of a stem with mass, where one of
# a loop that runs side by side costs 1: orders of magnitude, for the budgets of searches.
ALONE, RARE, MASS = 4.0, 16.0, 256.0


def kernel_weights(objective: Objective, samples: int, sample_time: float) -> FloatArray:
    """Return an objective's weights of the kernel's sums, shape (WEIGHTS,)."""
    figures = dict(objective.kpis)
    window = figures.get("mean_square_error", 0.0) / samples + figures.get("ise", 0.0) * sample_time
    rest = ("controller_travel", "reversals", "error_variance", "op_variance", "valve_variance", "pv_sd")
    return np.array(
        [
            *objective.weights,
            window,
            figures.get("valve_travel", 0.0),
            figures.get("iae", 0.0) * sample_time,
            *(figures.get(name, 0.0) for name in rest),
        ]
    )


def sums(
    rows: FloatArray, given: Signals, which: NDArray[np.int64] | None = None, *, every: bool = False
) -> FloatArray:
    """Return the sums of `batch_kernel.run_costs` for coefficient rows, shape (M, FEW_SUMS), or (M, SUMS) if `every`.

    given: one experiment, shape (N + 1,) each, or several of the same N, shape (E, N + 1); row i runs in which[i].
    """
    r, load, noise = (np.atleast_2d(s) for s in (given.r, given.load, given.noise))
    which = np.zeros(rows.shape[0], np.int64) if which is None else which
    result = np.empty((rows.shape[0], SUMS if every else FEW_SUMS))
    longest = int(rows[:, kernel.DELAY].max(initial=0.0))

    def work(part: slice) -> None:
        batch_kernel.run_costs(rows[part], which[part], r, load, noise, result[part], longest)

    shared_out(rows.shape[0], r.shape[1] - 1, work)
    return result


def price(rows: FloatArray, weights: FloatArray) -> float:
    """Return about what a sample costs of a loop with these coefficient rows, weighed so, in samples of a plain one."""
    row = rows[0]
    if row[kernel.VALVE] >= kernel.KARNOPP:
        return MASS
    if not kernel.usual(row):
        return RARE
    return 1.0 if batch_kernel.fits_abreast(row) and not batch_kernel.weighs_every(weights) else ALONE


def weigh(terms: FloatArray, weights: FloatArray, samples: int) -> FloatArray:
    """Return J for sums of shape (M, FEW_SUMS or SUMS) and `kernel_weights`; inf where a run overflowed."""
    costs = np.empty(terms.shape[0])
    weigh_all(terms, weights, samples, costs)
    return costs


def worst(
    rows: FloatArray,
    group: int,
    given: Signals,
    weights: FloatArray,
    ceilings: FloatArray,
    lost: NDArray[np.int64] | None = None,
) -> tuple[FloatArray, int]:
    """Return the worst J of each group of rows, shape (M,), inf above its ceiling, and the samples run for it.

    lost: shape (group,), how often each member's run has given its group up of late, kept up to date here. The members
    that do so most are run first: the values are the same, and groups that lose are given up sooner.
    """
    result = np.empty(ceilings.size)
    longest = int(rows[0, kernel.DELAY]) if rows.size else 0
    counts: list[int] = []
    given_up: list[NDArray[np.int64]] = []
    order = np.arange(group) if lost is None else np.argsort(-lost, kind="stable")

    def work(part: slice) -> None:
        own, late = rows[part.start * group : part.stop * group], np.zeros(group, np.int64)
        samples = batch_kernel.run_worst(
            own,
            group,
            given.r,
            given.load,
            given.noise,
            weights,
            ceilings[part],
            result[part],
            longest,
            order,
            late,
        )
        counts.append(samples)
        given_up.append(late)

    shared_out(ceilings.size, group * given.samples, work)
    if lost is not None:
        lost[:] = lost // 2 + sum(given_up)
    return result, sum(counts)


def cores() -> int:
    """Return how many of the machine's cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def shared_out(count: int, samples: int, work: Callable[[slice], None]) -> None:
    """Do `work` on parts of range(count), each of so many samples, on all cores if it is worth it."""
    workers = cores()
    if workers == 1 or count * samples < WORTH_SHARING or count < 2 * workers:
        work(slice(0, count))
        return
    # More parts than cores: runs that are given up early make some parts short.
    edges = np.linspace(0, count, min(2 * workers, count) + 1).astype(int).tolist()
    parts = deque(slice(a, b) for a, b in itertools.pairwise(edges))

    def take() -> None:
        while True:
            try:
                part = parts.popleft()
            except IndexError:
                return
            work(part)

    helpers = [_helpers(workers - 1).submit(take) for _ in range(workers - 1)]
    try:
        take()
    finally:
        parts.clear()
        # A helper that has not begun would find nothing left; the others end with the part that they are at.
        begun = [helper for helper in helpers if not helper.cancel()]
        for helper in begun:
            helper.result()


@cache
def _helpers(count: int) -> ThreadPoolExecutor:
    """Return the threads that help the caller's own; kept, as a search shares out thousands of times."""
    return ThreadPoolExecutor(count, thread_name_prefix="workbench-batch")


if hasattr(os, "register_at_fork"):
    # A copy of this process has none of its threads.
    os.register_at_fork(after_in_child=_helpers.cache_clear)
