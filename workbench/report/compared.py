"""Reading results.json files of runs that are to be compared: what each case and estimate in them says."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, BeforeValidator, ConfigDict, ValidationError

from workbench.errors import InvalidValue
from workbench.model.record import FloatArray
from workbench.report.results import FORMAT
from workbench.report.trends import read_signal

__all__ = ["Entry", "Found", "Results", "Trend", "read_all"]

NAME = "results.json"
LARGEST = 64 << 20  # bytes; those of the shipped scenarios have at most 250 kB
FLEET = ("fleet.parquet", "fleet.csv")
OF_VALVE = ("valve_travel", "valve_variance", "reversals")
ALLOWED = "must be a results.json of `workbench run`, a report's folder, or a folder of such folders"


def _figure(value: object) -> object:
    """Return a figure of a strict JSON file: null for what is not known, "none" for what there is none of (infinite).

    Earlier versions wrote "Infinity" for some of the latter, which is a number's text already.
    """
    return {None: math.nan, "none": math.inf}.get(value, value) if isinstance(value, str | None) else value


Figure = Annotated[float, BeforeValidator(_figure)]


class _Part(BaseModel):
    model_config = ConfigDict(extra="ignore", frozen=True, allow_inf_nan=True)


class _Controller(_Part):
    form: str
    Kc: Figure
    Ti: Figure
    Td: Figure
    derivative_on: str = "error"
    compensator: dict[str, Any] | None = None


class _Cycle(_Part):
    outcome: str
    period: Figure = math.nan
    pv_peak_to_peak: Figure = math.nan


class _Df(_Part):
    predicts_cycle: bool


class _Case(_Part):
    name: str
    controller: _Controller
    kpis: dict[str, Figure]
    settling_doubt: str | None = None
    objective: Figure = math.nan
    limit_cycle: _Cycle | None = None
    describing_function: _Df | None = None


class _Both(_Part):
    primary: _Controller
    secondary: _Controller


class _BothKpis(_Part):
    primary: dict[str, Figure]
    secondary: dict[str, Figure]


class _Search(_Part):
    name: str
    digits: int | None = None


class _Searches(_Part):
    primary: _Search | None = None
    secondary: _Search | None = None


class _CascadeCase(_Part):
    name: str
    controllers: _Both
    kpis: _BothKpis
    tuning: _Searches | None = None
    settling_doubt: str | None = None
    objective: Figure = math.nan
    limit_cycle: _Cycle | None = None


class _Model(_Part):
    type: str
    model_config = ConfigDict(extra="allow", frozen=True)


class _Loop(_Part):
    plant: _Model
    valve: _Model
    sample_time: float


class _Cascade(_Part):
    primary: _Loop
    secondary: _Loop
    cases: list[_CascadeCase]


class _Estimate(_Part):
    name: str
    verdict: str
    plant: _Model
    valve: _Model
    noise_sd: Figure = math.nan
    slips: int = 0
    intervals: dict[str, tuple[Figure, Figure] | None] = {}


class _Trend(_Part):
    case: str
    loop: str = ""
    sample_time: float
    sp: dict[str, str]
    pv: dict[str, str]
    op: dict[str, str]


class _Head(_Part):
    format: int = 1


class _File(_Head):
    name: str
    title: str
    loop: _Loop | None
    cases: list[_Case]
    estimates: list[_Estimate] = []
    objective: dict[str, Any] | None = None
    experiment: dict[str, Any] | None = None
    cascade: _Cascade | None = None
    tuning: list[_Search] = []
    trends: list[_Trend] = []


Kind = TypeVar("Kind", bound=_Head)


@dataclass(frozen=True, eq=False)
class Trend:
    """Signals of one case, each as (time, s; values) of shape (M,): sp and pv in EU, op in %, thinned."""

    sp: tuple[FloatArray, FloatArray]
    pv: tuple[FloatArray, FloatArray]
    op: tuple[FloatArray, FloatArray]


@dataclass(frozen=True, eq=False)
class Entry:
    """One case as a results.json tells it; of a cascade one of its loops, `part` says which.

    Kc in %/EU, Ti and Td in s (Ti inf without integral action), in the controller's own `form`; digits: those that its
    search rounded to, None without one. kpis: by the names of `model.results.Kpis`, nan where not known.
    settling_doubt: why its settling time is none to go by, or "". objective: J, nan without one. cycle: the long run's
    outcome, "" where not looked at, with its period (s) and PV's swing (EU). predicted: what the describing function
    says, None where not asked. plant, valve: type and parameters by name.
    """

    name: str
    part: str
    form: str
    derivative_on: str
    compensator: str
    Kc: float
    Ti: float
    Td: float
    digits: int | None
    kpis: Mapping[str, float]
    settling_doubt: str
    objective: float
    cycle: str
    period: float
    pv_peak_to_peak: float
    predicted: bool | None
    plant: Mapping[str, Any]
    valve: Mapping[str, Any]
    sample_time: float
    trend: Trend | None


@dataclass(frozen=True, eq=False)
class Found:
    """One estimate as a results.json tells it: its model, by the names of the parameters, and verdict."""

    name: str
    verdict: str
    plant: Mapping[str, Any]
    valve: Mapping[str, Any]
    noise_sd: float
    slips: int
    intervals: Mapping[str, tuple[float, float] | None]


@dataclass(frozen=True, eq=False)
class Results:
    """One results.json: where it lies, the scenario's name and title, cases and estimates.

    label: what tells it from the others, its name unless two have the same. experiment and objective: their contents,
    None where there is none; `told` is False for files that an earlier version wrote, which say neither experiment nor
    signals.
    """

    path: Path
    label: str
    name: str
    title: str
    told: bool
    experiment: Mapping[str, Any] | None
    objective: Mapping[str, Any] | None
    entries: tuple[Entry, ...]
    estimates: tuple[Found, ...]


def read_all(given: Sequence[Path]) -> tuple[tuple[Results, ...], tuple[str, ...]]:
    """Return the results that files and folders hold, in the order given, and notes on what was passed over.

    A file that is named twice is read once. Raises `InvalidValue` for whatever is not a whole results.json of a format
    that this version knows, or holds neither case nor estimate.
    """
    paths: dict[Path, Path] = {}
    notes: list[str] = []
    for one in given:
        found, said = _files(one)
        notes += said
        for path in found:
            paths.setdefault(path.resolve(), path)
    files = [(path, _read(path)) for path in paths.values()]
    labels = _labels([(path, file.name) for path, file in files])
    results = (_results(path, label, file) for (path, file), label in zip(files, labels, strict=True))
    return tuple(results), tuple(dict.fromkeys(notes))


def _labels(files: Sequence[tuple[Path, str]]) -> list[str]:
    """Return what tells files apart: their names, or for those of one name the ends of their folders' paths."""
    labels = []
    for path, name in files:
        alike = [one.resolve().parent.parts for one, other in files if other == name and one is not path]
        own = path.resolve().parent.parts
        count = next((k for k in range(1, len(own)) if all(parts[-k:] != own[-k:] for parts in alike)), len(own))
        labels.append("/".join(own[-count:]) if alike else name)
    return labels


