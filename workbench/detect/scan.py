"""Does the controller see what the record shows? Where it runs faster, OP moves between samples as nobody recorded.

A controller that runs once a sample makes OP's moves of what the record holds, PV and SP of that sample and of those
before: a law that then holds to rounding. One that runs ten times as fast answers noise and peaks between samples,
which no law of the record explains, and the stem slipped when OP was somewhere between its recorded values.

From one sample to the next little of that is left beside rounding: proportional action takes back what it gave, and
the integral's share alone stays. It gathers from sample to sample, and rounding does not. So the law is also set
against OP's moves over SUMMED samples, where rounding leaves no more than in one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from workbench.model.record import FloatArray, Record
from workbench.record.rounding import step_of

__all__ = ["runs_faster"]

Kind = TypeVar("Kind", bound=np.generic)

# Of error, setpoint and OP's own moves, back from a sample: PID with its filter, a filter of PV and setpoint weights.
ERRORS, SETPOINTS, MOVES = 5, 5, 3
LONGER = 10  # samples of the error over which sums of moves are explained: a rounded OP hides what its own moves tell
FEWEST, MOST = 100, 5_000  # samples
FEWEST_VALUES = 10  # of PV and of OP: fewer have no step to tell
ROUNDS = 12  # of weighing: limits, modes and operators break the law now and then, in less than half of the samples
HOLDS, ROUNDING = 1e-4, 2.0  # of OP's usual move, and of what rounding makes of the law: what it leaves where it holds
SUMMED = 16  # samples
# Times the median that rounding leaves of a sum. Of 6,000 simulated records at a controller's scan or closer, kept in
# many steps, one came to it; of 675 of controllers 2 to 10 times as fast, with OP to 0.01 %, four in five did.
GATHERED = 2.0
BROKEN = 8.0  # times the median: a sample in which the law does not hold is in no sum
# Where a step is more of OP's usual move, or of the variance of what is new in the error, the fitted law is too small.
COARSE_OP, COARSE_PV = 0.25, 0.15
MEDIAN = 0.6745  # of a normal distribution's absolute values, standard deviations


@dataclass(frozen=True, slots=True)
class _Moves:
    """What OP's moves, shape (N,), may come of: the error (N, LONGER), setpoints and a constant, its own moves before.

    whole: the samples, shape (N,), whose moves no limit cut.
    """

    made: FloatArray
    errors: FloatArray
    others: FloatArray
    before: FloatArray
    whole: NDArray[np.bool_]


def runs_faster(record: Record) -> bool:
    """Return whether OP's moves come of no linear law of the samples, as where the controller runs between them too.

    The law is fitted by least absolute errors: of one that holds in most samples nothing is left in the median. Steps
    of PV and OP, and limits of OP, break none; nor does a controller that runs each second sample, or less often.
    """
    pv, op, sp = _at_scans(record)
    if op.size < FEWEST or min(np.unique(pv).size, np.unique(op).size) < FEWEST_VALUES:
        return False
    moves = _moves_of(pv, op, sp)
    made, whole = moves.made, moves.whole
    usual = float(np.median(np.abs(made[made != 0.0]))) if made.any() else 0.0
    if usual == 0.0 or np.count_nonzero(whole) < FEWEST:
        return False
    causes = np.column_stack([moves.errors[:, :ERRORS], moves.others, moves.before])
    terms = _least_absolute(causes[whole], made[whole], usual)
    left = made - causes @ terms
    steps, by_move = (step_of(pv), step_of(op)), terms[-MOVES:]
    if steps[0] ** 2 / 12.0 > COARSE_PV * _new_in(moves):
        return False
    median = float(np.median(np.abs(left[whole])))
    if median > max(HOLDS * usual, ROUNDING * _rounding(steps, terms[:ERRORS], by_move, 1)):
        return True
    if steps[1] > COARSE_OP * usual:
        return False
    broken = ~whole | (np.abs(left) > BROKEN * median)
    unbroken = ~sliding_window_view(broken, SUMMED).any(axis=1)
    if np.count_nonzero(unbroken) < FEWEST:
        return False
    # OP's own part is known from its single moves: given anew, it would tell a sum from the one before.
    own = _summed(made - moves.before @ by_move)[unbroken]
    causes = _summed(np.column_stack([moves.errors, moves.others]))[unbroken]
    terms = _least_absolute(causes, own, usual)
    kept = MEDIAN * _rounding(steps, terms[:LONGER], by_move, SUMMED)
    return float(np.median(np.abs(own - causes @ terms))) > max(HOLDS * usual, GATHERED * kept)


def _at_scans(record: Record) -> tuple[FloatArray, FloatArray, FloatArray]:
    """PV, OP and SP at the samples in which OP moves, each so many of the record's first."""
    n = min(len(record), MOST)
    sp = np.zeros(n) if record.sp is None else record.sp[:n]
    moved = np.flatnonzero(np.diff(record.op[:n])) + 1
    every = int(np.gcd.reduce(np.diff(moved))) if moved.size > 1 else 1
    there = slice(int(moved[0]) % every if moved.size else 0, n, every)
    return record.pv[there], record.op[there], sp[there]


