"""A record as the kernels take it: centred signals, prefix sums, and the search's limits in samples."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from workbench.detect.action import gain_sign
from workbench.detect.causes import constant, refuse_unusable
from workbench.detect.resolution import coarseness, resolved, unseen
from workbench.detect.spikes import without_op_spikes, without_spikes
from workbench.detect.whitening import whitened
from workbench.errors import RecordError
from workbench.estimate.fits.drift import Drift
from workbench.estimate.kernels.output_error import NO_DELAY
from workbench.model.plant import FOPDT, Integrating, Plant
from workbench.model.record import FloatArray, Record

__all__ = ["PURPOSE", "WHITE", "Centred", "Law", "Starts", "centre", "integers", "plant_of", "refuse_unfit"]

WHITE = np.ones(1)
# Lags up to each of which a filter's terms after that at the one before are one, () where each is its own; or noise
# upon a drift.
Law = tuple[int, ...] | Drift
PURPOSE = "estimate a loop"
# What a record can resolve: fits whose rms residual is below this share of PV's standard deviation are equally good.
RESOLUTION = 1e-3


class Starts(NamedTuple):
    """The samples at which the stem may first slip: 0, and where OP exceeds all that was before it; each of shape (M,).

    ranged: %, how far OP had ranged before each, 0 before the first; senses: +1 where OP goes above all, -1 below.
    """

    firsts: NDArray[np.int64]
    ranged: FloatArray
    senses: FloatArray


@dataclass(frozen=True, eq=False)
class Centred:
    """PV and OP less `pv_mean` and `op_middle`, with prefix sums of y, y^2 and y_k y_{k+1}; floor: EU^2 (resolution).

    op_range: OP's peak to peak, %. integrating: the kind of plant that is fitted. sign: of the
    plant's gain, +1 or -1 where the controller's action shows, else 0. a: the filter (1, -a_1, .., -a_p) that leaves
    the disturbance white, (1,) where it is taken to be; target: y filtered by it. skip: the first samples, which do not
    count: they answer to what the stem did before the record. load: EU, shape (N,), what load steps add to PV; y is
    without it. answers: shape (2 steps, N), what it would change by with each step's size and time, up to
    factors: neither is known exactly. law: what the filter's terms come from, see `Law`. doubt: the standard deviation
    of what is not known of OP, %, where it is recorded in steps (see `resolved`), else 0. latest: the last sample at
    which the stem is tried to slip first.
    """

    y: FloatArray
    u: FloatArray
    pv_mean: float
    op_middle: float
    sample_time: float
    integrating: bool
    sums: FloatArray
    squares: FloatArray
    products: FloatArray
    variance: float
    floor: float
    op_range: float
    sign: float
    a: FloatArray
    target: FloatArray
    skip: int
    load: FloatArray
    answers: FloatArray
    doubt: float
    latest: float = math.inf
    law: Law = ()

    @property
    def unsure(self) -> float:
        """The share of slips that what is not known of OP may well move by a sample, at most 1."""
        # OP is in doubt by 1.96 standard deviations to either side, and comes that far in so much of a sample.
        rate = float(np.abs(np.diff(self.u)).mean())
        return min(4.0 * self.doubt / rate, 1.0) if self.doubt > 0.0 else 0.0

    @property
    def moves(self) -> bool:
        """Whether both PV and OP move."""
        return self.op_range > 0.0 and float(np.ptp(self.y)) > 0.0

    @property
    def samples(self) -> int:
        """N."""
        return int(self.y.size)

    @cached_property
    def starts(self) -> Starts:
        """Where the stem may first slip."""
        highs, lows = np.maximum.accumulate(self.u), np.minimum.accumulate(self.u)
        above = self.u[1:] > highs[:-1]
        new = np.flatnonzero(above | (self.u[1:] < lows[:-1]))
        new = new[new + 1 <= self.latest]
        return Starts(
            integers(np.append(0, new + 1)),
            np.append(0.0, (highs - lows)[new]),
            np.where(np.append(True, above[new]), 1.0, -1.0),
        )

    def whitened(self, a: FloatArray, skip: int, law: Law = ()) -> Centred:
        """Return the same record, its disturbance the autoregression that the filter a leaves white."""
        return replace(self, a=a, target=whitened(a, self.y), skip=max(skip, a.size - 1), law=law)

    @property
    def terms(self) -> int:
        """How many parameters the filter has."""
        if isinstance(self.law, Drift):
            return self.law.terms
        return self.a.size - 1 - (self.law[-1] - len(self.law) if self.law else 0)

    def less(self, load: FloatArray, answers: FloatArray) -> Centred:
        """Return the same record without a load, EU, shape (N,), made of some answers, any disturbance white."""
        without = _centred(self.y - load, self.u, self)
        return replace(without, load=self.load + load, answers=np.vstack([self.answers, answers]))

    def thinned(self, every: int) -> Centred:
        """Return one sample of `every` so many, any disturbance white: PV's means about them, OP amid what they span.

        Times in its samples are `every` times shorter; where the loop takes many samples over what it does, little else
        changes.
        """
        at = np.arange(self.samples // every) * every
        begin, stop = np.maximum(at - every // 2, 0), at - every // 2 + every
        means = np.add.reduceat(self.y[: stop[-1]], begin) / (stop - begin)
        thin = _centred(means, self.u[at + every // 2], self)
        return replace(thin, skip=-(-self.skip // every))

    def slipping_by(self, latest: float) -> Centred:
        """Return the same record, in which no stem is tried that first slips after a time, samples."""
        return replace(self, latest=latest)

    def innovations(self, prediction: FloatArray) -> FloatArray:
        """Return what a prediction of y leaves, filtered, without the samples that do not count: shape (N - skip,)."""
        left: FloatArray = whitened(self.a, self.y - prediction)[self.skip :]
        return left

    def part(self, first: int, stop: int) -> Centred:
        """Return the samples [first, stop) alone, centred as the whole, without its load, any disturbance white."""
        return _centred(self.y[first:stop], self.u[first:stop], self)


def _prefix(values: FloatArray) -> FloatArray:
    out = np.zeros(values.size + 1)
    np.cumsum(values, out=out[1:])
    return out


def _centred(y: FloatArray, u: FloatArray, whole: Centred) -> Centred:
    return Centred(
        y=y,
        u=u,
        pv_mean=whole.pv_mean,
        op_middle=whole.op_middle,
        sample_time=whole.sample_time,
        integrating=whole.integrating,
        sums=_prefix(y),
        squares=_prefix(y * y),
        products=_prefix(y[:-1] * y[1:]),
        variance=whole.variance,
        floor=whole.floor,
        op_range=float(np.ptp(u)),
        sign=whole.sign,
        a=WHITE,
        target=y,
        skip=0,
        load=np.zeros(y.size),
        answers=np.empty((0, y.size)),
        doubt=whole.doubt,
    )


def refuse_unfit(record: Record) -> None:
    """Raise `RecordError` where no estimate can begin: too few samples, or PV or OP never moves but for spikes."""
    refuse_unusable(record, PURPOSE)
    _refuse_still(without_spikes(without_op_spikes(record)))


def _refuse_still(record: Record) -> None:
    where, n = record.source or "record", len(record)
    for name, signal in (("PV", record.pv), ("OP", record.op)):
        if constant(signal):
            why = "frozen or saturated" if name == "PV" else "in manual, saturated or frozen"
            msg = f"{where}: {name} is constant ({signal[0]:g}) over all {n} samples ({why}?): nothing to estimate"
            raise RecordError(msg)


def centre(record: Record, plant: str, sent: bool = False) -> Centred:
    """Return a record as the kernels take it.

    sent: the valve got OP in the steps in which it is recorded; else these are the historian's (see `resolved`).

    Raises `RecordError` where nothing can be estimated: PV or OP never moves.
    """
    _refuse_still(record)
    op, doubt = (record.op, 0.0) if sent else resolved(record)
    mean, middle = float(record.pv.mean()), float(0.5 * (op.max() + op.min()))
    y, u = record.pv - mean, op - middle
    variance = float(np.var(y))
    # A quantised PV cannot be followed closer than its own steps allow, nor one that is reported by exception.
    floor = RESOLUTION**2 * variance + max(coarseness(record.pv) ** 2 / 12.0, unseen(record.pv))
    return Centred(
        y=y,
        u=u,
        pv_mean=mean,
        op_middle=middle,
        sample_time=record.sample_time,
        integrating=plant == "integrating",
        sums=_prefix(y),
        squares=_prefix(y * y),
        products=_prefix(y[:-1] * y[1:]),
        variance=variance,
        floor=floor,
        op_range=float(np.ptp(u)),
        sign=gain_sign(record),
        a=WHITE,
        target=y,
        skip=0,
        load=np.zeros(y.size),
        answers=np.empty((0, y.size)),
        doubt=doubt,
    )


def plant_of(data: Centred, gain: float, tau: float, theta: float) -> Plant:
    """Return the plant of a fit whose times are in samples; a gain of 0 becomes the least that a plant may have.

    A fit comes only near to no dead time (``NO_DELAY``): that is none.
    """
    if gain == 0.0 or not np.isfinite(gain):
        gain = 1e-12
    if theta <= NO_DELAY:
        theta = 0.0
    if data.integrating:
        return Integrating(gain / data.sample_time, theta * data.sample_time)
    return FOPDT(gain, tau * data.sample_time, theta * data.sample_time)


def integers(values: object) -> NDArray[np.int64]:
    """Return an int64 array."""
    return np.asarray(values, dtype=np.int64)