def _files(given: Path) -> tuple[list[Path], list[str]]:
    """Return the results.json files that a path means, and what was passed over."""
    try:
        if given.is_file():
            return [given], []
        if not given.is_dir():
            raise InvalidValue(str(given), "no such file or folder", ALLOWED)
        if (given / NAME).is_file():
            return [given / NAME], []
        if _is_fleet(given):
            raise InvalidValue(
                str(given), "a fleet's results", f"{ALLOWED}; `workbench fleet --previous` compares sites"
            )
        inside = sorted(path for path in given.iterdir() if path.is_dir())
        found = [path / NAME for path in inside if (path / NAME).is_file()]
        notes = [f"{path}: a fleet's results, which are not compared here." for path in inside if _is_fleet(path)]
    except (OSError, ValueError) as error:
        if isinstance(error, InvalidValue):
            raise
        raise InvalidValue(str(given), getattr(error, "strerror", None) or str(error), ALLOWED) from None
    if not found:
        raise InvalidValue(str(given), f"a folder without {NAME}", ALLOWED)
    return found, notes


def _is_fleet(folder: Path) -> bool:
    return any((folder / name).is_file() for name in FLEET)


def _read(path: Path) -> _File:
    try:
        if path.stat().st_size > LARGEST:
            raise InvalidValue(str(path), f"{path.stat().st_size >> 20} MiB", f"must have at most {LARGEST >> 20} MiB")
        content = path.read_bytes()
    except OSError as error:
        raise InvalidValue(str(path), error.strerror or str(error), "must be a file that can be read") from None
    written = _whole(path, _Head, content).format
    if written not in range(1, FORMAT + 1):
        allowed = f"must be at most {FORMAT}: another version of the workbench wrote this file"
        raise InvalidValue(str(path), f"format {written}", allowed)
    file = _whole(path, _File, content)
    if not file.cases and not file.estimates and file.cascade is None:
        raise InvalidValue(str(path), "results without cases and estimates", "must hold at least one of either")
    return file


