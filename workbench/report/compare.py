"""Runs beside each other: which figures may be compared with the base's, how they differ, and the tables of it."""

from __future__ import annotations

import csv
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from io import StringIO
from typing import Any

from workbench.errors import InvalidValue
from workbench.model.titles import KPI_ROWS, kpi_title, within
from workbench.report.cells import cell
from workbench.report.compared import Entry, Found, Results
from workbench.report.tables import Cell, Row, Table, shown
from workbench.report.words import change, duration, figure, given, interval, join, setting

__all__ = [
    "Comparison",
    "Line",
    "comparison",
    "comparison_csv",
    "difference_words",
    "estimate_table",
    "tables",
    "which",
]

ACROSS = 6  # cases beside the base in one table: what an A4 page holds
TOLD = 12  # names in a message
FIGURES = ("objective", *(name for name, *_ in KPI_ROWS))
BY_SAMPLE = ("objective", "valve_travel", "controller_travel", "reversals")  # grow with the samples counted
SAME = ("duration", "setpoint", "load", "primary_load", "stem_offset")


@dataclass(frozen=True, eq=False)
class Line:
    """One case of the comparison: its entry, where it comes from, and the name that tells it from all others.

    apart: why its figures are not held against the base's, "" where they are. unlike: the figures, by name, that are
    not, though the others are.
    """

    name: str
    entry: Entry
    results: Results
    apart: str = ""
    unlike: frozenset[str] = frozenset()

    def figure(self, name: str) -> float:
        """Return a figure: of `model.results.Kpis` by its name, or "objective"; nan where it is not known."""
        return self.entry.objective if name == "objective" else self.entry.kpis.get(name, math.nan)

    def doubt(self, name: str) -> str:
        """Return why a figure is not one to go by, as the case's own report says it, or ""."""
        return self.entry.settling_doubt if name == "settling_time" else ""

    def compares(self, name: str) -> bool:
        """Whether this figure may be held against the base's."""
        return not self.apart and name not in self.unlike


@dataclass(frozen=True, eq=False)
class Comparison:
    """Cases beside each other, the base first among them, and estimates likewise; notes on what does not compare."""

    lines: tuple[Line, ...]
    base: Line | None
    estimates: tuple[tuple[str, Found, Results], ...]
    results: tuple[Results, ...]
    notes: tuple[str, ...]

    @property
    def others(self) -> tuple[Line, ...]:
        """All cases but the base."""
        return tuple(line for line in self.lines if line is not self.base)


def comparison(
    results: Sequence[Results], base: str = "", include: Sequence[str] = (), notes: Sequence[str] = ()
) -> Comparison:
    """Return the cases and estimates of results beside each other.

    base: the case that the others are held against, by its name, "scenario: name", or the scenario whose first case it
    is; the first case by default. include: patterns, such as "Case*", of the names to keep. notes: to be told besides.
    Raises `InvalidValue` where no case or more than one is meant, or nothing is left.
    """
    several = len(results) > 1
    named = [(_name(r, e, several=several), e, r) for r in results for e in r.entries]
    found = [(_full(r, f.name, several=several), f, r) for r in results for f in r.estimates]
    if include:
        names = [name for name, *_ in named] + [name for name, *_ in found]
        named = [one for one in named if _wanted(include, one[0], one[1].name)]
        found = [one for one in found if _wanted(include, one[0], one[1].name)]
        if not named and not found:
            raise InvalidValue("--include", ", ".join(include), f"must fit one of {_some(names)}")
    first = _base(base, named) if named else None
    lines = [] if first is None else [_line(*one, base=first) for one in named]
    mine = None if first is None else next(line for line in lines if line.name == first[0])
    if first is None and base:
        raise InvalidValue("--base", base, "must be left out: there are no cases, and estimates follow the first")
    return Comparison(tuple(lines), mine, tuple(found), tuple(results), (*notes, *_notes(lines, mine)))


def _full(results: Results, name: str, *, several: bool) -> str:
    return f"{results.label}: {name}" if several else name


def _name(results: Results, entry: Entry, *, several: bool) -> str:
    full = _full(results, entry.name, several=several)
    return f"{full} ({entry.part})" if entry.part else full


def _wanted(patterns: Sequence[str], full: str, name: str) -> bool:
    return any(fnmatchcase(one, pattern) for pattern in patterns for one in (full, name))


def _some(names: Sequence[str]) -> str:
    told = "; ".join(names[:TOLD])
    return told + (f" and {len(names) - TOLD} more" if len(names) > TOLD else "")


