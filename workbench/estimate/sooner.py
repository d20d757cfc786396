"""An OP that is recorded later than it was sent: PV answers the stem before that OP lets it move.

Historians read values one after the other, an OP before the controller's execution of each sample, say. A dead time
below what OP is late by cannot show then, the first sample of each answer is there too soon, and another plant makes up
for it: of random loops with a dead time below a sample the gain came out a third too low, and passed for identified.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

import numpy as np

from workbench.detect.late import earlier
from workbench.detect.scan import runs_faster
from workbench.estimate.fits.data import Centred
from workbench.estimate.fits.fit import LEAST_TAU, Limits, fit_path
from workbench.estimate.loads.swing import Answered
from workbench.estimate.plants import CLEAR_BIC
from workbench.estimate.search.paths import Path
from workbench.model.numbers import given
from workbench.model.record import Record
from workbench.model.results import Estimate

__all__ = ["as_sent", "words_of_sooner"]

Found = TypeVar("Found")

LATEST = 3  # samples that OP may be late
AT_ONCE = 1.0  # samples: a plant with a longer dead time has no answer that comes too soon


def as_sent(
    record: Record,
    search: Callable[[Record], Found],
    answered: Callable[[Found], Answered[Estimate]],
    noise_alone: Callable[[Record, str], bool],
) -> tuple[Record, Found, int]:
    """Return a record with OP as it was sent, what is found there, and by how many samples that is earlier.

    search: finds a model of a record, of which `answered` is its stem and the record as it was fitted, beside loads.
    noise_alone: whether a stem of a record's OP leaves noise alone with a kind of plant.
    """
    found, samples = search(record), 0
    while more := _sent_before(record, answered(found), noise_alone, LATEST - samples):
        moved = _moved(record, more)
        other = search(moved)
        before, after = answered(found), answered(other)
        less = after.settled.a.size == 1 or after.model.residual_variance < before.model.residual_variance
        if after.model.verdict != "stiction" or not less:
            break
        record, found, samples = moved, other, samples + more
    return record, found, samples


def _sent_before(
    record: Record, answered: Answered[Estimate], noise_alone: Callable[[Record, str], bool], most: int
) -> int:
    """By how many samples, at most so many, OP was sent before the record has it, as far as a sticking valve shows it.

    Where OP is late stems slip a sample too late, or otherwise, and what is right may be hidden. Nothing is said where
    the controller runs faster than the record, as what moves the valve is newer than OP then.
    """
    model, (path, *_), data, _ = answered
    sticks = model.verdict == "stiction" and model.valve.stick_band > 0.0
    if most == 0 or not sticks or path.fit.theta >= AT_ONCE:
        return 0
    kind = "integrating" if data.integrating else "fopdt"
    if _answers_before(data, path):
        found = 1
    elif (data.a.size == 1 and path.even) or noise_alone(record, kind):
        return 0
    else:
        found = next((n for n in range(1, most + 1) if noise_alone(_moved(record, n), kind)), 0)
    return 0 if found == 0 or runs_faster(record) else found


def _answers_before(data: Centred, path: Path) -> bool:
    """Whether PV answers the stem clearly better, in N log V, where that moves a sample earlier.

    Noise in PV tells against it: what sets a stem off moves PV the other way than the stem does.
    """
    n, fit, begin = data.samples, path.fit, max(path.first - 1, 0)
    limits = Limits((LEAST_TAU, float(n)), (0.0, fit.theta + AT_ONCE))
    sooner = np.append(path.x[1:], path.x[-1])
    free = (-math.inf, math.inf)
    as_it_is = fit_path(data, path.x, path.first, free, limits, fit.theta, tau=fit.tau).sse
    tried = (fit_path(data, sooner, begin, free, limits, theta, tau=fit.tau).sse for theta in (0.0, 0.5, 1.0))
    least = data.floor * n
    return math.log(max(as_it_is, least) / max(min(tried), least)) * n > CLEAR_BIC


def _moved(record: Record, samples: int) -> Record:
    """A record with OP so many samples earlier; its last value stands after it."""
    return replace(record, op=earlier(record.op, samples), rest=())


def words_of_sooner(samples: int, sample_time: float) -> tuple[str, ...]:
    """Return in words that OP is late by so many samples (of s), where it is."""
    if samples == 0:
        return ()
    by = f"{given(samples * sample_time, 3)} s ({samples} sample{'s' if samples > 1 else ''})"
    said = (
        f"PV answers the valve before the recorded OP lets it move: OP is recorded up to {by} later than it was sent, "
        "and is taken so much earlier; the dead time is from there on"
    )
    return (said,)
