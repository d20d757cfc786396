"""From a loop to the kernel's coefficient rows: the only place where parameters turn into the numbers of the law."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from workbench.model.compensator import (
    Compensator,
    ConstantReinforcement,
    Dither,
    IntegralDeadband,
    Knocker,
    TwoMove,
)
from workbench.model.controller import PID
from workbench.model.karnopp import CREEP, Karnopp
from workbench.model.loop import Loop
from workbench.model.plant import FOPDT, Plant
from workbench.model.record import FloatArray
from workbench.model.valve import Choudhury, Deadband, Directional, He, Kano, Positional, Stenman, Valve
from workbench.simulate import kernel
from workbench.simulate.compiled import compiled

__all__ = ["Discrete", "ValveLaw", "coefficients", "discretise", "rest", "valve_law", "valve_row"]

TERMS = 7  # of a row, that a tuning changes


class Discrete(NamedTuple):
    """A plant's exact zero-order-hold step: `y = pole y + gain (c0 v_{k-delay} + c1 v_{k-delay-1})`."""

    pole: float
    gain: float
    c0: float
    c1: float
    delay: int


class ValveLaw(NamedTuple):
    """A valve in the kernel's terms: its kind, the leads u - x at which it slips and those that it keeps while moving.

    All in %; band and offset for the way up, band_down and offset_down for the way down. table: where they differ by
    place, the positions, then the band at each, then the offset at each; the four are then those at x = 0. Of a valve
    with mass: what the kernel names `KARNOPP` says.
    """

    kind: int
    band: float
    offset: float
    band_down: float
    offset_down: float
    table: tuple[float, ...] = ()


def discretise(plant: Plant, sample_time: float) -> Discrete:
    """Return the exact discrete plant. `theta = (m + f) Ts`, `m = floor(theta/Ts + 1e-9)`, f below 1e-9 is 0.

    FOPDT: `a = exp(-Ts/tau)`, c0 = `1 - a^(1-f)`, c1 = `a^(1-f) - a`; integrating: gain K Ts, c0 = 1 - f, c1 = f.
    """
    ratio = plant.dead_time / sample_time
    m = math.floor(ratio + 1e-9)
    f = ratio - m
    if f < 1e-9:
        f = 0.0
    if isinstance(plant, FOPDT):
        a = math.exp(-sample_time / plant.time_constant)
        part = a ** (1.0 - f)
        return Discrete(a, plant.gain, 1.0 - part, part - a, m)
    return Discrete(1.0, plant.gain * sample_time, 1.0 - f, f, m)


def valve_law(valve: Valve, sample_time: float = 1.0) -> ValveLaw:
    """Return a valve in the kernel's terms; sample_time: s, of concern to one with mass alone."""
    if isinstance(valve, Karnopp):
        n = math.ceil(sample_time / valve.substep - 1e-9)
        h, k_m, percent = sample_time / n, valve.spring / valve.mass, 100.0 / valve.travel
        damping = 1.0 + h * valve.viscous / valve.mass + h * h * k_m
        friction = valve.percent(valve.coulomb), valve.percent(valve.static)
        speeds = valve.stribeck * percent, CREEP * valve.stribeck * percent
        law = _same_both_ways(kernel.KARNOPP, valve.hold, friction[0])
        return law._replace(table=(float(n), h, h * k_m, damping, *friction, *speeds))
    if isinstance(valve, Stenman):
        return _same_both_ways(kernel.STAIRS, valve.d, 0.0)
    if isinstance(valve, He):
        return _same_both_ways(kernel.STAIRS, valve.fs, valve.fd)
    if isinstance(valve, Choudhury | Kano):
        kind = kernel.KANO if isinstance(valve, Kano) else kernel.TWO_PARAMETER
        return _same_both_ways(kind, (valve.S + valve.J) / 2.0, (valve.S - valve.J) / 2.0)
    if isinstance(valve, Deadband):
        return _same_both_ways(kernel.TWO_PARAMETER, valve.b / 2.0, valve.b / 2.0)
    if isinstance(valve, Directional):
        up, down = valve_law(valve.up), valve_law(valve.down)
        return ValveLaw(kernel.DIRECTIONAL, up.band, up.offset, down.band, down.offset)
    if isinstance(valve, Positional):
        laws = [valve_law(one) for one in valve.valves]
        bands, offsets = tuple(law.band for law in laws), tuple(law.offset for law in laws)
        here = _same_both_ways(laws[0].kind, valve.between(0.0, bands), valve.between(0.0, offsets))
        return here._replace(table=(*valve.positions, *bands, *offsets))
    return _same_both_ways(kernel.IDEAL, 0.0, 0.0)


