"""`wb.cascade_cycle`: the long run of a cascade without noise, and how its cycle appears in both loops."""

from __future__ import annotations

import cmath
import itertools
import math
from collections.abc import Callable
from dataclasses import fields, replace

import numpy as np
from numpy.typing import NDArray

from workbench.analyze.half_cycles import Block, fresh_carry
from workbench.model.cascade import Appearance, Cascade, CascadeCycle, CascadeExperiment, CascadeRun
from workbench.model.checks import callback, instance
from workbench.model.experiment import Experiment
from workbench.model.numbers import given as plain
from workbench.model.record import FloatArray
from workbench.simulate import events, kernel
from workbench.simulate.cascade import CascadeSignals, CascadeState, cascade_run, cascade_signals

__all__ = ["cascade_cycle"]

# Samples at most after the experiment, of one piece, and before a cycle is late; reversals in the blocks that must
# agree in period and in the secondary's swing, and how well.
BUDGET, PIECE, LEAST = 500_000, 16_384, 50_000
FIRST_BLOCK, LAST_BLOCK = 16, 512
ALIKE = 0.03
# Cycles that the appearance is read from, where the run's last piece holds so many.
CYCLES = 24
# Of the stick band (its worth in PV): what counts as no motion, a reversal; PV beyond this many of it has run away.
STILL, DUST, AWAY = 1e-8, 1e-10, 1e7


