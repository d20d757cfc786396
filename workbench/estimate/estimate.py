"""`wb.estimate`: a record to plant, valve, stem position, uncertainty and verdict."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from workbench.detect.detect import detect
from workbench.detect.stem import Fitted
from workbench.errors import InvalidValue
from workbench.estimate.data import Centred, centre, plant_of
from workbench.estimate.fit import (
    LEAST_TAU,
    Fit,
    Limits,
    again_linear,
    disturbance,
    fit_linear,
    fit_nothing,
    predict,
    standard_errors,
    start_range,
)
from workbench.estimate.models import (
    PLANT_PARAMETERS,
    VALVE_PARAMETERS,
    bands_of,
    choose,
    compared,
    reasons_of,
    refitted,
)
from workbench.estimate.profile import EXACT, Candidate, Profile, islands, profile_again, profile_of, search
from workbench.estimate.stems import path_of
from workbench.estimate.two_parameter import Bands, band_stem, look, repeated
from workbench.estimate.two_step import akaike, two_step
from workbench.estimate.verdict import ENOUGH_SLIPS, SHARP, WIDE_D, Evidence, agree, judge
from workbench.model.checks import choice, number
from workbench.model.record import FloatArray, Record
from workbench.model.results import Estimate, Intervals, Iteration, LinearFit
from workbench.model.valve import Choudhury, Ideal, Stenman
from workbench.record.modes import manual_share, mode_words

__all__ = ["estimate"]

METHODS = ("profile", "two_step")
VALVES = ("auto", "linear", "stenman", "choudhury", "deadband")
PLANTS = ("fopdt", "integrating")

# Dead times searched by default, in samples, doubled while the best fit lies at the end.
DELAYS = 30
LINEAR_DELAYS = 240
NORMAL = 1.96
STARTING = 20  # of the record at most is left out at its start
COLOURINGS = 2  # rounds of model and disturbance in turn
MUCH_MANUAL = 0.05  # share of the record in manual that is worth a word


def estimate(
    record: Record,
    *,
    method: str = "profile",
    valve: str = "auto",
    plant: str = "fopdt",
    start: float | None = None,
    max_dead_time: float | None = None,
    progress: Callable[[float], None] | None = None,
) -> Estimate:
    """Estimate a loop from a record of PV and OP, in closed loop and without a test.

    method: "profile", the global profile over (d, first slip, dead time) with output-error refinement, or "two_step",
    the paper's alternating algorithm from the stiction `start` (%), whose valve is "stenman". valve: "stenman",
    "choudhury" (S, J), "deadband" (J = 0), "linear" (none), or "auto", the one that sticks with the lowest BIC. plant:
    "fopdt" or "integrating".
    max_dead_time: s, the longest dead time searched (default: 30 samples, more where the best fit asks for it).
    progress: called with the share done, 0 to 1.

    Returns an `Estimate`; beside the model stands the linear fit that ignores stiction. Where stiction does not help
    ("no_stiction") the model is that linear fit with an ideal valve. intervals.d is the hull of all d whose fit the
    record cannot tell from the best, and None below ten stem moves, which do not pin the stem's unknown start;
    identifiable is True where the verdict is "stiction" and that hull is at most a tenth of d wide. Raises
    `RecordError` for a record that holds no information (too short, PV or OP constant) and `InvalidValue` for
    arguments that are not allowed.
    """
    if not isinstance(record, Record):
        raise InvalidValue("estimate.record", type(record).__name__, "must be a Record (see read_record)")
    choice(method, "estimate.method", METHODS)
    choice(valve, "estimate.valve", VALVES)
    choice(plant, "estimate.plant", PLANTS)
    if start is not None:
        if method != "two_step":
            raise InvalidValue("estimate.start", start, "only method 'two_step' starts from an initial stiction")
        start = number(start, "estimate.start", above=0.0, unit="%")
    if max_dead_time is not None:
        max_dead_time = number(max_dead_time, "estimate.max_dead_time", least=0.0, unit="s")
    tell = progress if progress is not None else _silent
    data = centre(record, plant)
    tell(0.0)
    linear = fit_linear(data, _longest(data, max_dead_time, LINEAR_DELAYS))
    tell(0.1)
    history: tuple[Iteration, ...] = ()
    found: Profile | None
    if method == "two_step":
        found, history = two_step(data, start, _longest(data, max_dead_time, DELAYS))
    else:
        found = _profile(data, max_dead_time, tell)
    answer = _answer(record, data, (method, valve), found, linear, history)
    tell(1.0)
    return answer


def _silent(share: float) -> None:
    """Ignore the progress."""


def _longest(data: Centred, max_dead_time: float | None, usual: int) -> float:
    """The longest dead time to search, in samples, never above `max_dead_time`; a quarter of the record at most."""
    most = max(data.samples // 4, 1)
    if max_dead_time is None:
        return min(usual, max(data.samples // 10, 1) if usual == DELAYS else most)
    return min(max_dead_time / data.sample_time, float(most))


def _profile(data: Centred, max_dead_time: float | None, tell: Callable[[float], None]) -> Profile | None:
    longest = _longest(data, max_dead_time, DELAYS)
    while True:
        found = search(data, longest, lambda share: tell(0.1 + 0.9 * share))
        if found is None or not found.at_limit or max_dead_time is not None or 2 * longest > data.samples // 4:
            return found
        longest *= 2


def _left(data: Centred, found: Profile | None, bands: dict[str, Bands], linear: Fit) -> FloatArray:
    """What the best stem leaves of y, EU."""
    best = None if found is None else found.best
    band = min((b.best for b in bands.values()), key=lambda b: b.fit.sse, default=None)
    if band is not None and (best is None or band.fit.sse < best.fit.sse):
        x = band_stem(data.u, band.S, band.J, band.first, band.sense)[0]
        return data.y - predict(data, x, max(band.first, 0), band.fit)[0]
    if best is not None:
        return data.y - predict(data, path_of(data.u, best.d_low, best.first)[0], best.first, best.fit)[0]
    return data.y - predict(data, data.u, 0, linear)[0]


def _settled(
    data: Centred, found: Profile | None, bands: dict[str, Bands], linear: Fit, delays: float
) -> tuple[Centred, Profile | None, dict[str, Bands], Fit]:
    """The record and its models in the measure of the disturbance that the best stem leaves.

    Where the record starts within a cycle, its first samples, up to the dead time, answer to slips before it: they no
    longer count. A PV that starts where it does not come again starts from rest, with a setpoint move.
    """
    theta = max(0.0 if found is None else found.best.fit.theta, min(linear.theta, delays))
    later = data.y[data.samples // 4 :]
    within = bool(later.min() <= data.y[0] <= later.max())
    skip = min(math.ceil(theta) + 2, data.samples // STARTING) if within else 0
    for turn in range(COLOURINGS):
        a = disturbance(_left(data, found, bands, linear)[skip:], data.floor)
        # Of a long record the first few samples are nothing.
        if a.size == data.a.size == 1 and (turn > 0 or skip == 0 or data.samples > EXACT):
            break
        coloured = a.size > 1
        data = data.whitened(a, skip)
        linear = again_linear(data, linear, delays)
        if found is not None:
            likely = [*found.likely, found.best.d_low]
            if coloured:
                found = profile_of(data, found.rows, likely, found.limits, _silent, (found.best,))
            else:
                found = profile_again(data, found)
        limits = Limits((LEAST_TAU, float(data.samples)), (0.0, delays))
        if bands:
            bands = bands_of(data, look(data, linear, delays), limits) if coloured else refitted(data, bands, limits)
    return data, found, bands, linear


def _coloured_linear(data: Centred, linear: Fit, delays: float) -> tuple[Centred, Fit]:
    """The record and its linear fit in the measure of the disturbance that this leaves."""
    for _ in range(COLOURINGS):
        data = data.whitened(disturbance(data.y - predict(data, data.u, 0, linear)[0], data.floor), 0)
        linear = again_linear(data, linear, delays)
    return data, linear


@dataclass(frozen=True, eq=False)
class _Stem:
    """The best stem model in the record's own scale."""

    valve_position: FloatArray
    prediction: FloatArray
    bias: float
    intervals: Intervals