def valve_row(valve: Valve, sample_time: float) -> FloatArray:
    """Return a coefficient row with the valve's columns alone, as `kernel.valve_path` takes it."""
    law = valve_law(valve, sample_time)
    row = np.zeros(kernel.COEFFICIENTS + len(law.table))
    _put(row[None, :], law)
    return row


def _put(rows: FloatArray, law: ValveLaw) -> None:
    rows[:, kernel.VALVE] = law.kind
    rows[:, kernel.BAND], rows[:, kernel.OFFSET] = law.band, law.offset
    rows[:, kernel.BAND_DOWN], rows[:, kernel.OFFSET_DOWN] = law.band_down, law.offset_down
    rows[:, kernel.PLACES] = 0 if law.kind == kernel.KARNOPP else len(law.table) // 3
    rows[:, kernel.COEFFICIENTS :] = law.table


def _same_both_ways(kind: int, band: float, offset: float) -> ValveLaw:
    return ValveLaw(kind, band, offset, band, offset)


@np.errstate(over="ignore", invalid="ignore")  # such a run diverges, and its figures say so
def coefficients(loop: Loop, stem_offset: float = 0.0, tunings: FloatArray | None = None) -> FloatArray:
    """Return coefficient rows, shape (M, COEFFICIENTS or more), of a loop with its own controller (M = 1).

    With `tunings`, shape (M, 3) of (Kc, Ti, Td) in the controller's own form, one row for each; that of a tuning which
    is refused for its back-calculation (see `PID.check_tracking`) makes every run nan. Raises `InvalidValue` where a
    controller has no ideal equivalent.
    """
    if tunings is None:
        tunings = np.array([[loop.controller.Kc, loop.controller.Ti, loop.controller.Td]])
    pid, Ts = loop.controller, loop.scan * loop.sample_time
    same = _untuned(loop, stem_offset)
    rows = np.empty((tunings.shape[0], same.size))
    Kc, Ti, Td, Tf, weight = _ideal_terms(pid, tunings)
    signed = pid.signed_gain * Kc
    terms = np.empty((TERMS, tunings.shape[0]))
    terms[0] = signed
    terms[1] = signed * Ts / Ti
    terms[2] = signed * Td
    terms[3] = Tf
    terms[4] = Tf + Ts
    terms[5] = weight
    terms[6] = Ts / (Ti if pid.tracking_time is None else pid.tracking_time)
    if pid.output_limits is not None and pid.anti_windup == "back_calculation":
        terms[5, terms[6] >= 2.0] = math.nan
    _fill(rows, same, terms)
    return rows


@compiled
def _fill(rows: FloatArray, same: FloatArray, terms: FloatArray) -> None:
    """Write what all rows share, then each one's own: in one pass, as searches ask for millions of rows."""
    for i in range(rows.shape[0]):
        for j in range(same.size):
            rows[i, j] = same[j]
        rows[i, kernel.KC] = terms[0, i]
        rows[i, kernel.KI] = terms[1, i]
        rows[i, kernel.KD] = terms[2, i]
        rows[i, kernel.TF] = terms[3, i]
        rows[i, kernel.TF_TS] = terms[4, i]
        rows[i, kernel.WEIGHT] = terms[5, i]
        rows[i, kernel.TS_TT] = terms[6, i]


