"""What the report says of limit cycles and describing functions: their sentences and their table."""

from __future__ import annotations

import math
import re
from collections.abc import Callable

from workbench.model.results import DescribingFunction, LimitCycle, LimitCycleStart
from workbench.model.study import CaseResult, Study
from workbench.report.judge import (
    at_odds,
    df_disagrees,
    last_change,
    late_words,
    over_starts,
    quiet,
    run_travel,
    too_short,
    unstable,
)
from workbench.report.tables import Cell, Row, Table, blocks
from workbench.report.words import capital, duration, figure, join, lower_first

__all__ = [
    "better_late",
    "by_start",
    "cycle_sentences",
    "cycle_tables",
    "from_others",
    "late_errors",
    "late_figures",
    "off_setpoint",
    "period_words",
    "rest_cause",
    "swing",
]

LISTED = 3  # cycling cases that are listed one by one
ALONE = "not the valve's alone"
LATE = ("mean_square_error", "travel_per_hour")  # what is told of a cycle that has set in


def _names(cases: list[CaseResult]) -> str:
    return join([c.name for c in cases])


def swing(cycle: LimitCycle) -> str:
    """Return a cycle in words: "PV swings 2.01 EU every 102 s"."""
    return f"PV swings {figure(cycle.pv_peak_to_peak, 3)} EU every {duration(cycle.period)}"


def off_setpoint(cycle: LimitCycle) -> str:
    """Return where PV stays in a loop that comes to rest off its setpoint: "PV 0.800 EU below its setpoint", or ""."""
    if not rest_cause(cycle):
        return ""
    error = cycle.starts[0].rest_error
    return f"PV {figure(abs(error), 3)} EU {'below' if error > 0.0 else 'above'} its setpoint"


def rest_cause(cycle: LimitCycle) -> str:
    """Return why a loop rests off its setpoint: "OP is at its limit", "" where it rests on it, or not at all."""
    return cycle.starts[0].reason.partition(", as ")[2] if cycle.outcome == "settles" else ""


def from_others(cycle: LimitCycle) -> str:
    """Return how many other starts cycle where this one rests: "from 7 of 8 other starts it cycles", else ""."""
    many = sum(start.outcome == "cycles" for start in cycle.starts)
    return (
        f"from {many} of {len(cycle.starts) - 1} other starts it cycles" if cycle.outcome == "settles" and many else ""
    )


def cycle_sentences(study: Study) -> list[str]:
    """Return what the cases do: which cycle, come to rest or grow, and where describing function or run differ."""
    out: list[str] = []
    wild = [c for c in study.cases if unstable(c)]
    aside = quiet(study.experiment)
    if wild:
        out.append(f"{_names(wild)}: the loop is unstable, PV grows without bound.")
    seen = [(c, c.limit_cycle) for c in study.cases if c.limit_cycle is not None]
    cycling = [(c, cycle) for c, cycle in seen if cycle.outcome == "cycles"]
    if cycling:
        lead = f"{len(cycling)} of {len(seen)} tunings keep the loop cycling"
        if len(cycling) == len(seen):
            every = "both" if len(seen) == 2 else f"all {len(seen)}"
            lead = "the loop keeps cycling" if len(seen) == 1 else f"{every} tunings keep the loop cycling"
        lead = capital(f"{aside}, {lead}" if aside else lead)
        ranked = sorted(cycling, key=lambda pair: pair[1].pv_peak_to_peak)
        if len(cycling) <= LISTED:
            out.append(f"{lead}: {'; '.join(f'{c.name} ({swing(cycle)})' for c, cycle in cycling)}.")
        else:
            least, most = (f"{swing(cycle)} ({c.name})" for c, cycle in (ranked[0], ranked[-1]))
            out.append(f"{lead}; at the least {least}, at the most {most}.")
    told: dict[str, list[str]] = {}
    for outcome in ("settles", "depends", "undecided"):
        for case, cycle in seen:
            if cycle.outcome == outcome and case not in wild:
                where = off_setpoint(cycle)
                told.setdefault(_without_cycle(cycle), []).append(f"{case.name} ({where})" if where else case.name)
    out += [f"{join(some)}: {f'{aside} ' if aside else ''}{text}." for text, some in told.items()]
    out += _noisy_sentences(study)
    out += _tuning_alone(cycling)
    out += _late_sentences(study, cycling)
    out += _agreement_sentences(study)
    return out


def _without_cycle(cycle: LimitCycle) -> str:
    """Return what a loop does that does not simply cycle, and why that stays open where it does."""
    if cycle.outcome == "settles":
        cause = rest_cause(cycle)
        return f"the loop comes to rest there, as {cause}" if cause else "the loop comes to rest"
    if cycle.outcome == "depends":
        return "the loop cycles or comes to rest depending on where it starts"
    reason = next((s.reason for s in cycle.starts if s.outcome == "undecided" and s.reason), "")
    return "whether the loop cycles could not be decided by simulation" + (f" ({reason})" if reason else "")


