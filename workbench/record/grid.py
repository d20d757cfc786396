"""A loop's signals on one even grid of time: as recorded where they are even, else resampled by a stated method.

Method: PV and a measured stem are interpolated linearly; OP, SP and MODE hold their last value, as the controller's
output and settings do. Nothing is interpolated over a gap, or over values that were recorded as bad, but for a single
row of an even file that is missing or unusable. Rows are even where each lies near its place on an even grid: a clock
that stamps them early or late did not move the samples, nor one that stamps tags one after the other (see `stamps`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from workbench.errors import RecordError
from workbench.model.record import FloatArray
from workbench.record.even import most_uneven, places
from workbench.record.missing import doubt_said, missing_said
from workbench.record.signals import Signal, Signals
from workbench.record.stamps import on_stamps_of_pv
from workbench.record.table import BLANK, OK, Cells
from workbench.record.times import JITTER

__all__ = ["Samples", "lay"]

SPARSE = 0.20  # of the values come after a blank from which blanks mean "no new value", as in a row per change
COMMON = 0.90  # share of times that PV and OP must have in common to count as sampled together
GAP = 10.0  # usual intervals without a value that are a gap in irregular records,
# unless a compressed archive is often silent for longer: then this many times the longest silence but for the rarest.
SILENCE, RARE, FEW = 3.0, 0.01, 40
FINEST = 10.0  # samples that a usual interval may be cut into
MOST = 20_000_000  # samples on the grid


@dataclass
class Samples:
    """A loop on one grid, shape (N,): usable where PV and OP are both known, joined where a sample follows the last.

    sample_time: s. even: whether the samples are the recorded rows themselves. gaps: in time. between: samples whose
    PV lies between recorded values. filled: single rows that were unusable. lines: of the file. sp and stem are nan
    where unknown.
    """

    seconds: FloatArray
    pv: FloatArray
    op: FloatArray
    usable: NDArray[np.bool_]
    joined: NDArray[np.bool_]
    sample_time: float
    lines: NDArray[np.int64]
    even: bool
    gaps: int
    sp: FloatArray | None = None
    stem: FloatArray | None = None
    mode: list[str] | None = None
    between: int = 0
    filled: int = 0
    notes: list[str] = field(default_factory=list)


def lay(signals: Signals, sample_time: float | None, max_gap: float | None, source: str) -> Samples:
    """Return the loop on one grid. sample_time, max_gap: s, or None for the record's own. Raises `RecordError`."""
    signals, apart = on_stamps_of_pv(signals)
    out = _laid(signals, sample_time, max_gap, source)
    out.notes[:0] = apart
    return out


def _laid(signals: Signals, sample_time: float | None, max_gap: float | None, source: str) -> Samples:
    pv, op = _together(signals.by["PV"], signals.by["OP"])
    why = "PV and OP have times of their own"
    if pv.seconds is op.seconds or np.array_equal(pv.seconds, op.seconds):
        if not signals.timed:
            one_by_one = np.ones(max(pv.seconds.size - 1, 0), dtype=np.int64)
            return _as_recorded(signals, pv, op, 1.0 if sample_time is None else sample_time, one_by_one)
        if pv.seconds.size < 2:
            many = f"{pv.seconds.size} row{'s' if pv.seconds.size != 1 else ''}"
            msg = f"{source}: {many} with a time; at least two are needed"
            raise RecordError(msg)
        values = [pv.cells.values, op.cells.values]
        usual, moved = places(pv.seconds, values)
        bridging = max_gap is not None and max_gap > (1.0 + JITTER) * usual
        if not bridging and moved is not None and not any(_sparse(s.cells) for s in (pv, op)):
            _agree(sample_time, usual, signals, source)
            out = _as_recorded(signals, pv, op, usual, moved)
            out.notes += doubt_said(pv.seconds, values, usual)
            return out
        why = "the times are not even" if moved is None else "most rows hold only what changed"
        if moved is None and (missing := missing_said(pv.seconds)) is not None:
            why, sample_time = missing[0], missing[1] if sample_time is None else sample_time
    if max_gap is not None:
        why = "gaps are to be bridged"
    return _resampled(signals, pv, op, sample_time, max_gap, source, why)