def _base(wanted: str, named: Sequence[tuple[str, Entry, Results]]) -> tuple[str, Entry, Results]:
    if not wanted:
        return named[0]
    exact = [one for one in named if one[0] == wanted]
    fitting = exact or [one for one in named if one[1].name == wanted]
    # A scenario stands for its first case; a cascade's case for its primary.
    fitting = fitting or [one for one in named if wanted in (one[2].label, one[2].name)][:1]
    if len({id(one[2]) for one in fitting}) == 1 and len({one[1].name for one in fitting}) == 1:
        return fitting[0]
    names = [name for name, *_ in fitting or named]
    what = "must say which one" if fitting else "must be a case that is there"
    raise InvalidValue("--base", wanted, f"{what}: {_some(names)}")


# what compares -----------------------------------------------------------------------------------------------------


def _line(name: str, entry: Entry, results: Results, *, base: tuple[str, Entry, Results]) -> Line:
    other, theirs = base[1], base[2]
    if entry.part != other.part:
        what = f"the {entry.part}" if entry.part else "a loop by itself"
        return Line(name, entry, results, f"{what} is another loop than the base's")
    if results is theirs:
        return Line(name, entry, results)
    apart = _apart(results, theirs)
    unlike: set[str] = set()
    if entry.sample_time != other.sample_time:
        unlike |= set(BY_SAMPLE)
    if results.objective != theirs.objective:
        unlike.add("objective")
    return Line(name, entry, results, apart, frozenset(unlike))


def _apart(ours: Results, theirs: Results) -> str:
    """Return why figures of two files do not compare, "" where they do; another seed of noise is no reason."""
    if not ours.told or not theirs.told:
        one = ours if not ours.told else theirs
        return f"{one.label} does not say its experiment (an earlier version wrote it; run its scenario again)"
    a, b = ours.experiment or {}, theirs.experiment or {}
    unlike = [name.replace("_", " ") for name in SAME if (a.get(name) or None) != (b.get(name) or None)]
    unlike += [name.replace("_", " ") for name in ("noise", "secondary_noise") if _sd(a, name) != _sd(b, name)]
    if not unlike:
        return ""
    return f"its experiment is another one in {join(unlike)} ({a.get('words', 'not told')})"


def _sd(experiment: Mapping[str, Any], name: str) -> float:
    noise = experiment.get(name)
    return float(noise.get("sd", 0.0)) if isinstance(noise, Mapping) else 0.0


def _notes(lines: Sequence[Line], base: Line | None) -> list[str]:
    """Return what a reader must know of cases that do not compare, each reason once with its cases."""
    if base is None:
        return []
    notes: dict[str, list[Line]] = {}
    for line in lines:
        if line.apart:
            notes.setdefault(f"not held against the base: {line.apart}", []).append(line)
            continue
        entry, other = line.entry, base.entry
        if entry.sample_time != other.sample_time:
            names = join([within(kpi_title(name)[0]) for name in BY_SAMPLE])
            text = (
                f"sampled every {setting(entry.sample_time)} s, the base every {setting(other.sample_time)} s: {names}"
            )
            notes.setdefault(f"{text} count samples and are not held against it", []).append(line)
        elif "objective" in line.unlike and not math.isnan(entry.objective):
            notes.setdefault("J has other weights than the base's and is not held against it", []).append(line)
        if dict(entry.plant) != dict(other.plant):
            text = f"another plant than the base's ({model_words(entry.plant)}; the base: {model_words(other.plant)})"
            notes.setdefault(f"{text}; figures in EU compare only where both PVs have one unit", []).append(line)
        if dict(entry.valve) != dict(other.valve):
            notes.setdefault(f"another valve than the base's ({model_words(entry.valve)})", []).append(line)
        if _seed(line.results) != _seed(base.results):
            text = "another draw of the noise than the base's; small differences are chance"
            notes.setdefault(text, []).append(line)
    return [f"{which(some, lines)}: {text}." for text, some in notes.items()]


def which(some: Sequence[Line], every: Sequence[Line]) -> str:
    """Return which of all cases some are, a run by its name where they are all of it: "all of table_2; b (SIMC)"."""
    by_run: dict[str, list[str]] = {}
    for line in some:
        by_run.setdefault(line.results.label, []).append(
            f"{line.entry.name}{f' ({p})' if (p := line.entry.part) else ''}"
        )
    counts = Counter(line.results.label for line in every)
    told = []
    for run, names in by_run.items():
        if len(counts) == 1:
            told.append(_some(names))
        elif len(names) < counts[run]:
            told.append(f"{run} ({_some(names)})")
        else:
            told.append(f"all of {run}" if len(names) > 1 else f"{run}: {names[0]}")
    return "; ".join(told)