def _answer(
    record: Record,
    data: Centred,
    asked: tuple[str, str],
    found: Profile | None,
    linear: Fit,
    history: tuple[Iteration, ...],
) -> Estimate:
    n = data.samples
    method, valve = asked
    straight = _linear_result(data, linear)
    plain = found
    # The rival of the verdict is as causal as the stem model: a long dead time passes for half a cycle.
    delays = found.limits.theta[1] if found is not None else float(_longest(data, None, DELAYS))
    rival = linear if linear.theta <= delays else fit_linear(data, delays)
    wide = [] if found is None else [c.fit.sse / n for c in found.fits if c.d >= WIDE_D * data.op_range]
    coarse = look(data, rival, delays)
    bands = {}
    if method == "profile" and valve not in ("stenman", "linear"):
        bands = bands_of(data, coarse, Limits((LEAST_TAU, float(n)), (0.0, delays)))
    # The verdict weighs what each model leaves of PV; the model itself is fitted in the measure that its disturbance
    # asks for.
    if method == "profile":
        data, found, bands, linear = _settled(data, found, bands, linear, delays)
    stem = None if found is None else _stem(data, found)
    evidence = Evidence(
        samples=n,
        variance=data.variance,
        linear=rival.sse / n,
        stem=math.inf if plain is None else plain.best.fit.sse / n,
        slips=0 if found is None else found.best.slips,
        d=math.nan if found is None else found.best.d,
        gain=0.0 if found is None else found.best.fit.gain,
        op_range=data.op_range,
        nothing=fit_nothing(data) / n,
        wide=min(wide, default=math.inf),
        two_parameter=coarse[0].fit.sse / n if coarse else math.inf,
        bands=(coarse[0].S, coarse[0].J) if coarse else (0.0, 0.0),
        linear_delay=rival.theta / n,
        tau=0.0 if found is None or data.integrating else found.best.fit.tau / n,
        d_range=None if stem is None else stem.intervals.d,
        islands=() if found is None else islands(found),
        exact=found is None or found.exact,
        at_limit=found is not None and found.at_limit,
        method=method,
        iterations=len(history),
    )
    limits = Limits((LEAST_TAU, float(n)), (0.0, delays))
    models = compared(data, linear, found, bands)
    chosen = choose(models, "stenman" if method == "two_step" else valve)
    verdict, reasons, identifiable = judge(evidence)
    if chosen in bands and verdict == "stiction":
        # The range of d is that of another valve than the one chosen.
        reasons = judge(replace(evidence, d_range=None))[1]
    fitted: Fitted | None = None if found is None or stem is None else (Stenman(found.best.d), stem.valve_position)
    leader = next((name for name in models if name in bands), None)
    if leader is not None and models[leader].bic < models.get("stenman", models[leader]).bic + 1e-9:
        pair = bands[leader].best
        fitted = (Choudhury(pair.S, pair.J), _band(data, bands[leader], leader).valve_position)
    verdict, reasons = agree(evidence, verdict, reasons, detect(record, fitted=fitted))
    identifiable = identifiable and verdict == "stiction"
    if chosen in bands and verdict != "no_stiction":
        bands[chosen] = repeated(data, bands[chosen], limits, 0.0 if chosen == "deadband" else None)
    if verdict != "no_stiction":
        reasons += reasons_of(models, chosen, valve, bands)
    reasons += _manual_said(record)
    if chosen in bands:
        stem = _band(data, bands[chosen], chosen)
        S = bands[chosen].best.S
        sharp = bands[chosen].S[1] - bands[chosen].S[0] <= SHARP * S
        identifiable = verdict == "stiction" and bands[chosen].best.slips >= ENOUGH_SLIPS and sharp
    if verdict == "no_stiction" or chosen == "linear":
        data, linear = _coloured_linear(data, linear, delays)
        straight = _linear_result(data, linear)
    profile_d = np.array([] if found is None else [c.d for c in found.fits])
    profile_cost = np.array([] if found is None else [c.fit.sse / n for c in found.fits])
    best = bands[chosen].best if chosen in bands else None if found is None else found.best
    if best is None or stem is None or chosen == "linear" or verdict == "no_stiction" or best.fit.gain == 0.0:
        return Estimate(
            record=record,
            method=method,
            plant=straight.plant,
            valve=Ideal(),
            valve_position=record.op.copy(),
            prediction=straight.prediction,
            bias=straight.bias,
            verdict=verdict,
            reasons=reasons,
            intervals=_linear_intervals(data, linear),
            identifiable=False,
            residual_variance=straight.residual_variance,
            aic=straight.aic,
            noise_sd=math.sqrt(straight.residual_variance),
            slips=0,
            linear=straight,
            profile_d=profile_d,
            profile_cost=profile_cost,
            iterations=history,
            candidates=tuple(models.values()),
        )
    # Of the prediction itself: where the model's columns are nearly dependent, the normal equations lose digits.
    sse = float(((record.pv - stem.prediction) ** 2).sum())
    return Estimate(
        record=record,
        method=method,
        plant=plant_of(data, best.fit.gain, best.fit.tau, best.fit.theta),
        valve=models[chosen].valve,
        valve_position=stem.valve_position,
        prediction=stem.prediction,
        bias=stem.bias,
        verdict=verdict,
        reasons=reasons,
        intervals=stem.intervals,
        identifiable=identifiable,
        residual_variance=sse / n,
        aic=akaike(data, sse, PLANT_PARAMETERS + VALVE_PARAMETERS[chosen] - data.integrating),
        noise_sd=float(np.sqrt(np.mean((record.pv - stem.prediction)[data.skip :] ** 2))),
        slips=best.slips,
        linear=straight,
        profile_d=profile_d,
        profile_cost=profile_cost,
        iterations=history,
        candidates=tuple(models.values()),
    )


