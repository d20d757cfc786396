"""Load steps beside the linear loop: the rival of a stem that moves so seldom that steps of a load may look the same.

Under feedback an unseen load step spoils the plant that is fitted without it, so that its time cannot be read from what
that plant leaves: plants and steps are searched together. For each plant of a grid, with all in the measure of the
filter that whitens the noise, the step that lowers the sum of squares most is added to those before it (orthogonal
least squares; S. Chen, S. Billings, W. Luo, Int. J. Control 50 (1989) 1873-1896). A load enters where the valve does.

A stem that rests while OP ramps leaves PV as a load that ramps the other way does. Ramps are rivals as steps are: each
begins at a sample and lasts until another bends it, and one may have begun before the record.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.fft import next_fast_len

from workbench.detect.load_kernel import add_step, take
from workbench.detect.whitening import whitened
from workbench.model.record import FloatArray
from workbench.simulate.filter import first_order

__all__ = ["load_steps", "unforced"]

STANDING = 2  # what PV shows beside OP and a load: its level, and what fades of how it started
FIRST, LAST = 2, 3  # samples at the record's ends in which no step is told from the start or from noise


def unforced(sp: FloatArray | None, pv: FloatArray, reach: int) -> NDArray[np.bool_]:
    """Return the samples in which a load step may be sought, shape (N,): those that no setpoint move accounts for.

    sp, pv: EU, shape (N,); without a setpoint all. A move accounts for what comes until PV has arrived at the new
    setpoint, and `reach` samples before and after: a step's time is known to within a dead time and a lag at best, and
    one that comes with a move of the setpoint is the controller's own work and the valve's.
    """
    free = np.ones(pv.size, dtype=bool)
    if sp is None:
        return free
    for k in (np.flatnonzero(np.diff(sp)) + 1).tolist():
        arrived = (sp[k:] - pv[k:]) * np.sign(sp[k] - sp[k - 1]) <= 0.0
        stop = k + int(np.argmax(arrived)) if arrived.any() else pv.size
        free[max(k - reach, 0) : stop + reach + 1] = False
    return free


def load_steps(
    y: FloatArray,
    u: FloatArray,
    a: FloatArray,
    live: NDArray[np.bool_],
    free: NDArray[np.bool_],
    taus: FloatArray,
    delays: NDArray[np.int64],
    sign: float,
    most: int,
    ramps: bool = False,
) -> Iterator[tuple[FloatArray, list[int]]]:
    """Yield the part of PV, shape (N,), that one load step explains best beside OP, that two do, .., up to `most`.

    With it come the samples at which PV first answers each step, or is first bent by each ramp.

    y, u: PV (EU) and OP (%), shape (N,); a: the filter that whitens the noise; live: the innovations that count, free:
    the samples at which a load may step; taus, delays: the grid of plants, samples; sign: that the plant's gain must
    have, or 0. ramps: ramps in place of steps. Ends early where no plant of that sign is left, or no place.
    """
    if not free[FIRST : y.size - LAST].any():
        return
    plants = [_Plants(y, u, a, live, free, tau, delays, most, ramps) for tau in taus.tolist()]
    for _ in range(most):
        for one in plants:
            one.add()
        costs = sorted((cost, i, j) for i, one in enumerate(plants) for j, cost in enumerate(one.costs()))
        seen = ((plants[i].wave(j, sign), plants[i].times[j].tolist()) for _, i, j in costs)
        found = next(((wave, times) for wave, times in seen if wave is not None), None)
        if found is None:
            return
        yield found


class _Plants:
    """Lags of one time constant, a row for each dead time, and the load steps that each has found so far."""

    def __init__(
        self,
        y: FloatArray,
        u: FloatArray,
        a: FloatArray,
        live: NDArray[np.bool_],
        free: NDArray[np.bool_],
        tau: float,
        delays: NDArray[np.int64],
        most: int,
        ramps: bool,
    ) -> None:
        n = y.size
        self.ramps = ramps
        self.a, self.pole, at = a, float(np.exp(-1.0 / tau)), np.arange(n)
        self.n, self.live, self.count = n, live, delays.size
        self.answer: FloatArray = np.asarray(1.0 - self.pole ** (at + 1.0), dtype=np.float64)  # to a step of 1 at 0
        if ramps:
            self.answer = np.cumsum(self.answer)
        self.step = whitened(a, self.answer)
        self.places = free & (at >= FIRST) & (at < n - LAST)
        lag = first_order(u - u[0], 0.0, 1.0 - self.pole, self.pole)
        rows = [np.ones(n), self.pole**at] + [np.concatenate([np.zeros(d), lag[: n - d]]) for d in delays.tolist()]
        if ramps:
            rows.insert(STANDING, self.answer)
        shown = np.where(live, whitened(a, np.array(rows)), 0.0)
        self.target = np.where(live, whitened(a, y), 0.0)
        self.shared, self.drives = shown[: STANDING + ramps], shown[STANDING + ramps :]
        self.rest = np.repeat(self.target[None, :], self.count, axis=0)
        fast = next_fast_len(2 * n, real=True)
        both = np.fft.rfft(live.astype(float), fast) * np.fft.rfft(self.step**2, fast).conj()
        squares = np.fft.irfft(both, fast)[:n]
        self.whole = float(squares.max())
        self.left = np.repeat(squares[None, :], self.count, axis=0)  # of each step's squares
        self.basis = np.empty((len(self.shared) + 1 + most, self.count, n))
        self.taken = 0
        self.times = np.empty((self.count, 0), dtype=np.int64)
        for column in self.shared:
            self._take(np.tile(column, (self.count, 1)))
        self._take(self.drives.copy())

    def _take(self, columns: FloatArray) -> None:
        """Let columns, (D, N), explain what they can of what is left."""
        take(columns, self.a, self.pole, self.ramps, self.basis, self.taken, self.rest, self.left)
        self.taken += 1

    def add(self) -> None:
        """Let every plant find its next step."""
        times = np.empty(self.count, dtype=np.int64)
        given = self.step, self.live, self.places, self.a, self.pole, self.ramps
        self._take(add_step(*given, self.rest, self.left, self.whole, times))
        self.times = np.column_stack([self.times, times])

    def costs(self) -> list[float]:
        """Return the sums of squares that the plants leave."""
        costs: list[float] = np.einsum("ij,ij->i", self.rest, self.rest).tolist()
        return costs

    def wave(self, i: int, sign: float) -> FloatArray | None:
        """Return the steps' part of PV beside plant i, None where its gain has not the sign."""
        times = self.times[i].tolist()
        steps = [self._moved(self.step, t) * self.live for t in times]
        columns = np.column_stack([*self.shared, self.drives[i], *steps])
        terms, *_ = np.linalg.lstsq(columns, self.target, rcond=None)
        before, (gain, *sizes) = terms[: len(self.shared)].tolist(), terms[len(self.shared) :].tolist()
        if gain * sign < 0.0:
            return None
        pairs = [*((size, 0) for size in before[STANDING:]), *zip(sizes, times, strict=True)]
        return sum((size * self._moved(self.answer, t) for size, t in pairs), np.zeros(self.n))

    def _moved(self, row: FloatArray, by: int) -> FloatArray:
        return np.concatenate([np.zeros(by), row[: self.n - by]])
