"""What signals give away: values beyond their range, a frozen sensor, held values, saturation, swapped columns."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from workbench.errors import RecordError
from workbench.model.record import FloatArray
from workbench.record.rounding import on_lines
from workbench.record.table import CODE, OK, RANGE, Cells
from workbench.record.times import runs

__all__ = [
    "frozen_rows",
    "held_said",
    "no_codes",
    "none_far",
    "op_said",
    "setpoint_said",
    "swapped",
    "within_range",
]

# Numbers that stand for no value, of either sign: nines and 999.25 (LAS 2.0, Canadian Well Logging Society; -9999 in
# ESRI grids), 7999 (Campbell Scientific's loggers), the ends of 16 bits, and all from 1e30 on (netCDF's 9.97e36, the
# largest of 32 bits).
CODES = (999.0, 9999.0, 99999.0, 999999.0, 9999999.0, 999.25, 7999.0, 32767.0, 32768.0, 65535.0)
LEAST_FILL = 1e30
AWAY = 0.5  # of a code's own size, by which it differs from the other values at least
FAR = 1.0  # of OP's range, beyond its ends: no output of a controller in %

# NAMUR NE 43: a transmitter below 3.6 mA or above 21 mA of its 4 to 20 mA reports a failure, not a measurement.
BELOW, ABOVE = 0.4 / 16.0, 1.0 / 16.0
SHORTEST = 20  # repeats on end that can be a frozen sensor at all
EXCEPTION = 5.0  # times longer than every other stretch of repeats
CHANCE = 1e-3  # of such a stretch among values that repeat as often as the others do
ABRUPT = 0.1  # of a usual move: a signal that dies away to nothing is no frozen one
BEFORE = 10  # moves before the stretch that show how it began
HELD = 0.10  # share of repeated values that is worth a word
STRAIGHT = 0.30  # share of values on a straight line between their neighbours that is
ABOUT = 0.1  # of OP's spread, by which SP may be off its middle where the two are exchanged
LIMITED = 0.10  # share of samples at OP's own highest or lowest value that is


def within_range(cells: Cells, limits: tuple[float, float], name: str, source: str) -> None:
    """Mark the values beyond a transmitter's range (NAMUR NE 43: 2.5 % below to 6.25 % above) as `RANGE`.

    Raises `RecordError` where that is most of them: the range, the unit or the column is wrong then.
    """
    low, high = limits
    span = high - low
    good = cells.marks == OK
    least, most = low - BELOW * span, high + ABOVE * span
    with np.errstate(invalid="ignore"):
        beyond = good & ((cells.values < least) | (cells.values > most))
    if np.count_nonzero(beyond) * 2 > np.count_nonzero(good):
        values = cells.values[good]
        msg = (
            f"{source}: {name} runs from {values.min():g} to {values.max():g}, and most of it lies beyond its range, "
            f"{low:g} to {high:g}: another unit, another range, or PV and OP swapped?"
        )
        raise RecordError(msg)
    _leave_out(cells, beyond, least, most)


def no_codes(cells: Cells) -> None:
    """Mark numbers that stand for no value as `CODE`: well-known ones, away from all that the signal does else."""
    sizes = np.abs(cells.values)
    code = (cells.marks == OK) & (np.isin(sizes, CODES) | (sizes >= LEAST_FILL))
    others = cells.values[(cells.marks == OK) & ~code]
    if not code.any() or others.size == 0:
        return
    low, high = np.percentile(others, (1.0, 99.0)).tolist()
    with np.errstate(invalid="ignore"):
        off = np.maximum(low - cells.values, cells.values - high)
        code &= (off > high - low) & (off > AWAY * sizes)
    cells.codes.update(f"{value:.10g}" for value in cells.values[code].tolist())
    cells.marks[code] = CODE
    cells.values[code] = np.nan


def none_far(cells: Cells) -> None:
    """Mark values of OP as `RANGE` that are far beyond 0 to 100 %, where the others show that OP is in %."""
    good = cells.marks == OK
    least, most = -100.0 * FAR, 100.0 * (1.0 + FAR)
    with np.errstate(invalid="ignore"):
        far = good & ((cells.values < least) | (cells.values > most))
    others = cells.values[good & ~far]
    if others.size > np.count_nonzero(far) and others.max() <= 100.0 * (1.0 + ABOVE):
        _leave_out(cells, far, least, most)


def _leave_out(cells: Cells, beyond: NDArray[np.bool_], least: float, most: float) -> None:
    cells.beyond = cells.values[beyond], least, most
    cells.marks[beyond] = RANGE
    cells.values[beyond] = np.nan


def frozen_rows(pv: FloatArray, joined: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return the stretches [first, stop) in which a sensor that moved before shows one value.

    pv: EU, shape (N,). joined: whether a sample follows the one before it. A stretch counts where it is many times
    longer than every other, where values that repeat as often as elsewhere would hardly make it, where PV did not die
    away into it, and where its value lies within what PV shows elsewhere. So the rests between the slips of a sticky
    valve, coarse or compressed signals, and a flow that is cut off at zero stay.
    """
    repeats = np.zeros(pv.size, dtype=bool)
    moves = np.zeros(pv.size)
    if pv.size > 1:
        moves[1:] = np.where(joined[1:], np.abs(np.diff(pv)), 0.0)
        repeats[1:] = joined[1:] & (moves[1:] == 0.0)
    first, length = runs(repeats)
    order = np.argsort(-length, kind="stable")
    out: list[tuple[int, int]] = []
    left = int(np.count_nonzero(joined))
    held = int(np.count_nonzero(repeats))
    for rank, at in enumerate(order.tolist()):
        many, begin = int(length[at]), int(first[at])
        second = int(length[order[rank + 1]]) if rank + 1 < order.size else 0
        left, held = left - many, held - many
        if many < max(SHORTEST, EXCEPTION * second) or left < SHORTEST:
            break
        share = (held + 1.0) / (left + 2.0)
        if many * -math.log(share) < math.log(pv.size / CHANCE):
            break
        others = np.ones(pv.size, dtype=bool)
        for a, b in [*out, (begin - 1, begin + many)]:
            others[a:b] = False
        elsewhere, usual = pv[others], moves[others & (moves > 0.0)]
        before = moves[max(begin - BEFORE, 0) : begin]
        abrupt = usual.size > 0 and (before.size == 0 or float(np.median(before)) >= ABRUPT * float(np.median(usual)))
        if not abrupt or not elsewhere.min() < pv[begin] < elsewhere.max():
            break
        out.append((begin - 1, begin + many))
    return sorted(out)