def _manual_said(record: Record) -> tuple[str, ...]:
    share = 0.0 if record.mode is None else manual_share(record.mode)
    if record.mode is None or share < MUCH_MANUAL:
        return ()
    said = f"the controller was in manual in {share:.0%} of the record ({mode_words(record.mode)})"
    return (f"{said}: a stretch in automatic alone would show the loop better",)


def _bias(data: Centred, fit: Fit) -> float:
    """PV at stem 0; for an integrating plant, PV at the record's start."""
    return data.pv_mean + fit.bias - (0.0 if data.integrating else fit.gain * data.op_middle)


def _linear_result(data: Centred, fit: Fit) -> LinearFit:
    modelled = predict(data, data.u, 0, fit)[0]
    sse = float(((data.y - modelled) ** 2).sum())
    return LinearFit(
        plant=plant_of(data, fit.gain, fit.tau, fit.theta),
        bias=_bias(data, fit),
        prediction=data.pv_mean + modelled,
        residual_variance=sse / data.samples,
        aic=akaike(data, sse, PLANT_PARAMETERS - data.integrating),
    )


def _linear_intervals(data: Centred, fit: Fit) -> Intervals:
    if fit.gain == 0.0:
        return Intervals()
    errors = standard_errors(data, data.u, 0, fit, clamped=False)
    return _ranges(data, [fit], errors, None)


