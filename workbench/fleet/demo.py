"""A synthetic site of known truth: loops simulated exactly, in the tall Parquet form that historians export.

Kinds of loop: quiet (noise alone), disturbed (a slow load, a sinusoidal one, or steps), sticky (a valve that sticks
cycles), coupled (loops with good valves that a sticky one drives through the plant), tight (a linear loop near its
stability limit), saturated (OP at its end most of the time). Plants are those of a refinery's flows, pressures,
temperatures and levels; PV is noisy and both signals are rounded as a historian keeps them.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from workbench.analyze.margins import margins
from workbench.errors import InvalidValue, OutputError
from workbench.kpi.kpis import reversals
from workbench.model.controller import PID
from workbench.model.loop import Loop
from workbench.model.plant import FOPDT, Integrating, Plant
from workbench.model.record import FloatArray
from workbench.model.valve import Choudhury, Ideal, Stenman, Valve
from workbench.report.files import write_files
from workbench.simulate import kernel
from workbench.simulate.coefficients import coefficients, rest
from workbench.simulate.filter import first_order

__all__ = ["KINDS", "MEMBERS", "Truth", "site", "write_site"]

KINDS = ("quiet", "disturbed", "sticky", "coupled", "tight", "saturated")
# Of 20 loops in a row: a third quiet, one in five sticky by itself or with what it drives.
PATTERN = (
    "quiet", "disturbed", "sticky", "quiet", "root", "coupled", "coupled", "coupled", "quiet", "tight",
    "disturbed", "quiet", "sticky", "saturated", "quiet", "disturbed", "sticky", "quiet", "disturbed", "quiet",
)  # fmt: skip
MEMBERS = 4  # loops of a group: the sticky one and those that it drives
PER_FILE = 40
REDRAWS = 20
LEAD = 7200  # samples in which a loop leaves its rest, and which are left out
START = datetime(2024, 10, 17, tzinfo=UTC)
MANY = 1_000_000


@dataclass(frozen=True, slots=True)
class Truth:
    """What a loop of the site is: its kind, the verdict that is right, and the loop that drives it (its own name else).

    stiction: of the valve (d or S), %; period: s that the kind was chosen for, nan where it has none.
    """

    name: str
    kind: str
    verdict: str
    root: str
    stiction: float
    period: float


@dataclass(frozen=True, slots=True)
class Made:
    """One simulated loop: truth, signals of shape (N,) in EU and %."""

    truth: Truth
    sp: FloatArray
    pv: FloatArray
    op: FloatArray


def site(loops: int, samples: int, sample_time: float = 1.0, seed: int = 0) -> Iterator[Made]:
    """Make `loops` loops, one after the other; loop i depends on seed and i alone, and on its group's sticky loop."""
    driver: Made | None = None
    for i in range(loops):
        word = PATTERN[i % len(PATTERN)]
        rng = np.random.default_rng([seed, i])
        # A stem that slides on with a load does not cycle, and is no story to tell: drawn again.
        for _ in range(REDRAWS):
            made, turns = _loop(i, word, rng, LEAD + samples, sample_time, driver if word == "coupled" else None)
            if made.truth.kind != "sticky" or turns * made.truth.period >= samples * sample_time:
                break
        if word == "root":
            driver = made
        yield replace(made, sp=made.sp[LEAD:], pv=made.pv[LEAD:], op=made.op[LEAD:])


