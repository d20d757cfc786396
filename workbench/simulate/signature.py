"""`wb.signature`: a valve on the test bench, where its input is moved slowly to and fro and then in small steps."""

from __future__ import annotations

import math
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InvalidValue
from workbench.model.analyses import Signature
from workbench.model.checks import instance, number
from workbench.model.record import FloatArray
from workbench.model.valve import Directional, Valve
from workbench.simulate import kernel
from workbench.simulate.coefficients import valve_row

__all__ = ["signature"]

Levels = NDArray[np.int64]

# In the largest of the valve's widths (stick band, jump, hold), or in % for a valve without friction: half the ramp.
# Steps in a width and in a jump by default, and at most then; in a width at least and at most. Steps are held so long,
# in samples, that every stem comes to rest.
REACH, STEPS_A_WIDTH, STEPS_A_JUMP, FINEST, FEWEST, MOST, HELD = 4, 200, 20, 4000, 5, 100_000, 4
BENCH = 1.0  # s a sample


def signature(valve: Valve, *, step: float | None = None) -> Signature:
    """Simulate a valve's signature: a slow ramp up, down and up again, and small steps up and down.

    step: size of the ramp's and of the small steps, %, between a 5th and a 100,000th of the valve's largest width
    (stick band, jump, hold); by default a 200th of it, or less, down to a 4,000th, for a 20th of the jump. The dead
    band is the largest change of the input after a turn that did not move the stem, the resolution the largest one in
    the same direction, over small steps that are held until the stem rests; true values lie at most a step above. Each
    turn is made where the stem has just moved, as elsewhere a stem that moves in stairs may rest anywhere within its
    stair. By the laws the dead band is S and the resolution J of every valve; `Directional` has its own pair for each
    way, `Positional` its own at each place, and `Karnopp`, of which each step of the ramp takes 1 s, what its motion
    makes of its friction.

    Terms and procedure follow ANSI/ISA-TR75.25.02-2000, "Control valve response measurement from step inputs"; the
    input is OP as the valve sees it, without positioner or transmitter. Raises `InvalidValue`.
    """
    instance(valve, get_args(Valve), "signature.valve", "one of the valve types")
    ways = (valve.up, valve.down) if isinstance(valve, Directional) else (valve,)
    width = max(w for v in ways for w in (v.stick_band, v.slip_jump, v.hold)) or 1.0
    least = min((v.slip_jump for v in ways if v.slip_jump > 0.0), default=width)
    size = max(width / FINEST, min(width / STEPS_A_WIDTH, least / STEPS_A_JUMP))
    if step is not None:
        size = number(step, "signature.step", above=0.0, unit="%")
    count = math.ceil(width / size - 1e-9)
    if not FEWEST <= count <= MOST:
        allowed = f"must lie between {width / MOST:g} and {width / FEWEST:g} % for this valve"
        raise InvalidValue("signature.step", f"{size:g} %", allowed)
    ramp, steps = _Bench(valve, size), _Bench(valve, size)
    _, down, up = (ramp.sweep(way * REACH * count, count) for way in (1, -1, 1))
    steps.sweep(2 * count, count)
    begin = steps.level
    rise, fall = (steps.sweep(begin + way * count, count, HELD) for way in (3, -2))
    return Signature(
        valve=valve,
        step=size,
        ramp_op=ramp.op,
        ramp_stem=ramp.stem,
        steps_op=steps.op,
        steps_stem=steps.stem,
        dead_band_down=ramp.dead_band(down),
        dead_band_up=ramp.dead_band(up),
        resolution_up=steps.resolution(rise),
        resolution_down=steps.resolution(fall),
    )


class _Bench:
    """A valve whose input is moved in whole steps from 0; keeps the input's levels and the stem's path."""

    def __init__(self, valve: Valve, size: float) -> None:
        self._row, self._size = valve_row(valve, BENCH), size
        self._levels, self.stem = np.zeros(1, np.int64), np.zeros(1)
        self._state = np.zeros(kernel.STATES)

    @property
    def op(self) -> FloatArray:
        """The input, %, shape (N,)."""
        return _input(self._levels, self._size)

    @property
    def level(self) -> int:
        """The input's present level, steps."""
        return int(self._levels[-1])

    def sweep(self, target: int, further: int, held: int = 1) -> range:
        """Move the input to a level, each level held so many samples, and on until the stem moves; return the samples.

        At most `further` levels on.
        """
        way = 1 if target > self.level else -1
        levels = np.repeat(np.arange(self.level + way, target + way * (further + 1), way), held)
        moved = np.flatnonzero(np.diff(self._path(levels)[0], prepend=self.stem[-1]))
        there = moved[(levels[moved] - target) * way >= 0]
        if there.size:
            levels = levels[: (int(there[0]) // held + 1) * held]
        path, self._state = self._path(levels)
        begin = self.stem.size
        self._levels, self.stem = np.concatenate([self._levels, levels]), np.concatenate([self.stem, path])
        return range(begin, self.stem.size)

    def _path(self, levels: Levels) -> tuple[FloatArray, FloatArray]:
        path, state = np.empty(levels.size), self._state.copy()
        kernel.valve_path(self._row, _input(levels, self._size), state, path)
        return path, state

    def _moves(self, part: range) -> Levels:
        """The samples of a sweep in which the stem moves."""
        return part.start + np.flatnonzero(np.diff(self.stem[part.start - 1 : part.stop]))

    def dead_band(self, part: range) -> float:
        """Return the largest change since the turn at which a sweep begins that moved nothing, %."""
        first = int(self._moves(part)[0])
        return float(abs(self._levels[first] - self._levels[part.start - 1]) - 1) * self._size

    def resolution(self, part: range) -> float:
        """Return the largest change between two moves of a sweep that moved nothing, %."""
        gaps = np.abs(np.diff(self._levels[self._moves(part)]))
        return float(gaps.max() - 1) * self._size


def _input(levels: Levels, size: float) -> FloatArray:
    return levels.astype(np.float64) * size
