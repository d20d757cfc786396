"""From a day of a loop to the stretch that tells about its valve: one rate and one window, chosen from the cycle.

The tests of `wb.detect` want up to a hundred samples in a cycle and ten cycles or more; a day at 1 s holds far too many
of the one or of the other. A cycle is looked for at every rate by halves, for at the full rate noise
hides a slow cycle; the record is then thinned by means to `PER_CYCLE` samples in a cycle and cut to the window of
`WINDOW` samples in which the cycle is strongest. A loop without a cycle is thinned by how long PV remembers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from workbench.detect.action import control_error
from workbench.detect.oscillation import OSCILLATES, REGULAR, oscillation_of
from workbench.kpi.oscillation import autocorrelation
from workbench.model.detection import Oscillation
from workbench.model.record import FloatArray, Record

__all__ = ["Seen", "cycle_of", "oscillation_at_any_rate", "stretch", "thinned"]

PER_CYCLE = 100  # samples of a cycle, as `wb.detect` thins to
WINDOW = 1500  # samples
LEAST = 256  # samples at the slowest rate that is looked at
MEMORY = 5.0  # samples in the time that PV remembers
TRIED = 8  # windows


@dataclass(frozen=True, slots=True)
class Seen:
    """PV's strongest oscillation over a record, and by how much the record was thinned where it showed."""

    oscillation: Oscillation
    factor: int


def means(signal: FloatArray, factor: int) -> FloatArray:
    """Return the means of `factor` samples each, shape (N // factor,)."""
    if factor == 1:
        return signal
    count = signal.size // factor
    short: FloatArray = signal[: count * factor].reshape(count, factor).mean(axis=1)
    return short


def oscillation_at_any_rate(signal: FloatArray, sample_time: float) -> Seen:
    """Return the strongest regular oscillation of a signal, shape (N,), among its rates N, N/2, N/4 ... samples.

    The index counts only what the thinned signal still holds of the variance: a slow wave under much noise is weak.
    """
    power = float(signal.var())
    best = Seen(oscillation_of(signal, sample_time), 1)
    score = _score(best.oscillation)
    factor, short = 1, signal
    while short.size >= 2 * LEAST:
        factor, short = 2 * factor, means(short, 2)
        left = float(short.var()) / power if power > 0.0 else 0.0
        found = oscillation_of(short, factor * sample_time)
        found = replace(found, index=found.index * min(left, 1.0))
        if _score(found) > score:
            best, score = Seen(found, factor), _score(found)
    return best


def cycle_of(record: Record) -> Seen:
    """Return the strongest oscillation of a record's PV, or of SP - PV: a few setpoint steps hide a cycle in PV."""
    seen = [oscillation_at_any_rate(one, record.sample_time) for one in _signals(record)]
    return max(seen, key=lambda one: _score(one.oscillation))


def _signals(record: Record) -> list[FloatArray]:
    """PV, and the control error where SP moves."""
    moved = record.sp is not None and float(np.ptp(record.sp)) > 0.0
    return [record.pv, control_error(record)] if moved else [record.pv]


def _score(found: Oscillation) -> float:
    return found.index if found.regularity > REGULAR and math.isfinite(found.period) else -1.0


def _memory(signal: FloatArray) -> float:
    """Return how long a signal remembers, samples: where its autocorrelation falls below 1/e."""
    acf = autocorrelation(signal)
    below = np.flatnonzero(acf < 1.0 / math.e)
    return float(below[0]) if below.size else float(signal.size)


def thinned(record: Record, factor: int, first: int = 0, count: int | None = None) -> Record:
    """Return `count` samples of a record thinned by `factor` from sample `first` on: the means of PV, OP and SP.

    A measured stem's likewise; the mode is that of the first sample of each.
    """
    stop = len(record) if count is None else first + count * factor
    if factor == 1 and stop - first == len(record):
        return record

    def cut(signal: FloatArray | None) -> FloatArray | None:
        return None if signal is None else means(signal[first:stop], factor)

    pv, op = means(record.pv[first:stop], factor), means(record.op[first:stop], factor)
    return Record(
        pv,
        op,
        record.sample_time * factor,
        sp=cut(record.sp),
        valve_position=cut(record.valve_position),
        mode=None if record.mode is None else record.mode[first:stop:factor][: pv.size],
        # A mean stands for the middle of its samples.
        start=record.start + (first + 0.5 * (factor - 1)) * record.sample_time,
        source=record.source,
        pv_range=record.pv_range,
        epoch=record.epoch,
        zone=record.zone,
    )


def stretch(record: Record, seen: Seen, window: int = WINDOW, per_cycle: int = PER_CYCLE) -> Record:
    """Return the stretch of a record that its valve is judged by: at most `window` samples, `per_cycle` in a cycle."""
    cycle = seen.oscillation
    if cycle.index >= OSCILLATES and math.isfinite(cycle.period):
        wanted = cycle.period / record.sample_time / per_cycle
    else:
        wanted = _memory(control_error(record)) / MEMORY
    longest = max(len(record) // window, 1)
    factor = min(max(int(wanted), 1), longest)
    if len(record) <= window * factor:
        return thinned(record, factor)
    span = window * factor
    starts = np.linspace(0, len(record) - span, min(TRIED, -(-len(record) // span))).astype(int).tolist()
    signals, every = _signals(record), factor * record.sample_time
    strengths = [
        max(_score(oscillation_of(means(one[s : s + span], factor), every)) for one in signals) for s in starts
    ]
    # The last of equals: what a loop does now counts.
    best = max(range(len(starts)), key=lambda i: (strengths[i], i))
    return thinned(record, factor, starts[best], window)
