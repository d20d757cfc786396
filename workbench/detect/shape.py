"""The shape of the cycle: triangle or sine (He), and moves of OP that PV does not answer (Yamashita)."""

from __future__ import annotations

import math

import numpy as np

from workbench.model.record import FloatArray

__all__ = ["TRIANGLES", "UNANSWERED", "movement_index", "triangle_index"]

TRIANGLES = (0.4, 0.6)  # up to the first no stiction, from the second on stiction, as published
UNANSWERED = 0.25  # rho_1 and rho_3 of random moves: two of the eight codes with a move; more is stiction, as published
FEWEST = 6  # samples of half a period that show a shape
STEADY = 0.5  # of the mean size of moves: less is no move


def triangle_index(signal: FloatArray) -> float:
    """Return He's stiction index of an oscillating signal, shape (N,): near 1 triangles, near 0 sinusoids.

    For each stretch between zero crossings the mean squared error of a half sine and of two straight lines that meet at
    the peak, both fitted by least squares; with their means over the stretches `index = MSE_sine/(MSE_sine +
    MSE_triangle)`: from 0.6 on stiction, up to 0.4 none (Q.P. He, J. Wang, M. Pottmann, S.J. Qin, "A curve fitting
    method for detecting valve stiction in oscillating control loops", Ind. Eng. Chem. Res. 46 (2007) 4549-4560). Taken
    of OP for a self-regulating plant and of PV for an integrating one: what comes out of the first integrator after the
    valve. nan where no half period has six samples.
    """
    x = signal - signal.mean()
    ends = np.flatnonzero((x[:-1] > 0.0) != (x[1:] > 0.0)) + 1
    sine, triangle = 0.0, 0.0
    for first, stop in zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True):
        half = np.abs(x[first:stop])
        if half.size < FEWEST:
            continue
        at = (np.arange(half.size) + 0.5) / half.size
        arch = np.sin(math.pi * at)
        sine += float(((half - arch * (half @ arch) / (arch @ arch)) ** 2).mean())
        # Of the two lines that meet at each sample, their product with the stretch and their own square.
        peaks, falls = at[1:-1], 1.0 - at
        along = _up_to(half * at) / peaks + _beyond(half * falls) / (1.0 - peaks)
        power = _up_to(at**2) / peaks**2 + _beyond(falls**2) / (1.0 - peaks) ** 2
        triangle += max(float(half @ half) - float((along**2 / power).max()), 0.0) / half.size
    return sine / (sine + triangle) if sine + triangle > 0.0 else math.nan


def _up_to(values: FloatArray) -> FloatArray:
    """Sums of the values up to each but the first and the last."""
    return np.cumsum(values)[1:-1]


def _beyond(values: FloatArray) -> FloatArray:
    """Sums of the values after each but the first and the last."""
    return np.cumsum(values[::-1])[::-1][2:]


def movement_index(pv: FloatArray, op: FloatArray, step: int) -> tuple[float, float]:
    """Return Yamashita's indices (rho_1, rho_3) of OP against PV: shares of time, above 0.25 stiction.

    Moves over `step` samples are coded I, S or D (up, steady, down) by half of their mean size (the published method
    leaves that limit to its user). rho_1: the share of
    times with OP moving and PV steady (IS, DS) of all that are not steady in both; rho_3: less those that the next
    code contradicts, a stem that sets off against OP or at once falls asleep (ISDD, ISDI, ISSD, ISID, ISDS and the
    mirrored DSII, DSID, DSSI, DSDI, DSIS) (Y. Yamashita, "An automatic method for detection of valve stiction in
    process control loops", Control Engineering Practice 14 (2006) 503-510). Meant for flow loops, where PV stands for
    the stem. (nan, nan) where nothing moves.
    """
    if pv.size < 3 * step:
        return math.nan, math.nan
    codes = []
    for signal in (op, pv):
        # The mean over the step quiets noise without hiding the moves.
        means = signal[: signal.size // step * step].reshape(-1, step).mean(axis=1)
        moves = np.diff(means)
        size = float(np.abs(moves - moves.mean()).mean())
        codes.append(np.where(np.abs(moves) <= STEADY * size, 0, np.sign(moves)).astype(int))
    u, y = codes
    moving = (u != 0) | (y != 0)
    total = int(moving.sum())
    if total == 0:
        return math.nan, math.nan
    stuck = (u != 0) & (y == 0)
    du, dy = u[1:] * u[:-1], y[1:] * u[:-1]
    contradicted = stuck[:-1] & (
        ((du == -1) & (dy != 0)) | ((du == 0) & (dy == -1)) | ((du == 1) & (dy == -1)) | ((du == -1) & (dy == 0))
    )
    return float(stuck.sum()) / total, float(stuck.sum() - contradicted.sum()) / total