def _whole(path: Path, kind: type[Kind], content: bytes) -> Kind:
    """Return a file's content, or raise `InvalidValue` with the first thing that is wrong with it."""
    try:
        return kind.model_validate_json(content)
    except ValidationError as error:
        first: Any = error.errors(include_url=False)[0]
    if first["type"] == "json_invalid":
        what = f"broken JSON ({first['ctx']['error']})"
        raise InvalidValue(str(path), what, f"{ALLOWED}; run its scenario again if it is half-written")
    place = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in first["loc"]).removeprefix(".")
    said = first["msg"][:1].lower() + first["msg"][1:]
    raise InvalidValue(str(path), "JSON of another kind", f"{place + ': ' if place else ''}{said}; {ALLOWED}")


def _results(path: Path, label: str, file: _File) -> Results:
    trends: dict[tuple[str, str], Trend] = {}
    for one in file.trends:
        try:
            sp, pv, op = (read_signal(signal, one.sample_time) for signal in (one.sp, one.pv, one.op))
        except (KeyError, ValueError, OverflowError) as error:
            raise InvalidValue(str(path), f"trends of {one.case}: {error}", "must be whole") from None
        trends[one.case, one.loop] = Trend(sp, pv, op)
    entries, digits = [], {search.name: search.digits for search in file.tuning}
    for case in file.cases:
        if file.loop is None:
            raise InvalidValue(str(path), "cases without a loop", ALLOWED)
        own, df = digits.get(case.name), case.describing_function
        entries.append(_entry(case, case.controller, own, case.kpis, file.loop, "", trends, df))
    if file.cascade is not None:
        for both in file.cascade.cases:
            for part in ("primary", "secondary"):
                pid, kpis = getattr(both.controllers, part), getattr(both.kpis, part)
                search = None if both.tuning is None else getattr(both.tuning, part)
                own = None if search is None else search.digits
                entries.append(_entry(both, pid, own, kpis, getattr(file.cascade, part), part, trends))
    estimates = tuple(
        Found(e.name, e.verdict, e.plant.model_dump(), e.valve.model_dump(), e.noise_sd, e.slips, e.intervals)
        for e in file.estimates
    )
    told = file.format >= FORMAT
    return Results(path, label, file.name, file.title, told, file.experiment, file.objective, tuple(entries), estimates)


def _entry(
    case: _Case | _CascadeCase,
    pid: _Controller,
    digits: int | None,
    kpis: Mapping[str, float],
    loop: _Loop,
    part: str,
    trends: Mapping[tuple[str, str], Trend],
    df: _Df | None = None,
) -> Entry:
    cycle = case.limit_cycle
    return Entry(
        name=case.name,
        part=part,
        form=pid.form,
        derivative_on=pid.derivative_on,
        compensator="" if pid.compensator is None else str(pid.compensator.get("type", "")),
        Kc=pid.Kc,
        Ti=pid.Ti,
        Td=pid.Td,
        digits=digits,
        # What a cascade's primary moves is the secondary's PV, and no valve.
        kpis={name: value for name, value in kpis.items() if part != "primary" or name not in OF_VALVE},
        settling_doubt="" if part == "secondary" else case.settling_doubt or "",
        objective=case.objective if part != "secondary" else math.nan,
        cycle="" if cycle is None else cycle.outcome,
        period=math.nan if cycle is None else cycle.period,
        pv_peak_to_peak=math.nan if cycle is None or part else cycle.pv_peak_to_peak,
        predicted=None if df is None else df.predicts_cycle,
        plant=loop.plant.model_dump(),
        valve=loop.valve.model_dump(),
        sample_time=loop.sample_time,
        trend=trends.get((case.name, part)),
    )
