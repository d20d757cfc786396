"""The stem test's compiled part: stems, whitened, drive lags that are fitted to whitened PV by least squares.

Stems, or time constants, are many: LANES of them run side by side (see `lags`).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from workbench.detect.lags import (
    ABREAST,
    BEST,
    DELAY_AT,
    ID,
    KINDS,
    LANES,
    POLE_AT,
    SE,
    SEE,
    SYE,
    P,
    fade,
    gather,
    one_tap,
    two_taps,
)
from workbench.detect.whitening import four_taps, noise, run_filter, whiten
from workbench.simulate.compiled import compiled, copy, specialised
from workbench.simulate.kernel import STAIRS, TWO_PARAMETER, valve_step

__all__ = ["plant", "screen", "settle", "stems_abreast"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

# Where each number of the lanes begins: of a stem the leads at which it slips and that it keeps, position and motion,
# and the first position.
_BAND, _OFFSET, _X, _MOTION, _X0 = range(0, 5 * LANES, LANES)
SPREADS = (1.25, 1.08, 1.03)  # refinement of the time constant, the dead time by whole samples beside it
STEPS = 12  # at most, at each of them
NEAR = 6  # dead times looked at at once there


@specialised
def _stems(kind: int, u: Floats, stems: Floats, x: Floats) -> None:
    """Write the moves of LANES stems away from where they are in sample 0, `x[k LANES + j]`; at rest before it."""
    u_last = u[0]
    for k in range(u.size):
        now, row = u[k], x[k * LANES : (k + 1) * LANES]
        for j in range(LANES):
            band, offset = stems[_BAND + j], stems[_OFFSET + j]
            motion = 0 if kind == STAIRS else int(stems[_MOTION + j])
            at, motion = valve_step(kind, band, offset, band, offset, now, u_last, stems[_X + j], motion)
            stems[_X + j], stems[_MOTION + j] = at, motion
        if k == 0:
            copy(stems[_X : _X + LANES], stems[_X0 : _X0 + LANES])
        for j in range(LANES):
            row[j] = stems[_X + j] - stems[_X0 + j]
        u_last = now


@compiled
def stems_abreast(kind: int, u: Floats, laws: Floats, stems: Floats, x: Floats) -> None:
    """Write the moves of up to LANES stems, x[k LANES + j], N LANES in all, as `valve_path` has them.

    kind: STAIRS or TWO_PARAMETER; laws: rows (lead u - x at which it slips, lead that it keeps while it moves, lead at
    the start, at rest); lanes without one have the last. stems: 5 LANES of room.
    """
    for j in range(LANES):
        i = min(j, laws.shape[0] - 1)
        stems[_BAND + j], stems[_OFFSET + j] = laws[i, 0], laws[i, 1]
        stems[_X + j], stems[_MOTION + j] = u[0] - laws[i, 2], 0.0
    if kind == STAIRS:
        _stems(STAIRS, u, stems, x)
    else:
        _stems(TWO_PARAMETER, u, stems, x)


@compiled
def _counted(
    target: Floats, live: Bools, first: int, longest: int
) -> tuple[Floats, Floats, bool, tuple[float, float, float]]:
    """Return what `gather` takes of PV: t and weight, whether all samples from `first` on count, and PV's sums."""
    n = target.size
    t, weight = np.zeros(n + longest + 8), np.zeros(n + longest + 8)
    count, sy, syy = 0, 0.0, 0.0
    for k in range(first, n):
        if live[k]:
            t[k], weight[k] = target[k], 1.0
            count += 1
            sy += target[k]
            syy += target[k] * target[k]
    return t, weight, count == n - first, (float(count), sy, syy)


@compiled
def screen(
    kind: int,
    u: Floats,
    laws: Floats,
    a: Floats,
    target: Floats,
    live: Bools,
    poles: Floats,
    first: int,
    delays: Ints,
    sign: float,
    best: Floats,
) -> None:
    """Write for each valve i the least sum of squares over a grid of plants that its stem drives, best[i].

    kind, laws: of `stems_abreast`, u: OP, (N,); a: the filter that whitens the stems, target: PV whitened, (N,); live:
    the samples that count, from `first` on; poles, delays (ascending): the grid; sign: that the gain must have, or 0. A
    constant and a transient with the plant's pole are free.
    """
    n, count = target.size, laws.shape[0]
    taps = four_taps(a)
    before = (taps.size - 1) * LANES
    t, weight, whole, pv = _counted(target, live, first, delays[-1])
    e = np.zeros(0 if whole else t.size * LANES)
    x, w, stems, st = np.zeros(before + n * LANES), np.zeros((n + 3) * LANES), np.empty(5 * LANES), np.zeros(ABREAST)
    sums = np.empty(KINDS * delays.size * LANES)
    fades = np.empty((poles.size, 3))
    for i in range(poles.size):
        st[P : P + LANES] = poles[i]
        fade(t, weight, first, n, st, e[:0])
        fades[i, 0], fades[i, 1], fades[i, 2] = st[SE], st[SEE], st[SYE]
    for begin in range(0, count, LANES):
        stems_abreast(kind, u, laws[begin : begin + LANES], stems, x[before:])
        run_filter(taps, x, LANES, w[: n * LANES])
        st[BEST : BEST + LANES] = np.inf
        for i in range(poles.size):
            st[P : P + LANES], st[ID : ID + LANES] = poles[i], i
            if whole:
                st[SE : SE + LANES], st[SEE : SEE + LANES], st[SYE : SYE + LANES] = (
                    fades[i, 0],
                    fades[i, 1],
                    fades[i, 2],
                )
            else:
                fade(t, weight, first, n, st, e)
            gather(w, t, weight, e, first, delays, st, sums)
            one_tap(sums, delays.size, pv, sign, st)
        for j in range(min(LANES, count - begin)):
            best[begin + j] = st[BEST + j]


