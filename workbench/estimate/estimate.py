"""`wb.estimate`: a record to plant, valve, stem position, uncertainty and verdict."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from workbench.detect.detect import detect
from workbench.errors import InvalidValue
from workbench.estimate.data import Centred, centre, plant_of
from workbench.estimate.fit import Fit, fit_linear, fit_nothing, predict, standard_errors, start_range
from workbench.estimate.profile import Candidate, Profile, islands, path_of, search
from workbench.estimate.two_parameter import look
from workbench.estimate.two_step import akaike, two_step
from workbench.estimate.verdict import WIDE_D, Evidence, agree, judge
from workbench.model.checks import choice, number
from workbench.model.record import FloatArray, Record
from workbench.model.results import Estimate, Intervals, Iteration, LinearFit
from workbench.model.valve import Ideal, Stenman
from workbench.record.modes import manual_share, mode_words

__all__ = ["estimate"]

METHODS = ("profile", "two_step")
VALVES = ("stenman",)
PLANTS = ("fopdt", "integrating")

# Numbers of free parameters for AIC: gain, time constant, dead time, bias, input before the record, transient; and d.
LINEAR_PARAMETERS = 6
STEM_PARAMETERS = 7
# Dead times searched by default, in samples, doubled while the best fit lies at the end.
DELAYS = 30
LINEAR_DELAYS = 240
NORMAL = 1.96
MUCH_MANUAL = 0.05  # share of the record in manual that is worth a word


def estimate(
    record: Record,
    *,
    method: str = "profile",
    valve: str = "stenman",
    plant: str = "fopdt",
    start: float | None = None,
    max_dead_time: float | None = None,
    progress: Callable[[float], None] | None = None,
) -> Estimate:
    """Estimate a loop from a record of PV and OP, in closed loop and without a test.

    method: "profile", the global profile over (d, first slip, dead time) with output-error refinement, or "two_step",
    the paper's alternating algorithm from the stiction `start` (%). valve: "stenman". plant: "fopdt" or "integrating".
    max_dead_time: s, the longest dead time searched (default: 30 samples, more where the best fit asks for it).
    progress: called with the share done, 0 to 1.

    Returns an `Estimate`; beside the model stands the linear fit that ignores stiction. Where stiction does not help
    ("no_stiction") the model is that linear fit with an ideal valve. intervals.d is the hull of all d whose fit the
    record cannot tell from the best; identifiable is False where that is wider than a tenth of d, or where the stem
    moved fewer than ten times. Raises `RecordError` for a record that holds no information (too short, PV or OP
    constant) and `InvalidValue` for arguments that are not allowed.
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
    answer = _answer(record, data, method, found, linear, history)
    tell(1.0)
    return answer


def _silent(share: float) -> None:
    """Ignore the progress."""


def _longest(data: Centred, max_dead_time: float | None, usual: int) -> int:
    """The longest dead time to search, in samples; a quarter of the record at most."""
    most = max(data.samples // 4, 1)
    if max_dead_time is None:
        return min(usual, max(data.samples // 10, 1) if usual == DELAYS else most)
    return min(math.ceil(max_dead_time / data.sample_time - 1e-9), most)


def _profile(data: Centred, max_dead_time: float | None, tell: Callable[[float], None]) -> Profile | None:
    longest = _longest(data, max_dead_time, DELAYS)
    while True:
        found = search(data, longest, lambda share: tell(0.1 + 0.9 * share))
        if found is None or not found.at_limit or max_dead_time is not None or 2 * longest > data.samples // 4:
            return found
        longest *= 2


@dataclass(frozen=True, eq=False)
class _Stem:
    """The best stem model in the record's own scale."""

    valve_position: FloatArray
    prediction: FloatArray
    bias: float
    intervals: Intervals


def _answer(
    record: Record, data: Centred, method: str, found: Profile | None, linear: Fit, history: tuple[Iteration, ...]
) -> Estimate:
    n = data.samples
    straight = _linear_result(data, linear)
    stem = None if found is None else _stem(data, found)
    # The rival of the verdict is as causal as the stem model: a long dead time passes for half a cycle.
    delays = found.limits.theta[1] if found is not None else float(_longest(data, None, DELAYS))
    rival = linear if linear.theta <= delays else fit_linear(data, int(delays))
    wide = [] if found is None else [c.fit.sse / n for c in found.fits if c.d >= WIDE_D * data.op_range]
    dead_band, dead_band_sse = look(data, rival, delays)
    evidence = Evidence(
        samples=n,
        variance=data.variance,
        linear=rival.sse / n,
        stem=math.inf if found is None else found.best.fit.sse / n,
        slips=0 if found is None else found.best.slips,
        d=math.nan if found is None else found.best.d,
        gain=0.0 if found is None else found.best.fit.gain,
        op_range=data.op_range,
        nothing=fit_nothing(data) / n,
        wide=min(wide, default=math.inf),
        two_parameter=dead_band_sse / n,
        bands=(dead_band.S, dead_band.J),
        linear_delay=rival.theta / n,
        tau=0.0 if found is None or data.integrating else found.best.fit.tau / n,
        d_range=None if stem is None else stem.intervals.d,
        islands=() if found is None else islands(found),
        exact=found is None or found.exact,
        at_limit=found is not None and found.at_limit,
        method=method,
        iterations=len(history),
    )
    verdict, reasons, identifiable = judge(evidence)
    fitted = None if found is None or stem is None else (Stenman(found.best.d), stem.valve_position)
    verdict, reasons = agree(evidence, verdict, reasons, detect(record, fitted=fitted))
    identifiable = identifiable and verdict == "stiction"
    reasons += _manual_said(record)
    profile_d = np.array([] if found is None else [c.d for c in found.fits])
    profile_cost = np.array([] if found is None else [c.fit.sse / n for c in found.fits])
    if found is None or stem is None or verdict == "no_stiction" or found.best.fit.gain == 0.0:
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
            identifiable=identifiable,
            residual_variance=straight.residual_variance,
            aic=straight.aic,
            noise_sd=math.sqrt(straight.residual_variance),
            slips=0,
            linear=straight,
            profile_d=profile_d,
            profile_cost=profile_cost,
            iterations=history,
        )
    best = found.best
    return Estimate(
        record=record,
        method=method,
        plant=plant_of(data, best.fit.gain, best.fit.tau, best.fit.theta),
        valve=Stenman(best.d),
        valve_position=stem.valve_position,
        prediction=stem.prediction,
        bias=stem.bias,
        verdict=verdict,
        reasons=reasons,
        intervals=stem.intervals,
        identifiable=identifiable,
        residual_variance=best.fit.sse / n,
        aic=akaike(data, best.fit.sse, STEM_PARAMETERS - data.integrating),
        noise_sd=math.sqrt(best.fit.sse / n),
        slips=best.slips,
        linear=straight,
        profile_d=profile_d,
        profile_cost=profile_cost,
        iterations=history,
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
    return LinearFit(
        plant=plant_of(data, fit.gain, fit.tau, fit.theta),
        bias=_bias(data, fit),
        prediction=data.pv_mean + predict(data, data.u, 0, fit)[0],
        residual_variance=fit.sse / data.samples,
        aic=akaike(data, fit.sse, LINEAR_PARAMETERS - data.integrating),
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
    intervals = _ranges(data, [c.fit for c in found.alike], errors, d if found.best.d_high > found.best.d_low else None)
    return _Stem(position, prediction, _bias(data, best.fit), intervals)
