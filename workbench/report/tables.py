"""The report's tables as rows of text: which figures stand where, with which unit and how many digits."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from workbench.model.controller import PID
from workbench.model.plant import FOPDT, Plant
from workbench.model.results import DescribingFunction, LimitCycle, LimitCycleStart
from workbench.model.study import CaseResult, NamedEstimate, Study
from workbench.model.valve import Choudhury, Deadband, Stenman, Valve
from workbench.report.judge import quiet, run_travel, settling_band, settling_doubt, unstable
from workbench.report.results import aic, reference_names
from workbench.report.words import (
    decimals_of,
    difference,
    duration,
    figure,
    given,
    interval,
    plant_words,
    published,
    setting,
    valve_words,
)

__all__ = [
    "KPI_ROWS",
    "Cell",
    "Row",
    "Table",
    "case_tables",
    "cycle_tables",
    "deciding_start",
    "difference_table",
    "estimate_table",
    "kpi_title",
    "loop_lines",
    "off_by",
    "plant_parameters",
    "shown",
    "valve_parameters",
]

NO_BIAS = 1e-6  # share of PV's span below which a bias is rounding error
COLUMNS = 7  # cases beside each other in one table: what an A4 page holds


@dataclass(frozen=True, slots=True)
class Cell:
    """One cell: its text, a second line in small print, and whether it is the best of its row."""

    text: str
    small: str = ""
    best: bool = False


@dataclass(frozen=True, slots=True)
class Row:
    """One row: what it shows, its unit, its cells; `group` starts a new group of rows."""

    label: str
    unit: str
    cells: tuple[Cell, ...]
    group: bool = False


@dataclass(frozen=True, slots=True)
class Table:
    """A table: the column heads after the first, and the rows."""

    heads: tuple[str, ...]
    rows: tuple[Row, ...]
    title: str = ""


# Name in Kpis, title, unit, whether less is better.
KPI_ROWS: tuple[tuple[str, str, str, bool], ...] = (
    ("mean_square_error", "Mean square error", "EU²", True),
    ("error_variance", "Error variance", "EU²", False),  # blind to a standing offset: shown, never a reason
    ("valve_travel", "Valve travel", "%", True),
    ("controller_travel", "Controller travel", "%", False),
    ("op_variance", "OP variance", "%²", False),
    ("valve_variance", "Valve variance", "%²", False),
    ("reversals", "Valve reversals", "", True),
    ("iae", "Integrated absolute error", "EU s", True),
    ("pv_sd", "Standard deviation of PV", "EU", False),
    ("overshoot", "Overshoot", "% of step", False),
    ("settling_time", "Settling time", "", True),
    ("final_error", "Error at the end", "EU", False),
    ("oscillation_index", "Oscillation index", "0 to 1", False),
    ("oscillation_period", "Oscillation period", "", False),
)
_TIMES = ("settling_time", "oscillation_period")
_TITLES = {name: (title, unit) for name, title, unit, _ in KPI_ROWS} | {
    "ise": ("Integrated squared error", "EU² s"),
    "objective": ("J", ""),
    "d": ("Stiction d", "%"),
    "S": ("Stick band S", "%"),
    "J": ("Slip jump J", "%"),
    "b": ("Dead band b", "%"),
    "gain": ("Gain K", "EU/%"),
    "time_constant": ("Time constant", "s"),
    "dead_time": ("Dead time", "s"),
}


def kpi_title(name: str) -> tuple[str, str]:
    """Return a figure's title and unit; an unknown name stands for itself."""
    return _TITLES.get(name, (name.replace("_", " "), ""))


def _blocks(cases: Sequence[CaseResult]) -> list[Sequence[CaseResult]]:
    count = math.ceil(len(cases) / COLUMNS)
    size = math.ceil(len(cases) / count) if count else 0
    return [cases[i * size : (i + 1) * size] for i in range(count)]


def _value(case: CaseResult, name: str) -> float:
    if name == "objective":
        return math.nan if case.objective is None else case.objective
    return float(getattr(case.run.kpis, name, math.nan))