def _seed(results: Results) -> object:
    noise = (results.experiment or {}).get("noise")
    return noise.get("seed") if isinstance(noise, Mapping) and noise.get("sd") else None


def model_words(model: Mapping[str, Any]) -> str:
    """Return a plant or valve in a few words: "stenman, d 2"."""
    parts = [str(model.get("type", ""))]
    for name, value in model.items():
        if isinstance(value, int | float) and not isinstance(value, bool):
            parts.append(f"{name.replace('_', ' ')} {given(float(value))}")
    return ", ".join(parts)


# tables ------------------------------------------------------------------------------------------------------------


def difference_words(line: Line, base: Line, name: str) -> str:
    """Return how a figure differs from the base's: "−12 %"; "" for the base itself and where they do not compare."""
    ours, theirs = line.figure(name), base.figure(name)
    if line is base or not line.compares(name) or math.isnan(ours) or math.isnan(theirs):
        return ""
    if name == "settling_time" and math.isinf(ours) != math.isinf(theirs):
        return ""  # "not in the run" beside a time says it
    if line.doubt(name) or base.doubt(name):
        return ""  # what does not last is neither longer nor shorter
    return change(ours, theirs)


def cycle_words(entry: Entry) -> str:
    """Return what the case does in the long run: "cycles, 102 s, 2.01 EU"."""
    words = [entry.cycle.replace("_", " ")]
    words += [duration(entry.period)] if math.isfinite(entry.period) else []
    words += [f"{figure(entry.pv_peak_to_peak, 3)} EU"] if math.isfinite(entry.pv_peak_to_peak) else []
    return ", ".join(words) if entry.cycle else "–"


def tables(found: Comparison) -> list[Table]:
    """Return the cases' tables, figures down and cases across, the base first in each."""
    base = found.base
    if base is None:
        return []
    count = max(1, math.ceil(len(found.others) / ACROSS))
    size = max(1, math.ceil(len(found.others) / count))
    parts = [found.others[i * size : (i + 1) * size] for i in range(count)]
    return [Table(tuple(line.name for line in (base, *part)), tuple(_rows((base, *part), found))) for part in parts]


def _rows(block: Sequence[Line], found: Comparison) -> list[Row]:
    base = block[0]
    entries = [line.entry for line in block]
    rows = []
    if any(line.apart for line in found.lines):
        held = ["base" if line is base else "no, see above" if line.apart else "yes" for line in block]
        rows.append(Row("Held against the base", "", tuple(Cell(text) for text in held)))
    rows += [
        Row("Kc", "%/EU", tuple(Cell(setting(e.Kc, e.digits)) for e in entries), group=True),
        Row("Ti", "s", tuple(Cell(setting(e.Ti, e.digits)) for e in entries)),
        Row("Td", "s", tuple(Cell(setting(e.Td, e.digits)) for e in entries)),
    ]
    texts: list[tuple[str, list[str], list[str]]] = [
        ("Form", *_both(found, entries, lambda e: e.form)),
        ("Derivative on", *_both(found, entries, lambda e: e.derivative_on if e.Td else "–")),
        ("Compensator", *_both(found, entries, lambda e: e.compensator or "–")),
        ("Plant", *_both(found, entries, lambda e: model_words(e.plant))),
        ("Valve", *_both(found, entries, lambda e: model_words(e.valve))),
        ("Sample time", *_both(found, entries, lambda e: f"{setting(e.sample_time)} s")),
    ]
    rows += [Row(title, "", tuple(Cell(t) for t in mine)) for title, mine, every in texts if len(set(every)) > 1]
    first = True
    for name in FIGURES:
        values = [line.figure(name) for line in block]
        if all(math.isnan(value) for value in values):
            continue
        title, unit = kpi_title(name)
        cells = []
        for line, value in zip(block, values, strict=True):
            doubt = "not compared" if name in line.unlike and not line.apart and not math.isnan(value) else ""
            cells.append(Cell(shown(name, value), difference_words(line, base, name) or line.doubt(name) or doubt))
        rows.append(Row(title, unit, tuple(cells), group=first))
        first = False
    if any(e.cycle for e in entries):
        rows.append(Row("In the long run", "", tuple(Cell(cycle_words(e)) for e in entries), group=True))
    if any(e.predicted is not None for e in entries):
        said = {None: "–", True: "a cycle", False: "no cycle"}
        rows.append(Row("Describing function predicts", "", tuple(Cell(said[e.predicted]) for e in entries)))
    return rows