def _loop(i: int, word: str, rng: np.random.Generator, n: int, Ts: float, driver: Made | None) -> tuple[Made, int]:
    """Return a loop of this kind and how often its stem turned."""
    kind = "sticky" if word == "root" else word
    service, plant = _plant(rng, word, Ts)
    name = f"{service}C{100 + i}"
    period = float(np.exp(rng.uniform(math.log(120.0), math.log(max(min(1200.0, (n - LEAD) * Ts / 12.0), 120.0)))))
    size = float(rng.uniform(1.0, 6.0))  # % of travel
    effect = abs(plant.gain) * (1.0 if isinstance(plant, FOPDT) else 4.0 * (plant.dead_time + 4.0 * Ts))
    controller = _tuning(plant, rng, Ts)
    valve: Valve = Ideal()
    load = np.zeros(n + 1)
    noise = float(rng.uniform(0.02, 0.08)) * size * effect
    limits = (-45.0, 55.0)
    if kind == "sticky":
        valve, controller = _sticky(plant, size, period, rng, controller)
        restless = 0.04 if word == "root" else 0.15
        load += float(rng.uniform(0.0, restless)) * size * _drift(rng, n + 1, rng.uniform(1.0, 4.0) * period / Ts)
        stiction = valve.stick_band
    else:
        stiction = 0.0
    if kind == "quiet":
        noise = 0.3 * size * effect
        load += 0.1 * size * _drift(rng, n + 1, 300.0 / Ts)
    elif kind == "disturbed":
        load += _load(rng, n + 1, size, period / Ts)
    elif kind == "coupled" and driver is not None:
        moved = driver.pv - driver.pv.mean()
        reach = rng.uniform(0.6, 1.5) * size / max(float(moved.std()), 1e-12)
        late = int(rng.uniform(0.0, 0.1) * driver.truth.period / Ts)
        load[late:] += reach * np.concatenate((moved, moved[-1:]))[: n + 1 - late]
        load += 0.15 * size * _drift(rng, n + 1, 100.0 / Ts)
        period = driver.truth.period
    elif kind == "tight":
        controller = _tight(plant, controller, rng, Ts)
        load += 0.3 * size * _drift(rng, n + 1, 20.0 / Ts)
    elif kind == "saturated":
        limits = (-45.0, 4.0)
        load += -8.0 - 2.0 * _drift(rng, n + 1, 2000.0 / Ts)
    loop = Loop(plant, valve, replace(controller, output_limits=limits), Ts)
    pv, op, stem = _run(loop, load, rng.normal(0.0, noise, n + 1))
    cycles = kind in ("sticky", "coupled")
    truth = Truth(
        name,
        kind,
        "stiction" if kind == "sticky" else "no_stiction",
        driver.truth.name if kind == "coupled" and driver is not None else name,
        stiction,
        period if cycles else math.nan,
    )
    digits = 2 - math.floor(math.log10(max(noise, 1e-9)))
    centre = 10.0 ** math.ceil(math.log10(20.0 * size * effect))
    sp = np.full(n, round(centre / 2.0, 6))
    return Made(truth, sp, np.round(sp + pv, digits), np.round(op + 45.0, 3)), reversals(stem[LEAD:])


def _plant(rng: np.random.Generator, kind: str, Ts: float) -> tuple[str, Plant]:
    # A level's own integration hides a sinusoidal source, and makes no relaxation cycle by itself.
    services = {"root": "FFP", "coupled": "FFFPPT", "tight": "FFFPPT", "saturated": "FFFPPT"}.get(kind, "FFFPPTL")
    service = services[int(rng.integers(len(services)))]
    gain = float(np.exp(rng.uniform(math.log(0.4), math.log(2.5))))
    if service == "L":
        return "LI", Integrating(gain / float(rng.uniform(80.0, 400.0)), float(rng.uniform(1.0, 5.0)) * Ts)
    low, high = {"F": (2.0, 8.0), "P": (8.0, 30.0), "T": (30.0, 80.0)}[service]
    tau = float(rng.uniform(low, high)) * max(Ts, 1.0)
    return f"{service}I", FOPDT(gain, tau, float(rng.uniform(0.2, 0.6)) * tau)


def _tuning(plant: Plant, rng: np.random.Generator, Ts: float) -> PID:
    """A detuned rule of Skogestad, as found in plants."""
    slow = float(rng.uniform(1.5, 5.0)) * max(plant.dead_time, 2.0 * Ts)
    if isinstance(plant, Integrating):
        return PID(1.0 / (plant.gain * (slow + plant.dead_time)), 4.0 * (slow + plant.dead_time))
    return PID(plant.time_constant / (plant.gain * (slow + plant.dead_time)), plant.time_constant)


def _sticky(plant: Plant, size: float, period: float, rng: np.random.Generator, tuned: PID) -> tuple[Valve, PID]:
    """A valve that sticks and a tuning with which it cycles at about `period` (self-regulating: its closed form)."""
    jump = float(rng.uniform(0.4, 1.0))
    valve: Valve = Stenman(size) if rng.random() < 0.5 else Choudhury(size, jump * size)
    if isinstance(plant, Integrating):
        return valve, tuned
    ratio = 1.0 if isinstance(valve, Stenman) else 1.0 / jump
    part = float(rng.uniform(0.3, 0.7))  # Kc K J/S
    Kc = part / plant.gain * (1.0 if isinstance(valve, Stenman) else jump) * ratio
    # T/4 = Ti (S/(Kc K J) - 1) + tau + theta
    slope = ratio / (Kc * plant.gain) - 1.0
    Ti = (period / 4.0 - plant.time_constant - plant.dead_time) / slope
    return valve, PID(Kc, max(Ti, plant.time_constant))


def _tight(plant: Plant, controller: PID, rng: np.random.Generator, Ts: float) -> PID:
    margin = margins(Loop(plant, Ideal(), controller, Ts)).gain_margin
    if not 1.0 < margin < math.inf:
        return controller
    return replace(controller, Kc=controller.Kc * margin / float(rng.uniform(1.08, 1.25)))