def shown(kpi: str, value: float) -> str:
    """Return a figure as the tables print it; `kpi` is its name in `Kpis`."""
    if kpi == "settling_time" and math.isinf(value):
        return "not in the run"
    if kpi in _TIMES:
        return duration(value)
    return f"{value:,.0f}" if kpi == "reversals" else figure(value)


def case_tables(study: Study) -> list[Table]:
    """Return the comparison of the cases, KPIs down and cases across, at most seven beside each other."""
    decimals = {n: decimals_of([c.reference[n] for c in study.cases if n in c.reference]) for n in _references(study)}
    return [
        Table(tuple(c.name for c in block), tuple(_case_rows(study, block, decimals))) for block in _blocks(study.cases)
    ]


def _references(study: Study) -> list[str]:
    order = ["objective", *(name for name, *_ in KPI_ROWS)]
    names = reference_names(study.cases)
    return [n for n in order if n in names] + [n for n in names if n not in order]


def _case_rows(study: Study, block: Sequence[CaseResult], decimals: dict[str, int]) -> list[Row]:
    pids = [c.loop.controller for c in block]
    parallel = all(p.form == "parallel" for p in pids)
    digits = [c.tuned.digits if c.tuned is not None else None for c in block]

    def settings(name: str) -> tuple[Cell, ...]:
        return tuple(Cell(setting(getattr(p, name), d)) for p, d in zip(pids, digits, strict=True))

    rows = [
        Row("Kc", "%/EU", settings("Kc"), group=True),
        Row("Ti", "EU s/%" if parallel else "s", settings("Ti")),
        Row("Td", "% s/EU" if parallel else "s", settings("Td")),
    ]
    for text, describe in _CONTROLLER_ROWS:
        every = [describe(c.loop.controller) for c in study.cases]
        if len(set(every)) > 1:
            rows.append(Row(text, "", tuple(Cell(describe(p)) for p in pids)))
    first = True
    everything = [("objective", "J", "", True), *KPI_ROWS]
    for name, title, given_unit, less in everything:
        unit = given_unit
        values = [_value(c, name) for c in block]
        if all(math.isnan(v) for v in values):
            continue
        doubts = {c.name: settling_doubt(c, study.experiment) if name == "settling_time" else "" for c in study.cases}
        fit = [c for c in study.cases if not unstable(c) and not doubts[c.name]]
        best = min((v for v in (_value(c, name) for c in fit) if not math.isnan(v)), default=math.nan)
        if name == "settling_time":
            unit = settling_band(block[0], study.experiment)
        cells = []
        for case, value in zip(block, values, strict=True):
            small = doubts[case.name]
            if name in case.reference:
                small = f"publ. {published(case.reference[name], decimals[name])}"
            mark = less and len(study.cases) > 1 and value == best and math.isfinite(value) and case in fit
            cells.append(Cell(shown(name, value), small, mark))
        rows.append(Row(title, unit, tuple(cells), group=first))
        first = False
    return rows


def _filter(pid: PID) -> str:
    if pid.Td == 0.0:
        return "–"
    return "none" if math.isinf(pid.derivative_filter) else f"Td/{given(pid.derivative_filter)}"


def _limits(pid: PID) -> str:
    limits = pid.output_limits
    return "none" if limits is None else f"{_signed(limits[0])} to {_signed(limits[1])} %"


def _signed(value: float) -> str:
    return "none" if math.isinf(value) else given(value)


def _tracking(pid: PID) -> str:
    if pid.output_limits is None or pid.anti_windup != "back_calculation":
        return "–"
    return "Ti" if pid.tracking_time is None else f"{setting(pid.tracking_time)} s"