def _both(found: Comparison, entries: Sequence[Entry], text: Any) -> tuple[list[str], list[str]]:
    """Return a text of each entry of a table, and of every case there is."""
    return [text(e) for e in entries], [text(line.entry) for line in found.lines]


PARAMETERS = ("gain", "time_constant", "dead_time", "d", "S", "J", "b")


def estimate_table(found: Comparison) -> Table | None:
    """Return the estimates' table, parameters down and estimates across, with ranges and changes from the first."""
    if not found.estimates:
        return None
    every = [one for _, one, _ in found.estimates]
    values = [_numbers(one) for one in every]
    rows = [
        Row("Verdict", "", tuple(Cell(e.verdict.replace("_", " ")) for e in every), group=True),
        Row("Plant", "", tuple(Cell(str(e.plant["type"])) for e in every)),
        Row("Valve", "", tuple(Cell(str(e.valve["type"])) for e in every)),
    ]
    for name in PARAMETERS:
        if not any(name in one for one in values):
            continue
        cells = []
        for i, (one, own) in enumerate(zip(every, values, strict=True)):
            alike = all(getattr(one, what)["type"] == getattr(every[0], what)["type"] for what in ("plant", "valve"))
            small = [interval(pair, "") for pair in [one.intervals.get(name)] if pair is not None]
            small += [change(own[name], values[0][name])] if i and alike and name in own and name in values[0] else []
            cells.append(Cell(figure(own.get(name, math.nan)), "; ".join(small)))
        title, unit = kpi_title(name)
        if name == "gain" and any(one.plant["type"] == "integrating" for one in every):
            unit = "EU/%, integrating EU/(% s)"
        rows.append(Row(title, unit, tuple(cells), group=name == "gain"))
    rows.append(Row("PV about the prediction, sd", "EU", tuple(Cell(figure(e.noise_sd)) for e in every)))
    rows.append(Row("Stem moves", "", tuple(Cell(f"{e.slips:,}") for e in every)))
    return Table(tuple(name for name, *_ in found.estimates), tuple(rows))


def _numbers(one: Entry | Found) -> dict[str, float]:
    """Return the parameters of a plant and valve by name."""
    both = [*one.plant.items(), *one.valve.items()]
    return {k: float(v) for k, v in both if isinstance(v, int | float) and not isinstance(v, bool)}


def comparison_csv(found: Comparison) -> str:
    """Return the comparison as CSV: a row for each case, each figure followed by its difference from the base's.

    Differences are ours less the base's, and empty where the figures do not compare; estimates have a row each below.
    """
    out = StringIO()
    writer = csv.writer(out, lineterminator="\n")
    head = ["scenario", "kind", "name", "loop", "base", "compared", "Kc", "Ti", "Td", "form", "sample_time"]
    head += [column for name in FIGURES for column in (name, f"{name}_difference")]
    head += ["settling_doubt", "verdict", "period", "pv_peak_to_peak", *PARAMETERS]
    writer.writerow(head)
    for line in found.lines:
        e, base = line.entry, found.base
        row: list[object] = [line.results.label, "case", e.name, e.part, line is base, not line.apart, e.Kc]
        row += ["none" if math.isinf(e.Ti) else e.Ti, e.Td, e.form, e.sample_time]
        for name in FIGURES:
            ours, theirs = line.figure(name), math.nan if base is None else base.figure(name)
            known = line.compares(name) and math.isfinite(ours) and math.isfinite(theirs)
            known = known and not line.doubt(name) and not (base is not None and base.doubt(name))
            row += [ours, ours - theirs if known else math.nan]
        numbers = _numbers(e)
        row += [
            e.settling_doubt,
            e.cycle,
            e.period,
            e.pv_peak_to_peak,
            *(numbers.get(name, math.nan) for name in PARAMETERS),
        ]
        writer.writerow([cell(value) for value in row])
    for _, one, results in found.estimates:
        row = [
            results.label,
            "estimate",
            one.name,
            *[None] * (len(head) - len(PARAMETERS) - 6),
            one.verdict,
            None,
            None,
        ]
        row += [_numbers(one).get(name, math.nan) for name in PARAMETERS]
        writer.writerow([cell(value) for value in row])
    return out.getvalue()
