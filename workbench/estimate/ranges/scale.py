"""Fits in the record's own scale: plants, stems, predictions and their 95 % ranges."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce

import numpy as np

from workbench.estimate.fits.data import Centred, plant_of
from workbench.estimate.fits.fit import LEAST_TAU, Fit, Limits, grounded, predict, start_range
from workbench.estimate.fits.sureness import ENOUGH_SLIPS, NORMAL, SHARP, effective_samples, standard_errors
from workbench.estimate.kernels.output_error import NO_DELAY
from workbench.estimate.loads.steps import CLEAR
from workbench.estimate.ranges.few import widened
from workbench.estimate.ranges.freed import Loaded, freed
from workbench.estimate.ranges.resting import resting_short
from workbench.estimate.search.bands import Bands, Found, alike
from workbench.estimate.search.candidates import Candidate
from workbench.estimate.search.models import PLANT_PARAMETERS, akaike
from workbench.estimate.search.profile import CHI_SQUARE, Profile
from workbench.estimate.search.two_parameter import Band, held_range
from workbench.estimate.search.uneven import Uneven
from workbench.model.loads import LoadStep
from workbench.model.plant import FOPDT, Plant
from workbench.model.record import FloatArray
from workbench.model.results import Intervals, LinearFit

__all__ = [
    "InScale",
    "band_of",
    "band_position",
    "bias_of",
    "joined",
    "linear_intervals",
    "linear_result",
    "ranges_of",
    "rivals_of",
    "short_of",
    "stem_of",
    "uneven_of",
    "unknown",
    "unsure",
    "wider",
    "without_jump",
]

AT_END = 0.05  # of a limit of the search for a time constant: nearer, it is the limit that was found
HALF_SAMPLE = 0.5  # likewise of a dead time


@dataclass(frozen=True, eq=False)
class InScale:
    """The best stem model in the record's own scale.

    parts: what parts of the record say of its plant beside, and stems that have load steps of their own.
    """

    valve_position: FloatArray
    prediction: FloatArray
    bias: float
    intervals: Intervals
    parts: tuple[Intervals, ...] = ()


def bias_of(data: Centred, fit: Fit) -> float:
    """Return PV at stem 0; for an integrating plant, PV at the record's start."""
    return data.pv_mean + fit.bias - (0.0 if data.integrating else fit.gain * data.op_middle)


def linear_result(data: Centred, fit: Fit) -> LinearFit:
    """Return the linear fit as a result, its AIC by the paper's eq. (1)."""
    fit = grounded(data, data.u, 0, fit)
    modelled = predict(data, data.u, 0, fit)[0]
    sse = float(((data.y - modelled) ** 2).sum())
    return LinearFit(
        plant=plant_of(data, fit.gain, fit.tau, fit.theta),
        bias=bias_of(data, fit),
        prediction=data.pv_mean + data.load + modelled,
        residual_variance=sse / data.samples,
        aic=akaike(data, sse, PLANT_PARAMETERS - data.integrating),
    )


def linear_intervals(data: Centred, fit: Fit, longest: float) -> Intervals:
    """Return the ranges of the linear fit's plant, none where OP has no part in PV; longest: as in `ranges_of`."""
    if fit.gain == 0.0:
        return Intervals()
    errors = standard_errors(data, data.u, 0, fit, clamped=False)
    return ranges_of(data, [fit], errors, None, longest)


def unknown(plant: Plant) -> Intervals:
    """Return the ranges of a plant of which the record tells no more than the gain's sign."""
    all_that_lasts = 0.0, math.inf
    gain = all_that_lasts if plant.gain > 0.0 else (-math.inf, 0.0)
    tau = all_that_lasts if isinstance(plant, FOPDT) else None
    return Intervals(gain=gain, time_constant=tau, dead_time=all_that_lasts)


