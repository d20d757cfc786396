"""The linear loop, which ignores stiction, with all that may disturb it: load steps, colour, an outside oscillation."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from workbench.detect.load_steps import unforced
from workbench.detect.rivals import Loaded, Rivals, dead_times, fine_taus
from workbench.estimate.fits.data import Centred
from workbench.estimate.fits.fit import Fit, again_linear, fit_linear
from workbench.estimate.fits.windows import WHOLE
from workbench.estimate.loads.settled import calm_linear, coloured_linear
from workbench.estimate.loads.steps import DEGREES
from workbench.estimate.loads.swing import Answered, Swing, beside_swing
from workbench.estimate.ranges.scale import linear_result
from workbench.estimate.search.paths import linear_path
from workbench.model.loads import LoadStep
from workbench.model.record import Record
from workbench.model.results import LinearFit

__all__ = ["MOST", "Coloured", "Straight", "free_of", "level", "linear_beside", "sought_beside_steps"]

MOST = 4  # load steps that are sought together with the plant: as many as detection gives the linear loop
SPARE = 6  # and more than are needed
LARGEST = 2.0  # times OP's range: a load that moves further is none; OP may not yet have answered one that goes again


# A record without load steps in some measure, its linear fit there, and the steps.
Coloured = tuple[Centred, Fit, tuple[LoadStep, ...]]


@dataclass(frozen=True, eq=False)
class Straight:
    """The linear fit to a record whose OP is as it explains more of PV; longest: the longest delay, samples.

    free: the samples in which a load may step (see `free_of`), shape (N,); None where no steps are sought with the
    plant.
    """

    data: Centred
    fit: Fit
    longest: float
    free: NDArray[np.bool_] | None = None

    def calm(self, data: Centred) -> Straight:
        """Return the same of a record without an oscillation from outside."""
        return replace(self, data=data, fit=fit_linear(data, self.longest))

    @cached_property
    def coloured(self) -> Coloured:
        """The record without load steps and its linear fit, in the measure of what this leaves, and the steps."""
        return coloured_linear(self.data, self.fit, self.longest)

    @cached_property
    def likeliest(self) -> Coloured:
        """The same, with steps sought together with the plant where they leave noise alone and those found do not."""
        own = self.coloured
        data = own[0]
        if self.free is not None and data.a.size > 1 and data.samples <= WHOLE:
            least = level(*own)
            for beside, times in sought_beside_steps(self, self.free):
                found = calm_linear(beside.data, beside.fit, beside.longest, times)
                if found is not None and level(*found) < least and _answered(found[2], data.op_range):
                    return found
        return own


# A line, and samples at which PV answers load steps beside it.
Beside = tuple[Straight, tuple[int, ...]]


def free_of(record: Record) -> NDArray[np.bool_]:
    """Return the samples in which a load may step: those that no setpoint move accounts for, shape (N,)."""
    return unforced(record.sp, record.pv, dead_times(len(record), math.nan)[-1])


def linear_beside(line: Straight, settled: Callable[[Straight], Coloured]) -> tuple[Answered[LinearFit], Swing | None]:
    """Return the linear model beside what disturbs the loop from outside, and the oscillation if there is one.

    settled: gives a line's fit without load steps, beside an oscillation that has been taken out of it.
    """

    def answered(line: Straight) -> Answered[LinearFit]:
        data, linear, _ = settled(line)
        return Answered(linear_result(data, linear), linear_path(data, linear), data, ())

    return beside_swing(line.data, answered(line), lambda calm: answered(line.calm(calm)), line.longest)


def level(data: Centred, fit: Fit, steps: Sequence[LoadStep]) -> float:
    """Return the BIC of a plant beside load steps in the measure of what disturbs the loop, but for its parameters."""
    n = data.samples
    terms = data.terms + 1 + DEGREES * len(steps)
    return n * math.log(max(fit.sse / (n - data.skip), data.floor)) + terms * math.log(n)


def _answered(steps: Sequence[LoadStep], op_range: float) -> bool:
    """Whether a loop whose OP moved no further may have answered load steps, %, as integral action does in the end."""
    load = np.cumsum([0.0, *(step.size for step in steps)])
    return float(np.ptp(load)) <= LARGEST * op_range


def sought_beside_steps(line: Straight, free: NDArray[np.bool_]) -> Iterator[Beside]:
    """Yield lines with the plant beside which load steps leave least, and the samples at which PV answers these.

    An unseen step spoils the plant that is fitted without it, so that what this leaves does not show the step (see
    `detect.load_steps`). The first has as many steps as explain what they cost, in the samples in which the load may
    step: free, shape (N,). An autoregression explains steps away; the others have more than are needed, anywhere.
    """
    data, n = line.data, line.data.samples
    rivals, taus = (
        Rivals(data.y - data.y.mean(), dead_times(n, math.nan), data.sign, np.zeros(n, dtype=bool)),
        fine_taus(n),
    )
    filters = rivals.linear(data.u, taus).a, rivals.white
    found = [rivals.under_load(data.u, a, taus, free, MOST, ramps=False) for a in filters]
    yield from _with_plant(line, min(found, key=lambda one: one.variance))
    for a in filters:
        full = list(rivals.loads(data.u, a, taus, np.ones(n, dtype=bool), SPARE, ramps=False))[-1:]
        yield from (pair for one in full for pair in _with_plant(line, one))


def _with_plant(line: Straight, found: Loaded) -> Iterator[Beside]:
    """The line with the plant found beside load steps, if there are any, and the last samples without an answer."""
    if found.fit is None:
        return
    near = replace(line.fit, tau=found.fit.tau, theta=min(float(found.fit.delay), line.longest))
    fit = again_linear(line.data.less(found.wave, np.empty((0, line.data.samples))), near, line.longest)
    yield replace(line, fit=fit), tuple(t - 1 for t in found.times)