_CONTROLLER_ROWS: tuple[tuple[str, Callable[[PID], str]], ...] = (
    ("Form", lambda p: p.form),
    ("Structure", lambda p: p.structure or f"D on {p.derivative_on}, weight {given(p.setpoint_weight)}"),
    ("Derivative filter", _filter),
    ("Action", lambda p: p.action),
    ("Output limits", _limits),
    ("Anti-windup", lambda p: "–" if p.output_limits is None else p.anti_windup.replace("_", "-")),
    ("Tracking time", _tracking),
)


def loop_lines(study: Study) -> list[tuple[str, str]]:
    """Return what all cases share, as (what, text): plant, valve, controller, sampling, experiment, objective."""
    lines: list[tuple[str, str]] = []
    if study.cases:
        loop = study.cases[0].loop
        lines += [("Plant", plant_words(loop.plant)), ("Valve", valve_words(loop.valve))]
        shared = []
        for text, describe in _CONTROLLER_ROWS:
            every = {describe(c.loop.controller) for c in study.cases}
            if text == "Derivative filter":  # of no concern where a case has no derivative action
                every -= {"–"}
            if len(every) == 1 and every != {"–"} and (text, every) != ("Output limits", {"none"}):
                shared.append(f"{text.lower()} {every.pop()}")
        lines.append(("Controller", ", ".join(shared) or "differs from case to case (see the table)"))
        lines.append(("Sample time", f"{given(loop.sample_time)} s"))
        if loop.pv_range is not None:
            lines.append(("PV range", f"{given(loop.pv_range[0])} to {given(loop.pv_range[1])} EU"))
    if study.experiment is not None:
        lines.append(("Experiment", _experiment_words(study)))
    if study.objective is not None:
        lines.append(("Objective J", _objective_words(study)))
    return lines


def _experiment_words(study: Study) -> str:
    experiment = study.experiment
    assert experiment is not None  # noqa: S101
    parts = [f"{setting(experiment.duration)} s"]
    for name, unit, profile in (
        ("setpoint", "EU", experiment.setpoint_parts),
        ("load", "%", experiment.load_parts),
    ):
        for part in profile:
            kind = type(part).__name__.lower()
            if kind == "step":
                parts.append(f"{name} step of {given(part.size)} {unit} at {setting(part.at)} s")  # type: ignore[union-attr]
            elif kind == "ramp":
                parts.append(
                    f"{name} ramp of {given(part.size)} {unit} from {setting(part.start)} s to {setting(part.end)} s"  # type: ignore[union-attr]
                )
            else:
                parts.append(f"{name} as a given series")
    noise = experiment.noise
    if noise is not None and noise.sd > 0.0:
        parts.append(f"measurement noise of standard deviation {given(noise.sd)} EU (seed {noise.seed})")
    else:
        parts.append("no noise")
    if experiment.stem_offset != 0.0:
        parts.append(f"stem offset {given(experiment.stem_offset)} %")
    return ", ".join(parts)


def _objective_words(study: Study) -> str:
    weights = study.objective
    assert weights is not None  # noqa: S101
    terms = []
    for weight, text in (
        (weights.w1, "Σ (SP − PV)²"),
        (weights.w2, "Σ OP²"),
        (weights.w4, "Σ (OP move)²"),
        (weights.w3, "(SP − PV)² at the end"),
    ):
        if weight > 0.0:
            terms.append(f"{given(weight)} {text}")
    words = [" + ".join(terms) + ", sums over samples"] if terms else []
    for name, weight in dict(weights.kpis).items():
        title, unit = kpi_title(name)
        words.append(f"{given(weight)} × {title}{f' ({unit})' if unit else ''}")
    return " + ".join(words)


def difference_table(study: Study) -> Table | None:
    """Return our figures against the published ones in words, cases down and figures across; None without any."""
    names = _references(study)
    if not names:
        return None
    rows = []
    for case in study.cases:
        if not case.reference:
            continue
        cells = []
        for name in names:
            if name not in case.reference:
                cells.append(Cell("–"))
                continue
            theirs = case.reference[name]
            decimals = decimals_of([c.reference[name] for c in study.cases if name in c.reference])
            ours = _value(case, name)
            text = difference(ours, theirs, decimals)
            here = shown(name, ours) if math.isinf(ours) else published(ours, decimals)
            cells.append(Cell(text, f"{here} here, {published(theirs, decimals)} published", text == "to the digit"))
        rows.append(Row(case.name, "", tuple(cells)))
    heads = []
    for name in names:
        title, unit = kpi_title(name)
        heads.append(f"{title}, {unit}" if unit else title)
    return Table(tuple(heads), tuple(rows))