def ranges_of(
    data: Centred,
    fits: list[Fit],
    errors: tuple[float, float, float],
    d: tuple[float, float] | None,
    longest: float,
    spare: Sequence[float] = (),
) -> Intervals:
    """Return hulls over fits that are alike, each widened by 1.96 standard errors, or by its share of that in spare.

    longest: samples, the longest dead time searched. An end that is the search's, or lies beyond all that the record
    can show, says nothing of the plant: the range is open there (see `Intervals`). A time constant or a dead time as
    long as the record is beyond it; so is a gain by which the whole of OP's range moves PV by more in one sample than
    PV ranges (a lag takes up to N samples to show it). A slow plant shows the ratio of gain and time constant alone:
    where the one is open upward, so is the other.
    """
    Ts, n = data.sample_time, data.samples
    wide = NORMAL * np.array(spare or [1.0] * len(fits))

    def hull(values: FloatArray, error: float) -> tuple[float, float] | None:
        if not math.isfinite(error):
            return None
        return float((values - wide * error).min()), float((values + wide * error).max())

    def time(values: FloatArray, error: float, least: float, end: float) -> tuple[float, float] | None:
        pair = hull(values, error)
        if pair is None:
            return None
        low = 0.0 if values.min() <= least else max(pair[0], 0.0)
        return low * Ts, math.inf if values.max() >= end or pair[1] > n else pair[1] * Ts

    gains = np.array([f.gain for f in fits])
    taus = np.array([f.tau for f in fits])
    tau = None if data.integrating else time(taus, errors[1], (1.0 + AT_END) * LEAST_TAU, (1.0 - AT_END) * n)
    gain = hull(gains, errors[0])
    if gain is not None:
        reach = float(np.ptp(data.y)) / data.op_range * (1.0 if data.integrating else n)
        slow = tau is not None and math.isinf(tau[1])
        low = -math.inf if gain[0] < -reach or (slow and gains.min() < 0.0) else min(gain[0], reach)
        high = math.inf if gain[1] > reach or (slow and gains.max() > 0.0) else max(gain[1], -reach)
        unit = 1.0 / Ts if data.integrating else 1.0
        gain = low * unit, high * unit
    end = longest - HALF_SAMPLE if longest > 0.0 else math.inf
    theta = time(np.array([f.theta for f in fits]), errors[2], NO_DELAY, end)
    return Intervals(d=d, gain=gain, time_constant=tau, dead_time=theta)


def wider(data: Centred, band: tuple[float, float]) -> tuple[float, float]:
    """Return a range of a valve's band, %, wider by what is not known of OP."""
    reach = NORMAL * data.doubt
    return max(band[0] - reach, 0.0), band[1] + reach


def unsure(data: Centred, errors: tuple[float, float, float], fit: Fit, band: float) -> tuple[float, float, float]:
    """Return a plant's standard errors with what is not known of OP: of the gain as a share of the band, of dead time.

    errors: of gain, tau and theta (samples), of a fit along a stem; band: its stick band, %, or 0 for one that does not
    stick. A cycle tells the product of gain and band, and a slip is seen sooner or later by as long as OP takes to go
    as far.
    """
    if data.doubt == 0.0 or band == 0.0:
        return errors
    gain, tau, theta = errors
    rate = float(np.abs(np.diff(data.u)).mean())
    return math.hypot(gain, fit.gain * data.doubt / band), tau, math.hypot(theta, data.doubt / rate)


def _start(data: Centred, best: Candidate) -> tuple[float, bool]:
    """The stem before the first slip (centred), and whether it was set to an end of its range."""
    low, high = start_range(data.u, best.first, best.d_low, best.d_high)
    if best.fit.gain == 0.0:
        return float(data.u[best.first]), False
    free = best.fit.start / best.fit.gain
    if math.isinf(low):
        # Nothing of OP's record tells where the stem was before sample 0; it does not show within the record.
        return free, False
    return float(np.clip(free, low, high)), not low * (1 + 1e-9) < free < high * (1 - 1e-9)


def joined(one: Intervals, other: Intervals) -> Intervals:
    """Return the hull of two valves' ranges, of those that the first has; d and S are both the stick band."""

    def hull(a: tuple[float, float] | None, b: tuple[float, float] | None) -> tuple[float, float] | None:
        return a if a is None or b is None else (min(a[0], b[0]), max(a[1], b[1]))

    band = other.d or other.S
    return Intervals(
        d=hull(one.d, band),
        S=hull(one.S, band),
        J=hull(one.J, other.J),
        gain=hull(one.gain, other.gain),
        time_constant=hull(one.time_constant, other.time_constant),
        dead_time=hull(one.dead_time, other.dead_time),
    )


