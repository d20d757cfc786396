"""Does the controller see what the record shows? Where it runs faster, OP moves between samples as nobody recorded.

A controller that runs once a sample makes OP's moves of what the record holds, PV and SP of that sample and of those
before: a law that then holds to rounding. One that runs ten times as fast answers noise and peaks between samples,
which no law of the record explains, and the stem slipped when OP was somewhere between its recorded values.
"""

from __future__ import annotations

import numpy as np

from workbench.model.record import FloatArray, Record
from workbench.record.rounding import step_of

__all__ = ["runs_faster"]

# Of error, setpoint and OP's own moves, back from a sample: PID with its filter, a filter of PV and setpoint weights.
ERRORS, SETPOINTS, MOVES = 5, 3, 3
FEWEST, MOST = 100, 5_000  # samples
ROUNDS = 12  # of weighing: limits, modes and operators break the law now and then, in less than half of the samples
HOLDS, ROUNDING = 1e-4, 2.0  # of OP's usual move, and of what rounding makes of the law: what it leaves where it holds


def runs_faster(record: Record) -> bool:
    """Return whether OP's moves come of no linear law of the samples, as where the controller runs between them too.

    The law is fitted by least absolute errors: of one that holds in most samples nothing is left in the median.
    """
    n = min(len(record), MOST)
    if n < FEWEST:
        return False
    first = max(ERRORS, MOVES) + 1
    sp = np.zeros(n) if record.sp is None else record.sp[:n]
    error, op = sp - record.pv[:n], record.op[:n]
    moves = np.diff(op, prepend=op[0])
    causes = [_back(error, lag, first) for lag in range(ERRORS)]
    causes += [_back(sp, lag, first) for lag in range(SETPOINTS)] if np.ptp(sp) > 0.0 else []
    causes += [_back(moves, lag, first) for lag in range(1, MOVES + 1)]
    columns = np.column_stack([*causes, np.ones(n - first)])
    made = moves[first:]
    usual = float(np.median(np.abs(made[made != 0.0]))) if made.any() else 0.0
    if usual == 0.0:
        return False
    left, terms = made, np.zeros(columns.shape[1])
    scale = np.maximum(np.sqrt((columns**2).mean(axis=0)), 1e-300)
    for _ in range(ROUNDS):
        weight = 1.0 / np.sqrt(np.maximum(np.abs(left), 1e-3 * HOLDS * usual))
        solved, *_ = np.linalg.lstsq(columns / scale * weight[:, None], made * weight, rcond=1e-12)
        terms = solved / scale
        left = made - columns @ terms
    by_error, by_move = terms[:ERRORS], terms[-1 - MOVES : -1]
    # OP's move is the difference of two roundings.
    kept = step_of(record.pv[:n]) ** 2 * float(by_error @ by_error)
    kept += step_of(op) ** 2 * 2.0 * (1.0 + float(by_move @ by_move))
    return float(np.median(np.abs(left))) > max(HOLDS * usual, ROUNDING * float(np.sqrt(kept / 12.0)))


def _back(signal: FloatArray, lag: int, first: int) -> FloatArray:
    return signal[first - lag : signal.size - lag]
