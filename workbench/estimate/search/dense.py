"""A dense grid of two-parameter stems (S, J), walked at a few plants and from a few starts.

The grid of `two_parameter.look` is coarse, as each of its stems has all plants to choose from, and a walk from it takes
the plant of the stem that it begins with. A sequence of slips may hold for a few hundredths of S and of J only: it is
met by neither where the best stem of the grid goes with a plant far from the truth. Here the stems lie close together
and the plants far apart: with the right slips PV is explained well at a dead time some samples off.
"""

from __future__ import annotations

import math

import numpy as np

from workbench.estimate.fits.data import Centred
from workbench.estimate.fits.fit import LEAST_TAU, Limits
from workbench.estimate.fits.windows import EXACT
from workbench.estimate.search.two_parameter import (
    USUAL,
    WIDE,
    WIDEST,
    Band,
    Line,
    Seed,
    best_start,
    bests,
    differs,
    fit_band,
    walked,
)
from workbench.model.record import FloatArray

__all__ = ["densely", "densely_about"]

NARROWEST = 0.05  # of OP's range: the least S
STEPS = (0.02, 0.025)  # of S: how far apart the values of S are, up to `WIDE` of OP's range and from there on
JUMPS, JUMP = 1.36, (0.056, 0.08)  # of S: the largest J, the least and the largest step of J
DELAYS = (0.5, 2.0, 5.0, 10.0, 20.0)  # samples
FURTHER = 1.6  # times the longest of these, and so on, where longer ones than usual are asked for
LAGGED, LEAST_LAG = 0.9, 0.2  # of time constant and dead time together: the longest dead time, the least time constant
RANGED = (0.05, 0.8)  # of OP's range: how far OP has ranged before a start that is tried,
WITHIN = (0.3, 1.8)  # and of S
ABOUT = 0.1  # of S: how far a grid goes about a stem
SEEDS = 8  # stems that get their own plant


def densely(data: Centred, coarse: list[Band], longest: float) -> tuple[Band, ...]:
    """Return the best stems of a dense grid of (S, J) that differ, each with its own plant, dead time up to `longest`.

    coarse: what `two_parameter.look` found, the best first; none is found of a record that is too long to be looked at
    as it is, nor where that found none.
    """
    if not coarse or data.samples > EXACT:
        return ()
    return _best(data, _lines(data, _plants(data, coarse[0], longest), _widths(data)), longest)


def densely_about(data: Centred, b: Band, longest: float) -> tuple[Band, ...]:
    """Return the same of a grid about a stem that is right but for its jump or start, at its own plant."""
    widths = b.S * np.exp(np.arange(-ABOUT, 1.001 * ABOUT, STEPS[0]))
    return _best(data, _lines(data, [(b.fit.tau, b.fit.theta)], widths), longest)


def _best(data: Centred, lines: list[Line], longest: float) -> tuple[Band, ...]:
    """The best stems of some lines that differ, each with its own plant and the start that suits it."""
    chosen: list[Seed] = []
    for _, seed in sorted(bests(lines, walked(data, lines))):
        if len(chosen) < SEEDS and differs(seed, chosen):
            chosen.append(seed)
    limits = Limits((LEAST_TAU, float(data.samples)), (0.0, longest))
    found = []
    for S, J, *plant in chosen:
        tau, theta = plant
        start = best_start(data, (S, J), (tau, theta))[1:]
        found.append(fit_band(data, S, J, start, limits, (tau, theta), 60, 1e-5))
    return tuple(b for b in found if b.slips > 0 and b.fit.gain != 0.0)


def _plants(data: Centred, best: Band, longest: float) -> list[tuple[float, float]]:
    """Rows (tau, theta) in samples, with the lag of time constant and dead time together that the best stem has.

    Which of them makes up the lag is what a stem with wrong slips gets wrong.
    """
    lag = best.fit.tau + best.fit.theta
    further = [DELAYS[-1] * FURTHER**i for i in range(1, 20)] if longest > USUAL else []
    delays = [d for d in (*DELAYS, *further) if d <= longest and (data.integrating or d <= LAGGED * lag)]
    return [(max(lag - d, LEAST_LAG * lag, LEAST_TAU), d) for d in delays or [0.0]]


def _widths(data: Centred) -> FloatArray:
    """The values of S of the grid, %."""
    narrow, wide = (
        np.exp(np.arange(math.log(low), math.log(high), step))
        for low, high, step in ((NARROWEST, WIDE, STEPS[0]), (WIDE, WIDEST, STEPS[1]))
    )
    return data.op_range * np.concatenate([narrow, wide])


def _lines(data: Centred, plants: list[tuple[float, float]], widths: FloatArray) -> list[Line]:
    """The lines along J at each S, for each plant and start: at rest in the middle of the band, or at a slip known."""
    starts = _starts(data)
    lines = []
    for S in widths.tolist():
        end = min(JUMPS * S, 2.0 * data.op_range - S)
        slipped = [(first, sense) for first, sense, ranged in starts if WITHIN[0] * S <= ranged <= WITHIN[1] * S]
        for start in [(-1, 0.0), *slipped]:
            lines += [Line((S, 0.0), 1, end, (JUMP[0] * S, JUMP[1] * S), start, plant) for plant in plants]
    return lines


def _starts(data: Centred) -> list[tuple[int, float, float]]:
    """(first, sense, how far OP had ranged, %) at either end of each stretch in which OP goes beyond all one way.

    A stem that slips within such a stretch goes on with OP and is at its end where one is that slips at its end.
    """
    firsts, ranged, senses = (column[1:] for column in data.starts)
    turns = senses[1:] != senses[:-1]
    ends = np.append(True, turns) | np.append(turns, True)
    low, high = (share * data.op_range for share in RANGED)
    kept = np.flatnonzero(ends[: firsts.size] & (low <= ranged) & (ranged <= high)).tolist()
    return [(int(firsts[i]), float(senses[i]), float(ranged[i])) for i in kept]
