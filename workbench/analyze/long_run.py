"""One start followed exactly and noise-free until its fate is decided: it settles, it cycles, or neither can be said.

The kernel runs in chunks and keeps its state. Blocks of stem reversals decide on a cycle, not the recurrence of a
state: the setpoint's place between the stem positions drifts over many cycles, and hardly any run repeats itself.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from workbench.analyze import half_cycles
from workbench.analyze.frequency import linear_stable
from workbench.analyze.half_cycles import Block
from workbench.model.loop import Loop
from workbench.model.plant import FOPDT
from workbench.model.record import FloatArray
from workbench.model.results import LimitCycleStart
from workbench.model.valve import Stenman
from workbench.simulate import kernel
from workbench.simulate.coefficients import coefficients
from workbench.simulate.run import rest
from workbench.simulate.signals import Signals

__all__ = ["BUDGET", "Start", "follow"]

# Samples per start: at most, and at least before a cycle is called late (fast ones may dwell on a plateau first).
BUDGET, LEAST = 2_000_000, 100_000
FIRST_CHUNK, LONGEST_CHUNK = 2048, 65536
# Reversals in the first block, each next one twice as long; how well successive ones must agree, and how often in turn.
FIRST_BLOCK, LAST_BLOCK = 16, 1024
PERIOD_TOLERANCE, SWING_TOLERANCE = 0.03, 0.02
AGREEMENTS = 2
# At the budget's end: fewer reversals still show a cycle, as long as PV's swing varies by no more than this.
FEWEST, STEADY = 8, 0.15
# Of the stick band: what counts as no motion any more, as a reversal, as an error too small to matter at the budget's
# end; PV beyond this many of it has run away.
STILL, DUST, CREPT, AWAY = 1e-8, 1e-10, 1e-4, 1e7


@dataclass(frozen=True, eq=False)
class Start:
    """A start: its name, the stem's offset (%), and the signals until they last change (r and load then stay)."""

    name: str
    stem_offset: float
    given: Signals


@dataclass(frozen=True, slots=True)
class _Scale:
    """Sizes against which to judge: the stick band (%), what it is worth in PV (EU)."""

    band: float
    pv: float


