"""From a loop's samples to its stretches: parted at gaps, bad values, a frozen sensor and changes of mode."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.model.record import FloatArray, Record
from workbench.record.checks import frozen_rows
from workbench.record.even import best_grid
from workbench.record.grid import Samples
from workbench.record.modes import MANUAL, mode_kinds, mode_words, modes_unknown, zero_is_manual

__all__ = ["Parts", "part", "record_of"]

USABLE = 30  # samples of a stretch that is worth keeping beside the best one
SAID = 5e-4  # of the sample time, by which times differ from the even grid at least where that is said
NAMED = 4  # frozen stretches named one by one


@dataclass(frozen=True)
class Parts:
    """Stretches [first, stop) in the order of time: the best one, and others of `USABLE` samples at least.

    frozen: samples left out as frozen; manual: samples in manual beside a stretch that is not. notes: why it was
    parted, in words.
    """

    best: tuple[int, int]
    others: tuple[tuple[int, int], ...]
    frozen: int
    manual: int
    notes: tuple[str, ...]


def part(samples: Samples, unit: str) -> Parts:
    """Return the stretches of a record; the best is the longest that is not in manual, else the longest.

    Automatic and cascade stretches are kept apart, for a cascade moves SP all the time. A stretch in manual counts only
    where there is no other.
    """
    usable, notes = samples.usable.copy(), []
    frozen = frozen_rows(samples.pv, samples.joined & _and_before(usable)) if samples.even else []
    for first, stop in frozen:
        usable[first:stop] = False
    if frozen:
        notes.append(_frozen_said(samples, frozen, unit))
    follows = samples.joined & _and_before(usable)
    kinds = None if samples.mode is None else np.array(mode_kinds(samples.mode))
    if kinds is not None:
        follows[1:] &= kinds[1:] == kinds[:-1]
    begins = np.flatnonzero(usable & ~follows)
    if begins.size == 0:
        return Parts((0, 0), (), _many(frozen), 0, tuple(notes))
    ends = np.concatenate((begins[1:], [usable.size]))
    # Unusable samples lie behind the last sample that follows.
    stops = np.array(
        [b + 1 + _leading(follows[b + 1 : e]) for b, e in zip(begins.tolist(), ends.tolist(), strict=True)]
    )
    length = stops - begins
    manual = np.zeros(begins.size, dtype=bool) if kinds is None else kinds[begins] == MANUAL
    all_manual = not (length[~manual] >= 2).any()
    score = np.where(manual & (not all_manual), -1, length)
    best = int(np.argmax(score))
    others = [
        (int(b), int(e))
        for i, (b, e) in enumerate(zip(begins.tolist(), stops.tolist(), strict=True))
        if i != best and score[i] >= USABLE
    ]
    in_manual = 0 if all_manual else int(length[manual].sum())
    if samples.mode is not None and kinds is not None:
        notes += _modes_said(samples.mode, kinds[usable], all_manual and bool(manual.any()), in_manual)
    return Parts((int(begins[best]), int(stops[best])), tuple(others), _many(frozen), in_manual, tuple(notes))


def _and_before(flags: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Whether a sample and the one before it are both flagged."""
    out = flags.copy()
    out[1:] &= flags[:-1]
    out[:1] = False
    return out


def _leading(flags: NDArray[np.bool_]) -> int:
    return int(flags.size if flags.all() else np.argmin(flags))


def _many(stretches: list[tuple[int, int]]) -> int:
    return sum(stop - first for first, stop in stretches)


def _frozen_said(samples: Samples, frozen: list[tuple[int, int]], unit: str) -> str:
    named = ", ".join(
        f"{samples.pv[a]:.6g} in {unit}s {samples.lines[a]} to {samples.lines[b - 1]}" for a, b in frozen[:NAMED]
    )
    more = f" and {len(frozen) - NAMED} more times" if len(frozen) > NAMED else ""
    return (
        f"PV is frozen at {named}{more} ({_many(frozen)} samples) while it moves elsewhere: left out, as of a stuck "
        "sensor or transmission"
    )


def _modes_said(mode: list[str], kinds: NDArray[np.str_], all_manual: bool, in_manual: int) -> list[str]:
    if all_manual:
        return [f"MODE: {mode_words(mode)}; the controller was never in automatic: OP is not its answer to PV"]
    unknown, several = modes_unknown(mode), len(set(kinds.tolist())) > 1
    if not several and not unknown:
        return []
    told = ["stretches of one mode are kept apart"] if several else []
    told += [f"the {in_manual} samples in manual are left out"] if in_manual else []
    told += ["0 is taken for manual"] if in_manual and zero_is_manual(mode) else []
    told += [f"whether {' or '.join(unknown[:NAMED])} is automatic or manual is not known"] if unknown else []
    return [f"MODE: {mode_words(mode)}; {'; '.join(told)}"]


def _sampling(samples: Samples, first: int, stop: int) -> tuple[float, float, float]:
    """Return (sample time, start, largest deviation from the even grid as a share of the sample time)."""
    times = samples.seconds[first:stop]
    usual = samples.sample_time
    off = float(np.abs(times - times[0] - usual * np.arange(times.size)).max()) / usual
    if off > 1e-6:
        # A rounded or drifting clock: the first row and the last are no better than the others.
        usual, away = best_grid(times, np.ones(times.size - 1, dtype=np.int64))
        off = float(np.abs(away).max()) / usual
    return usual, float(times[0]), off


def record_of(samples: Samples, first: int, stop: int, sample_time: float | None, notes: list[str]) -> Record:
    """Return one stretch as a record, and add to `notes` what had to be left out or held in it."""
    where = slice(first, stop)
    Ts, start, jitter = _sampling(samples, first, stop)
    if jitter >= SAID and samples.even:
        notes.append(f"times differ from the even grid by up to {jitter:.1%} of the sample time; taken as even")
    if sample_time is not None and sample_time != Ts:
        notes.append(f"the sample time is taken as {sample_time:g} s, as given; the times show {Ts:.9g} s")
        Ts = sample_time
    sp = None if samples.sp is None else _setpoint(samples.sp[where], notes)
    stem = None if samples.stem is None else _stem(samples.stem[where], notes)
    mode = None if samples.mode is None else tuple(samples.mode[where])
    return Record(samples.pv[where], samples.op[where], Ts, sp=sp, valve_position=stem, mode=mode, start=start)


def _setpoint(values: FloatArray, notes: list[str]) -> FloatArray | None:
    good = np.isfinite(values)
    missing = int(np.count_nonzero(~good))
    if missing == values.size:
        notes.append("SP left out: no cell of the kept rows holds a number")
        return None
    if missing == 0:
        return values
    held = np.maximum.accumulate(np.where(good, np.arange(values.size), -1))
    held[held < 0] = int(np.argmax(good))
    first = int(np.argmax(good))
    if first:
        notes.append(f"SP: the first good value is taken for the {_cells(first)} before it, too; theirs may differ")
    if missing > first:
        notes.append(f"SP: the value before is held in {_cells(missing - first)} without a good value")
    return values[held]


def _cells(many: int) -> str:
    return f"{many} cell{'s' if many > 1 else ''}"


def _stem(values: FloatArray, notes: list[str]) -> FloatArray | None:
    missing = int(np.count_nonzero(~np.isfinite(values)))
    if missing:
        notes.append(f"valve position left out: {missing} of the kept cells hold no number")
        return None
    return values