def deciding_start(cycle: LimitCycle) -> LimitCycleStart | None:
    """Return the start whose figures are the cycle's own (the given experiment's), or None where they are medians."""
    for start in cycle.starts:
        if start.outcome == "cycles" and start.period == cycle.period:
            return start
    return None


_OUTCOMES = {
    "settles": "settles",
    "cycles": "cycles",
    "depends": "depends on the start",
    "undecided": "undecided",
}


def _of_cycle(text: Callable[[LimitCycle], str]) -> Callable[[CaseResult], str]:
    return lambda case: "–" if case.limit_cycle is None else text(case.limit_cycle)


def _of_df(text: Callable[[DescribingFunction], str]) -> Callable[[CaseResult], str]:
    return lambda case: "–" if case.describing_function is None else text(case.describing_function)


def _predicted(df: DescribingFunction) -> str:
    if df.predicts_cycle and math.isnan(df.period):
        return "unstable crossings only"
    return "cycle" if df.predicts_cycle else "no cycle"


def _first_period(cycle: LimitCycle) -> str:
    start = deciding_start(cycle)
    return "–" if start is None else duration(start.first_period)


def _range(cycle: LimitCycle) -> str:
    low, high = cycle.period_range
    return "–" if math.isnan(low) else duration(low) if low == high else f"{_held(low)} to {_held(high)}"


def _held(seconds: float) -> str:
    """A duration that does not break between number and unit."""
    return duration(seconds).replace(" ", "\u00a0")


_CYCLE_ROWS: tuple[tuple[str, str, Callable[[CaseResult], str]], ...] = (
    ("Exact simulation", "", _of_cycle(lambda c: _OUTCOMES.get(c.outcome, c.outcome))),
    ("First period", "", _of_cycle(_first_period)),
    ("Late period", "", _of_cycle(lambda c: duration(c.period))),
    ("Late period, all starts", "", _of_cycle(_range)),
    ("Closed form, shortest", "", _of_cycle(lambda c: duration(c.closed_form_period))),
    ("PV peak to peak", "EU", _of_cycle(lambda c: figure(c.pv_peak_to_peak, 3))),
    ("OP peak to peak", "%", _of_cycle(lambda c: figure(c.op_peak_to_peak, 3))),
    ("Mean square error", "EU²", _of_cycle(lambda c: figure(c.mean_square_error, 3))),
    ("Valve travel an hour", "%", _of_cycle(lambda c: figure(c.travel_per_hour, 3))),
    ("Time simulated to see it", "", _of_cycle(lambda c: duration(c.window))),
    ("Describing function", "", _of_df(_predicted)),
    ("Predicted period", "", _of_df(lambda d: duration(d.period))),
    ("Predicted PV peak to peak", "EU", _of_df(lambda d: figure(2.0 * d.pv_amplitude, 3))),
    ("Distance of the loci", "", _of_df(lambda d: figure(d.distance, 3))),
    ("Loop with an ideal valve", "", _of_df(lambda d: "stable" if d.linear_stable else "unstable")),
)


