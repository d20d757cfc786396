"""Unmeasured load steps: when PV takes a lasting change that no stem explains, and how much of PV that is.

A step at the plant's input is told from a coloured disturbance by its likelihood: what is left of PV with it and its
own autoregression must be worth more by BIC than with an autoregression alone, and hardly be coloured (G. Box, G. Tiao,
"Intervention analysis", J. Am. Stat. Assoc. 70 (1975) 70-79; the search for its time after R. Tsay, "Outliers, level
shifts, and variance changes in time series", J. Forecasting 7 (1988) 1-20).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize

from workbench.detect.whitening import whitened
from workbench.estimate.fits.data import WHITE, Centred
from workbench.estimate.fits.fit import LOUD, Fit, Limits, autoregression, fit_path, grown, predict
from workbench.estimate.fits.sureness import NORMAL, inflation
from workbench.estimate.fits.windows import WHOLE
from workbench.estimate.kernels.beside import left_beside
from workbench.estimate.loads.drifting import drifting_bic
from workbench.model.loads import LoadStep
from workbench.model.record import FloatArray

__all__ = ["CLEAR", "DEGREES", "SHIFT", "Loads", "Stem", "loads_of", "steps_of"]

TURNS = 6  # of least squares and output error in turn, at most
STILL = 1e-4, 1e-3  # of the time constant, and samples of dead time: a plant that moved less in a turn stays
# A step must have a share of the record on either side, and no more than so many samples: these tell PV's level,
# however long the record goes on.
LEAST, ENOUGH = 0.02, 20
# A step has a size and a time, and the time is found by a search: three degrees (N. Zhang, D. Siegmund, "A modified
# Bayes information criterion", Biometrics 63 (2007) 22-32). Beyond these "very strong" evidence (Kass, Raftery 1995).
DEGREES, CLEAR = 3, 10.0
# A load that drifts looks like steps too, but what these leave of it is as coloured as before. The sum of the
# autocorrelation must in the end fall to WHITER of what it was and below WHITE_ENOUGH, or to what noise alone has: of
# 400 records of 1,000 samples of noise about nine in ten are below NOISE. Single steps in noise pass that by far (a
# hundredth), of 15 drifts two came to .3 and .4 and the others to .6 and more.
WHITER, WHITE_ENOUGH, NOISE = 0.4, 5.0, 1.2
SPREADS, EVALUATIONS = (0.03, 0.01, -0.01, 0.003), 120  # of a valve's and plant's parameters, in turn
PLACINGS, WITHIN = 4, 1.5  # of a step's time, each by what the one before says; samples, by which it may be off then
SLIPPED = 3  # samples about a step and the plant's dead time before it: a first slip that it may have been taken for
# Of its power: a step's answer that the other columns leave less of is theirs; rounding leaves some 1e-14. Of a level,
# the first of thousands of samples are little.
APART = 1e-9
SHIFT = 0.05  # a move of a dead time by one sample counts as that of a parameter by this share

Valve = tuple[float, float, int, float]  # S, J, %, and the stem's start, first and sense; J nan for Stenman's of d = S


@dataclass(frozen=True, eq=False)
class Loads:
    """What load steps add to PV, EU, shape (N,), what the model leaves beside them, and the steps themselves.

    answers: shape (2 steps, N), what PV changes by with each step's size, and with its time, up to factors. beside: the
    valve and start of the stem that they were found beside, as moved with them (see `Stem`), and its plant.
    """

    pv: FloatArray
    answers: FloatArray
    left: FloatArray
    steps: tuple[LoadStep, ...]
    beside: tuple[Valve, Fit] | None = None


@dataclass(frozen=True, eq=False)
class Stem:
    """A stem path x, shape (N,), its first slip, the plant fitted to it, and the paths of valves near its own.

    near: the path of the same stem with S (or d) and J multiplied by two factors; None where the plant stays as it is.
    free: the first so many of these factors make a difference. valve: None of OP itself.
    times: samples at which PV begins to answer load steps, where it was found beside such. begun: the same stem with
    another first slip, of that sense.
    """

    x: FloatArray
    first: int
    fit: Fit
    near: Callable[[float, float], FloatArray] | None = None
    free: int = 0
    times: tuple[int, ...] = ()
    valve: Valve | None = None
    begun: Callable[[int, float], Stem] | None = None


def loads_of(
    data: Centred,
    lead: Stem,
    limits: Limits,
    skip: int,
    most: int,
    further: Callable[[tuple[int, int]], Sequence[Stem]] | None = None,
    strict: bool = True,
    others: Sequence[Stem] = (),
) -> Loads:
    """Return the load steps in a record that no stem explains, `most` at most; data: with no load removed.

    lead: the stem that explains most without steps. skip: the first samples that do not count. further: stems found
    beside steps in a span of samples, asked for where what the lead leaves is coloured. strict: what is left beside the
    steps must be nearly white; a stem that is not yet quite known leaves errors that are not. others: stems that
    explain nearly as much as the lead, which may have made up for a step. The model is fitted anew beside the steps.
    """
    n = data.samples
    nothing = Loads(np.zeros(n), np.empty((0, n)), np.zeros(n), ())
    least = min(int(LEAST * n), ENOUGH)
    span = (skip + max(least, 3), n - max(least, 8))
    if n > WHOLE or most == 0 or span[1] - span[0] <= 8 or lead.fit.gain == 0.0:
        return nothing
    bare = _beside(data, lead.x, lead.first, lead.fit, limits, skip, [])
    # Where it is hardly coloured (see WHITER) the lead is not far from right.
    coloured = bare.a.size > 1

    def explained(stem: Stem, alone: _Model) -> list[tuple[_Model, Stem]]:
        one = _explained(data, stem, alone, limits, skip, span, most, strict)
        return [] if one is None else [one]

    def also(stems: Sequence[Stem]) -> list[tuple[_Model, Stem]]:
        alone = (_beside(data, s.x, s.first, s.fit, limits, skip, []) for s in stems)
        return [one for s, model in zip(stems, alone, strict=True) for one in explained(s, model)]

    found = [*explained(lead, bare), *also(others)]
    # Slips that leave noise alone beside steps are the right ones; what a wrong dead band leaves, its plant takes.
    slips = (model.a.size == 1 and s.near is not None and (s.valve is None or s.valve[1] != 0.0) for model, s in found)
    if further is not None and coloured and not any(slips):
        found += also(further(span))
    model, stem = min(found, key=lambda one: one[0].bic, default=(None, lead))
    # Steps beside a worse stem explain nothing that the first one does not by itself.
    if model is None or model.bic > bare.bic - CLEAR:
        return nothing
    if lead.valve is not None and data.doubt == 0.0:
        # Nor what a load that drifts explains as well; what OP's own steps hide of it drifts, too.
        near = [(one.tau, one.theta) for one in (lead.fit, model.fit)]
        if model.bic > drifting_bic(data, lead.x, lead.first, near, limits, skip) - CLEAR:
            return nothing
    gain, errors = float(model.terms[1]), _errors(model, skip)
    steps = []
    for i, (at, later) in enumerate(zip(model.times, model.later, strict=True)):
        size, half = float(model.terms[4 + i]) / gain, NORMAL * float(errors[4 + i]) / abs(gain)
        answered = (at + min(max(later, -1.0), 1.0)) * data.sample_time
        steps.append(LoadStep(answered, size, (size - half, size + half)))
    valve = stem.valve
    beside = None
    if valve is not None:
        beside = (valve[0] * model.wider, valve[1] * model.further, valve[2], valve[3]), model.fit
    sized = model.columns[4 : 4 + len(steps)]
    answers = np.vstack([sized, np.diff(sized, prepend=0.0)])
    return Loads(model.load, answers, model.left, tuple(sorted(steps, key=lambda step: step.at)), beside)


def _explained(
    data: Centred, stem: Stem, model: _Model, limits: Limits, skip: int, span: tuple[int, int], most: int, strict: bool
) -> tuple[_Model, Stem] | None:
    """The model of one stem with the load steps that it needs, or None where it needs none (see `loads_of`).

    model: without any. With it the stem, whose first slip may be another.
    """
    x, first, fit = stem.x, stem.first, stem.fit
    coloured = inflation(model.left[skip:])
    come_to = {model.times: model.bic}
    while len(model.times) < most:
        measures = [WHITE] if model.a.size == 1 else [model.a, WHITE]
        likely = {_likeliest(data, model, measure, span, skip) for measure in measures}
        times = [[*model.times, at] for at in sorted(likely)] + (
            [[*stem.times]] if stem.times and not model.times else []
        )
        trials = [_beside(data, x, first, model.fit, limits, skip, those) for those in times]
        trial = min(trials, key=lambda t: t.bic)
        if trial.bic < model.bic - CLEAR:
            trial = _needed(data, _placed(data, trial, limits, skip, span), limits, skip)
        trial = replace(trial, wider=model.wider, further=model.further)
        if not trial.bic < model.bic - CLEAR or trial.terms[1] * fit.gain <= 0.0:
            break
        moved = _refined(data, stem, trial, limits, skip)
        # What leaves less of PV may be more coloured: a step that is taken for another then goes and comes again.
        if moved.bic > come_to.get(moved.times, math.inf) - CLEAR:
            break
        model, x = moved, moved.x
        come_to[model.times] = model.bic
    model, stem = _begun(data, stem, model, limits, skip)
    # What the record does not resolve has no colour.
    after = inflation(model.left[skip:]) if model.power(skip) > LOUD * data.floor else 0.0
    white = after <= max(min(WHITER * coloured, WHITE_ENOUGH), NOISE)
    # One as early as may be, after samples that do not count, stands for what moved PV among these.
    hidden = skip > 0 and span[0] in model.times
    return (model, stem) if model.times and not hidden and (white or not strict) else None


def _begun(data: Centred, stem: Stem, model: _Model, limits: Limits, skip: int) -> tuple[_Model, Stem]:
    """The model with the first slip where a step was taken for it, if that is likelier, and the stem.

    Up to its first slip the stem is anywhere: one that was missed, or comes at the wrong sample, moves PV as a step of
    the load does.
    """
    best = model, stem
    if stem.begun is None or len(model.times) < 2:
        return best
    firsts, _, senses = data.starts
    for at in model.times:
        fewer = [other for other in model.times if other != at]
        near = (firsts != stem.first) & (np.abs(firsts + model.fit.theta - at) <= SLIPPED)
        for first, sense in zip(firsts[near].tolist(), senses[near].tolist(), strict=True):
            other = stem.begun(first, sense)
            # The valve as it is by now, beside the steps.
            x = other.x if other.near is None else other.near(model.wider, model.further)
            trial = _beside(data, x, other.first, model.fit, limits, skip, fewer)
            trial = replace(trial, wider=model.wider, further=model.further)
            best = min(best, (trial, other), key=lambda one: one[0].bic)
    if best[0] is not model:
        best = _refined(data, best[1], best[0], limits, skip), best[1]
    return best


@dataclass(frozen=True, eq=False)
class _Model:
    """A model beside steps: its stem and plant, columns and terms, what it leaves, its disturbance, BIC and times.

    columns: of the stem and plant, what PV makes of each step, and, where it may answer between samples (`between`),
    what that would change by were each a sample earlier.
    wider, further: the factors by which S (or d) and J are others than they were given.
    """

    x: FloatArray
    first: int
    fit: Fit
    columns: FloatArray
    terms: FloatArray
    left: FloatArray
    a: FloatArray
    bic: float
    times: tuple[int, ...]
    wider: float = 1.0
    further: float = 1.0

    @property
    def later(self) -> list[float]:
        """By how many samples PV answers each step later than at its time, about so where that is little."""
        many = len(self.times)
        sizes, moves = self.terms[4 : 4 + many].tolist(), self.terms[4 + many :].tolist() or [0.0] * many
        return [-move / size if size != 0.0 else 0.0 for size, move in zip(sizes, moves, strict=True)]

    @property
    def between(self) -> bool:
        """Whether PV may answer the steps between samples."""
        return len(self.columns) > 4 + len(self.times)

    def power(self, skip: int) -> float:
        """Mean square of what is left, EU^2."""
        return float(np.mean(self.left[skip:] ** 2))

    @property
    def load(self) -> FloatArray:
        """What the steps add to PV, EU."""
        added: FloatArray = self.terms[4:] @ self.columns[4:]
        return added


def _beside(
    data: Centred,
    x: FloatArray,
    first: int,
    fit: Fit,
    limits: Limits,
    skip: int,
    times: list[int],
    between: bool = True,
) -> _Model:
    """The model with load steps at some samples: their sizes by least squares, the plant by output error, in turn.

    between: PV may answer them between samples.
    """
    for turn in range(TURNS if times else 1):
        answers = np.array(steps_of(data, fit, times)).reshape(len(times), data.samples)
        moves = np.diff(answers, prepend=0.0)[: len(times) if between else 0]
        columns = np.vstack([predict(data, x, first, fit)[1], answers, moves])
        solved, *_ = np.linalg.lstsq(columns[:, skip:].T, data.y[skip:], rcond=1e-10)
        terms: FloatArray = solved.astype(np.float64)
        if times and turn < TURNS - 1:
            bare = data.less(terms[4:] @ columns[4:], columns[4:]).whitened(WHITE, skip)
            free = (-math.inf, math.inf)
            again = fit_path(bare, x, first, free, limits, fit.theta, tau=fit.tau, evaluations=30, tolerance=1e-8)
            if again.gain == 0.0 or _as_it_was(fit, again):
                break
            fit = again
    left = data.y - terms @ columns
    a, bic = autoregression(left[skip:], data.floor)
    bic += DEGREES * len(times) * math.log(data.samples)
    return _Model(x, first, fit, columns, terms, left, a, bic, tuple(times))


def _as_it_was(fit: Fit, again: Fit) -> bool:
    """Whether a plant that was fitted again has not moved."""
    return abs(again.tau - fit.tau) <= STILL[0] * fit.tau and abs(again.theta - fit.theta) <= STILL[1]


def _placed(data: Centred, model: _Model, limits: Limits, skip: int, span: tuple[int, int]) -> _Model:
    """The model with each step at the last sample before PV answers it, by what its answer gains from coming later."""
    tried = {model.times: model}
    for _ in range(PLACINGS):
        moved = zip(model.times, model.later, strict=True)
        times = [min(max(at + math.floor(later), span[0]), span[1]) for at, later in moved]
        if tuple(times) in tried or len(set(times)) < len(times):
            break
        model = _beside(data, model.x, model.first, model.fit, limits, skip, times)
        tried[model.times] = model
    steady = [one for one in tried.values() if all(abs(later) <= WITHIN for later in one.later)]
    if steady:
        return min(steady, key=lambda one: one.bic)
    # An answer that begins with a leap is no step's.
    first, *_ = tried.values()
    return _beside(data, first.x, first.first, first.fit, limits, skip, list(first.times), between=False)


def _needed(data: Centred, model: _Model, limits: Limits, skip: int) -> _Model:
    """The model without those of several load steps that do not explain what they cost."""
    while len(model.times) > 1:
        kept = [[t for t in model.times if t != at] for at in model.times]
        fewer = (_beside(data, model.x, model.first, model.fit, limits, skip, times, model.between) for times in kept)
        least = min(fewer, key=lambda one: one.bic)
        if least.bic >= model.bic + CLEAR:
            break
        model = least
    return model


def _refined(data: Centred, stem: Stem, model: _Model, limits: Limits, skip: int) -> _Model:
    """The model with valve and plant moved to where they explain most of PV beside the steps, whose sizes are free.

    What was fitted to PV less a step of nearly the right size has made up for the rest of it.
    """
    if stem.near is None:
        return model
    near, begun = stem.near, (model.wider, model.further)

    def valve(point: FloatArray) -> tuple[FloatArray, Fit]:
        tau = min(max(model.fit.tau * grown(point[2]), limits.tau[0]), limits.tau[1])
        theta = min(max(model.fit.theta + float(point[3]) / SHIFT, limits.theta[0]), limits.theta[1])
        return near(begun[0] * grown(point[0]), begun[1] * grown(point[1])), replace(model.fit, tau=tau, theta=theta)

    # A step between samples is one at either, in part.
    times = np.array(sorted({at + i for at in model.times for i in ((0, 1) if model.between else (0,))}))
    moves = np.eye(4)[[*range(stem.free), *([] if data.integrating else [2]), 3]]

    unexplained = 4.0 * float(np.mean(data.y**2))

    def left(step: FloatArray) -> float:
        point = step @ moves
        if (
            stem.valve is not None
            and sum(size * by * grown(more) for size, by, more in zip(stem.valve, begun, point[:2], strict=False))
            >= 2.0 * data.op_range
        ):
            # Such a jump is never made: beyond it the stem's size is a gain of its own.
            return unexplained
        x, fit = valve(point)
        return left_beside(data.y, x, stem.first, data.integrating, fit.tau, fit.theta, times, skip)

    step = np.zeros(len(moves))
    for spread in SPREADS:
        simplex = step + spread * np.vstack([np.zeros(step.size), np.eye(step.size)])
        step = minimize(
            left,
            step,
            method="Nelder-Mead",
            options={
                "initial_simplex": simplex,
                "maxfev": EVALUATIONS,
                "xatol": math.inf,
                "fatol": 1e-6 * model.power(skip),
            },
        ).x
    point = step @ moves
    x, fit = valve(point)
    wider, further = (by * grown(more) for by, more in zip(begun, point[:2].tolist(), strict=True))
    moved = replace(
        _beside(data, x, stem.first, fit, limits, skip, list(model.times), model.between), wider=wider, further=further
    )
    return moved if moved.power(skip) < model.power(skip) and moved.terms[1] * model.fit.gain > 0.0 else model


def _answer(data: Centred, fit: Fit) -> FloatArray:
    """What PV makes of a unit step of load through a plant of gain 1, shape (N,)."""
    k = np.arange(data.samples, dtype=np.float64)
    return k if data.integrating else 1.0 - np.exp(-k / fit.tau)


def steps_of(data: Centred, fit: Fit, times: Sequence[int]) -> list[FloatArray]:
    """Return what PV makes of unit steps of load, through a plant of gain 1, that it answers from some samples on."""
    return [_step(_answer(data, fit), at) for at in times]


def _step(answer: FloatArray, at: int) -> FloatArray:
    """What PV makes of a unit step that it begins to answer at a sample."""
    out = np.zeros(answer.size)
    out[at:] = answer[: answer.size - at]
    return out


def _likeliest(data: Centred, model: _Model, a: FloatArray, span: tuple[int, int], skip: int) -> int:
    """The sample in a span at which one more step explains most of PV, in the measure of a filter."""
    n = data.samples
    basis, _ = np.linalg.qr(whitened(a, model.columns)[:, skip:].T)
    target = whitened(a, data.y)[skip:]
    rows = np.zeros((basis.shape[1] + 1, n))
    rows[:-1, skip:] = basis.T
    rows[-1, skip:] = target - basis @ (basis.T @ target)
    # A step at another time is the same answer, later: its products with all of them are correlations.
    answer = whitened(a, _answer(data, model.fit))
    size = 1 << (2 * n - 1).bit_length()
    products = np.fft.irfft(np.fft.rfft(rows, size) * np.conj(np.fft.rfft(answer, size)), size)[:, slice(*span)]
    whole = np.cumsum(answer**2)[n - 1 - np.arange(*span)]
    power = whole - (products[:-1] ** 2).sum(axis=0)
    apart = power > APART * whole
    return span[0] + int(np.argmax(np.where(apart, products[-1] ** 2 / np.where(apart, power, 1.0), -1.0)))


def _errors(model: _Model, skip: int) -> FloatArray:
    """Standard errors of the columns' terms, in the measure of the disturbance that they leave."""
    matrix = whitened(model.a, model.columns)[:, skip:]
    scale = np.sqrt((matrix**2).sum(axis=1))
    scale[scale == 0.0] = 1.0
    matrix = matrix / scale[:, None]
    variance = float(np.mean(whitened(model.a, model.left)[skip:] ** 2))
    # Where columns are nearly dependent rounding may leave less than nothing.
    inverse = np.diag(np.linalg.pinv(matrix @ matrix.T, rcond=1e-12))
    spread: FloatArray = np.sqrt(np.maximum(inverse, 0.0) * variance) / scale
    return spread
