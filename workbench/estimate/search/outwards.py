"""A two-parameter stem followed from a window of a long record outwards to all of it, as slips are added.

A window of a slow loop holds a few slips, which a band some hundredths off explains as well. In all of the record that
band slips at other times, and a search there by small steps ends in one of many stems that are wrong in as many slips.
In twice the window half of the slips are right, and the others say which way to go: so it is doubled, and the stem
placed anew, until the record is all there is. The slips that are right hold for a rectangle of S and J, in which the
one that is right throughout lies too: each time there is less of it to look at, and it is looked at closer.
"""

from __future__ import annotations

import numpy as np

from workbench.estimate.fits.data import Centred
from workbench.estimate.fits.fit import LEAST_TAU, Limits
from workbench.estimate.kernels.path import J_HIGH, J_LOW, S_HIGH, S_LOW, band_path, spans_of
from workbench.estimate.search.nearer import REACHES, SPREADS, closer, nearer, within
from workbench.estimate.search.two_parameter import Band, best_of, best_start, fit_band
from workbench.model.record import FloatArray

__all__ = ["outwards"]

STAYS = 1.02  # times what it left before: a stem that leaves no more needs no search in the whole
# Times what it left in the window: a stem that leaves more has lost its way, unless PV drifts, and one that leaves no
# more in all of the record is right.
LOST, RIGHT = 1.5, 1.2
# Of S: a stem with less of a jump turns wherever OP does, and noise leaves what its slips hold for no width.
JUMPS = 0.1
NARROW = 2  # the spread that is the first from the second doubling on
SLIPS = 20  # from which close walks tell more than steps
# Mean times between slips by which a stem has slipped. One that rests over half of what was added leaves less than one
# that is wrong there in a slip or two, and leads nowhere.
LATEST = 4.0


def outwards(
    data: Centred, window: tuple[int, int], seed: Band, only: float | None, limits: Limits
) -> tuple[list[Band], bool]:
    """Return the stems met in all of the record, and whether the best leaves hardly more there than in the window.

    window: samples [begin, stop) in which seed was found; only: J as a share of S, None for any. No stems where what
    they leave grows too fast.
    """
    met, right = _followed(data, window, seed, only, limits, closely=True)
    if right:
        return met, right
    other, right = _followed(data, window, seed, only, limits, closely=False)
    better = not met or (bool(other) and best_of(other).fit.sse < best_of(met).fit.sse)
    return (other, right) if better else (met, False)


def _followed(
    data: Centred, window: tuple[int, int], seed: Band, only: float | None, limits: Limits, *, closely: bool
) -> tuple[list[Band], bool]:
    """`outwards`: in the rectangle that the slips so far leave, from an early start, or by steps of S and J alone."""
    n, (begin, stop), b, wide = data.samples, window, seed, 0
    first = level = max(seed.fit.sse / (stop - begin), data.floor)
    met, op = list[Band](), data.u[begin:stop]
    while stop - begin < n:
        size = 2 * (stop - begin)
        size = size if 3 * size < 2 * n else n
        begin = max(min((begin + stop - size) // 2, n - size), 0)
        stop = begin + size
        whole = size == n
        part = data if whole else data.part(begin, stop).whitened(data.a, max(data.skip - begin, 0), data.law)
        if closely:
            # As many slips as there were in half of it.
            part = part.slipping_by(LATEST * 0.5 * size / max(b.slips, 1))
        own = limits if whole else Limits((LEAST_TAU, float(size)), (0.0, limits.theta[1]))
        plant = b.fit.tau, min(b.fit.theta, limits.theta[1])
        met = [fit_band(part, b.S, b.J, best_start(part, (b.S, b.J), plant)[1:], own, plant, 40)]
        unsure = not whole or met[0].fit.sse / size > STAYS * level
        if unsure and closely:
            met += within(part, met[0], _right(op, b), only, own)
            best = best_of(met)
            unsure = best.J < JUMPS * best.S or best.fit.sse / size > STAYS * level
        if unsure:
            met += nearer(part, best_of(met), SPREADS[wide:], only, own)
            for reach in REACHES if best_of(met).slips >= SLIPS and not whole else ():
                met += closer(part, best_of(met), reach, 0.05 * reach[0], only, own)[0]
        b, wide, op = best_of(met), min(wide + 1, NARROW), part.u
        level = max(b.fit.sse / size, data.floor)
        if level > LOST * first:
            return [], False
    return met, level <= RIGHT * first


def _right(op: FloatArray, b: Band) -> tuple[float, float, float, float]:
    """The rectangle (S from, to, J from, to) in which stems slip along OP as one does."""
    box = np.empty(4)
    band_path(op, spans_of(op), b.S, b.J, b.first, b.sense, np.empty(op.size), box)
    low, high, least, most = box[[S_LOW, S_HIGH, J_LOW, J_HIGH]].tolist()
    return low, high, least, most