@compiled
def plant(
    y: Floats,
    x: Floats,
    a: Floats,
    live: Bools,
    first: int,
    taus: Floats,
    delays: Ints,
    sign: float,
    longest: float,
    residual: Floats,
) -> tuple[float, float, int]:
    """Fit a lag driven by x to PV, the gain shared by two neighbouring dead times, and write what it leaves of PV.

    y, x: PV and the drive, (N,), measured as the filter a whitens them; live, first, sign: as in `screen`. Begins with
    the best of a grid, taus and delays (ascending), samples, and goes on to time constants of up to `longest` and dead
    times up to the grid's last. Returns the least sum of squares, time constant and dead time (the shorter of the two).
    """
    n, end = y.size, delays[-1]
    target, drive, moves = np.empty(n), np.empty(n), x - x[0]
    whiten(a, y, target)
    whiten(a, moves, drive)
    t, weight, whole, pv = _counted(target, live, first, end + 1)
    e = np.zeros(0 if whole else t.size * LANES)
    w, st = np.zeros((n + 3) * LANES), np.zeros(ABREAST)
    for k in range(n):
        w[k * LANES : (k + 1) * LANES] = drive[k]
    sums = np.empty(KINDS * max(delays.size, NEAR) * LANES)
    least, tau, delay = np.inf, taus[0], delays[0]
    for begin in range(0, taus.size, LANES):
        for j in range(LANES):
            st[ID + j] = min(begin + j, taus.size - 1)
            st[P + j] = math.exp(-1.0 / taus[int(st[ID + j])])
        st[BEST : BEST + LANES] = np.inf
        fade(t, weight, first, n, st, e)
        gather(w, t, weight, e, first, delays, st, sums)
        one_tap(sums, delays.size, pv, sign, st)
        for j in range(LANES):
            if st[BEST + j] < least:
                least, tau, delay = st[BEST + j], taus[int(st[POLE_AT + j])], delays[int(st[DELAY_AT + j])]
    least, g0, g1 = np.inf, 0.0, 0.0
    trials = np.empty(LANES)
    for spread in SPREADS:
        low, high, lane = 0, -1, 0
        for _ in range(STEPS):
            before, middle = least, delay
            if not (0 < lane < LANES - 1 and low <= max(middle - 1, 0) and min(middle + 1, end) <= high):
                low, high, lane = max(middle - 2, 0), min(middle + 2, end), LANES // 2
                centre = tau
                for j in range(LANES):
                    trials[j] = min(centre * spread ** (j - lane), longest)
                    st[P + j] = math.exp(-1.0 / trials[j])
                near = np.arange(low, high + 2)
                fade(t, weight, first, n, st, e)
                gather(w, t, weight, e, first, near, st, sums)
                one_tap(sums, near.size, pv, sign, st)
            at = lane
            for j in range(at - 1, at + 2):
                for d in range(max(middle - 1, 0), min(middle + 1, end) + 1):
                    cost, h0, h1 = two_taps(sums, near.size, d - low, j, pv, sign, st)
                    if cost < least:
                        least, tau, delay, g0, g1, lane = cost, trials[j], d, h0, h1, j
            if not least < before:
                break
    pole = math.exp(-1.0 / tau)
    lag, last = 0.0, 0.0
    copy(y[:delay], residual[:delay])
    for k in range(delay, n):
        residual[k] = y[k] - (g0 * lag + g1 * last)
        last = lag
        lag = pole * lag + (1.0 - pole) * moves[k - delay]
    return least, tau, delay


@compiled
def settle(
    y: Floats,
    x: Floats,
    a: Floats,
    live: Bools,
    order: int,
    taus: Floats,
    delays: Ints,
    sign: float,
    longest: float,
    rounds: int,
    filters: Floats,
    residuals: Floats,
) -> tuple[int, float, float, int]:
    """Fit plant and autoregression in turn, `rounds` times; return the best round, its variance, tau and dead time.

    a: the filter to begin with. Written, a row for each round: filters, (rounds, order + 1), residuals, (rounds, N).
    All else as in `plant`.
    """
    best, least, tau, delay = 0, np.inf, 0.0, 0
    for i in range(rounds):
        _, trial, at = plant(y, x, a, live, order, taus, delays, sign, longest, residuals[i])
        variance = noise(residuals[i], live, order, math.exp(-1.0 / trial), filters[i])
        a = filters[i]
        if i == 0 or variance < least:
            best, least, tau, delay = i, variance, trial, at
    return best, least, tau, delay
