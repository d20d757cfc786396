"""A rectangular or triangular load of steady period beside the free linear predictor.

Another loop whose valve sticks sends such a wave, of halves that are alike; a heater that is switched, or a tank that
is filled by turns, one whose halves are not. A linear loop answers it with corners that no past of PV and OP
foretells, and a stem that turns a while after OP does may come near enough to them to pass for their cause. A clock
tells the wave's corners; those of the loop's own valve come when OP has moved far enough.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from workbench.detect.predictor import ANSWERS, SAME, FreePredictor
from workbench.model.record import FloatArray

__all__ = ["steady_wave", "uneven_wave"]

Sort = Callable[[FloatArray], FloatArray]  # of the phase, turns

FINER = 8  # the first frequency against the record's own
ABOUT = 1.25  # PV's period is known to within this factor
PAID = 3  # for period, phase and form, ln N each
CLOSEST = 0.1  # of a sample, over the whole record, to which the period is sought, and corners
MOST = 60  # places in a turn at which the corners of an uneven wave are looked for at first
NEAR = np.array([-1.0, 0.0, 1.0])


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


def uneven_wave(free: FreePredictor, y: FloatArray, period: float) -> tuple[float, float]:
    """Return the same of a load whose halves are not alike, the place of its second corner paid for by ln N too.

    Second, the same of the wave in OP's place, for stems that take it there.
    """
    if not period >= 4.0:
        return 0.0, 0.0
    frequency, step = _frequency(y, period), 0.5 / y.size
    apart = float(math.ceil(1.0 / frequency / MOST))
    places = np.arange(0.0, 1.0 / frequency, apart)
    best, first, second, sort = max(
        ((*_cornered(free, frequency, sort, places, places), sort) for sort in (_jump, _kink)), key=lambda one: one[0]
    )
    while step * y.size > CLOSEST * frequency or apart > 0.5:
        step, apart = step / 2.0, max(apart / 2.0, 0.25)
        for f in (frequency - step, frequency, frequency + step):
            gain, one, other = _cornered(free, f, sort, first + apart * NEAR, second + apart * NEAR)
            if gain > best:
                best, frequency, first, second = gain, f, one, other
    paid = (PAID + 1) * math.log(y.size)
    at = np.arange(float(y.size)) - free.first - free.live.size // 2
    wave = sort((at - first) * frequency) - sort((at - second) * frequency)
    return best - paid, max(best, free.instead(wave)) - paid


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


def _jump(phase: FloatArray) -> FloatArray:
    """A leap once a turn, and even slopes between: of two the slopes cancel, and a rectangle is left."""
    wave: FloatArray = 0.5 - phase % 1.0
    return wave


def _kink(phase: FloatArray) -> FloatArray:
    """A corner once a turn, and even bends between: of two the bends cancel, and a triangle is left."""
    at = phase % 1.0
    wave: FloatArray = at * (at - 1.0)
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
    return free.gain(float(_explained(products, along).max()))


def _explained(products: FloatArray, along: FloatArray) -> FloatArray:
    """What the answers of waves explain, EU^2, shape (M,), by their products, (M, ANSWERS, ANSWERS), and with PV."""
    trace = np.trace(products, axis1=1, axis2=2)[:, None, None]
    terms = np.linalg.solve(products + (SAME * trace + 1e-300) * np.eye(ANSWERS), along[..., None])[..., 0]
    explained: FloatArray = (terms * along).sum(axis=1)
    return explained


def _cornered(
    free: FreePredictor, frequency: float, sort: Sort, ones: FloatArray, others: FloatArray
) -> tuple[float, float, float]:
    """Return the best gain of a wave that turns at one of `ones` and one of `others`, samples, and the two."""
    at = np.flatnonzero(free.live) - free.live.size // 2
    later = np.arange(float(ANSWERS))
    places, where = np.unique(
        np.concatenate([np.add.outer(ones, later), np.add.outer(others, later)]), return_inverse=True
    )
    waves = free.beside(sort((at[:, None] - places) * frequency))
    products, along = waves.T @ waves, waves.T @ free.left
    where = where.reshape(-1, ANSWERS)
    i, k = np.nonzero(np.abs(np.subtract.outer(ones, others)) >= 1.0)
    first, second = where[i], where[ones.size + k]

    def of(a: NDArray[np.intp], b: NDArray[np.intp]) -> FloatArray:
        both: FloatArray = products[a[:, :, None], b[:, None, :]]
        return both

    # Of differences: what turns at the one less what turns at the other.
    squares = of(first, first) + of(second, second) - of(first, second) - of(second, first)
    explained = _explained(squares, along[first] - along[second])
    best = int(np.argmax(explained))
    return free.gain(float(explained[best])), float(ones[i[best]]), float(others[k[best]])