def held_said(pv: FloatArray, op: FloatArray, joined: NDArray[np.bool_]) -> list[str]:
    """Return what repeated and straight values of a recorded PV (shape (N,)) say about the historian."""
    if pv.size < SHORTEST:
        return []
    follows = joined[1:]
    repeats = follows & (np.diff(pv) == 0.0)
    many = max(int(np.count_nonzero(follows)), 1)
    share = float(np.count_nonzero(repeats)) / many
    notes = []
    if HELD <= share < 1.0:
        longest = int(runs(repeats)[1].max())
        both = float(np.count_nonzero(repeats & (np.diff(op) == 0.0))) / float(np.count_nonzero(repeats))
        why = (
            "and OP with it: the historian held old values, which hides moves of the valve"
            if both >= 0.8
            else "a coarse, compressed or held signal"
        )
        notes.append(f"PV repeats the value before it in {share:.0%} of the samples, {longest} on end at most; {why}")
    straight = on_lines(pv) & follows[1:] & follows[:-1]
    if float(np.count_nonzero(straight)) / many >= STRAIGHT:
        notes.append(
            f"PV lies on straight lines in {np.count_nonzero(straight) / many:.0%} of the samples: interpolated from a "
            "compressed archive, which hides moves of the valve; raw values show more"
        )
    return notes


def op_said(op: FloatArray, scaled: bool) -> list[str]:
    """Return what the values of OP (%, shape (N,)) say: a unit that is not %, or a limit. scaled: by a given range."""
    low, high = float(op.min()), float(op.max())
    notes = []
    if not scaled and (low < -100.0 * BELOW or high > 100.0 * (1.0 + ABOVE)):
        notes.append(
            f"OP runs from {low:.4g} to {high:.4g}, beyond 0 to 100 %: give its range if it is in another unit, as "
            "op_range (--op-range LOW:HIGH)"
        )
    elif not scaled and low >= 0.0 and high <= 1.0 and high > low:
        notes.append(
            f"OP runs from {low:.4g} to {high:.4g} %: give its range, 0 to 1, if it is a fraction, as op_range "
            "(--op-range 0:1); without it stiction comes out a hundredth of what it is"
        )
    if high > low and op.size >= SHORTEST:
        for value, which in ((high, "highest"), (low, "lowest")):
            share = float(np.mean(op == value))
            if share >= LIMITED:
                notes.append(
                    f"OP stays at its {which} value, {value:.4g} %, in {share:.0%} of the samples: saturated or held"
                )
    return notes


def setpoint_said(sp: FloatArray, pv: FloatArray, op: FloatArray) -> list[str]:
    """Return what an SP (shape (N,)) says that never comes near to PV, or in whose place OP is and PV is not."""
    low, high = float(pv.min()), float(pv.max())
    if low == high or float(np.maximum(low - sp, sp - high).min()) <= high - low:
        # Integral action leaves no lasting error: of the loop's two signals the controlled one lies about SP.
        about_op = abs(float(np.mean(sp - op))) < ABOUT * float(np.std(op))
        if about_op and abs(float(np.mean(sp - pv))) > float(np.std(pv)) > 0.0:
            return ["SP lies in the middle of OP, and PV lies off it: are PV and OP exchanged?"]
        return []
    where = " to ".join(f"{value:.4g}" for value in sorted({float(sp.min()), float(sp.max())}))
    said = f"SP ({where}) stays far from PV ({low:.4g} to {high:.4g}) all along"
    return [f"{said}: are PV and OP exchanged, is SP that of another loop or unit, or does the loop not reach it?"]


def swapped(sp: FloatArray, pv: FloatArray, op: FloatArray) -> bool:
    """Whether SP goes with OP and not with PV (shapes (N,)), as in a file whose PV and OP are swapped."""
    from_pv, from_op = float(np.median(np.abs(sp - pv))), float(np.median(np.abs(sp - op)))
    # OP is no controlled signal: it meets SP as closely as PV usually does only where the columns are swapped. A
    # controlled PV is usually nearer to SP than all that it ranges over.
    return from_pv > 10.0 * from_op and from_pv > float(np.ptp(pv)) and float(np.ptp(op)) > 0.0