def _together(pv: Signal, op: Signal) -> tuple[Signal, Signal]:
    """Return PV and OP of a tall file on the times of either, where they are nearly all common, with blanks between."""
    if pv.seconds.size == op.seconds.size and np.array_equal(pv.seconds, op.seconds):
        return pv, op
    union = np.union1d(pv.seconds, op.seconds)
    common = pv.seconds.size + op.seconds.size - union.size
    if common < COMMON * union.size:
        return pv, op
    lines = np.zeros(union.size, dtype=np.int64)
    places = []
    for signal in (op, pv):
        places.append(np.searchsorted(union, signal.seconds))
        lines[places[-1]] = signal.lines
    spread = []
    for signal, at in zip((op, pv), places, strict=True):
        values, marks = np.full(union.size, np.nan), np.full(union.size, BLANK, dtype=np.int8)
        values[at], marks[at] = signal.cells.values, signal.cells.marks
        cells = Cells(values, marks, signal.cells.words, qualities=signal.cells.qualities)
        spread.append(Signal(signal.name, union, cells, lines))
    return spread[1], spread[0]


def _sparse(cells: Cells) -> bool:
    """Whether blanks stand among the values throughout; blanks in a block are values that are missing."""
    values, blank = int(np.count_nonzero(cells.marks == OK)), cells.marks == BLANK
    begun = int(np.count_nonzero(blank & ~np.concatenate([[False], blank[:-1]])))
    return begun >= SPARSE * values and values > 1


def _agree(sample_time: float | None, usual: float, signals: Signals, source: str) -> None:
    if sample_time is not None and abs(usual - sample_time) > 0.01 * sample_time:
        msg = (
            f"{source}: sample_time {sample_time:g} s given, but column {signals.time_name!r} has {usual:g} s between "
            "rows; leave sample_time out, or the time column"
        )
        raise RecordError(msg)


def _as_recorded(signals: Signals, pv: Signal, op: Signal, usual: float, moved: NDArray[np.int64]) -> Samples:
    """The rows themselves, for they are evenly spaced; between rows of which few are missing, their places filled."""
    seconds = pv.seconds * (1.0 if signals.timed else usual)
    usable = (pv.cells.marks == OK) & (op.cells.marks == OK)
    joined = np.concatenate([np.zeros(min(seconds.size, 1), dtype=bool), moved > 0])
    gaps = int(np.count_nonzero((moved == 0) & (np.diff(seconds) > (1.0 + JITTER) * usual)))
    out = Samples(seconds, pv.cells.values, op.cells.values, usable, joined, usual, pv.lines, True, gaps)
    _others(out, signals, np.inf)
    out = _mended(out, moved, pv.cells.marks == OK, op.cells.marks == OK)
    return _filled(out, moved) if (moved > 1).any() else out


def _mended(rows: Samples, moved: NDArray[np.int64], good_pv: NDArray[np.bool_], good_op: NDArray[np.bool_]) -> Samples:
    """Return the rows with single ones among usable ones made usable, as a single missing row's place is filled.

    Not where these are many: who loses every few values says little between them.
    """
    good = rows.usable
    single = np.zeros(good.size, dtype=bool)
    single[1:-1] = ~good[1:-1] & good[:-2] & good[2:] & (moved[:-1] == 1) & (moved[1:] == 1)
    many = int(np.count_nonzero(single))
    if not 0 < many <= most_uneven(moved.size):
        return rows

    def linear(values: FloatArray, missing: NDArray[np.bool_]) -> FloatArray:
        at, mended = np.flatnonzero(single & missing), values.copy()
        mended[at] = 0.5 * (values[at - 1] + values[at + 1])
        return mended

    op, no_op = rows.op.copy(), np.flatnonzero(single & ~good_op)
    op[no_op] = op[no_op - 1]
    mode = rows.mode
    if mode is not None:
        # What stands in place of a value may stand in place of the mode too.
        mode = [mode[i - 1] if bad else mode[i] for i, bad in enumerate(single.tolist())]
    value = "1 single unusable row is" if many == 1 else f"{many} single unusable rows are"
    note = f"{value} filled: there PV is linear between its neighbours, or OP held"
    return replace(
        rows,
        pv=linear(rows.pv, ~good_pv),
        op=op,
        usable=good | single,
        stem=None if rows.stem is None else linear(rows.stem, np.isnan(rows.stem)),
        mode=mode,
        between=int(np.count_nonzero(single & ~good_pv)),
        filled=many,
        notes=[*rows.notes, note],
    )