def rivals_of(
    data: Centred, chosen: str, found: Profile | None, bands: dict[str, Found], limits: Limits
) -> dict[str, Intervals]:
    """Return the ranges of the sticking valves beside the chosen one whose fit the record cannot tell from its own.

    A dead band is a stem with S and J that needs no J: neither is the other's rival (but see `without_jump`).
    """
    n = data.samples
    best = bands[chosen].best if chosen in bands else None
    if best is not None:
        x, first, fit = best.stem(data.u), best.begin, best.fit
    elif found is not None:
        x, first, fit = found.best.stem(data.u), found.best.first, found.best.fit
    else:
        return {}
    most = max(fit.sse / n, data.floor) * math.exp(CHI_SQUARE / effective_samples(data, x, first, fit)) * n
    ranges = {}
    if found is not None and chosen != "stenman" and max(found.best.fit.sse, n * data.floor) <= most:
        near = tuple(c for c in found.alike if max(c.fit.sse, n * data.floor) <= most)
        ranges["stenman"] = stem_of(data, replace(found, alike=near)).intervals
    for name, one in bands.items() if chosen == "stenman" else ():
        if max(one.best.fit.sse, n * data.floor) <= most:
            near_it = widened(data, alike(data, one, limits, fit.sse), one.only, limits, fit.sse)
            ranges[name] = band_of(data, near_it, name, limits).intervals
    return ranges


def short_of(
    data: Centred, whole: Centred, best: Candidate | Uneven, limits: Limits, steps: Sequence[LoadStep]
) -> dict[str, Intervals]:
    """Return the plant's ranges with stems that rest short of OP, where the record cannot tell them from the best.

    whole: the record with its load steps.
    """
    # As in `freed`: the steps stand beside no filter.
    loaded = Loaded.of(whole, data, steps, limits) if steps and data.a.size == 1 else None
    fits = resting_short(data, best, limits, loaded)
    if not fits:
        return {}
    x = best.x if isinstance(best, Uneven) else best.stem(data.u)
    errors = standard_errors(data, x, best.first, best.fit, clamped=False)
    return {"he": ranges_of(data, fits, errors, None, limits.theta[1])}


def without_jump(data: Centred, whole: Centred, dead: Found, limits: Limits, steps: Sequence[LoadStep]) -> Intervals:
    """Return the ranges of a dead band that the record cannot tell from a stem with a slip jump: J is 0.

    whole: the record with its load steps.
    """
    near = freed(data, whole, widened(data, alike(data, dead, limits), dead.only, limits), dead.only, limits, steps)
    found = band_of(data, near, "deadband", limits)
    return replace(reduce(joined, found.parts, found.intervals), J=(0.0, 0.0))


def stem_of(data: Centred, found: Profile) -> InScale:
    """Return the best one-parameter stem; d has a range where enough slips pin it."""
    best = found.best
    x = best.stem(data.u)
    start, clamped = _start(data, best)
    bounds = start_range(data.u, best.first, best.d_low, best.d_high)
    whole = grounded(data, x, best.first, best.fit, bounds)
    if best.first > 0 and whole.gain != 0.0:
        start = float(np.clip(whole.start / whole.gain, *bounds))
    prediction = data.pv_mean + data.load + predict(data, x, best.first, whole)[0]
    position = x + data.op_middle
    position[: best.first] = start + data.op_middle
    errors = (math.nan, math.nan, math.nan)
    if best.fit.gain != 0.0:
        errors = standard_errors(data, x, best.first, best.fit, clamped)
    errors = unsure(data, errors, best.fit, best.d)
    d = wider(data, (min(c.d_low for c in found.alike), max(c.d_high for c in found.alike)))
    known = best.d_high > best.d_low and best.slips >= ENOUGH_SLIPS
    intervals = ranges_of(data, [c.fit for c in found.alike], errors, d if known else None, found.limits.theta[1])
    return InScale(position, prediction, bias_of(data, whole), intervals)


