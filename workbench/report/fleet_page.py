"""The fleet report: one HTML page whose size is bounded, whatever the number of loops."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass

from markupsafe import Markup

from workbench.model.fleet import FleetRow, Group, Site
from workbench.report.lines import spark
from workbench.report.loop_page import DIGITS, PINS_NOT, page_name, verdict_words
from workbench.report.templating import environment, style_sheet
from workbench.report.words import counted, duration, figure, setting

__all__ = ["page_name", "render_site"]

# What the page shows at most of each; the files hold all.
RANKED, DRAWN, GROUPS, MEMBERS, LISTED = 500, 300, 60, 12, 200
WORDS = 260  # characters of the evidence; a loop's page has all
UNEXPLAINED = "oscillates without stiction and follows no sticking valve: tight tuning, or a source outside"
OPEN = (
    "oscillates and follows no sticking valve, but whether its own sticks is undecided: a test of the valve comes "
    "before another tuning"
)
TOO_FEW = (
    "oscillates like another loop here, over too few recorded cycles to tell whether with it: look at a longer record "
    "before tuning"
)
SATURATED = 0.2  # share of the time at an end of OP


@dataclass(frozen=True, slots=True)
class Line:
    """A row of the ranking as the template takes it: a cell's text and the value that it is sorted by."""

    rank: int
    name: str
    page: str
    row: FleetRow
    trend: Markup
    verdict: str
    cells: tuple[tuple[str, str], ...]


@dataclass(frozen=True, slots=True)
class Advised:
    """A loop of the list for tuning: its present settings, those proposed ("" without a proposal), and why."""

    row: FleetRow
    present: str
    proposed: str
    why: str


def render_site(site: Site) -> str:
    """Return report.html for a fleet run."""
    rows, seen = site.rows, site.looked_at
    by = {row.name: row for row in rows}
    sticky = [row for row in seen if row.sticks]
    pages = {name: f"loops/{page_name(name)}" for name in site.pages}
    drives = {group.members[0]: len(group.members) - 1 for group in site.groups if group.sticky}
    driven = {name: group.members[0] for group in site.groups if group.sticky for name in group.members[1:]}
    areas = sorted({row.area for row in rows[:RANKED] if row.area})
    ranking = [row for row in rows if not row.failed][:RANKED]
    tuning = _to_tune(seen, driven, site.untold)
    return (
        environment()
        .get_template("fleet.html.j2")
        .render(
            site=site,
            css=style_sheet("report.css", "fleet.css"),
            script=style_sheet("fleet.js"),
            tiles=_tiles(site),
            summary=_summary(site, tuning),
            lines=[_line(i, row, site, i < DRAWN) for i, row in enumerate(ranking)],
            hidden=len(seen) - len(ranking),
            areas=areas,
            groups=[_group(group, by) for group in site.groups[:GROUPS]],
            more_groups=max(len(site.groups) - GROUPS, 0),
            maintenance=[
                (row, _stiction(row), drives.get(row.name, 0), driven.get(row.name, ""), _short(row.reasons))
                for row in sticky[:LISTED]
            ],
            more_maintenance=max(len(sticky) - LISTED, 0),
            tuning=tuning[:LISTED],
            more_tuning=max(len(tuning) - LISTED, 0),
            changes=None if site.changes is None else site.changes[:LISTED],
            more_changes=max(len(site.changes or ()) - LISTED, 0),
            failures=site.failures[:LISTED],
            more_failures=max(len(site.failures) - LISTED, 0),
            pages=pages,
            duration=duration,
            verdict_words=verdict_words,
        )
    )


def _share(part: int, whole: int) -> str:
    return f"{part / whole:.0%}" if whole else "–"


def _tiles(site: Site) -> list[tuple[str, str]]:
    seen = site.looked_at
    many = len(seen)
    known = [row.automatic for row in seen if math.isfinite(row.automatic)]
    return [
        ("loops", f"{len(site.rows):,}"),
        ("oscillate", _share(sum(row.oscillates for row in seen), many)),
        ("show stiction", _share(sum(row.sticks for row in seen), many)),
        ("undecided", _share(sum(row.verdict == "undecided" for row in seen), many)),
        ("time in automatic", f"{statistics.fmean(known):.1%}" if known else "not recorded"),
        ("could not be read", f"{len(site.failures):,}"),
    ]


def _summary(site: Site, tuning: Sequence[Advised]) -> list[str]:
    seen = site.looked_at
    sticky = [row for row in seen if row.sticks]
    lines = []
    if sticky:
        worst = ", ".join(row.name for row in sticky[:3])
        lines.append(f"{counted(len(sticky), 'valve shows', 'valves show')} stiction; the most urgent: {worst}.")
    else:
        lines.append("No valve shows stiction.")
    rooted = [group for group in site.groups if group.sticky]
    if site.groups:
        loops = sum(len(group.members) for group in site.groups)
        words = f"{counted(loops, 'loop')} oscillate together in {counted(len(site.groups), 'group')}"
        if rooted:
            spared = sum(len(group.members) - 1 for group in rooted)
            where = f"in {len(rooted)} of them" if len(site.groups) > 1 else "there"
            others = counted(spared, "other loop follows", "other loops follow")
            words += f"; {where} a sticking valve is the likely root, and {others} it"
        lines.append(f"{words}.")
    lines += _tuning_said(tuning)
    ends = sum(row.saturated >= SATURATED for row in seen)
    if ends:
        have = counted(ends, "loop has", "loops have")
        lines.append(f"{have} OP at its highest or lowest value for a fifth of the time or more.")
    if site.failures:
        lines.append(f"{counted(len(site.failures), 'loop')} could not be looked at; the reasons are below.")
    if site.changes is not None:
        worse = sum(change.kind == "worse" for change in site.changes)
        better = sum(change.kind == "better" for change in site.changes)
        lines.append(f"Since the run before, {counted(worse, 'loop is', 'loops are')} worse and {better:,} better.")
    return lines