def _filled(rows: Samples, moved: NDArray[np.int64]) -> Samples:
    """Return the samples with the places between joined rows filled, where the rows on both sides are usable."""
    both = rows.usable[1:] & rows.usable[:-1]
    moved = np.where(both, moved, np.minimum(moved, 1))
    place = np.concatenate([[0], np.cumsum(np.maximum(moved, 1))])
    at = np.arange(int(place[-1]) + 1)
    last = np.searchsorted(place, at, side="right") - 1
    new = place[last] != at

    def linear(values: FloatArray) -> FloatArray:
        return np.where(new, np.interp(at, place, values), values[last])

    missing = int(np.count_nonzero(new))
    single = "1 single row is" if missing == 1 else f"{missing} single rows are"
    note = f"{single} missing: there PV is linear between its neighbours, and OP held"
    return replace(
        rows,
        seconds=linear(rows.seconds),
        pv=linear(rows.pv),
        op=rows.op[last],
        usable=rows.usable[last],
        joined=rows.joined[last] | new,
        lines=rows.lines[last],
        sp=None if rows.sp is None else rows.sp[last],
        stem=None if rows.stem is None else linear(rows.stem),
        mode=None if rows.mode is None else [rows.mode[i] for i in last.tolist()],
        between=rows.between + missing,
        notes=[*rows.notes, note],
    )


def _resampled(
    signals: Signals,
    pv: Signal,
    op: Signal,
    sample_time: float | None,
    max_gap: float | None,
    source: str,
    why: str,
) -> Samples:
    t, y, lines, bad = _good(pv)
    t_op, u, _, bad_op = _good(op)
    usual = [float(np.median(np.diff(times))) for times in (t, t_op) if times.size > 1]
    if t.size < 2 or not usual:
        msg = f"{source}: {t.size} usable value{'s' if t.size != 1 else ''} of PV; at least two are needed"
        raise RecordError(msg)
    Ts = float(f"{min(usual):.4g}") if sample_time is None else sample_time
    if Ts <= 0.0 or not np.isfinite(Ts) or Ts * FINEST < min(usual) * (1.0 - 1e-9):
        msg = (
            f"{source}: sample_time {Ts:g} s is too short: values are recorded every {min(usual):.4g} s; at most "
            f"{FINEST:g} samples to one of these are made"
        )
        raise RecordError(msg)
    steps = np.diff(t)
    limit = max(_gap(steps), GAP * Ts) if max_gap is None else max_gap
    limit_op = max(limit, _gap(np.diff(t_op))) if max_gap is None else max_gap
    split = steps > limit * (1.0 + 1e-9)
    gaps = int(np.count_nonzero(split))
    if max_gap is None and bad.size:
        split |= np.diff(np.searchsorted(bad, t)) > 0
    zero = max(float(t[0]), float(t_op[0]))
    first = np.concatenate(([0], np.flatnonzero(split) + 1))
    last = np.concatenate((first[1:] - 1, [t.size - 1]))
    begin = np.maximum(np.ceil((t[first] - zero) / Ts - 1e-6), 0.0)
    end = np.floor((t[last] - zero) / Ts + 1e-6)
    counts = np.maximum(end - begin + 1.0, 0.0)
    if not float(counts.sum()) <= MOST:
        msg = (
            f"{source}: {counts.sum():.3g} samples of {Ts:g} s would be needed, at most {MOST:,} are made; give a "
            "longer sample_time, or a shorter max_gap"
        )
        raise RecordError(msg)
    each = counts.astype(np.int64)
    k = np.concatenate([b + np.arange(n) for b, n in zip(begin.tolist(), each.tolist(), strict=True)] or [np.zeros(0)])
    which = np.repeat(np.arange(each.size), each)
    seconds = zero + Ts * k
    joined = np.zeros(k.size, dtype=bool)
    joined[1:] = (np.diff(which) == 0) & (np.diff(k) == 1.0)
    at_op = np.searchsorted(t_op, seconds + 1e-6 * Ts, side="right") - 1
    age = seconds - t_op[np.maximum(at_op, 0)]
    usable = (at_op >= 0) & (age <= limit_op * (1.0 + 1e-9))
    if max_gap is None and bad_op.size:
        usable &= np.searchsorted(bad_op, seconds, side="right") == np.searchsorted(bad_op, t_op)[np.maximum(at_op, 0)]
    at = np.clip(np.searchsorted(t, seconds + 1e-6 * Ts, side="right") - 1, 0, t.size - 1)
    between = int(np.count_nonzero(np.abs(seconds - t[at]) > 1e-6 * Ts))
    out = Samples(
        seconds,
        np.interp(seconds, t, y),
        u[np.maximum(at_op, 0)],
        usable,
        joined,
        Ts,
        lines[at],
        even=False,
        gaps=gaps,
        between=between,
    )
    _others(out, signals, limit)
    out.notes.append(_method(signals, out, why, min(usual), limit))
    return out


