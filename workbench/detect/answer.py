"""Does PV answer OP at all? A valve that is stuck fast shows no stick-slip: OP wanders, and PV goes its own way.

In a closed loop OP echoes PV, so that the two go together whether the valve moves or not. What tells is the part of OP
that PV's own last samples do not account for, the error that integral action has gathered: in a loop that works it
pushes PV back, and is pushed back itself; with a valve that does not move it does neither and wanders as a random walk.
Each is a regression on a level that may be such a walk, whose t ratio is not Student's but that of D. Dickey,
W. Fuller, "Distribution of the estimators for autoregressive time series with a unit root", J. Am. Stat. Assoc. 74
(1979) 427-431.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from workbench.detect.action import gain_sign
from workbench.model.record import FloatArray, Record

__all__ = ["Answer", "answer_of"]

# Dickey and Fuller's critical values beside a constant: 5 %, and 1 % for OP's own return, which is the lesser evidence.
PUSHES, RETURNS = 2.86, 3.43
OWN = 0.1  # of OP's variance, the least that PV's last samples must leave for OP to have gone a way of its own
SHORT, LONG, PER_LAG = 8, 30, 100  # samples of the past: one for each hundred of the record, within limits
SPARE = 10  # samples beyond the regressors, at least
WENT_ALONG = 0.5  # of PV's variance, and of a setpoint's move: a PV that goes along with that much answers OP
ROUNDING = 1e-12  # share of a variance


@dataclass(frozen=True, slots=True)
class Answer:
    """How PV answers OP: t ratios of how OP pushes PV (the way that feedback must, positive) and of OP's own return.

    own: share of OP's variance that PV's last samples leave. moved: OP's peak to peak, %.
    """

    pushes: float
    returns: float
    own: float
    moved: float

    @property
    def missing(self) -> bool:
        """Whether OP went a way of its own and PV did not answer."""
        return self.own >= OWN and self.pushes < PUSHES and self.returns < RETURNS


def answer_of(record: Record) -> Answer | None:
    """Return how PV answers OP, or None where that needs no telling or cannot be told.

    No controller is seen, the record is too short, or PV went along with its setpoint, which it does through the valve
    alone: beside such a move OP's own way is little, and PV's own past tells what is to come as well as OP does.
    """
    sign = gain_sign(record)
    lags = min(max(len(record) // PER_LAG, SHORT), LONG)
    if sign == 0.0 or len(record) < 2 * lags + SPARE or _went_along(record):
        return None
    y, u = record.pv - record.pv.mean(), record.op - record.op.mean()
    pushes, own = _level(y[lags:], _past(y, lags), u[lags - 1 : -1])
    moves = np.diff(u)
    returns, _ = _level(moves[lags:], _past(moves, lags), u[lags:-1])
    return Answer(sign * pushes, -returns, own, float(np.ptp(record.op)))


def _went_along(record: Record) -> bool:
    """Whether most of PV is its setpoint's moves of some samples before, at about their size."""
    if record.sp is None:
        return False
    for lag in range(min(LONG, len(record) // 2)):
        pv, sp = record.pv[lag:], record.sp[: len(record) - lag]
        y, r = pv - pv.mean(), sp - sp.mean()
        both, moved = float(r @ y), float(r @ r)
        same_size = WENT_ALONG * moved < both < moved / WENT_ALONG
        if same_size and both * both > WENT_ALONG * moved * float(y @ y):
            return True
    return False


def _past(signal: FloatArray, lags: int) -> list[FloatArray]:
    return [signal[lags - lag : signal.size - lag] for lag in range(1, lags + 1)]


def _level(target: FloatArray, past: list[FloatArray], level: FloatArray) -> tuple[float, float]:
    """Return the t ratio of a level beside the past and a constant, and the level's share that those leave."""
    columns = np.column_stack([np.ones(target.size), *past, level])
    columns /= np.maximum(np.sqrt((columns**2).sum(axis=0)), np.finfo(float).tiny)
    basis, factor = np.linalg.qr(columns)
    terms = basis.T @ target
    left = target - basis @ terms
    variance = float(left @ left) / (target.size - columns.shape[1]) + ROUNDING * float(target.var())
    own = float(factor[-1, -1])
    if not (variance > 0.0 and own * own > ROUNDING):
        return 0.0, 0.0
    return float(np.sign(own) * terms[-1] / np.sqrt(variance)), own * own