def _tuning_said(tuning: Sequence[Advised]) -> list[str]:
    """Return how many loops have a proposal, and how many are listed without one and why, in sentences."""
    lines = []
    proposed = [one.row for one in tuning if one.proposed]
    if proposed:
        hints = sum(bool(row.hint) for row in proposed)
        words = f"{counted(len(proposed), 'loop has', 'loops have')} a proposed tuning"
        lines.append(f"{words}, {hints:,} of them no more than a hint." if hints else f"{words}.")
    open_ = sum(one.why == OPEN for one in tuning)
    few = sum(one.why == TOO_FEW for one in tuning)
    others = len(tuning) - len(proposed) - open_ - few
    if others:
        lines.append(f"{counted(others, 'loop oscillates', 'loops oscillate')} without a sticking valve, own or other.")
    if few:
        lines.append(
            f"{counted(few, 'loop oscillates', 'loops oscillate')} over too few recorded cycles to tell whether "
            f"{'it does' if few == 1 else 'they do'} so with another."
        )
    if open_:
        lines.append(
            f"{counted(open_, 'loop oscillates', 'loops oscillate')}, and whether the valve sticks is undecided."
        )
    return lines


def _value(value: float) -> str:
    return f"{value:.6g}" if math.isfinite(value) else ""


def _line(i: int, row: FleetRow, site: Site, drawn: bool) -> Line:
    page = f"loops/{page_name(row.name)}" if row.name in site.pages else ""
    period = figure(row.period / 60.0, 3) if row.oscillates else "–"
    cells = (
        (
            f"{row.oscillation_index:.2f}" if math.isfinite(row.oscillation_index) else "–",
            _value(row.oscillation_index),
        ),
        (period, _value(row.period if row.oscillates else math.nan)),
        (figure(row.stiction, 3) + (" (hint)" if row.vague else ""), _value(row.stiction)),
        (f"{max(row.evidence, 0.0):.0%}" if math.isfinite(row.evidence) else "–", _value(row.evidence)),
        (f"{row.automatic:.0%}" if math.isfinite(row.automatic) else "–", _value(row.automatic)),
        (f"{row.saturated:.0%}" if math.isfinite(row.saturated) else "–", _value(row.saturated)),
        (figure(row.op_travel, 3), _value(row.op_travel)),
        (str(row.criticality) if row.criticality else "–", str(row.criticality)),
    )
    trend = spark(row.trend) if drawn else Markup()
    return Line(i + 1, row.name, page, row, trend, verdict_words(row.verdict), cells)


def _group(group: Group, by: dict[str, FleetRow]) -> dict[str, object]:
    members = [(name, lock, by[name]) for name, lock in zip(group.members, group.locked, strict=True)]
    return {
        "group": group,
        "members": members[:MEMBERS],
        "more": max(len(members) - MEMBERS, 0),
    }


def _short(text: str) -> str:
    """Return as many whole reasons as the table has room for; a first one that is longer is cut."""
    kept, *rest = text.split("; ")
    for reason in rest:
        if len(kept) + len(reason) + 2 > WORDS:
            break
        kept += f"; {reason}"
    return kept if len(kept) <= WORDS else kept[: WORDS - 1].rsplit(" ", 1)[0] + " …"


def _stiction(row: FleetRow) -> str:
    if not math.isfinite(row.stiction):
        return "–"
    words = f"{figure(row.stiction, 3)} %"
    if math.isfinite(row.stiction_low):
        words += f" ({figure(row.stiction_low, 3)} to {figure(row.stiction_high, 3)} %)"
    return f"{words}, {PINS_NOT}" if row.vague else words


def _settings(Kc: float, Ti: float, Td: float, form: str, digits: int | None) -> str:
    """Return settings as they are typed in, "–" for those that are not known."""
    if not math.isfinite(Kc):
        return "–"
    integral = f", Ti {setting(Ti, digits)} s" if math.isfinite(Ti) else ", no integral action"
    return f"Kc {setting(Kc, digits)} %/EU{integral}{f', Td {setting(Td, digits)} s' if Td > 0.0 else ''} ({form})"


def _to_tune(rows: Sequence[FleetRow], driven: dict[str, str], untold: frozenset[str]) -> list[Advised]:
    """Return the loops that another tuning may help, and those that oscillate and nobody knows why."""
    found = []
    for row in rows:
        proposed = math.isfinite(row.Kc)
        if not proposed and (row.sticks or not row.oscillates or row.name in driven):
            continue
        why = TOO_FEW if row.name in untold else OPEN if row.verdict == "undecided" else UNEXPLAINED
        if proposed:
            why = "until the valve is repaired"
            if math.isfinite(row.gain_of_tuning):
                times = figure(row.gain_of_tuning, 2)
                why += f"; cost J {times} times that of the present tuning, on the loop's model"
                why += ", as this one holds the loop without stiction too" if row.gain_of_tuning > 1.0 else ""
            if row.hint:
                why += f"; {row.hint}"
        found.append(
            Advised(
                row,
                _settings(row.present_Kc, row.present_Ti, row.present_Td, row.present_form, None),
                _settings(row.Kc, row.Ti, row.Td, row.form, DIGITS) if proposed else "",
                why,
            )
        )
    return found