def _gap(steps: FloatArray) -> float:
    """Return the longest interval, s, that is no gap in an irregular signal's own intervals, shape (N - 1,)."""
    if steps.size == 0:
        return 0.0
    rare = max(4, math.ceil(RARE * steps.size))
    silence = float(np.sort(steps)[-rare]) if steps.size >= FEW else 0.0
    return max(GAP * float(np.median(steps)), SILENCE * silence)


def _method(signals: Signals, out: Samples, why: str, usual: float, limit: float) -> str:
    held = ["OP", *(name for name in ("SP", "MODE") if name in signals.by)]
    linear = ["PV", *(["valve position"] if out.stem is not None else [])]
    return (
        f"resampled, as {why}: every {out.sample_time:g} s (values came every {usual:.4g} s), {' and '.join(linear)} "
        f"linear between values, {', '.join(held)} held; {out.between / max(out.pv.size, 1):.0%} of the samples lie "
        f"between recorded values of PV; more than {limit:.4g} s without a value is a gap"
    )


def _good(signal: Signal) -> tuple[FloatArray, FloatArray, NDArray[np.int64], FloatArray]:
    """Return times, values and lines of the good cells, shape (M,), and the times of bad ones."""
    good = signal.cells.marks == OK
    bad = ~good & (signal.cells.marks != BLANK)
    return signal.seconds[good], signal.cells.values[good], signal.lines[good], signal.seconds[bad]


def _others(out: Samples, signals: Signals, limit: float) -> None:
    """Add SP, MODE and the stem where they were recorded; at the rows' own times cell by cell."""
    for name in ("SP", "MODE", "valve_position"):
        signal = signals.by.get(name)
        if signal is None:
            continue
        own = out.even and (not signals.timed or np.array_equal(signal.seconds, out.seconds))
        if name == "MODE":
            out.mode = _held_texts(signal, out.seconds, own)
            continue
        t, values, _, _ = _good(signal)
        if t.size == 0:
            found = np.full(out.seconds.size, np.nan)
        elif own:
            found = np.where(signal.cells.marks == OK, signal.cells.values, np.nan)
        elif name == "SP":
            at = np.searchsorted(t, out.seconds + 1e-6 * out.sample_time, side="right") - 1
            found = np.where(at >= 0, values[np.maximum(at, 0)], np.nan)
        else:
            found = np.interp(out.seconds, t, values, left=np.nan, right=np.nan)
            after = np.clip(np.searchsorted(t, out.seconds, side="left"), 0, t.size - 1)
            before = np.clip(np.searchsorted(t, out.seconds, side="right") - 1, 0, t.size - 1)
            found[t[after] - t[before] > limit] = np.nan
        if name == "SP":
            out.sp = found
        else:
            out.stem = found


def _held_texts(signal: Signal, seconds: FloatArray, own: bool) -> list[str]:
    texts = signal.cells.as_texts()
    filled = np.flatnonzero([bool(text) for text in texts])
    if filled.size == 0:
        return [""] * seconds.size
    # A blank mode is the mode before it; before the first nothing is known.
    if own:
        at = np.searchsorted(filled, np.arange(len(texts)), side="right") - 1
    else:
        at = np.searchsorted(signal.seconds[filled], seconds, side="right") - 1
    return [texts[filled[i]] if i >= 0 else "" for i in at.tolist()]