def _noisy_sentences(study: Study) -> list[str]:
    """Name the cases whose own run, with its noise or load, contradicts the verdict without."""
    told = []
    for case in study.cases:
        cycle = case.limit_cycle
        if cycle is None or not at_odds(case, study.experiment):
            continue
        rate = figure(run_travel(case, study.experiment), 3)
        text = f"{case.name}: the run itself shows otherwise, late in it the valve"
        if cycle.outcome == "settles":
            told.append(f"{text} keeps moving, by {rate} % an hour.")
        else:
            told.append(f"{text} travels {rate} % an hour, not {figure(cycle.travel_per_hour, 3)} %.")
    return told


def _tuning_alone(cycling: list[tuple[CaseResult, LimitCycle]]) -> list[str]:
    """Name the cycling cases whose loop would be unstable without any stiction."""
    some = [
        c
        for c, _ in cycling
        if c.describing_function is not None
        and not c.describing_function.linear_stable
        and not (df_disagrees(c) and ALONE in c.agreement)
    ]
    if not some:
        return []
    whose = "its cycle is" if len(some) == 1 else "their cycles are"
    return [f"{_names(some)}: the loop would be unstable with an ideal valve too, so {whose} {ALONE}."]


def _late_sentences(study: Study, cycling: list[tuple[CaseResult, LimitCycle]]) -> list[str]:
    """Name the cases whose cycle the run is too short to show: their figures are flattered."""
    if study.experiment is None:
        return []
    late = [c for c, _ in cycling if too_short(c, study.experiment)]
    if not late:
        return []
    whose = "its figures in the table do" if len(late) == 1 else "their figures in the table do"
    changed = last_change(late[0].run)
    since = f", with its last change at {duration(changed)}," if changed > 0.0 else ""
    return [
        (
            f"The run of {duration(study.experiment.duration)}{since} is too short to show the cycle of "
            f"{_names(late)}: {whose} not contain it."
        )
    ]


def _agreement_sentences(study: Study) -> list[str]:
    """Say where describing function and exact simulation disagree on whether the loop cycles."""
    out = []
    wrong = [c for c in study.cases if df_disagrees(c)]
    for sentence in dict.fromkeys(c.agreement for c in wrong):
        owners = _names([c for c in wrong if c.agreement == sentence])
        if sentence:
            out.append(f"{owners}: {lower_first(sentence)}")
        else:
            out.append(f"{owners}: the describing function is wrong about the cycle; the exact simulation is right.")
    return out


def late_errors(study: Study) -> list[str]:
    """Compare the cases once their cycles have set in, which one run may not show."""
    late = [(c, c.limit_cycle) for c in study.cases if c.limit_cycle and c.limit_cycle.outcome == "cycles"]
    if len(late) < 2:
        return []
    late = sorted(late, key=lambda pair: over_starts(pair[1], "mean_square_error")[1])
    if len(late) > LISTED:
        late = [late[0], late[-1]]
    told = [f"{c.name} {late_figures(cycle)}" for c, cycle in late]
    aside = quiet(study.experiment)
    when = f"once the cycle has set in, {aside}" if aside else "once the cycle has set in"
    return [f"Mean square error and valve travel {when}: {'; '.join(told)}{by_start(*(cycle for _, cycle in late))}."]


def late_figures(cycle: LimitCycle) -> str:
    """Return a cycle's mean square error and valve travel, over the starts that cycle: "0.81 EU² at 142 % an hour"."""
    error, travel = (late_words(cycle, name) for name in LATE)
    return f"{error} EU² at {travel} % an hour"


def by_start(*cycles: LimitCycle) -> str:
    """Return what explains the ranges in `late_figures` of these cycles, "" where every start gives the same."""
    ranges = [" to " in late_words(cycle, name) for cycle in cycles for name in LATE]
    return " (where a range stands, it depends on the start)" if any(ranges) else ""


def better_late(study: Study, best: CaseResult, cycle: LimitCycle) -> list[str]:
    """Name the cases that come to rest, and one of clearly less error, where the recommended one cycles on."""
    when = quiet(study.experiment) or "without disturbances"
    by_run = "the recommendation goes by the run of this experiment"
    out = []
    seen = [(c, c.limit_cycle) for c in study.cases if c is not best and c.limit_cycle is not None]
    rest = [c for c, theirs in seen if theirs.outcome == "settles"]
    if rest:
        verb = "comes" if len(rest) == 1 else "come"
        out.append(f"In the long run {when} {_names(rest)} {verb} to rest after this experiment; {by_run}.")
    others = [(c, t, over_starts(t, "mean_square_error")[1]) for c, t in seen if t.outcome == "cycles"]
    # Which of its cycles a slow loop falls into is chosen by the start: only what holds for all of them is a claim.
    if others:
        other, theirs, error = min(others, key=lambda one: one[2])
        if error < 0.8 * over_starts(cycle, "mean_square_error")[0]:
            both = (late_words(one, "mean_square_error") for one in (theirs, cycle))
            out.append(
                f"In the long run {when} {other.name} has a smaller error in its cycle, from every start tried "
                f"({' EU² against '.join(both)} EU²); {by_run}."
            )
    return out