def cycle_tables(study: Study) -> list[Table]:
    """Return limit cycles and describing functions, figures down and cases across; empty where none was asked for."""
    cases = [c for c in study.cases if c.limit_cycle is not None or c.describing_function is not None]
    tables = []
    for block in _blocks(cases):
        rows = []
        for title, unit, text in _CYCLE_ROWS:
            if all(text(c) == "–" for c in cases):
                continue
            group = title in ("Exact simulation", "Describing function")
            rows.append(Row(title, unit, tuple(Cell(text(c)) for c in block), group))
        if quiet(study.experiment) and any(c.limit_cycle is not None for c in cases):
            end = next((i for i, row in enumerate(rows) if row.label == "Describing function"), len(rows))
            rates = [figure(run_travel(c, study.experiment), 3) for c in block]
            if any(rate != "–" for rate in rates):
                title = "Late in the run itself: valve travel an hour"
                rows.insert(end, Row(title, "%", tuple(Cell(rate) for rate in rates)))
        tables.append(Table(tuple(c.name for c in block), tuple(rows)))
    return tables


def valve_parameters(valve: Valve) -> list[tuple[str, float]]:
    """Return a valve's parameters by their names, in order."""
    if isinstance(valve, Stenman):
        return [("d", valve.d)]
    if isinstance(valve, Choudhury):
        return [("S", valve.S), ("J", valve.J)]
    return [("b", valve.b)] if isinstance(valve, Deadband) else []


def estimate_table(named: NamedEstimate) -> Table:
    """Return an estimate's parameters with their ranges, beside truth, published figures and the linear fit."""
    found, truth = named.found, named.truth
    true_values = {} if truth is None else dict(valve_parameters(truth.valve)) | plant_parameters(truth.plant)
    linear = plant_parameters(found.linear.plant)
    heads = ["estimate", "95 % range"]
    heads += ["true value", "off by"] if truth is not None else []
    heads += ["published", "difference"] if named.reference else []
    heads.append("fit that ignores stiction")
    rows = []
    for name, value in [*valve_parameters(found.valve), *plant_parameters(found.plant).items()]:
        title, unit = kpi_title(name)
        if name == "gain" and not isinstance(found.plant, FOPDT):
            unit = "EU/(% s)"
        cells = [Cell(figure(value)), Cell(interval(getattr(found.intervals, name, None), ""))]
        if truth is not None:
            true = true_values.get(name)
            cells.append(Cell("–" if true is None else given(true)))
            cells.append(Cell("–" if true is None else off_by(value, true)))
        if named.reference:
            theirs = named.reference.get(name)
            decimals = 0 if theirs is None else decimals_of([theirs])
            cells.append(Cell("–" if theirs is None else published(theirs, decimals)))
            cells.append(Cell("–" if theirs is None else difference(value, theirs, decimals)))
        cells.append(Cell(figure(linear[name]) if name in linear else "–"))
        rows.append(Row(title, unit, tuple(cells)))
    blanks = len(heads) - 3
    span = float(found.record.pv.max() - found.record.pv.min())
    for title, unit, ours, theirs in (
        ("Bias (PV at stem 0)", "EU", found.bias, found.linear.bias),
        ("Residual variance", "EU²", found.residual_variance, found.linear.residual_variance),
        (
            "AIC",
            "",
            aic(found.aic, found.residual_variance),
            aic(found.linear.aic, found.linear.residual_variance),
        ),
    ):
        if title.startswith("Bias"):
            ours, theirs = (0.0 if abs(b) < NO_BIAS * span else b for b in (ours, theirs))
        middle = tuple(Cell("") for _ in range(blanks + 1))
        rows.append(Row(title, unit, (Cell(figure(ours)), *middle, Cell(figure(theirs)))))
    return Table(tuple(heads), tuple(rows))


def plant_parameters(plant: Plant) -> dict[str, float]:
    """Return a plant's parameters by their names, in order."""
    names = ("gain", "time_constant", "dead_time")
    return {n: getattr(plant, n) for n in names if hasattr(plant, n)}


def off_by(value: float, true: float) -> str:
    """Return how far an estimate lies from the true value, in per cent of it."""
    if value == true:
        return "0"
    if true == 0.0:
        return figure(value - true, 2)
    percent = 100.0 * (value / true - 1.0)
    return "under 0.01 %" if abs(percent) < 0.01 else f"{figure(percent, 2)} %"