def _ranges(
    data: Centred, fits: list[Fit], errors: tuple[float, float, float], d: tuple[float, float] | None
) -> Intervals:
    """Hulls over fits that are alike, each widened by 1.96 standard errors."""
    Ts = data.sample_time

    def hull(values: list[float], error: float, unit: float, least: float = -math.inf) -> tuple[float, float] | None:
        if not math.isfinite(error):
            return None
        low, high = (min(values) - NORMAL * error) * unit, (max(values) + NORMAL * error) * unit
        return max(low, least), high

    return Intervals(
        d=d,
        gain=hull([f.gain for f in fits], errors[0], 1.0 / Ts if data.integrating else 1.0),
        time_constant=None if data.integrating else hull([f.tau for f in fits], errors[1], Ts, 0.0),
        dead_time=hull([f.theta for f in fits], errors[2], Ts, 0.0),
    )


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


def _stem(data: Centred, found: Profile) -> _Stem:
    best = found.best
    x, _ = path_of(data.u, best.d_low, best.first)
    start, clamped = _start(data, best)
    prediction = data.pv_mean + predict(data, x, best.first, best.fit)[0]
    position = x + data.op_middle
    position[: best.first] = start + data.op_middle
    errors = (math.nan, math.nan, math.nan)
    if best.fit.gain != 0.0:
        errors = standard_errors(data, x, best.first, best.fit, clamped)
    d = (min(c.d_low for c in found.alike), max(c.d_high for c in found.alike))
    known = best.d_high > best.d_low and best.slips >= ENOUGH_SLIPS
    intervals = _ranges(data, [c.fit for c in found.alike], errors, d if known else None)
    return _Stem(position, prediction, _bias(data, best.fit), intervals)


def _band(data: Centred, found: Bands, name: str) -> _Stem:
    """The best two-parameter stem in the record's own scale."""
    best = found.best
    x, _ = band_stem(data.u, best.S, best.J, best.first, best.sense)
    begin = max(best.first, 0)
    prediction = data.pv_mean + predict(data, x, begin, best.fit)[0]
    position = x + data.op_middle
    if begin > 0 and best.fit.gain != 0.0:
        # Where the stem was before it first slipped, kept to what the valve can hold there.
        reach = 0.5 * (best.S + best.J)
        low, high = float(data.u[:begin].max()) - reach, float(data.u[:begin].min()) + reach
        position[:begin] = data.op_middle + float(
            np.clip(best.fit.start / best.fit.gain, min(low, high), max(low, high))
        )
    errors = (math.nan, math.nan, math.nan)
    if best.fit.gain != 0.0:
        errors = standard_errors(data, x, begin, best.fit, clamped=False)
    ranges = _ranges(data, [b.fit for b in found.alike if b.fit.gain != 0.0] or [best.fit], errors, None)
    if best.slips >= ENOUGH_SLIPS:
        ranges = replace(ranges, S=found.S, J=None if name == "deadband" else found.J)
    return _Stem(position, prediction, _bias(data, best.fit), ranges)