def _moves_of(pv: FloatArray, op: FloatArray, sp: FloatArray) -> _Moves:
    first, error = max(LONGER, MOVES + 1), sp - pv
    moves = np.diff(op, prepend=op[0])
    setpoints = [_back(sp, lag, first) for lag in range(SETPOINTS)] if np.ptp(sp) > 0.0 else []
    limited = (op == op.min()) | (op == op.max())
    return _Moves(
        moves[first:],
        np.column_stack([_back(error, lag, first) for lag in range(LONGER)]),
        np.column_stack([*setpoints, np.ones(op.size - first)]),
        np.column_stack([_back(moves, lag, first) for lag in range(1, MOVES + 1)]),
        ~np.any([_back(limited, lag, first) for lag in range(MOVES + 2)], axis=0),
    )


def _least_absolute(causes: FloatArray, made: FloatArray, usual: float) -> FloatArray:
    """The terms, shape (K,), with which causes, shape (N, K), leave the least of moves in absolute values."""
    scale = np.maximum(np.sqrt((causes**2).mean(axis=0)), 1e-300)
    left, terms = made, np.zeros(scale.size)
    for _ in range(ROUNDS):
        weight = 1.0 / np.sqrt(np.maximum(np.abs(left), 1e-3 * HOLDS * usual))
        solved, *_ = np.linalg.lstsq(causes / scale * weight[:, None], made * weight, rcond=1e-12)
        terms = solved / scale
        left = made - causes @ terms
    return terms


def _rounding(steps: tuple[float, float], by_error: FloatArray, by_move: FloatArray, summed: int) -> float:
    """What rounding PV (EU) and OP (%) in steps leaves of a law over so many samples: its standard deviation, %."""
    window = np.ones(summed)
    # OP's move is the difference of two roundings.
    of_op = np.convolve(np.convolve([1.0, -1.0], window), np.append(1.0, -by_move))
    of_pv = np.convolve(by_error, window)
    return float(np.sqrt((steps[0] ** 2 * (of_pv @ of_pv) + steps[1] ** 2 * (of_op @ of_op)) / 12.0))


def _new_in(moves: _Moves) -> float:
    """Variance of what the error's past and the setpoint do not foretell of it, for each of rounding it once, EU^2."""
    now, past = moves.errors[:, 0], np.column_stack([moves.errors[:, 1:ERRORS], moves.others])
    terms, *_ = np.linalg.lstsq(past, now, rcond=1e-12)
    spread = float(np.median(np.abs(now - past @ terms))) / MEDIAN
    by_past = terms[: ERRORS - 1]
    return spread**2 / (1.0 + float(by_past @ by_past))


def _summed(signal: FloatArray) -> FloatArray:
    """Sums over SUMMED samples, shape (N - SUMMED + 1, ...)."""
    total = np.cumsum(signal, axis=0)
    total[SUMMED:] -= total[:-SUMMED].copy()
    return total[SUMMED - 1 :]


def _back(signal: NDArray[Kind], lag: int, first: int) -> NDArray[Kind]:
    return signal[first - lag : signal.size - lag]