def _load(rng: np.random.Generator, n: int, size: float, period: float) -> FloatArray:
    which = int(rng.integers(3))
    if which == 0:
        return size * _drift(rng, n, rng.uniform(100.0, 1000.0))
    if which == 1:
        angle = 2.0 * math.pi * np.arange(n) / period + rng.uniform(0.0, 6.0)
        wave: FloatArray = size * np.sin(angle) + 0.2 * size * _drift(rng, n, 60.0)
        return wave
    steps = np.zeros(n)
    for at in rng.integers(0, n, 12).tolist():
        steps[at:] += float(rng.normal()) * size
    return np.clip(steps, -10.0, 10.0)


def _drift(rng: np.random.Generator, n: int, correlation: float) -> FloatArray:
    """A first-order drift of unit variance and this correlation time, samples."""
    pole = math.exp(-1.0 / max(correlation, 1.0))
    kicks = rng.normal(size=n)
    return first_order(kicks, math.sqrt(1.0 - pole * pole), 0.0, pole)


def _run(loop: Loop, load: FloatArray, noise: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return (PV measured, OP, stem) in deviation, shape (N,); load and noise have N + 1 samples."""
    n = load.size - 1
    row = coefficients(loop, 0.0)[0]
    state, past = rest(row)
    y, u, x, v = np.empty(n + 1), np.empty(n), np.empty(n), np.empty(n)
    kernel.run_loop(row, np.zeros(n + 1), load[:n], noise, state, past, y, u, x, v, np.empty(n, np.int8))
    return (y + noise)[:n], u, x


def write_site(
    folder: Path, loops: int, hours: float = 24.0, seed: int = 0, progress: Callable[[float], None] | None = None
) -> list[Truth]:
    """Write a site of `loops` loops, `hours` at 1 s, into `folder` and return its truth.

    Files unit=<number>/values.parquet hold 40 loops each, a row per value (tag, time, value, quality), sorted by tag,
    a row group per tag; SP and MODE are written where they change, as historians do. _truth.csv, which
    `workbench fleet` passes over, says what each loop is. Raises `InvalidValue`, and `OutputError` where the folder
    cannot be written or holds something.
    """
    if not 1 <= loops <= MANY:
        raise InvalidValue("loops", loops, f"must be 1 to {MANY:,}")
    if not 0.2 <= hours <= 24.0 * 31.0:
        raise InvalidValue("hours", hours, "must be 0.2 to 744")
    samples = round(hours * 3600.0)
    if folder.is_dir() and any(folder.iterdir()):
        raise OutputError(f"{folder}: holds files already; give a new folder with --out")
    truths: list[Truth] = []
    writer: Any = None
    try:
        for i, made in enumerate(site(loops, samples, 1.0, seed)):
            if i % PER_FILE == 0:
                if writer is not None:
                    writer.close()
                writer = _writer(folder / f"unit={100 * (i // PER_FILE + 1)}")
            _write(writer, made)
            truths.append(made.truth)
            if progress is not None:
                progress((i + 1) / loops)
        writer.close()
    except OSError as error:
        raise OutputError(f"{folder}: cannot be written ({error.strerror or error})") from None
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(["loop", "kind", "verdict", "root", "stiction", "period"])
    for t in truths:
        table.writerow([t.name, t.kind, t.verdict, t.root, f"{t.stiction:.4g}", f"{t.period:.4g}"])
    write_files({"_truth.csv": text.getvalue()}, folder)
    return truths


def _writer(folder: Path) -> Any:
    import pyarrow as pa
    import pyarrow.parquet as pq

    folder.mkdir(parents=True, exist_ok=True)
    schema = pa.schema(
        [("tag", pa.string()), ("time", pa.timestamp("ms")), ("value", pa.float64()), ("quality", pa.string())]
    )
    return pq.ParquetWriter(
        folder / "values.parquet",
        schema,
        compression="zstd",
        use_dictionary=["tag", "quality", "value"],
        column_encoding={"time": "DELTA_BINARY_PACKED"},
    )


def _write(writer: Any, made: Made) -> None:
    import pyarrow as pa

    begin = int(START.timestamp() * 1000)
    times = begin + 1000 * np.arange(made.pv.size, dtype=np.int64)
    name = made.truth.name
    first = np.concatenate(([True], np.diff(made.sp) != 0.0))
    for tag, at, values in (
        (f"{name}.MODE", times[:1], np.ones(1)),
        (f"{name}.OP", times, made.op),
        (f"{name}.PV", times, made.pv),
        (f"{name}.SP", times[first], made.sp[first]),
    ):
        same = pa.array(np.zeros(at.size, dtype=np.int32))
        columns = [
            pa.DictionaryArray.from_arrays(same, [tag]).cast(pa.string()),
            pa.array(at, pa.int64()).cast(pa.timestamp("ms")),
            pa.array(values),
            pa.DictionaryArray.from_arrays(same, ["Good"]).cast(pa.string()),
        ]
        writer.write_table(pa.table(columns, schema=writer.schema))
