"""Recorded data of one loop, evenly sampled."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from numbers import Complex, Number, Real
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InvalidValue
from workbench.model.checks import all_of, instance, number, ordered_pair
from workbench.model.numbers import given
from workbench.model.show import Shown

__all__ = ["FloatArray", "Record", "signal_of"]

FloatArray = NDArray[np.float64]


def _number(value: object) -> bool:
    """Whether an object is a real number, or none that was recorded; a decimal one is no `Real` for Python."""
    real = isinstance(value, Real) or not isinstance(value, Complex)
    return value is None or (isinstance(value, Number) and real and not isinstance(value, bool))


def signal_of(value: object, where: str, length: int | None) -> FloatArray:
    """Return a signal as a read-only copy, shape (N,), of `length` samples where that is given.

    Masked values are missing ones, nan. Raises `InvalidValue` for anything but an array of one dimension of finite real
    numbers (truth values, text, times and complex numbers are none).
    """
    what, rule = type(value).__name__, "must be an array of real numbers"
    try:
        given = np.asarray(value)
        if isinstance(value, np.ma.MaskedArray) and given.dtype.kind in "fiuO":
            given = np.where(np.ma.getmaskarray(value), np.nan, given)
        array = np.array(given, dtype=np.float64) if given.dtype.kind in "fiuO" else np.empty(0)
    except (TypeError, ValueError, OverflowError):
        raise InvalidValue(where, what, rule) from None
    if given.dtype.kind not in "fiuO" or (given.dtype.kind == "O" and not all(map(_number, given.flat))):
        raise InvalidValue(where, f"{what} of {given.dtype.name}", rule)
    if array.ndim != 1:
        raise InvalidValue(where, f"shape {array.shape}", "must have one dimension")
    if length is not None and array.size != length:
        raise InvalidValue(where, f"{array.size} samples", f"must have the {length} samples of PV")
    if array.size == 0:
        raise InvalidValue(where, "no samples", "must hold at least one sample")
    bad = ~np.isfinite(array)
    if bad.any():
        first = int(np.argmax(bad))
        raise InvalidValue(f"{where}[{first}]", float(array[first]), "must be a finite number")
    array.setflags(write=False)
    return array


@dataclass(frozen=True, eq=False)
class Record(Shown):
    """Measured data of one loop.

    pv (EU) and op (%) are needed, shape (N,), finite, evenly sampled every sample_time s from `start` s on; op[k] is
    the output that the controller computed in the sample of pv[k]. sp (EU), valve_position (% of travel, measured by a
    positioner) and mode (text per sample) where recorded. epoch: what time 0 is on the clock of the timestamps, s since
    1970, or 0 where times are plain seconds: loops meet at epoch + time. zone: where the timestamps carry one, how far
    it is east of Greenwich, as (s since 1970, s east from then on) in the order of time; () where they carry none, and
    are what a clock on a wall shows. pv_range: (low, high) of the transmitter, EU, where known. `notes` say what
    reading kept, rejected and assumed; `counts` the same in numbers. Gaps, bad values and changes of mode part what a
    plant records: the record is the best stretch, and `rest` holds the others of the same loop. Arrays are copied and
    read-only. Raises `InvalidValue`.
    """

    pv: FloatArray
    op: FloatArray
    sample_time: float
    sp: FloatArray | None = None
    valve_position: FloatArray | None = None
    mode: tuple[str, ...] | None = None
    start: float = 0.0
    source: str = ""
    notes: tuple[str, ...] = ()
    counts: Mapping[str, int] = field(default_factory=dict)
    pv_range: tuple[float, float] | None = None
    rest: tuple[Record, ...] = ()
    epoch: float = 0.0
    zone: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        pv = signal_of(self.pv, "Record.pv", None)
        object.__setattr__(self, "pv", pv)
        object.__setattr__(self, "op", signal_of(self.op, "Record.op", pv.size))
        object.__setattr__(self, "sample_time", number(self.sample_time, "Record.sample_time", above=0.0, unit="s"))
        for name in ("sp", "valve_position"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, signal_of(getattr(self, name), f"Record.{name}", pv.size))
        if self.mode is not None:
            instance(self.mode, Iterable, "Record.mode", "a sequence of texts, one for each sample")
            mode = tuple(str(m) for m in self.mode)
            if len(mode) != pv.size:
                raise InvalidValue("Record.mode", f"{len(mode)} samples", f"must have the {pv.size} samples of PV")
            object.__setattr__(self, "mode", mode)
        object.__setattr__(self, "start", number(self.start, "Record.start", unit="s"))
        object.__setattr__(self, "epoch", number(self.epoch, "Record.epoch", unit="s"))
        instance(self.zone, Iterable, "Record.zone", "pairs (s since 1970, s east of Greenwich from then on)")
        zone = tuple((number(at, "Record.zone", unit="s"), number(s, "Record.zone", unit="s")) for at, s in self.zone)
        object.__setattr__(self, "zone", zone)
        if self.pv_range is not None:
            object.__setattr__(self, "pv_range", ordered_pair(self.pv_range, "Record.pv_range"))
        object.__setattr__(self, "rest", all_of(self.rest, Record, "Record.rest", "a Record"))
        object.__setattr__(self, "notes", all_of(self.notes, str, "Record.notes", "a text"))
        instance(self.counts, Mapping, "Record.counts", "a mapping such as {'rows': 100}")
        object.__setattr__(self, "counts", MappingProxyType(dict(self.counts)))

    def __len__(self) -> int:
        return int(self.pv.size)

    @property
    def time(self) -> FloatArray:
        """Sample times, s, shape (N,), from `start` on."""
        return self.start + self.sample_time * np.arange(self.pv.size, dtype=np.float64)

    @property
    def segments(self) -> tuple[Record, ...]:
        """This stretch and the others of the same loop, in the order of time; nothing joins one to the next."""
        return tuple(sorted((replace(self, rest=()), *self.rest), key=lambda r: r.start))

    def instant(self, wall: float) -> float:
        """Return a time by the clock of the timestamps, s since 1970 with no zone, as `epoch` + `time` counts it.

        Of an hour that this clock shows twice it is the first.
        """
        found = wall - (self.zone[0][1] if self.zone else 0.0)
        for since, east in self.zone[1:]:
            found = found if found < since else max(wall - east, since)
        return found

    def summary(self) -> tuple[str, ...]:
        """Return what the record is, what was kept and why, in lines of words."""
        hours = len(self) * self.sample_time / 3600.0
        lines = [f"{len(self)} samples of {given(self.sample_time, 6)} s ({given(hours, 3)} h)"]
        if self.rest:
            many = sum(len(r) for r in self.rest)
            lines[0] += f"; {len(self.rest)} other stretch{'es' if len(self.rest) > 1 else ''} of {many} samples"
        return (*lines, *self.notes)