def uneven_of(data: Centred, found: Sequence[Uneven], limits: Limits) -> InScale:
    """Return the likeliest stem that does not stick alike at every slip, %, its band's mean with a range."""
    best = found[0]
    whole = grounded(data, best.x, best.first, best.fit, best.bounds)
    prediction = data.pv_mean + data.load + predict(data, best.x, best.first, whole)[0]
    position = best.x + data.op_middle
    if best.first > 0:
        position[: best.first] = data.op_middle + float(np.clip(whole.start / whole.gain, *best.bounds))
    # What is not known of OP at a slip is in all that PV answers until the next.
    worth = effective_samples(data, best.x, best.first, best.fit) / data.samples
    near = [one for one in found if worth * (one.level - best.level) <= CLEAR]
    alike = [one for one in near if one.sticks == best.sticks]
    beside = data
    if not best.sticks:
        # How far it stands apart in its two directions was found with the plant.
        apart = predict(data, best.senses, best.first, best.fit)[1][1]
        beside = replace(data, answers=np.vstack([data.answers, apart]))
    errors = standard_errors(beside, best.x, best.first, best.fit, clamped=False)
    if not best.sticks:
        # What a cycle tells is the product of gain and band, and of this one both parameters are means of bands.
        errors = math.hypot(errors[0], best.fit.gain * best.error / best.S), *errors[1:]
    # All bands are wider by what OP goes on by while PV answers sooner.
    mean = math.hypot(best.error, best.step * errors[2] if math.isfinite(errors[2]) else 0.0)
    errors = unsure(data, errors, best.fit, best.S)
    ranges = ranges_of(data, [one.fit for one in near], errors, None, limits.theta[1])

    # Of bands that differ widely the mean is none to go by.
    about = NORMAL * (best.spread if best.spread > SHARP * best.S else mean)

    def hull(values: list[float]) -> tuple[float, float]:
        return wider(data, (max(min(values) - about, 0.0), max(values) + about))

    if best.slips >= ENOUGH_SLIPS and best.sticks:
        ranges = replace(ranges, d=hull([one.S for one in alike]))
    elif best.slips >= ENOUGH_SLIPS:
        ranges = replace(ranges, S=hull([one.S for one in alike]), J=hull([one.J for one in alike]))
    return InScale(position, prediction, bias_of(data, whole), ranges)


def band_position(data: Centred, best: Band) -> FloatArray:
    """Return a two-parameter stem, % of OP's scale, shape (N,)."""
    x, begin = best.stem(data.u), best.begin
    whole = grounded(data, x, begin, best.fit)
    position = x + data.op_middle
    if begin > 0 and best.fit.gain != 0.0:
        # Where the stem was before it first slipped, kept to what the valve can hold there.
        position[:begin] = data.op_middle + float(np.clip(whole.start / whole.gain, *held_range(data.u, best)))
    return position


def band_of(data: Centred, found: Bands, name: str, limits: Limits) -> InScale:
    """Return the best two-parameter stem, searched within limits, in the record's own scale."""
    best = found.best
    x, begin = best.stem(data.u), best.begin
    whole = grounded(data, x, begin, best.fit)
    prediction = data.pv_mean + data.load + predict(data, x, begin, whole)[0]
    errors = (math.nan, math.nan, math.nan)
    if best.fit.gain != 0.0:
        errors = standard_errors(data, x, begin, best.fit, clamped=False)
    errors = unsure(data, errors, best.fit, best.S)
    ranges = ranges_of(data, [b.fit for b in found.alike], errors, None, limits.theta[1], found.spare)
    # The valve's own width and jump take part in what the plant may be: parts of the record differ in all of them.
    apart = (found.parts, ()), ([b.fit for b in found.beside], found.spare_beside)
    parts = tuple(ranges_of(data, list(fits), errors, None, limits.theta[1], spare) for fits, spare in apart if fits)
    if best.slips >= ENOUGH_SLIPS:
        ranges = replace(ranges, S=wider(data, found.S), J=None if name == "deadband" else wider(data, found.J))
    return InScale(band_position(data, best), prediction, bias_of(data, whole), ranges, parts)
