"""From samples to half cycles: what happens between two reversals of the stem, in one compiled pass."""

from __future__ import annotations

import numpy as np

from workbench.model.record import FloatArray
from workbench.simulate.compiled import compiled

__all__ = ["COLUMNS", "Block", "collect", "fresh_carry"]

# Columns of a half cycle [start, end): sample numbers, extremes of PV and OP, sum of squared errors, stem travel.
START, END, Y_HIGH, Y_LOW, U_HIGH, U_LOW, SQUARES, TRAVEL = range(8)
COLUMNS = 8
# Carried between chunks: the half cycle begun so far, then the stem's reference, direction and last move.
STEM, DIRECTION, MOVED = range(8, 11)
CARRIED = 11


def fresh_carry(stem: float) -> FloatArray:
    """Return what `collect` carries along, for a stem at rest at `stem` (%) that has not moved yet."""
    carry = np.zeros(CARRIED)
    carry[STEM] = stem
    carry[MOVED] = -1.0
    carry[Y_HIGH] = carry[U_HIGH] = -np.inf
    carry[Y_LOW] = carry[U_LOW] = np.inf
    return carry


@compiled
def collect(
    y: FloatArray, u: FloatArray, x: FloatArray, r: float, first: int, dust: float, carry: FloatArray, rows: FloatArray
) -> int:
    """Write the half cycles that end within this chunk into `rows` (at least u.size of them); return how many.

    A half cycle runs from one reversal of the stem to the next, the first from the first move of all: a staircase of
    slips in one direction is one half cycle. Moves are counted once they add up to more than `dust` (%), so that
    rounding reverses nothing. `first` is the number of the chunk's first sample; `carry` from `fresh_carry`.
    """
    count = 0
    for k in range(u.size):
        move = x[k] - carry[8]
        if abs(move) > dust:
            direction = 1.0 if move > 0.0 else -1.0
            if direction != carry[9]:
                if carry[9] != 0.0:
                    for column in range(8):
                        rows[count, column] = carry[column]
                    rows[count, 1] = first + k
                    count += 1
                carry[0] = first + k
                carry[2], carry[3], carry[4], carry[5] = -np.inf, np.inf, -np.inf, np.inf
                carry[6], carry[7] = 0.0, 0.0
                carry[9] = direction
            carry[7] += abs(move)
            carry[8] = x[k]
            carry[10] = first + k
        carry[2] = max(carry[2], y[k])
        carry[3] = min(carry[3], y[k])
        carry[4] = max(carry[4], u[k])
        carry[5] = min(carry[5], u[k])
        carry[6] += (r - y[k]) * (r - y[k])
    return count


class Block:
    """Figures of an even number of successive half cycles.

    period: s, mean over its cycles; pv_peak_to_peak (EU) and op_peak_to_peak (%): median over its cycles of max - min;
    mean_square_error: EU^2; travel_per_hour: %.
    """

    __slots__ = ("mean_square_error", "op_peak_to_peak", "period", "pv_peak_to_peak", "travel_per_hour")

    def __init__(self, halves: FloatArray, sample_time: float) -> None:
        samples = halves[-1, END] - halves[0, START]
        first, second = halves[0::2], halves[1::2]
        self.period = float(samples * sample_time * 2.0 / halves.shape[0])
        self.pv_peak_to_peak = _swing(first, second, Y_HIGH, Y_LOW)
        self.op_peak_to_peak = _swing(first, second, U_HIGH, U_LOW)
        self.mean_square_error = float(halves[:, SQUARES].sum() / samples)
        self.travel_per_hour = float(halves[:, TRAVEL].sum() / (samples * sample_time) * 3600.0)


def _swing(first: FloatArray, second: FloatArray, high: int, low: int) -> float:
    swings = np.maximum(first[:, high], second[:, high]) - np.minimum(first[:, low], second[:, low])
    return float(np.median(swings))