@lru_cache(maxsize=32)
def _untuned(loop: Loop, stem_offset: float) -> FloatArray:
    """Return a loop's row without what its tuning gives; kept, as searches ask for the same loop's again and again."""
    pid, Ts = loop.controller, loop.scan * loop.sample_time
    law = valve_law(loop.valve, loop.sample_time)
    row = np.zeros(kernel.COEFFICIENTS + len(law.table))
    _put(row[None, :], law)
    row[kernel.ON_PV] = float(pid.derivative_on == "pv")
    row[kernel.BIAS] = stem_offset
    row[kernel.LOW], row[kernel.HIGH] = (-math.inf, math.inf) if pid.output_limits is None else pid.output_limits
    row[kernel.WINDUP] = float(pid.anti_windup == "back_calculation")
    row[kernel.RESOLUTION] = pid.output_resolution
    for column, value in _compensation(pid.compensator, Ts).items():
        row[column] = value
    plant = discretise(loop.plant, loop.sample_time)
    row[kernel.POLE], row[kernel.GAIN] = plant.pole, plant.gain * loop.direction
    row[kernel.CURVE], row[kernel.SCAN] = loop.curve, loop.scan
    row[kernel.C0], row[kernel.C1], row[kernel.DELAY] = plant.c0, plant.c1, plant.delay
    row.setflags(write=False)
    return row


def _compensation(given: Compensator | None, Ts: float) -> dict[int, float]:
    """Return a compensator's columns and their values; what is not among them is 0."""
    c = kernel
    match given:
        case None:
            return {}
        case IntegralDeadband():
            return {c.COMPENSATOR: c.RESET_BAND, c.SIZE: given.band, c.LEVEL: 1.0 / given.ratio}
        case Knocker():
            every, width = round(given.period / Ts), round(given.width / Ts)
            return {c.COMPENSATOR: c.KNOCKER, c.SIZE: given.amplitude, c.EVERY: every, c.WIDTH: width}
        case ConstantReinforcement():
            return {c.COMPENSATOR: c.REINFORCEMENT, c.SIZE: given.amplitude}
        case TwoMove():
            own = {c.SIZE: given.amplitude, c.EVERY: round(given.at / Ts), c.LEVEL: given.steady_output}
            return {c.COMPENSATOR: c.TWO_MOVES, **own, c.EXTRA: given.release}
        case Dither():
            n = round(given.period / Ts)
            if given.shape == "square":
                return {c.COMPENSATOR: c.SQUARE, c.SIZE: given.amplitude, c.EVERY: n}
            a, half, whole = given.amplitude, math.pi / n, 2.0 * math.pi / n
            start = {c.SIZE: a * math.sin(half), c.WIDTH: a * math.cos(half)}
            return {c.COMPENSATOR: c.SINE, c.EVERY: n, **start, c.LEVEL: math.cos(whole), c.EXTRA: math.sin(whole)}


def _ideal_terms(pid: PID, tunings: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Columns Kc, Ti, Td, Tf and setpoint weight of the equivalent ideal form."""
    Kc, Ti, Td = tunings[:, 0], tunings[:, 1], tunings[:, 2]
    if pid.form == "ideal":
        return Kc, Ti, Td, Td / pid.derivative_filter, np.full(Kc.size, pid.setpoint_weight)
    # Row by row only where the forms' plain formulas do not hold; `PID.ideal_terms` is the reference for both.
    if pid.form == "series" and bool(np.isfinite(Ti).all()):
        Tf, b = Td / pid.derivative_filter, pid.setpoint_weight
        weight = (b * Ti + Td) / (Ti + Td) if pid.derivative_on == "error" else b * Ti / (Ti + Td)
        return Kc * (1.0 + Td / Ti), Ti + Td, Td * (Ti - Tf) / (Ti + Td), Tf, weight
    if pid.form == "parallel" and bool((Kc > 0.0).all()):
        return Kc, Kc * Ti, Td / Kc, Td / Kc / pid.derivative_filter, np.full(Kc.size, pid.setpoint_weight)
    terms = [replace(pid, Kc=row[0], Ti=row[1], Td=row[2]).ideal_terms() for row in tunings.tolist()]
    columns = np.array([(t.Kc, t.Ti, t.Td, t.Tf, t.b) for t in terms]).reshape(-1, 5).T
    return columns[0], columns[1], columns[2], columns[3], columns[4]


def rest(row: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the kernel's state and past at rest for a coefficient row."""
    state = np.zeros(kernel.STATES)
    state[kernel.U_LAST] = row[kernel.BIAS]
    return state, np.zeros(int(row[kernel.DELAY]) + 1)
