"""One start followed exactly and noise-free until its fate is decided: it settles, it cycles, or neither can be said.

The run goes from slip to slip (`simulate.events.run_events`), so that a cycle of hours costs what one of seconds does.
Blocks of stem reversals decide on a cycle, not the recurrence of a state: the setpoint's place between the stem
positions drifts over many cycles, and hardly any run repeats itself.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from workbench.analyze.frequency import linear_stable
from workbench.analyze.half_cycles import Block, fresh_carry
from workbench.model.analyses import Waveform
from workbench.model.loop import Loop
from workbench.model.numbers import given
from workbench.model.plant import FOPDT
from workbench.model.record import FloatArray
from workbench.model.results import LimitCycleStart
from workbench.simulate import events, kernel
from workbench.simulate.coefficients import coefficients, rest
from workbench.simulate.signals import Signals

__all__ = ["BUDGET", "Start", "follow"]

# Per start, samples that the kernel runs one by one: at most. Samples and reversals before a cycle is called late (fast
# ones may dwell on a plateau first, slow ones drift).
BUDGET, LEAST, LEAST_REVERSALS = 2_000_000, 100_000, 1000
FIRST_CHUNK, LONGEST_CHUNK = 2048, 65536
# Samples within which a resting stem slips, or never.
NEVER = 2**40
# Reversals in the first block, each next one twice as long; how well successive ones must agree, and how often in turn.
FIRST_BLOCK, LAST_BLOCK = 16, 1024
PERIOD_TOLERANCE, SWING_TOLERANCE = 0.03, 0.02
AGREEMENTS = 2
# At the budget's end: fewer reversals still show a cycle, as long as PV's swing varies by no more than this.
FEWEST, STEADY = 8, 0.15
# Of the stick band: what counts as no motion any more, as a reversal, as an error too small to matter at the budget's
# end; PV beyond this many of it has run away.
STILL, DUST, CREPT, AWAY = 1e-8, 1e-10, 1e-4, 1e7
# A stem that slides one way: the error below which (of the band) it is asked whether it shrinks in even ratios, and how
# even they must be.
SLID, EVEN = 1e-2, 0.02
SLIDES = "the stem slides onto the setpoint without turning"
# Points of a waveform's trace, and its length in periods: enough for one cycle from turn to turn.
POINTS, TRACED = 800, 3.3


@dataclass(frozen=True, eq=False)
class Start:
    """A start: its name, the stem's offset (%), and the signals until they last change (r and load then stay).

    The load is in OP's direction, as `simulate.run.signals` has it.
    """

    name: str
    stem_offset: float
    given: Signals


@dataclass(frozen=True, slots=True)
class _Scale:
    """Sizes against which to judge: the stick band (%), what it is worth in PV (EU)."""

    band: float
    pv: float


class _Follower:
    """One run: the kernel's state, the chunk last looked at, and the half cycles since the signals last changed."""

    def __init__(self, loop: Loop, start: Start, traced: bool) -> None:
        self.loop, self.traced = loop, traced
        self.row = coefficients(loop, start.stem_offset)[0]
        self.table = np.empty((events.DOUBLINGS, events.FILTER_SUM + 1))
        events.doublings(self.row, self.table)
        self.state, self.past = rest(self.row)
        self.r, self.load = float(start.given.r[-1]), float(start.given.load[-1])
        self.scale = _scale(loop, self.r)
        self.y, self.u, self.x = np.zeros(1), np.zeros(0), np.zeros(0)
        self.branch = np.zeros(0, np.int8)
        self.limited = False  # OP at a limit, or held by clamping, throughout the latest chunk's second half
        self._prelude(start.given)
        self.carry = fresh_carry(float(self.state[kernel.X_LAST]))
        self.samples = self.worked = 0
        self._kept, self._filled = np.empty((1024, events.HALF_CYCLE)), 0

    @property
    def halves(self) -> FloatArray:
        """The half cycles so far; row 0 starts with the first move, the others with a reversal."""
        return self._kept[: self._filled]

    def _prelude(self, given: Signals) -> None:
        """Run what comes before the signals' last change."""
        changes = np.flatnonzero((np.diff(given.r) != 0.0) | (np.diff(given.load) != 0.0))
        until = int(changes[-1]) + 1 if changes.size else 0
        for first in range(0, until, LONGEST_CHUNK):
            stop = min(first + LONGEST_CHUNK, until)
            self._run(given.r[first:stop], given.load[first:stop])

    def _run(self, r: FloatArray, load: FloatArray) -> None:
        n = r.size
        self.y, self.u, self.x, self.branch = np.empty(n + 1), np.empty(n), np.empty(n), np.empty(n, np.int8)
        signals = (r, load, np.zeros(n))
        kernel.run_loop(self.row, *signals, self.state, self.past, self.y, self.u, self.x, np.empty(n), self.branch)
        late = self.branch[n // 2 :]
        self.limited = bool(((late % 9 // 3 != 1) | (late >= 9)).all())

    def advance(self, work: int, wanted: int) -> int:
        """Run on for about `work` samples of the kernel, or `wanted` half cycles; gather these; return the ending."""
        rows = np.empty((wanted + max(4 * self.past.size + 4, 1024), events.HALF_CYCLE))
        dust, still, reach = DUST * self.scale.band, 10.0 * STILL * self.scale.pv, self._reach()
        given = (self.row, self.r, self.load, self.state, self.past, self.table, NEVER, work)
        samples, worked, count, ended = events.run_events(*given, self.samples, dust, still, reach, self.carry, rows)
        self._count(samples, worked, rows[:count])
        return ended

    def look(self, n: int) -> None:
        """Run n more samples one by one, and keep them to be looked at."""
        self._run(np.full(n, self.r), np.full(n, self.load))
        rows = np.empty((n, events.HALF_CYCLE))
        dust, kind = DUST * self.scale.band, int(self.row[kernel.VALVE])
        kept = (self.y, self.u, self.x, self.branch)
        count = events.collect(kind, *kept, self.r, self.samples, dust, self.carry, rows)
        self._count(n, n, rows[:count])

    def _count(self, samples: int, worked: int, rows: FloatArray) -> None:
        filled = self._filled + rows.shape[0]
        if filled > self._kept.shape[0]:
            # Doubled, so that a drifting loop's many thousands are copied a few times, not at every block.
            self._kept = np.concatenate([self.halves, np.empty((filled, events.HALF_CYCLE))])
        self._kept[self._filled : filled] = rows
        self._filled = filled
        self.samples += samples
        self.worked += worked

    def _reach(self) -> float:
        return AWAY * self.scale.pv + 1e3 * abs(self.r)

    def away(self) -> str:
        """Return what a PV beyond every bound means."""
        if linear_stable(self.loop):
            return "PV grows without bound, although the loop is stable with an ideal valve"
        return "the loop is unstable: PV grows without bound"

    def drifts(self) -> str:
        """Return why an integrating plant's PV drifts away without end, or an empty string; after a `look`."""
        if isinstance(self.loop.plant, FOPDT):
            return ""
        v = self.loop.flow(float(self.x[-1])) + self.load
        if self.row[kernel.KC] == 0.0 and self.row[kernel.KD] == 0.0 and v != 0.0:
            return "there is no feedback: PV drifts without end"
        tail = self.u.size // 2
        error = np.abs(self.r - self.y[tail:])
        stuck = tail > self.past.size and float(np.ptp(self.x[tail:])) == 0.0
        if stuck and self.limited and bool((np.diff(error) > 0.0).all()):
            return "OP stands at its limit, and PV drifts away without end"
        return ""

    def at_rest(self) -> tuple[str, str]:
        """Return (outcome, reason) of a stem that will not slip any more, once `advance` has gone on to its end."""
        error = self.r - float(self.state[kernel.Y])
        if not abs(error) <= self._reach():
            feedback = "no feedback" if self.row[kernel.KD] == 0.0 else "no feedback that lasts"
            return "undecided", f"there is {feedback}: PV drifts without end"
        if self.row[kernel.KI] == 0.0:
            return "settles", self._resting(error, "no integral action moves the stem on")
        if abs(error) <= 10.0 * STILL * self.scale.pv:
            return "settles", self._on_setpoint()
        time = NEVER * self.loop.sample_time
        return "undecided", f"the integral action needs more than {given(time, 3)} s to move the stem on"

    def settled(self) -> str:
        """Return how the loop has come to rest in the chunk looked at, or an empty string."""
        tail = self.u.size // 2
        if tail <= self.past.size:
            return ""
        y, u, x = self.y[tail:], self.u[tail:], self.x[tail:]
        still_u = STILL * self.scale.band + 1e-12 * float(np.abs(u).max())
        still_y = STILL * self.scale.pv + 1e-12 * (float(np.abs(y).max()) + abs(self.r))
        compensator = int(self.row[kernel.COMPENSATOR])
        if np.ptp(x) > still_u or np.ptp(y) > still_y or (compensator == kernel.NONE and np.ptp(u) > still_u):
            return ""
        error = self.r - float(y[-1])
        if compensator != kernel.NONE:
            return self._compensated(error, tail, still=bool(np.ptp(u) <= still_u))
        if abs(error) <= 10.0 * still_y:
            return self._on_setpoint()
        if self.row[kernel.KI] == 0.0:
            return self._resting(error, "no integral action moves the stem on")
        return self._resting(error, "OP is at its limit") if self.limited else ""

    def _compensated(self, error: float, samples: int, *, still: bool) -> str:
        """The same for a loop with a compensator whose stem and PV have stood still for so many samples."""
        row = self.row
        kind = int(row[kernel.COMPENSATOR])
        if kind == kernel.TWO_MOVES and self.state[kernel.KEPT] != 2.0:
            held = self.state[kernel.KEPT] == 1.0 and abs(error) <= row[kernel.EXTRA]
            return self._resting(error, "OP is held after the two moves") if held else ""
        if kind == kernel.RESET_BAND and still and row[kernel.LEVEL] == 0.0 and abs(error) <= row[kernel.SIZE]:
            return self._resting(error, "the integral action rests within its deadband")
        if kind in (kernel.KNOCKER, kernel.SINE, kernel.SQUARE) and samples < 2 * row[kernel.EVERY]:
            return ""
        if abs(error) <= 10.0 * STILL * self.scale.pv:
            return self._on_setpoint()
        if row[kernel.KI] == 0.0:
            return self._resting(error, "no integral action moves the stem on")
        return self._resting(error, "OP is at its limit") if self.limited and still else ""

    def _on_setpoint(self) -> str:
        """By which way PV came to rest on the setpoint; only a stem that sticks at once lands there by a slip."""
        slid = self._follows() and self.carry[events.DIRECTION] != 0.0
        return SLIDES if slid else "PV comes to rest on the setpoint"

    def _follows(self) -> bool:
        """Whether the stem sticks, but once moving follows OP: two-parameter valves and dead band."""
        valve = self.loop.valve
        return not valve.sticks_at_once and valve.stick_band + valve.slip_jump > 0.0

    def _resting(self, error: float, cause: str) -> str:
        if abs(error) <= 10.0 * STILL * self.scale.pv:
            return "PV comes to rest on the setpoint"
        return f"PV comes to rest with an error of {error:+.3g} EU, as {cause}"

    def slides(self) -> bool:
        """Return whether the stem slides one way while the error dies away as one real mode does: it will not turn.

        A moving two-parameter stem follows OP at a constant distance, so that the loop is linear: where its error
        shrinks by the same ratio over both parts of the chunk's second half, the slowest mode is all that is left.
        """
        tail = self.u.size // 2
        moves = np.diff(self.x[tail:])
        linear = self._follows() and self.row[kernel.COMPENSATOR] == kernel.NONE
        if not linear or self.row[kernel.KI] == 0.0 or tail <= 4 * self.past.size:
            return False
        if not (bool((moves > 0.0).all()) or bool((moves < 0.0).all())):
            return False
        error = self.r - self.y[tail:-1]
        half = (error.size - 1) // 2
        first, middle, last = float(error[0]), float(error[half]), float(error[2 * half])
        if first == 0.0 or middle == 0.0 or not 0.0 < last / middle < 1.0:
            return False
        return abs(middle) <= SLID * self.scale.pv and abs(last * first / middle**2 - 1.0) <= EVEN

    def calms_down(self) -> bool:
        """Return whether OP's swing shrinks over the latest chunk, away from the limits."""
        half = self.u.size // 2
        return not self.limited and bool(np.ptp(self.u[half:]) <= np.ptp(self.u[:half]))

    def waveform(self, period: float) -> Waveform | None:
        """Return one cycle of about this period (s) from here on, from one upward turn of the stem to the next."""
        Ts = self.loop.sample_time
        stride = max(1, math.ceil(TRACED * period / Ts / POINTS))
        points = np.empty((math.ceil(TRACED * period / Ts / stride) + 2, 3))
        events.trace(self.row, self.r, self.load, self.state, self.past, self.table, stride, points)
        x = points[:, 2]
        moved = np.flatnonzero(np.abs(np.diff(x)) > DUST * self.scale.band) + 1
        rising = x[moved] > x[moved - 1]
        turns = moved[1:][rising[1:] & ~rising[:-1]]
        if turns.size < 2:
            return None
        cycle = slice(int(turns[0]), int(turns[1]) + 1)
        time = np.arange(cycle.stop - cycle.start, dtype=np.float64) * (stride * Ts)
        return Waveform(time, points[cycle, 0].copy(), points[cycle, 1].copy(), points[cycle, 2].copy())


def follow(loop: Loop, start: Start, *, least: int = LEAST, traced: bool = True) -> LimitCycleStart:
    """Follow one start, with at most `BUDGET` samples of the kernel after the last change of its signals.

    Settles: the stem rests where OP will never reach the end of the stick band (known in closed form), or OP, stem and
    PV have stood still, to 1e-8 of the stick band, at OP's limit; or a two-parameter stem slides onto the setpoint.
    Cycles: after at least `least` samples and `LEAST_REVERSALS`, the latest three blocks of 16, 32, .. 1,024 stem
    reversals agree in turn (period 3 %, PV's swing 2 %), or the budget is spent and PV's swing is steady; the last
    block gives the figures, `reason` says how steady they are. Undecided: PV grows without bound, or the budget is
    spent without that. `window` runs from the last change of the signals to the end of the first full cycle. traced:
    whether the waveform of a late cycle is kept.
    """
    run = _Follower(loop, start, traced)
    # Without friction the loop is linear while within its limits, and slow damping is no cycle.
    frictionless = loop.valve.stick_band == loop.valve.slip_jump == loop.controller.output_resolution == 0.0
    linear = frictionless and loop.controller.compensator is None and linear_stable(loop)
    damped = linear and loop.controller.output_limits is None
    longest = max(LONGEST_CHUNK, 4 * run.past.size)
    chunk = max(FIRST_CHUNK, min(4 * run.past.size, longest))
    first, size, before, agreed = 1, FIRST_BLOCK, None, 0
    while run.worked < BUDGET:
        turns = run.halves.shape[0]
        ended = run.advance(min(chunk, BUDGET - run.worked), max(1, first + size - turns))
        if ended == events.AWAY:
            return _no_cycle(run, start, "undecided", run.away())
        if ended == events.RESTS:
            return _no_cycle(run, start, *run.at_rest())
        if run.halves.shape[0] == turns or frictionless:
            run.look(min(chunk, max(BUDGET - run.worked, FIRST_CHUNK)))
            reason = run.drifts()
            if reason:
                return _no_cycle(run, start, "undecided", reason)
            reason = run.settled()
            if not reason and run.slides():
                reason = SLIDES
            if reason:
                return _no_cycle(run, start, "settles", reason)
        chunk = min(2 * chunk, longest)
        while not damped and run.halves.shape[0] >= first + size:
            block = Block(run.halves[first : first + size], loop.sample_time)
            agreed = agreed + 1 if before is not None and _agree(before, block) else 0
            first, size, before = first + size, min(2 * size, LAST_BLOCK), block
        late = run.samples >= least and run.halves.shape[0] > LEAST_REVERSALS
        if before is not None and agreed >= AGREEMENTS and late:
            return _cycle(run, start, first, "successive blocks of reversals agree")
    if linear and run.calms_down():
        return _no_cycle(run, start, "settles", "the valve does not stick, and the loop is linear and stable")
    return _spent(run, start)


def _spent(run: _Follower, start: Start) -> LimitCycleStart:
    """The verdict at the end of the budget: a slow slide, few slow cycles, a drifting or irregular one, or none."""
    run.look(LONGEST_CHUNK)
    # A stem at rest under a constant error is pushed on by the integral action: only a moving one creeps.
    creeps = bool(np.ptp(run.x[run.x.size // 2 :]) > 0.0) and not run.loop.valve.sticks_at_once
    if creeps and float(np.abs(run.r - run.y).max()) <= CREPT * run.scale.pv:
        reason = f"PV creeps onto the setpoint (within {CREPT:g} of the stick band by now)"
        return _no_cycle(run, start, "settles", reason)
    Ts, end = run.loop.sample_time, run.halves.shape[0]
    half = (end - 1) // 4 * 2
    simulated = f"{given(run.samples * Ts, 4)} s"
    if 2 * half < FEWEST:
        return _no_cycle(run, start, "undecided", f"fewer than {FEWEST} reversals of the stem within {simulated}")
    before, block = Block(run.halves[end - 2 * half : end - half], Ts), Block(run.halves[end - half :], Ts)
    if _agree(before, block):
        return _cycle(run, start, end, "successive blocks of reversals agree")
    if before.pv_peak_to_peak == 0.0:
        return _no_cycle(run, start, "undecided", "the stem chatters, but PV does not move")
    swing = block.pv_peak_to_peak / before.pv_peak_to_peak - 1.0
    if abs(swing) <= STEADY:
        period = block.period / before.period - 1.0
        reason = f"the last {half} of {end} reversals differ from those before by {100 * period:+.2g} % in period"
        return _cycle(run, start, end, reason)
    return _no_cycle(run, start, "undecided", f"after {simulated} PV's swing still changes ({100 * swing:+.2g} %)")


def _agree(before: Block, block: Block) -> bool:
    period, swing = before.period, before.pv_peak_to_peak
    return (
        swing > 0.0
        and abs(block.period - period) <= PERIOD_TOLERANCE * period
        and abs(block.pv_peak_to_peak - swing) <= SWING_TOLERANCE * swing
    )


def _cycle(run: _Follower, start: Start, end: int, reason: str) -> LimitCycleStart:
    """The figures of the latter half of the first `end` reversals."""
    Ts, halves = run.loop.sample_time, run.halves
    half = (end - 1) // 4 * 2
    block = Block(halves[end - half : end], Ts)
    # Slow cycles are met long before they are late: the range holds what drifts from the first `LEAST` samples on.
    early = 1 + max(FIRST_BLOCK, int(np.searchsorted(halves[:end, events.START], LEAST)))
    begin = min(early, end - half)
    part = min(FIRST_BLOCK, half)
    first = np.arange(begin, end - part + 1, part)
    periods = 2.0 * Ts / part * (halves[first + part - 1, events.END] - halves[first, events.START])
    return LimitCycleStart(
        name=start.name,
        outcome="cycles",
        reason=reason,
        first_period=float(halves[2, events.END] - halves[1, events.START]) * Ts,
        period=block.period,
        pv_peak_to_peak=block.pv_peak_to_peak,
        op_peak_to_peak=block.op_peak_to_peak,
        mean_square_error=block.mean_square_error,
        travel_per_hour=block.travel_per_hour,
        window=float(halves[2, events.END]) * Ts,
        period_range=(min(block.period, float(periods.min())), max(block.period, float(periods.max()))),
        slips_per_hour=block.slips_per_hour,
        reversals_per_hour=block.reversals_per_hour,
        waveform=run.waveform(block.period) if run.traced else None,
    )


def _no_cycle(run: _Follower, start: Start, outcome: str, reason: str) -> LimitCycleStart:
    nan = math.nan
    found = LimitCycleStart(start.name, outcome, reason, nan, nan, nan, nan, nan, nan, nan)
    if outcome != "settles":
        return found
    y, x = float(run.state[kernel.Y]), float(run.state[kernel.X_LAST])
    return replace(found, rest_pv=y, rest_stem=x, rest_error=run.r - y)


def _scale(loop: Loop, r: float) -> _Scale:
    band = max(loop.valve.stick_band, loop.valve.slip_jump, loop.controller.output_resolution)
    gain = abs(loop.plant.gain)
    Kc = loop.controller.ideal_terms().Kc
    if isinstance(loop.plant, FOPDT):
        if band == 0.0:
            band = max(abs(r) / gain, 1e-6 / gain)
        return _Scale(band, gain * band)
    if band == 0.0:
        band = abs(r) * Kc if r != 0.0 and Kc > 0.0 else 1.0
    slow = gain * band * (loop.sample_time + loop.plant.dead_time)
    return _Scale(band, max(band / Kc, slow) if Kc > 0.0 else slow)
