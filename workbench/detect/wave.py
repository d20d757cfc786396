"""A square or triangular load of steady period beside the free linear predictor.

Another loop whose valve sticks sends such a wave. A linear loop answers it with corners that no past of PV and OP
foretells, and a stem that turns a while after OP does may come near enough to them to pass for their cause. A clock
tells the wave's corners; those of the loop's own valve come when OP has moved far enough.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from workbench.detect.predictor import ANSWERS, SAME, FreePredictor
from workbench.model.record import FloatArray

__all__ = ["steady_wave"]

Sort = Callable[[FloatArray], FloatArray]

FINER = 8  # the first frequency against the record's own
ABOUT = 1.25  # PV's period is known to within this factor
PAID = 3  # for period, phase and form, ln N each
CLOSEST = 0.1  # of a sample, over the whole record, to which the period is sought, and corners


def steady_wave(free: FreePredictor, y: FloatArray, period: float) -> float:
    """Return the log likelihood ratio of the prediction of PV (EU, shape (N,)) with and without the best such load.

    period: samples, of PV's oscillation, about which it is sought; four at least, else there is no corner to tell: 0.
    The load has as many answers in PV as a stem has (`FreePredictor.adds`); what it is chosen by is paid for by ln N.
    """
    if not period >= 4.0:
        return 0.0
    frequency, step, part = _frequency(y, period), 0.5 / y.size, 0.0
    near = [frequency - step, frequency, frequency + step]
    best, frequency, sort = max(
        ((_gain(free, f, sort), f, sort) for f in near for sort in (_square, _triangle)), key=lambda found: found[0]
    )
    # Closer and closer: noise aside, what makes one corner a part of a sample late is not what made it.
    apart = 0.5
    while step * y.size > CLOSEST * frequency:
        step /= 2.0
        tried = [(frequency - step, part), (frequency + step, part)]
        if step * y.size <= frequency:
            apart /= 2.0
            tried += [(frequency, part - apart), (frequency, part + apart)]
            tried += [(frequency, 0.5)] if apart == 0.25 else []
        for f, later in tried:
            gain = _gain(free, f, sort, later)
            if gain > best:
                best, frequency, part = gain, f, later
    return best - PAID * math.log(y.size)


def _frequency(y: FloatArray, period: float) -> float:
    """Return the frequency, per sample, of PV's strongest sinusoid about a period."""
    n = FINER * y.size
    power = np.abs(np.fft.rfft((y - y.mean()) * np.hanning(y.size), n))
    lowest, highest = int(n / (ABOUT * period)), int(ABOUT * n / period) + 1
    at = lowest + int(np.argmax(power[lowest:highest]))
    # A window's peak is nearly a parabola in decibels: between its own frequencies it lies a hundred times closer.
    if not 0 < at < power.size - 1 or not min(before := power[at - 1], peak := power[at], after := power[at + 1]) > 0.0:
        return at / n
    before, peak, after = (math.log(one) for one in (before, peak, after))
    bend = before - 2.0 * peak + after
    return (at + (0.5 * (before - after) / bend if bend < 0.0 else 0.0)) / n


def _square(phase: FloatArray) -> FloatArray:
    wave: FloatArray = np.where(phase % 1.0 < 0.5, 1.0, -1.0)
    return wave


def _triangle(phase: FloatArray) -> FloatArray:
    wave: FloatArray = 1.0 - 4.0 * np.abs(phase % 1.0 - 0.5)
    return wave


def _gain(free: FreePredictor, frequency: float, sort: Sort, part: float = 0.0) -> float:
    """Return the best gain over all phases, a sample apart."""
    at = np.flatnonzero(free.live)
    # Later by a sample is the next phase: half a period of phases, the other half is the same turned over.
    many = math.ceil(0.5 / frequency)
    latest = many + ANSWERS - 2
    wave = sort((np.arange(-latest, free.live.size) - part) * frequency)
    waves = free.beside(np.lib.stride_tricks.sliding_window_view(wave, latest + 1)[at, ::-1])
    products = np.empty((many, ANSWERS, ANSWERS))
    for i in range(ANSWERS):
        for j in range(i + 1):
            products[:, i, j] = products[:, j, i] = (waves[:, i : many + i] * waves[:, j : many + j]).sum(axis=0)
    along = np.lib.stride_tricks.sliding_window_view(waves.T @ free.left, ANSWERS)
    trace = np.trace(products, axis1=1, axis2=2)[:, None, None]
    terms = np.linalg.solve(products + (SAME * trace + 1e-300) * np.eye(ANSWERS), along[..., None])[..., 0]
    return free.gain(float((terms * along).sum(axis=1).max()))