def cascade_cycle(
    cascade: Cascade, experiment: Experiment, *, progress: Callable[[float], None] | None = None
) -> CascadeCycle:
    """Return what a cascade does in the long run after an experiment, its last values held and without noise.

    The run is followed sample by sample, for at most 500,000 samples after the experiment. Cycles: after 50,000 of
    them, successive blocks of 16, 32, .. 512 reversals of the stem agree (period and swing of the secondary's PV within
    3 %); settles: stem and both PVs stand still; else undecided. The figures are of the last 24 cycles or fewer, phases
    those of the fundamental at their mean period. progress: called with the share of the budget done. Raises
    `InvalidValue` for an experiment that does not fit the cascade.
    """
    instance(cascade, Cascade, "cascade", "a Cascade")
    instance(experiment, Experiment, "experiment", "an Experiment")
    callback(progress, "cascade_cycle.progress")
    quiet = replace(experiment, noise=None)
    if isinstance(quiet, CascadeExperiment):
        quiet = replace(quiet, secondary_noise=None)
    Ts, every = cascade.secondary.sample_time, cascade.every
    start = cascade_signals(cascade, quiet).samples
    # Profiles hold their last value, so that a longer experiment is the same one, left alone.
    whole = replace(quiet, duration=(start + BUDGET // every * every) * Ts)
    given = cascade_signals(cascade, whole)
    state = CascadeState(cascade, quiet.stem_offset)
    out, _ = state.run(_part(given, 0, start))
    r, band = float(given.r[-1]), _band(cascade)
    carry, kind = fresh_carry(float(out["x"][-1])), int(state.secondary[kernel.VALVE])
    halves = np.empty((0, events.HALF_CYCLE))
    first, size, before, begin = 1, FIRST_BLOCK, None, start
    piece = max(1, PIECE // every) * every
    while begin < given.samples:
        if progress is not None:
            progress((begin - start) / BUDGET)
        end = min(begin + piece, given.samples)
        part = _part(given, begin, end)
        out, branch = state.run(part)
        rows = np.empty((end - begin, events.HALF_CYCLE))
        figures = (out["y2"], out["u2"], out["x"], branch)
        count = events.collect(kind, *figures, 0.0, begin - start, DUST * band, carry, rows)
        halves = np.concatenate([halves, rows[:count]])
        late = cascade_run(cascade, whole, part, out, branch, rested=False)
        if not max(abs(late.primary.final_pv), abs(late.secondary.final_pv)) <= AWAY * _reach(cascade, r):
            return CascadeCycle(cascade, "undecided", "PV grows without bound", late=late)
        if _still(late, band):
            error = r - late.primary.final_pv
            there = abs(error) <= 10.0 * STILL * max(abs(r), band)
            where = "on its setpoint" if there else f"with an error of {error:+.3g} EU"
            reason = f"both loops come to rest, the primary {where}"
            return CascadeCycle(cascade, "settles", reason, late=late)
        while halves.shape[0] >= first + size:
            block = Block(halves[first : first + size], Ts)
            if before is not None and end - start >= LEAST and _agree(before, block):
                return _seen(cascade, block, late)
            first, size, before = first + size, min(2 * size, LAST_BLOCK), block
        begin = end
    hours = (given.samples - start) * Ts / 3600.0
    return CascadeCycle(cascade, "undecided", f"the stem makes no even cycle within {plain(hours, 3)} h", late=late)


def _part(given: CascadeSignals, begin: int, end: int) -> CascadeSignals:
    return CascadeSignals(*(getattr(given, field.name)[begin : end + 1] for field in fields(given)))


def _band(cascade: Cascade) -> float:
    """What a motion of the stem is measured by, %: its stick band, or 1 without any."""
    return max(cascade.secondary.valve.stick_band, cascade.secondary.valve.slip_jump) or 1.0


def _reach(cascade: Cascade, r: float) -> float:
    return max(1.0, abs(r), _band(cascade) * abs(cascade.secondary.plant.gain))


def _still(late: CascadeRun, band: float) -> bool:
    """Whether the stem and both PVs have stood still over the second half of a piece, but for rounding."""
    tail = late.time.size // 2
    signals = (late.secondary.valve, late.secondary.pv, late.primary.pv)
    return all(float(np.ptp(s[tail:])) <= STILL * band + 1e-12 * float(np.abs(s[tail:]).max()) for s in signals)


def _agree(before: Block, block: Block) -> bool:
    return (
        block.pv_peak_to_peak > 0.0
        and abs(block.period - before.period) <= ALIKE * before.period
        and abs(block.pv_peak_to_peak - before.pv_peak_to_peak) <= ALIKE * before.pv_peak_to_peak
    )


def _seen(cascade: Cascade, block: Block, late: CascadeRun) -> CascadeCycle:
    """The cycle's appearance, over whole cycles at the end of the latest piece."""
    Ts, x = cascade.secondary.sample_time, late.secondary.valve
    turns = _upward_turns(x, DUST * _band(cascade))[-CYCLES - 1 :]
    if turns.size < 2:
        reason = f"a cycle of {plain(block.period, 4)} s, longer than what is kept of the run"
        return CascadeCycle(cascade, "cycles", reason, block.period, block.travel_per_hour, late=late)
    cycles = slice(int(turns[0]), int(turns[-1]))
    period = (cycles.stop - cycles.start) * Ts / (turns.size - 1)
    stem = _fundamental(x[cycles], period / Ts)

    def seen(pv: FloatArray, sp: FloatArray, op: FloatArray) -> Appearance:
        swings, amplitudes, phases = [], [], []
        for signal in (pv, sp, op):
            parts = [signal[a:b] for a, b in itertools.pairwise(turns.tolist())]
            swings.append(float(np.median([np.ptp(part) for part in parts])))
            wave = _fundamental(signal[cycles], period / Ts)
            amplitudes.append(abs(wave))
            moves = swings[-1] > 1e-12 * float(np.abs(signal[cycles]).max())
            phases.append(math.degrees(cmath.phase(stem / wave)) % 360.0 if moves and wave != 0.0 else math.nan)
        return Appearance(*swings, *amplitudes, *phases)

    one, two = late.primary, late.secondary
    return CascadeCycle(
        cascade=cascade,
        outcome="cycles",
        reason="successive blocks of the stem's reversals agree",
        period=block.period,
        travel_per_hour=block.travel_per_hour,
        primary=seen(one.pv, one.sp, one.op),
        secondary=seen(two.pv, two.sp, two.op),
        late=late,
    )


def _upward_turns(x: FloatArray, dust: float) -> NDArray[np.int64]:
    """The samples at which the stem begins to move up after having moved down."""
    moves = np.diff(x)
    moved = np.flatnonzero(np.abs(moves) > dust)
    up = moves[moved] > 0.0
    return np.asarray(moved[1:][up[1:] & ~up[:-1]] + 1, dtype=np.int64)


def _fundamental(signal: FloatArray, samples: float) -> complex:
    """Amplitude and phase at a period of so many samples, over whole cycles."""
    turn = np.exp(-2j * math.pi / samples * np.arange(signal.size))
    return complex(2.0 / signal.size * np.dot(signal - signal.mean(), turn))
