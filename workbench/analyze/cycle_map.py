"""`wb.cycle_map`: what each tuning of a plane does in the long run, exactly, with the textbook's borders."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, replace

import numpy as np

from workbench.analyze.describing_function import meeting_gain
from workbench.analyze.frequency import linear_stable
from workbench.analyze.limit_cycle import STARTS, standard_starts, together
from workbench.analyze.long_run import follow
from workbench.analyze.margins import margins
from workbench.analyze.valve_loci import no_locus
from workbench.errors import InvalidValue
from workbench.model.checks import callback, instance, ordered_pair, whole
from workbench.model.controller import PID
from workbench.model.cycle_map import FIGURES, MOST, OUTCOMES, POINTS, CycleMap
from workbench.model.loop import Loop
from workbench.model.plant import FOPDT
from workbench.model.record import FloatArray
from workbench.simulate.batch import cores

__all__ = ["cycle_map", "map_ranges"]

Pair = tuple[float, float]

# By default: Kc from and to these shares of the gain at which the loop with an ideal valve turns unstable; Ti in tau +
# theta, or sample time and dead time of an integrating plant; Td in the same. How far beyond a tuning a map reaches.
KC_SHARES, TI_LAGS, TI_DELAYS, TD_LAGS = (0.02, 1.2), (0.3, 60.0), (2.0, 200.0), (0.0, 1.0)
BEYOND = 1.3
# Samples before a cell's cycle may be called late: a fifth of what `limit_cycle` takes gives the same on all cells that
# were compared (benchmarks/cycle_maps.py).
LEAST = 20_000


@dataclass(frozen=True, eq=False)
class _Row:
    """One row's results, shape (M,) each."""

    outcome: FloatArray
    figures: FloatArray  # (len(FIGURES), M)
    linear_stable: FloatArray
    crossing: FloatArray
    loop_gain: FloatArray
    lag_ratio: FloatArray


def cycle_map(
    loop: Loop,
    Kc: Pair | None = None,
    Ti: Pair | None = None,
    Td: Pair | None = None,
    *,
    points: int | tuple[int, int] = POINTS,
    starts: int = 4,
    progress: Callable[[float], None] | None = None,
) -> CycleMap:
    """Return the map over Kc and Ti at the controller's Td, or where a range of Td is given over Kc and Td at its Ti.

    Kc: (low, high) in %/EU, low > 0; Ti, Td: (low, high) in s, Ti's low > 0; in the controller's own form. A range that
    is not given is `map_ranges`'. points: cells along (Kc, Ti or Td), one number for both. Each cell is followed from
    `starts` of the starts of `limit_cycle`, evenly chosen, by its own rules but for 20,000 samples in place of 100,000
    before a cycle is late: its figures are medians over those that cycle. With a compensator there is no describing
    function and no closed form, and what is drawn of them is nan. Rows are shared out over the machine's cores.

    progress: called with the share done, 0 .. 1; an error or interrupt that it raises, like Ctrl-C, ends the work
    within a cell. Raises `InvalidValue` for ranges of both Ti and Td, bad ranges or counts, and tunings in them that
    the loop's controller refuses or that have no ideal equivalent.
    """
    instance(loop, Loop, "loop", "a Loop")
    callback(progress, "cycle_map.progress")
    if Ti is not None and Td is not None:
        raise InvalidValue("cycle_map.Td", (Ti, Td), "must not be given beside a range of Ti: a map has two axes")
    axis = "Td" if Td is not None else "Ti"
    columns, rows = points if isinstance(points, tuple) and len(points) == 2 else (points, points)
    for name, count in (("columns", columns), ("rows", rows)):
        if whole(count, f"cycle_map.points ({name})", least=2) > MOST:
            raise InvalidValue(f"cycle_map.points ({name})", count, f"must be at most {MOST}")
    if whole(starts, "cycle_map.starts", least=1) > len(STARTS):
        raise InvalidValue("cycle_map.starts", starts, f"must be at most {len(STARTS)}")
    usual = {} if Kc is not None and (Ti is not None or Td is not None) else map_ranges(loop, axis=axis)
    across = _range(usual.get("Kc") if Kc is None else Kc, "cycle_map.Kc", from_zero=False)
    given = Td if axis == "Td" else Ti
    up = _range(usual.get(axis) if given is None else given, f"cycle_map.{axis}", from_zero=axis == "Td")
    gains = np.geomspace(*across, columns)
    values = np.geomspace(*up, rows) if axis == "Ti" else np.linspace(*up, rows)

    def at(column: int, row: int) -> Loop:
        tuned = replace(loop.controller, Kc=float(gains[column]))
        value = float(values[row])
        return loop.with_controller(replace(tuned, Td=value) if axis == "Td" else replace(tuned, Ti=value))

    # The corners refuse what the controller's form does not allow, before the work starts.
    for column in (0, columns - 1):
        for row in (0, rows - 1):
            at(column, row).controller.ideal_terms()
    stop = threading.Event()
    done = _shared_out(lambda row: _row([at(c, row) for c in range(columns)], starts, stop), rows, stop, progress)
    figures = np.stack([row.figures for row in done], axis=1)
    return CycleMap(
        loop=loop,
        axis=axis,
        Kc=gains,
        values=values,
        starts=starts,
        outcome=np.stack([row.outcome for row in done]).astype(np.int8),
        **dict(zip(FIGURES, figures, strict=True)),
        linear_stable=np.stack([row.linear_stable for row in done]).astype(np.bool_),
        crossing=np.stack([row.crossing for row in done]),
        loop_gain=np.stack([row.loop_gain for row in done]),
        lag_ratio=np.stack([row.lag_ratio for row in done]),
    )