def _deciding_start(cycle: LimitCycle) -> LimitCycleStart | None:
    """Return the start whose figures are the cycle's own (the given experiment's), or None where they are medians."""
    for start in cycle.starts:
        if start.outcome == "cycles" and start.period == cycle.period:
            return start
    return None


def _of_cycle(text: Callable[[LimitCycle], str]) -> Callable[[CaseResult], str]:
    return lambda case: "–" if case.limit_cycle is None else text(case.limit_cycle)


def _of_df(text: Callable[[DescribingFunction], str]) -> Callable[[CaseResult], str]:
    return lambda case: "–" if case.describing_function is None else text(case.describing_function)


def _outcome(case: CaseResult) -> str:
    cycle = case.limit_cycle
    if cycle is not None and cycle.outcome == "undecided" and unstable(case):
        return "unstable: PV grows"
    return "–" if cycle is None else {"depends": "depends on the start"}.get(cycle.outcome, cycle.outcome)


def _rest_error(cycle: LimitCycle) -> str:
    return figure(cycle.starts[0].rest_error, 3) if rest_cause(cycle) else "–"


def _first_period(cycle: LimitCycle) -> str:
    start = _deciding_start(cycle)
    return "–" if start is None else duration(start.first_period)


def period_words(cycle: LimitCycle) -> str:
    """Return the late period over all starts: "28 min to 85 min", or one where they agree."""
    return _times(*cycle.period_range)


def _seen_after(cycle: LimitCycle) -> str:
    windows = [start.window for start in cycle.starts if start.outcome == "cycles"] or [cycle.window]
    return _times(min(windows), max(windows))


def _times(low: float, high: float) -> str:
    if math.isnan(low) or duration(low) == duration(high):
        return duration(low)
    return f"{duration(low)} to {duration(high)}"


def _held(text: str) -> str:
    """Return a range whose numbers do not part from their units."""
    return text if " to " not in text else re.sub(r"(\d) ", "\\1\u00a0", text)


def _all_starts(name: str) -> Callable[[CaseResult], str]:
    return _of_cycle(lambda cycle: late_words(cycle, name))


_CYCLE_ROWS: tuple[tuple[str, str, Callable[[CaseResult], str]], ...] = (
    ("Exact simulation", "", _outcome),
    ("Rests with SP − PV at", "EU", _of_cycle(_rest_error)),
    ("Rests there, as", "", _of_cycle(lambda c: rest_cause(c) or "–")),
    ("First period", "", _of_cycle(_first_period)),
    ("Late period", "", _of_cycle(lambda c: duration(c.period))),
    ("Late period, all starts", "", _of_cycle(lambda c: _held(period_words(c)))),
    ("Closed form, shortest", "", _of_cycle(lambda c: duration(c.closed_form_period))),
    ("PV peak to peak", "EU", _of_cycle(lambda c: figure(c.pv_peak_to_peak, 3))),
    ("PV peak to peak, all starts", "EU", _all_starts("pv_peak_to_peak")),
    ("OP peak to peak", "%", _of_cycle(lambda c: figure(c.op_peak_to_peak, 3))),
    ("Mean square error", "EU²", _of_cycle(lambda c: figure(c.mean_square_error, 3))),
    ("Mean square error, all starts", "EU²", _all_starts("mean_square_error")),
    ("Valve travel an hour", "%", _of_cycle(lambda c: figure(c.travel_per_hour, 3))),
    ("Valve travel an hour, all starts", "%", _all_starts("travel_per_hour")),
    ("Slips an hour", "", _of_cycle(lambda c: figure(c.slips_per_hour, 3))),
    ("Stem reversals an hour", "", _of_cycle(lambda c: figure(c.reversals_per_hour, 3))),
    ("Time after the last change to see it", "", _of_cycle(lambda c: duration(c.window))),
    ("Time after the last change to see it, all starts", "", _of_cycle(lambda c: _held(_seen_after(c)))),
    ("Describing function", "", _of_df(lambda d: d.prediction)),
    ("Predicted period", "", _of_df(lambda d: duration(d.period))),
    ("Predicted PV peak to peak", "EU", _of_df(lambda d: figure(2.0 * d.pv_amplitude, 3))),
    ("Distance of the loci", "", _of_df(lambda d: figure(d.distance, 3))),
    ("Loop with an ideal valve", "", _of_df(lambda d: "stable" if d.linear_stable else "unstable")),
)


def cycle_tables(study: Study) -> list[Table]:
    """Return limit cycles and describing functions, figures down and cases across; empty where none was asked for."""
    cases = [c for c in study.cases if c.limit_cycle is not None or c.describing_function is not None]
    tables = []
    for block in blocks(cases):
        rows: list[Row] = []
        shown: dict[str, list[str]] = {}
        for title, unit, text in _CYCLE_ROWS:
            plain = shown.get(title.removesuffix(", all starts"), [])
            shown[title] = [text(c) for c in cases]
            if all(one == "–" for one in shown[title]) or shown[title] == plain:
                continue  # nothing to tell, or the same from all starts
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
