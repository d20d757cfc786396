"""What a record resolves: OP within the steps that it is kept in, by its controller's law; a PV kept by exception.

A historian keeps OP to a tenth of a per cent, the valve got it in full: a stem that slips where OP has gone a hundredth
of a step too far does so samples earlier or later in the record, and goes another way from there. PV and SP of the same
samples say where within its step OP was: a PI or PID controller's output is a sum of theirs, of those before, and of
the error's sum, beside a level that wanders by what the law leaves out.

A PV that is reported by exception keeps its value until the process is so far from it: it rests and jumps as a loop
does whose valve sticks, and only what moves by more can be told from that. One that was drawn in straight lines from
value to value foretells itself along them: what it leaves there is the historian's work.
"""

from __future__ import annotations

import math

import numpy as np

from workbench.detect.action import control_error
from workbench.model.record import FloatArray, Record
from workbench.record.rounding import ROUNDED, step_of
from workbench.simulate.filter import first_order

__all__ = ["coarseness", "exception_of", "resolved", "unseen"]

# Of the level's innovations, (1 - B)/(1 - l B): 0 where it goes where it likes, 1 where it stays.
STEADY = (0.0, 0.5, 0.8, 0.9, 0.95, 0.98, 0.99, 0.995, 0.998, 1.0)
AS_WELL = 1.05  # times the least variance: the steadiest level that leaves no more is taken
EXPLAINS = 0.5  # of what the level leaves without the law: a law that leaves more did not make this OP
LEVELS = 8  # values of OP: fewer are moves that were made so, by an operator or a test
# A PV that keeps its value in half the samples, and then moves by hardly less than by half of what it usually moves by:
# noise, a lag's answer and a converter's steps begin at nothing, or at one step.
KEPT, LEAST, CUT, STEPS, FEWEST = 0.5, 0.05, 0.5, 1.5, 8
LEAST_DOUBT = 0.1  # of a step: laws that fit to rounding were off by .04 to .1 of it in simulated loops


def coarseness(signal: FloatArray) -> float:
    """Return the least step between a signal's values where these are few, or multiples of it apart; else 0."""
    steps = np.diff(np.unique(signal))
    steps = steps[steps > ROUNDED * float(np.ptp(signal))]
    return float(steps.min()) if 0 < steps.size < signal.size / 4 else step_of(signal)


def exception_of(pv: FloatArray) -> float:
    """Return how far PV goes, EU, before it is kept anew where it is reported by exception, else 0."""
    moves = np.abs(np.diff(pv))
    moved = moves[moves > 0.0]
    if not FEWEST <= moved.size <= (1.0 - KEPT) * moves.size:
        return 0.0
    least, usual = np.quantile(moved, (LEAST, 0.5)).tolist()
    return float(least) if least >= CUT * usual and least >= STEPS * step_of(pv) else 0.0


def unseen(pv: FloatArray) -> float:
    """Return the variance, EU^2, of what is not seen of PV, shape (N,), that is reported by exception; else 0.

    The process is anywhere within the deviation, to either side, as likely here as there.
    """
    return exception_of(pv) ** 2 / 3.0


def resolved(record: Record) -> tuple[FloatArray, float]:
    """Return OP, %, shape (N,), within half a step of what is recorded, and the standard deviation of its error, %.

    An OP that is not recorded in even steps, or in a few levels alone, is returned as it is, its error 0; one that no
    law of PV and SP explains too, its error that of rounding. The level is a random walk seen under rounding, filtered
    and smoothed in the steady state (J. F. Muth, J. Am. Stat. Assoc. 55 (1960) 299-306); where the law leaves more than
    rounding does, both have their say by their variances.
    """
    op = record.op
    step = step_of(op)
    if step == 0.0 or np.unique(op).size < LEVELS:
        return op, 0.0
    rounding = step * step / 12.0
    made, level = op - op.mean(), _causes(record)
    tried = [(_left(made, level, steady), steady) for steady in STEADY]
    most = AS_WELL * max(rounding, min(variance for (variance, _), _ in tried))
    (variance, law), steady = max((one for one in tried if one[0][0] <= most), key=lambda one: one[1])
    without, _ = _left(made, np.empty((0, op.size)), steady)
    if variance > EXPLAINS * without:
        return op, math.sqrt(rounding)
    explained = law @ level
    told = op.mean() + explained + _smoothed(made - explained, steady)
    # Of the variance that the law leaves, what is more than rounding is its own.
    share = min(rounding / variance, 1.0)
    error = rounding * min(1.0 - share + (1.0 - steady) / (1.0 + steady), 1.0)
    within = np.clip(share * told + (1.0 - share) * op, op - 0.5 * step, op + 0.5 * step)
    return within, max(math.sqrt(error), LEAST_DOUBT * step)


def _causes(record: Record) -> FloatArray:
    """What a controller's output is a sum of, one row each, of one scale: shape (rows, N)."""
    error = control_error(record)
    signals = [record.pv, _before(record.pv), np.cumsum(error), np.arange(error.size, dtype=np.float64)]
    if record.sp is not None:
        signals += [record.sp, _before(record.sp)]
    rows = np.array(signals)
    rows -= rows.mean(axis=1, keepdims=True)
    size = np.abs(rows).max(axis=1)
    return np.asarray(rows[size > 0.0] / size[size > 0.0, None])


def _before(signal: FloatArray) -> FloatArray:
    return np.concatenate([signal[:1], signal[:-1]])


def _left(made: FloatArray, causes: FloatArray, steady: float) -> tuple[float, FloatArray]:
    """The variance of the innovations that a law beside a level leaves, %^2, and the law's factors."""
    if steady == 1.0:
        filtered, columns = made, causes
    else:
        # The first samples hold what the filter makes of their start.
        filtered = first_order(made, 1.0, -1.0, steady)[2:]
        columns = first_order(causes, 1.0, -1.0, steady)[:, 2:]
    law = np.asarray(np.linalg.lstsq(columns.T, filtered, rcond=1e-10)[0], dtype=np.float64)
    return float(np.mean((filtered - law @ columns) ** 2)), law


def _smoothed(left: FloatArray, steady: float) -> FloatArray:
    """The level in what a law leaves, shape (N,): weights fall by `steady` a sample to both sides."""
    if steady == 1.0:
        return np.full(left.size, left.mean())
    some = max(3, int(1.0 / (1.0 - steady)))

    def onward(values: FloatArray) -> FloatArray:
        return first_order(values, 1.0 - steady, 0.0, steady, steady * float(values[:some].mean()))

    return np.asarray((onward(left) + onward(left[::-1])[::-1] - (1.0 - steady) * left) / (1.0 + steady))
