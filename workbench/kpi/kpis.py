"""The figures of a run or a record over a window (see `model.results.Kpis` for each one's meaning and unit)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from workbench.errors import InvalidValue
from workbench.kpi.oscillation import oscillation
from workbench.model.cascade import Cascade, CascadeExperiment
from workbench.model.experiment import Experiment, Step
from workbench.model.loop import Loop
from workbench.model.plant import FOPDT
from workbench.model.record import FloatArray
from workbench.model.results import Kpis

__all__ = ["STILL", "Event", "cascade_event", "last_event", "measure", "reversals", "travel"]

# %: a stem that moves no further in a sample is at rest. An ideal valve follows the rounding of OP to and fro for ever.
STILL = 1e-9


@dataclass(frozen=True, slots=True)
class Event:
    """The last change that a loop has to settle from: its time (s) and its band; and the last step of the setpoint.

    band: EU; nan takes 2 % of the largest error after the change. setpoint_step: EU, 0 where there is none, at
    `setpoint_at` (s); PV answers it alone until `setpoint_stop` (s), when a load steps, if one does.
    """

    at: float
    band: float
    setpoint_step: float = 0.0
    setpoint_at: float = 0.0
    setpoint_stop: float = math.inf


def last_event(loop: Loop, experiment: Experiment) -> Event | None:
    """Return the last setpoint or load step, with the band as the larger of 2 % of the step and K J/2, or None.

    A load step of size L on a self-regulating plant counts as the PV change K L that it would make; on an integrating
    plant, which has no such figure, 2 % of the largest error after it is taken.
    """
    setpoint = [(p.at, p.size) for p in experiment.setpoint_parts if isinstance(p, Step)]
    load = [(p.at, p.size) for p in experiment.load_parts if isinstance(p, Step)]
    if not setpoint and not load:
        return None
    set_at, step = max(setpoint, key=lambda part: part[0], default=(-math.inf, 0.0))
    load_at, size = max(load, key=lambda part: part[0], default=(-math.inf, 0.0))
    at, is_setpoint = max(set_at, load_at), set_at >= load_at
    event = Event(at, 0.02 * abs(step))
    if setpoint:
        event = replace(event, setpoint_step=step, setpoint_at=set_at)
        event = replace(event, setpoint_stop=min((t for t, _ in load if t > set_at), default=math.inf))
    if not isinstance(loop.plant, FOPDT):
        return event if is_setpoint else replace(event, band=math.nan)
    gain = abs(loop.plant.gain)
    effect = abs(step) if is_setpoint else gain * abs(size)
    return replace(event, band=max(0.02 * effect, 0.5 * gain * loop.valve.slip_jump))


def cascade_event(cascade: Cascade, experiment: Experiment) -> Event | None:
    """Return the last step that a cascade's primary settles from; one at the valve counts as the secondary's PV step.

    The band is at least half of what a jump of the stem moves the primary's PV.
    """
    loads = list(experiment.primary_load_parts) if isinstance(experiment, CascadeExperiment) else []
    primary, secondary = cascade.primary.plant, cascade.secondary.plant
    if isinstance(secondary, FOPDT):
        loads += [Step(secondary.gain * part.size, part.at) for part in experiment.load_parts if isinstance(part, Step)]
    event = last_event(cascade.primary, Experiment(experiment.duration, experiment.setpoint, loads))
    if event is None or not isinstance(primary, FOPDT) or not isinstance(secondary, FOPDT):
        return event
    slip = 0.5 * abs(primary.gain * secondary.gain) * cascade.secondary.valve.slip_jump
    return replace(event, band=max(event.band, slip))


def travel(signal: FloatArray, before: float = math.nan) -> float:
    """Return the sum of absolute moves; the first from `before`, the sample before the window (none if nan)."""
    first = 0.0 if math.isnan(before) else abs(float(signal[0]) - before)
    return first + float(np.abs(np.diff(signal)).sum())


def reversals(valve: FloatArray, before: float = math.nan) -> int:
    """Return how often successive stem moves change sign; a stem that is `STILL` makes none."""
    moves = np.diff(valve, prepend=valve[0] if math.isnan(before) else before)
    signs = np.sign(moves[np.abs(moves) > STILL])
    return int(np.count_nonzero(signs[1:] != signs[:-1]))


@np.errstate(over="ignore", invalid="ignore")  # an unstable run may overflow
def measure(
    pv: FloatArray,
    sample_time: float,
    *,
    sp: FloatArray | None = None,
    op: FloatArray | None = None,
    valve: FloatArray | None = None,
    op_before: float = math.nan,
    valve_before: float = math.nan,
    event: Event | None = None,
    window: tuple[float, float] | None = None,
) -> Kpis:
    """Return the figures of signals of shape (N,) (pv, sp in EU; op, valve in %) over `window` (s, [start, end)).

    The whole run by default. `op_before` and `valve_before` are the values of the sample before the first (nan:
    unknown, that move is not counted). A run whose squares overflow has diverged: each figure of its size is inf, from
    whichever signal, and it holds no oscillation. Raises `InvalidValue` for a window that holds no sample.
    """
    first, stop = 0, pv.size
    if window is not None:
        first, stop = (math.ceil(t / sample_time - 1e-9) for t in window)
        if not 0 <= first < stop or stop > pv.size:
            whole = pv.size * sample_time
            raise InvalidValue("window", window, f"must hold at least one sample and lie within 0..{whole:g} s")
    part = slice(first, stop)

    def before(signal: FloatArray | None, given: float) -> float:
        return given if signal is None or first == 0 else float(signal[first - 1])

    error = None if sp is None else sp[part] - pv[part]
    own = None if op is None else op[part]
    stem = None if valve is None else valve[part]
    signals = [signal for signal in (pv[part], error, own, stem) if signal is not None]
    diverged = not all(math.isfinite(float(np.square(signal).sum())) for signal in signals)

    def figure(signal: FloatArray | None, of: Callable[[FloatArray], np.floating | float]) -> float:
        return math.nan if signal is None else math.inf if diverged else float(of(signal))

    index, period = (0.0, math.nan) if diverged else oscillation(pv[part] if error is None else error, sample_time)
    overshoot, settling = math.nan, math.nan
    if event is not None and sp is not None:
        overshoot, settling = _step_response(sp[:stop] - pv[:stop], sample_time, event)
        if diverged:
            overshoot, settling = math.inf if event.setpoint_step != 0.0 else math.nan, math.inf
    return Kpis(
        error_variance=figure(error, np.var),
        mean_square_error=figure(error, lambda e: np.mean(e**2)),
        op_variance=figure(own, np.var),
        valve_variance=figure(stem, np.var),
        valve_travel=figure(stem, lambda x: travel(x, before(valve, valve_before))),
        controller_travel=figure(own, lambda u: travel(u, before(op, op_before))),
        reversals=0 if stem is None else reversals(stem, before(valve, valve_before)),
        iae=figure(error, lambda e: sample_time * np.abs(e).sum()),
        ise=figure(error, lambda e: sample_time * (e**2).sum()),
        pv_sd=figure(pv[part], np.std),
        overshoot=overshoot,
        settling_time=settling,
        final_error=figure(error, lambda e: e[-1]),
        oscillation_index=index,
        oscillation_period=period,
    )


def _step_response(error: FloatArray, sample_time: float, event: Event) -> tuple[float, float]:
    """Overshoot (% of the setpoint step) and settling time (s, inf if it never settles) from the event on."""

    def sample(time: float) -> int:
        return math.ceil(time / sample_time - 1e-9) if math.isfinite(time) else error.size

    after = error[sample(event.at) :]
    if after.size == 0:
        return math.nan, math.nan
    step, answer = event.setpoint_step, error[sample(event.setpoint_at) : sample(event.setpoint_stop)]
    overshoot = math.nan
    if step != 0.0 and answer.size > 0:
        overshoot = 100.0 * float(np.maximum((-answer * np.sign(step)).max(), 0.0)) / abs(step)
    band = 0.02 * float(np.abs(after).max()) if math.isnan(event.band) else event.band
    outside = np.flatnonzero(np.abs(after) > band)
    entry = 0 if outside.size == 0 else int(outside[-1]) + 1
    settling = math.inf if 0 < entry == after.size else entry * sample_time
    return overshoot, settling