def map_ranges(loop: Loop, tunings: Iterable[PID] = (), *, axis: str = "Ti") -> dict[str, Pair]:
    """Return the ranges {"Kc": (low, high), axis: (low, high)} that suit a loop, widened to hold `tunings`.

    Kc from 0.02 to 1.2 of the gain at which the loop with an ideal valve and without integral action turns unstable, Ti
    from 0.3 to 60 (tau + theta), on an integrating plant from 2 to 200 (Ts + theta); Td from 0 to that lag. Tunings
    with an axis' parameter infinite, or at 0 where the axis has ratios, are left out. Raises `InvalidValue`.
    """
    controller, plant = loop.controller, loop.plant
    plain = replace(controller, form="ideal", Kc=1.0, Ti=math.inf, Td=0.0, action=_fitting(loop))
    # The margin is a factor on a gain that is stable, so this one is made small enough to be.
    while not linear_stable(loop.with_controller(plain)):
        plain = replace(plain, Kc=0.1 * plain.Kc)
    ultimate = plain.Kc * margins(loop.with_controller(plain)).gain_margin
    if not math.isfinite(ultimate):
        ultimate = 10.0 / abs(plant.gain)
    lag, lags = loop.sample_time + plant.dead_time, TI_DELAYS
    if isinstance(plant, FOPDT):
        lag, lags = plant.time_constant + plant.dead_time, TI_LAGS
    if axis == "Td":
        lags = TD_LAGS
    # A parallel controller's Ti is the ideal one's over Kc, and its Td that times Kc.
    middle = math.sqrt(KC_SHARES[0] * KC_SHARES[1]) * ultimate
    share = 1.0 if controller.form != "parallel" else middle if axis == "Td" else 1.0 / middle
    ranges = {
        "Kc": (KC_SHARES[0] * ultimate, KC_SHARES[1] * ultimate),
        axis: (lags[0] * lag * share, lags[1] * lag * share),
    }
    for name, (low, high) in ranges.items():
        there = [float(getattr(tuning, name)) for tuning in tunings]
        kept = [v for v in there if math.isfinite(v) and (v > 0.0 or name == "Td")]
        least, most = min(kept, default=low), max(kept, default=high)
        ranges[name] = (least / BEYOND if least < low else low, most * BEYOND if most > high else high)
    return ranges


def _fitting(loop: Loop) -> str:
    return "reverse" if loop.gain > 0.0 else "direct"


def _range(given: object, where: str, *, from_zero: bool) -> Pair:
    low, high = ordered_pair(given, where, least=0.0)
    if low == 0.0 and not from_zero:
        raise InvalidValue(where, (low, high), "must be a pair (low, high) with low > 0: the axis has even ratios")
    return low, high


def _shared_out(
    work: Callable[[int], _Row], rows: int, stop: threading.Event, progress: Callable[[float], None] | None
) -> list[_Row]:
    """Do `work` for every row on all cores; `stop` is set where anything goes wrong here."""
    with ThreadPoolExecutor(cores()) as pool:
        futures = [pool.submit(work, row) for row in range(rows)]
        try:
            for count, future in enumerate(as_completed(futures), start=1):
                future.result()
                if progress is not None:
                    progress(count / rows)
        except BaseException:
            stop.set()
            for future in futures:
                future.cancel()
            raise
    return [future.result() for future in futures]


def _row(loops: list[Loop], count: int, stop: threading.Event) -> _Row:
    """Return one row's results; a row that was told to stop is left unfinished, and nobody reads it."""
    size = len(loops)
    outcome, figures, stable = np.zeros(size), np.full((len(FIGURES), size), math.nan), np.zeros(size)
    loop_gain, lag_ratio = np.full(size, math.nan), np.full(size, math.nan)
    for k, loop in enumerate(loops):
        if stop.is_set():
            break
        all_starts = standard_starts(loop)
        each = np.arange(min(count, len(all_starts))) * len(all_starts) // min(count, len(all_starts))
        found = tuple(follow(loop, all_starts[i], least=LEAST, traced=False) for i in each)
        outcome[k], stable[k] = OUTCOMES.index(together(found)), linear_stable(loop)
        cycling = [one for one in found if one.outcome == "cycles"]
        if cycling:
            figures[:, k] = [np.median([getattr(one, name) for one in cycling]) for name in FIGURES]
        terms, valve, plant = loop.controller.ideal_terms(), loop.valve, loop.plant
        plain = loop.controller.compensator is None
        if plain and isinstance(plant, FOPDT) and valve.slip_jump > 0.0 and valve.stick_band > 0.0:
            J_S = valve.slip_jump / valve.stick_band
            loop_gain[k] = loop.controller.signed_gain * terms.Kc * loop.gain * J_S
            lag_ratio[k] = terms.Ti / (plant.time_constant + plant.dead_time)
    crossing = np.full(size, math.nan)
    # Neither describing function nor closed form knows a compensator.
    plain = loops[0].controller.compensator is None and not no_locus(loops[0].valve)
    if plain and loops[0].controller.form != "parallel" and not stop.is_set():
        # Kc scales L as a whole, so that one search does for the row.
        crossing = meeting_gain(loops[0]) * loops[0].controller.Kc / np.array([loop.controller.Kc for loop in loops])
    return _Row(outcome, figures, stable, crossing, loop_gain, lag_ratio)