class _Follower:
    """One run: the kernel's state, its latest chunk, and the half cycles since the signals last changed."""

    def __init__(self, loop: Loop, start: Start) -> None:
        self.loop = loop
        self.row = coefficients(loop, start.stem_offset)[0]
        self.state, self.past = rest(self.row)
        self.r, self.load = float(start.given.r[-1]), float(start.given.load[-1])
        self.scale = _scale(loop, self.r)
        self.y, self.u, self.x = np.zeros(1), np.zeros(0), np.zeros(0)
        self.limited = False  # OP at a limit, or held by clamping, throughout the latest chunk's second half
        self._prelude(start.given)
        self.carry = half_cycles.fresh_carry(float(self.state[kernel.X_LAST]))
        self.samples = 0
        # Row 0 starts with the first move, the others with a reversal.
        self.halves = np.empty((0, half_cycles.COLUMNS))

    def _prelude(self, given: Signals) -> None:
        """Run what comes before the signals' last change."""
        changes = np.flatnonzero((np.diff(given.r) != 0.0) | (np.diff(given.load) != 0.0))
        until = int(changes[-1]) + 1 if changes.size else 0
        for first in range(0, until, LONGEST_CHUNK):
            stop = min(first + LONGEST_CHUNK, until)
            self._run(given.r[first:stop], given.load[first:stop])

    def _run(self, r: FloatArray, load: FloatArray) -> None:
        n = r.size
        self.y, self.u, self.x = np.empty(n + 1), np.empty(n), np.empty(n)
        branch, noise = np.empty(n, np.int8), np.zeros(n)
        kernel.run_loop(self.row, r, load, noise, self.state, self.past, self.y, self.u, self.x, np.empty(n), branch)
        late = branch[n // 2 :]
        self.limited = bool(((late % 9 // 3 != 1) | (late >= 9)).all())

    def advance(self, n: int) -> None:
        """Run n more samples at constant setpoint and load, and gather the half cycles that end in them."""
        self._run(np.full(n, self.r), np.full(n, self.load))
        rows = np.empty((n, half_cycles.COLUMNS))
        dust = DUST * self.scale.band
        count = half_cycles.collect(self.y, self.u, self.x, self.r, self.samples, dust, self.carry, rows)
        if count:
            self.halves = np.concatenate([self.halves, rows[:count]])
        self.samples += n

    def runs_away(self) -> str:
        """Return why PV leaves every bound, or an empty string."""
        reach = AWAY * self.scale.pv + 1e3 * abs(self.r)
        if not float(np.abs(self.y).max()) <= reach:  # nan has run away too
            if linear_stable(self.loop):
                return "PV grows without bound, although the loop is stable with an ideal valve"
            return "the loop is unstable: PV grows without bound"
        if isinstance(self.loop.plant, FOPDT):
            return ""
        v = float(self.x[-1]) + self.load
        if self.row[kernel.KC] == 0.0 and self.row[kernel.KD] == 0.0 and v != 0.0:
            return "there is no feedback: PV drifts without end"
        tail = self.u.size // 2
        error = np.abs(self.r - self.y[tail:])
        stuck = tail > self.past.size and float(np.ptp(self.x[tail:])) == 0.0
        if stuck and self.limited and bool((np.diff(error) > 0.0).all()):
            return "OP stands at its limit, and PV drifts away without end"
        return ""

    def settled(self) -> str:
        """Return how the loop has come to rest, or an empty string."""
        tail = self.u.size // 2
        if tail <= self.past.size:
            return ""
        y, u, x = self.y[tail:], self.u[tail:], self.x[tail:]
        still_u = STILL * self.scale.band + 1e-12 * float(np.abs(u).max())
        still_y = STILL * self.scale.pv + 1e-12 * (float(np.abs(y).max()) + abs(self.r))
        if np.ptp(u) > still_u or np.ptp(x) > still_u or np.ptp(y) > still_y:
            return ""
        error = self.r - float(y[-1])
        if abs(error) <= 10.0 * still_y:
            return "PV comes to rest on the setpoint"
        if self.row[kernel.KI] == 0.0:
            return f"PV comes to rest with an error of {error:+.3g} EU, as no integral action moves the stem on"
        if self.limited:
            return f"PV comes to rest with an error of {error:+.3g} EU, as OP is at its limit"
        return ""

    def calms_down(self) -> bool:
        """Return whether OP's swing shrinks over the latest chunk, away from the limits."""
        half = self.u.size // 2
        return not self.limited and bool(np.ptp(self.u[half:]) <= np.ptp(self.u[:half]))


def follow(loop: Loop, start: Start) -> LimitCycleStart:
    """Follow one start for at most `BUDGET` samples after the last change of its signals; see the module's head.

    Settles: OP, stem and PV have stood still, to 1e-8 of the stick band, and nothing will move the stem: the error is 0
    as well, or there is no integral action, or OP is at its limit. Cycles: after at least `LEAST` samples, the latest
    three blocks of 16, 32, .. 1,024 stem reversals agree in turn (period 3 %, PV's swing 2 %), or the budget is spent
    and PV's swing is steady; the last block gives the figures, `reason` says how steady they are. Undecided: PV grows
    without bound, or the budget is spent without that. `window` runs from the last change of the signals to the end of
    the first full cycle.
    """
    run = _Follower(loop, start)
    # Without friction the loop is linear while within its limits, and slow damping is no cycle.
    linear = loop.valve.stick_band == loop.valve.slip_jump == 0.0 and linear_stable(loop)
    damped = linear and loop.controller.output_limits is None
    longest = max(LONGEST_CHUNK, 4 * run.past.size)
    chunk = max(FIRST_CHUNK, min(4 * run.past.size, longest))
    first, size, before, agreed = 1, FIRST_BLOCK, None, 0
    while run.samples < BUDGET:
        run.advance(min(chunk, BUDGET - run.samples))
        chunk = min(2 * chunk, longest)
        reason = run.runs_away()
        if reason:
            return _no_cycle(start, "undecided", reason)
        reason = run.settled()
        if reason:
            return _no_cycle(start, "settles", reason)
        while not damped and run.halves.shape[0] >= first + size:
            block = Block(run.halves[first : first + size], loop.sample_time)
            agreed = agreed + 1 if before is not None and _agree(before, block) else 0
            first, size, before = first + size, min(2 * size, LAST_BLOCK), block
        if before is not None and agreed >= AGREEMENTS and run.samples >= LEAST:
            return _cycle(run, start, before, "successive blocks of reversals agree")
    if linear and run.calms_down():
        return _no_cycle(start, "settles", "the valve does not stick, and the loop is linear and stable")
    # A stem at rest under a constant error is pushed on by the integral action: only a moving one creeps.
    creeps = bool(np.ptp(run.x[run.x.size // 2 :]) > 0.0) and not isinstance(loop.valve, Stenman)
    if creeps and float(np.abs(run.r - run.y).max()) <= CREPT * run.scale.pv:
        return _no_cycle(start, "settles", f"PV creeps onto the setpoint (within {CREPT:g} of the stick band by now)")
    return _spent(run, start)


def _spent(run: _Follower, start: Start) -> LimitCycleStart:
    """The verdict at the end of the budget: a few slow cycles, a drifting or irregular one, or none that shows."""
    Ts, end = run.loop.sample_time, run.halves.shape[0]
    half = (end - 1) // 4 * 2
    simulated = f"{run.samples * Ts:.4g} s"
    if 2 * half < FEWEST:
        return _no_cycle(start, "undecided", f"fewer than {FEWEST} reversals of the stem within {simulated}")
    before, block = Block(run.halves[end - 2 * half : end - half], Ts), Block(run.halves[end - half :], Ts)
    if _agree(before, block):
        return _cycle(run, start, block, "successive blocks of reversals agree")
    if before.pv_peak_to_peak == 0.0:
        return _no_cycle(start, "undecided", "the stem chatters, but PV does not move")
    swing = block.pv_peak_to_peak / before.pv_peak_to_peak - 1.0
    if abs(swing) <= STEADY:
        period = block.period / before.period - 1.0
        reason = f"the last {half} of {end} reversals differ from those before by {100 * period:+.2g} % in period"
        return _cycle(run, start, block, reason)
    return _no_cycle(start, "undecided", f"after {simulated} PV's swing still changes ({100 * swing:+.2g} %)")


def _agree(before: Block, block: Block) -> bool:
    period, swing = before.period, before.pv_peak_to_peak
    return (
        swing > 0.0
        and abs(block.period - period) <= PERIOD_TOLERANCE * period
        and abs(block.pv_peak_to_peak - swing) <= SWING_TOLERANCE * swing
    )


def _cycle(run: _Follower, start: Start, block: Block, reason: str) -> LimitCycleStart:
    Ts, halves = run.loop.sample_time, run.halves
    return LimitCycleStart(
        name=start.name,
        outcome="cycles",
        reason=reason,
        first_period=float(halves[2, half_cycles.END] - halves[1, half_cycles.START]) * Ts,
        period=block.period,
        pv_peak_to_peak=block.pv_peak_to_peak,
        op_peak_to_peak=block.op_peak_to_peak,
        mean_square_error=block.mean_square_error,
        travel_per_hour=block.travel_per_hour,
        window=float(halves[2, half_cycles.END]) * Ts,
    )


def _no_cycle(start: Start, outcome: str, reason: str) -> LimitCycleStart:
    nan = math.nan
    return LimitCycleStart(start.name, outcome, reason, nan, nan, nan, nan, nan, nan, nan)


def _scale(loop: Loop, r: float) -> _Scale:
    band = max(loop.valve.stick_band, loop.valve.slip_jump)
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
