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
PARTS = (0.33, 0.67)  # of a sample, between which corners may lie


def steady_wave(free: FreePredictor, y: FloatArray, period: float) -> float:
    """Return the log likelihood ratio of the prediction of PV (EU, shape (N,)) with and without the best such load.

    period: samples, of PV's oscillation, about which it is sought; four at least, else there is no corner to tell: 0.
    The load has as many answers in PV as a stem has (`FreePredictor.adds`); what it is chosen by is paid for by ln N.
    """
    if not period >= 4.0:
        return 0.0
    frequency, step = _frequency(y, period), 0.5 / y.size
    near = [frequency - step, frequency, frequency + step]
    best, frequency, sort = max(
        ((_gain(free, f, sort), f, sort) for f in near for sort in (_square, _triangle)), key=lambda found: found[0]
    )
    # Closer and closer, until no corner is a sample off.
    while step * y.size > 0.5 * frequency:
        step /= 2.0
        for tried in (frequency - step, frequency + step):
            gain = _gain(free, tried, sort)
            if gain > best:
                best, frequency = gain, tried
    best = max([best, *(_gain(free, frequency, sort, part) for part in PARTS)])
    return best - PAID * math.log(y.size)


def _frequency(y: FloatArray, period: float) -> float:
    """Return the frequency, per sample, of PV's strongest sinusoid about a period."""
    n = FINER * y.size
    power = np.abs(np.fft.rfft((y - y.mean()) * np.hanning(y.size), n))
    lowest, highest = int(n / (ABOUT * period)), int(ABOUT * n / period) + 1
    return (lowest + int(np.argmax(power[lowest:highest]))) / n


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
