"""The free linear predictor: does a stem add anything to what the past of PV and OP tells about PV?

The linear rival of the stem test is of low order. In closed loop a stem may better it without sticking: its plant and
its steps make up for what low order leaves of a slow disturbance. So the stem must also add to a predictor that knows
no valve and no plant, a regression of PV on its own past and OP's, which any linear loop obeys, the controller's
inverse included. What the stem adds is tested as R. Davidson, J.G. MacKinnon, "Several tests for model specification in
the presence of alternative hypotheses", Econometrica 49 (1981) 781-793, test one model against another: by putting
the one's answer beside the other's regressors.

Where setpoint moves or an oscillation from outside make most of PV, they show what no linear law obeys, the curve of a
process, a valve or a sensor, and where OP is about to turn a stem takes that up too. The curved predictor knows the
squares of PV and OP, and their product, as well (second-order Volterra terms, on the diagonal).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from workbench.model.record import FloatArray

__all__ = ["FreePredictor"]

PAST = 30  # samples of PV and of OP that are known, fewer in short records
PER_PAST = 20  # samples of the record for each
CURVES = (1, 2, 3, 5, 8, 13)  # samples ago, of which the squares are known
CLOSE = 10  # a dead time is known to within so much of it, or a few samples
ANSWERS = 3  # samples of the stem, one after the other, that PV may answer to
LEAST_ROWS = 4  # samples for each coefficient: with fewer nothing is said
SAME = 1e-10  # share of a regressor's power: less apart from the others is rounding
RANK = 1e-4  # of a stem's path: less of it left beside OP is rounding


class FreePredictor:
    """PV of one stretch (EU), predicted from the past of PV and OP (%), each of shape (N,).

    held: the samples that nobody recorded, shape (N,). floor: variance (EU^2) below which no residual counts.
    longest: the longest dead time of a stem, samples. curved: whether the past's squares are known too. delay: the dead
    time of the linear loop, samples: where the past does not reach as far, what OP was about then is known too.
    """

    def __init__(
        self,
        y: FloatArray,
        u: FloatArray,
        held: NDArray[np.bool_],
        floor: float,
        longest: int,
        curved: bool = False,
        delay: int = 0,
    ) -> None:
        self.asked = y, held, floor, longest, curved, delay
        past = max(min(PAST, y.size // PER_PAST), 1)
        while not self._knows(y, u, held, past, longest) and past > 1:
            # Where samples are missing a shorter past leaves more of them to predict.
            past //= 2
        self.past, self.floor = past, floor * self.left.size

    def _knows(self, y: FloatArray, u: FloatArray, held: NDArray[np.bool_], past: int, longest: int) -> bool:
        """Regress PV on the past and say whether the samples are enough."""
        curved, delay = self.asked[-2:]
        late = range(0)
        if delay + ANSWERS > past:
            late = range(max(past + 1, delay - max(delay // CLOSE, ANSWERS)), delay + past // 2 + 1)
        self.first = max(past, longest + ANSWERS, *late) + 1
        reach = np.zeros(self.first + 1)
        reach[[*range(past + 1), *late]] = 1.0
        self.live = np.convolve(held, reach)[: y.size][self.first :] == 0.0
        known = [_back(v, lag, self.first) for v in (y, u) for lag in range(1, past + 1)]
        known += [_back(u, lag, self.first) for lag in late]
        if curved:
            squares = y * y, u * u, y * u
            known += [_back(v, lag, self.first) for v in squares for lag in CURVES if lag <= past]
            known += [_back(u * u, delay + lag, self.first) for lag in CURVES if delay + lag in late]
        known.append(np.ones(y.size - self.first))
        columns = self._known(known)
        coefficients = columns.shape[1] + ANSWERS
        self.freedom = columns.shape[0] - coefficients
        self.enough = bool(columns.shape[0] >= LEAST_ROWS * coefficients)
        self.basis = _orthonormal(columns) if self.enough else columns
        self.left = self.beside(y[self.first :][self.live]) if self.enough else np.zeros(0)
        return self.enough

    def _known(self, columns: list[FloatArray]) -> FloatArray:
        """Return columns side by side, at the samples that are known."""
        known: FloatArray = np.column_stack(columns if self.live.all() else [v[self.live] for v in columns])
        return known

    def beside(self, columns: FloatArray) -> FloatArray:
        """Return what is left of columns (at the samples that are known) beside the past."""
        beside: FloatArray = columns - self.basis @ (self.basis.T @ columns)
        return beside

    def adds(self, path: FloatArray, delay: int) -> float:
        """Return the log likelihood ratio of the prediction with and without a stem's path (%, shape (N,)), delayed.

        N times the logarithm of the residual variances' ratio, N less the coefficients fitted; about 3 by chance for a
        path chosen beforehand (chi^2 with three degrees of freedom), more for the best of many. 0 where the record is
        too short to say.
        """
        return self.adds_at(path, [delay])[0]

    def adds_at(self, path: FloatArray, delays: Sequence[int]) -> list[float]:
        """Return the same for each of some delays, samples."""
        if not self.enough or not np.ptp(path) > 0.0:
            return [0.0] * len(delays)
        x = path - path.mean()
        at = np.array(delays)[:, None] + np.arange(1, ANSWERS + 1)
        lags, place = np.unique(at, return_inverse=True)
        columns = self._known([_back(x, lag, self.first) for lag in lags.tolist()])
        beside_past, place = self.beside(columns), place.reshape(at.shape)
        products = beside_past.T @ beside_past
        powers, axes = np.linalg.eigh(products[place[:, :, None], place[:, None, :]])
        # A stem that follows OP is known already: what is left of it is rounding.
        kept = powers > RANK**2 * (columns**2).sum(axis=0)[place].sum(axis=1)[:, None]
        along = np.einsum("dji,dj->di", axes, (beside_past.T @ self.left)[place])
        explained = np.where(kept, along**2 / np.where(kept, powers, 1.0), 0.0).sum(axis=1)
        return [self.gain(one) for one in explained.tolist()]

    def gain(self, explained: float) -> float:
        """Return the log likelihood ratio of a prediction that leaves so much less of PV's squares, EU^2."""
        without = float(self.left @ self.left) + self.floor
        beside = max(without - explained, self.floor)
        return float(self.freedom * math.log(without / beside)) if beside > 0.0 else 0.0

    def instead(self, path: FloatArray) -> float:
        """Return the log likelihood ratio of the prediction by a stem's past (%, shape (N,)) to that by OP's.

        0 where the record is too short to say.
        """
        if not self.enough or not np.ptp(path) > 0.0:
            return 0.0
        y, held, floor, longest, curved, delay = self.asked
        return FreePredictor(y, path - path.mean(), held, floor, longest, curved, delay).ahead_of(self)

    def ahead_of(self, other: FreePredictor) -> float:
        """Return the log likelihood ratio of this prediction to another, 0 where one is not known, or of less of PV."""
        if not self.enough or not other.enough or self.left.size != other.left.size:
            return 0.0
        theirs = float(other.left @ other.left) + other.floor
        left = float(self.left @ self.left) + self.floor
        return float(other.freedom * math.log(theirs / left)) if min(theirs, left) > 0.0 else 0.0


def _orthonormal(columns: FloatArray) -> FloatArray:
    """Return an orthonormal basis of columns, shape (N, P), by Cholesky's factor of their products.

    What two columns have in common to within `SAME` is left out of the later one.
    """
    columns = columns / np.maximum(np.sqrt((columns**2).sum(axis=0)), 1e-300)
    factor = np.linalg.cholesky(columns.T @ columns + SAME * np.eye(columns.shape[1]))
    basis: FloatArray = columns @ np.linalg.inv(factor).T
    return basis


def _back(signal: FloatArray, lag: int, first: int) -> FloatArray:
    return signal[first - lag : signal.size - lag]
