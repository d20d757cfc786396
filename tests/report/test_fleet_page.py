"""The fleet report and a loop's page: escaped, of bounded size, and saying what the rows say."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

import workbench as wb
from workbench.fleet.run import changes_since, ranked
from workbench.model.fleet import Change, FleetRow, Group, Settings, Site
from workbench.report.fleet_page import RANKED, render_site
from workbench.report.lines import panel, spark
from workbench.report.loop_page import page_name, render_loop

EVIL = "<script>alert('x')</script>\"'&"


def rows(many: int) -> tuple[FleetRow, ...]:
    trend = bytes(range(0, 192, 2))
    out = []
    for k in range(many):
        sticky, cycles = k % 5 == 0, k % 3 == 0
        out.append(
            FleetRow(
                f"FIC{k}",
                verdict="stiction" if sticky else "no_stiction",
                oscillates=cycles,
                oscillation_index=(k % 97) / 97.0,
                period=60.0 + k % 700 if cycles else math.nan,
                stiction=1.0 + k % 4 if sticky else math.nan,
                predicts=0.2,
                automatic=0.9,
                saturated=0.1,
                op_travel=12.0,
                reasons="a stem that sticks over 1.06 % leaves 57.9% less of PV unpredicted " * 5,
                trend=trend,
            )
        )
    return ranked(out)


def site(many: int, **more: object) -> Site:
    return Site("A site", "somewhere", Settings(), rows(many), **more)  # type: ignore[arg-type]


class Checker(HTMLParser):
    """Counts elements, and holds that each one that was opened is closed."""

    VOID = frozenset({"meta", "input", "br", "path", "rect"})

    def __init__(self) -> None:
        super().__init__()
        self.stack: list[str] = []
        self.count: dict[str, int] = {}

    def handle_starttag(self, tag: str, _: object) -> None:
        self.count[tag] = self.count.get(tag, 0) + 1
        if tag not in self.VOID:
            self.stack.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if tag not in self.VOID:
            assert self.stack.pop() == tag


def parsed(page: str) -> Checker:
    checker = Checker()
    checker.feed(page)
    assert not checker.stack
    return checker


def test_the_page_is_bounded_whatever_the_number_of_loops() -> None:
    names = [f"FIC{k}" for k in range(15_000)]
    groups = tuple(Group(tuple(names[k : k + 40]), (1.0,) * 40, 300.0, True) for k in range(0, 15_000, 40))
    changes = tuple(Change(name, "worse", "now oscillates") for name in names)
    small, large = render_site(site(20)), render_site(site(15_000, groups=groups, changes=changes))
    assert len(small) < 80_000
    assert len(large) < 1_200_000
    checker = parsed(large)
    assert checker.count["svg"] == 300
    assert large.count("data-name=") == RANKED
    assert "14,500 more loops, of lower rank, are in fleet.csv." in large
    parsed(small)


def test_every_text_is_escaped() -> None:
    evil = FleetRow(
        EVIL, area=EVIL, verdict="stiction", oscillates=True, oscillation_index=0.9, period=60.0, stiction=2.0,
        predicts=0.1, op_travel=1.0, reasons=EVIL, trend=b"\x00\xff", Kc=1.0, Ti=2.0, Td=0.0, form=EVIL,
    )  # fmt: skip
    failed = FleetRow(EVIL + "2", "failed", EVIL)
    changes = (Change(EVIL, "worse", EVIL),)
    groups = (Group((EVIL, EVIL + "2"), (1.0, 0.9), 60.0, True),)
    page = render_site(Site(EVIL, EVIL, Settings(), (evil, failed), groups, changes, frozenset([EVIL])))
    assert "<script>alert" not in page
    assert page.count("<script>") == 1  # our own
    assert "&lt;script&gt;alert" in page
    checker = parsed(page)
    assert checker.count["script"] == 1
    assert f'href="loops/{page_name(EVIL)}"' in page


def test_what_the_page_says() -> None:
    base = rows(20)
    sticky = [row.name for row in base if row.sticks]
    driven = next(row.name for row in base if row.oscillates and not row.sticks)
    group = Group((sticky[0], driven), (1.0, 0.93), 240.0, True)
    failed = FleetRow("broken", "failed", "no column for OP")
    page = render_site(
        Site("A site", "x", Settings(), (*base, failed), (group,), (Change("new", "new", "was not there"),))
    )
    text = re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", page))
    assert "4 valves show stiction" in text
    assert "2 loops oscillate together in 1 group; there a sticking valve is the likely root, and 1 other loop" in text
    assert "broken: no column for OP" in text
    assert "1 other loop" in text  # that the root drives
    tuning = text[text.index("For tuning") :]
    assert driven not in tuning.split("Not looked at")[0].split()  # it follows a sticking valve
    assert "20%" in text  # of the loops stick
    assert "new : new was not there" in text
    quiet = render_site(
        Site("A site", "x", Settings(), tuple(row for row in base if not row.sticks and not row.oscillates))
    )
    assert "No valve shows stiction." in quiet
    assert "No two loops oscillate together." in quiet
    assert "Since the run before" not in quiet
    assert render_site(Site("empty", "x", Settings(), (failed,)))


def test_ranking_puts_what_is_urgent_first() -> None:
    given = [
        FleetRow("quiet", verdict="no_stiction", oscillation_index=0.1),
        FleetRow("cycles", verdict="undecided", oscillates=True, oscillation_index=0.9),
        FleetRow("broken", "failed", "x"),
        FleetRow("weak", verdict="stiction", oscillation_index=0.3),
        FleetRow("strong", verdict="stiction", oscillation_index=0.8),
        FleetRow("critical", verdict="stiction", oscillation_index=0.1, criticality=5),
    ]
    expected = ["critical", "strong", "weak", "cycles", "quiet", "broken"]
    assert [row.name for row in ranked(given)] == expected
    assert [row.name for row in ranked(given[::-1])] == expected


def test_changes_since_the_run_before() -> None:
    ok = FleetRow("a", verdict="no_stiction", oscillation_index=0.2)
    sticky = FleetRow("a", verdict="stiction", stiction=2.0, oscillation_index=0.2)
    cycling = FleetRow("a", verdict="no_stiction", oscillates=True, oscillation_index=0.5)
    failed = FleetRow("a", "failed", "no file")

    def change(old: FleetRow, new: FleetRow) -> list[tuple[str, str]]:
        return [(one.kind, one.words) for one in changes_since([old], [new])]

    assert change(ok, ok) == change(failed, failed) == change(sticky, sticky) == []
    assert change(ok, sticky) == [("worse", "the valve now shows stiction")]
    assert change(sticky, ok) == [("better", "stiction is no longer found")]
    assert change(sticky, replace(ok, verdict="undecided"))[0][1].endswith("but undecided")
    assert change(ok, cycling) == [("worse", "now oscillates")]
    assert change(cycling, ok) == [("better", "no longer oscillates")]
    assert change(cycling, replace(cycling, oscillation_index=0.9))[0][0] == "worse"
    assert change(cycling, replace(cycling, oscillation_index=0.55)) == []
    assert change(sticky, replace(sticky, stiction=4.0)) == [("worse", "stiction 2 % before, 4 % now")]
    assert change(sticky, replace(sticky, stiction=2.5)) == []
    assert change(ok, failed) == [("worse", "could not be read: no file")]
    assert change(failed, ok) == [("better", "can be read again")]
    kinds = [one.kind for one in changes_since([ok, replace(ok, name="z")], [replace(ok, name="b"), sticky])]
    assert kinds == ["worse", "new", "gone"]


def test_page_names_are_safe_and_differ() -> None:
    names = ["FIC101", "unit 2/b", "unit_2_b", "../../etc/passwd", "", "FIC 101", "Ä" * 300, "-x", "con\x00"]
    found = [page_name(name) for name in names]
    assert len(set(found)) == len(names)
    assert found[0] == "FIC101.html"
    assert all(re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_-]*\.html", name) for name in found)
    assert all(len(name) < 80 for name in found)


def test_a_loops_page() -> None:
    n = 5000
    t = np.arange(n)
    record = wb.Record(np.sin(t / 20.0), np.cos(t / 20.0), 1.0, sp=np.zeros(n))
    row = FleetRow(
        EVIL, verdict="stiction", oscillates=True, oscillation_index=0.9, period=125.7, samples=n, sample_time=1.0,
        hours=1.4, stiction=2.0, saturated=0.0, pv_sd=0.7, op_travel=9.0, reasons=EVIL,
    )  # fmt: skip
    evidence = wb.detect(wb.Record(record.pv[:300], record.op[:300], 1.0)).statistics
    page = render_loop(row, record, record, evidence, None, None)
    assert "<script>" not in page
    checker = parsed(page)
    assert checker.count["svg"] == 4  # the whole, and the latest cycles from near
    alike = replace(row, period=170.0)  # 20 such cycles are more than two thirds
    assert parsed(render_loop(alike, record, record, evidence, None, None)).count["svg"] == 2
    assert len(page) < 80_000
    assert "2.00 % of travel" in page


def test_pictures() -> None:
    assert spark(b"") == spark(b"\x01") == ""
    assert spark(b"\x00\xff") == spark(bytes([0, 255]))
    assert "M0 250l1200 -240" in spark(b"\x00\xff")
    flat = panel(np.array([0.0, 1.0]), [("pv", np.array([5.0, 5.0]))], "PV")
    assert "nan" not in flat
    # A spike in a long signal is still drawn.
    signal = np.zeros(100_000)
    signal[5] = 1.0
    drawn = panel(np.arange(100_000) / 3600.0, [("pv", signal)], "PV")
    assert len(drawn) < 10_000
    assert "-142" in drawn


@pytest.mark.parametrize("many", [0, 1])
def test_hardly_any_loops(many: int) -> None:
    parsed(render_site(site(many)))


def test_evidence_is_told_in_whole_reasons_and_settings_at_their_digits() -> None:
    first = "a stem that sticks over 2 % leaves 38.9% less of PV unpredicted than OP itself does"
    reasons = f"{first}; {'the second is too long to stand beside it ' * 6}"
    made = FleetRow(
        "FIC1", verdict="stiction", oscillates=True, reasons=reasons, Kc=1.17, Ti=93.4, Td=0.0, form="ideal"
    )
    page = render_site(Site("A site", "somewhere", Settings(), (made,)))
    assert f"{first}</td>" in re.sub(r"\s+<", "<", page)
    assert "Kc 1.170 %/EU, Ti 93.40 s (ideal)" in page
    long = replace(made, reasons=reasons.replace("; ", " "))
    assert "…" in render_site(Site("A site", "somewhere", Settings(), (long,)))


def test_a_loop_of_too_few_cycles_is_not_said_to_follow_no_valve() -> None:
    found = (FleetRow("FIC1", verdict="no_stiction", oscillates=True, period=600.0, hours=1.0),)
    page = render_site(Site("x", "y", Settings(), found, untold=frozenset({"FIC1"})))
    assert "follows no sticking valve" not in page
    assert "1 loop oscillates over too few recorded cycles to tell whether it does so with another." in page
    assert "recorded over too few cycles to tell whether together: FIC1." in page
    assert "follows no sticking valve" in render_site(Site("x", "y", Settings(), found))


def test_who_is_undecided_is_not_sent_to_tuning_as_healthy_and_a_hint_is_called_one() -> None:
    hinted = FleetRow(
        "FIC1", verdict="stiction", oscillates=True, period=60.0, stiction=0.4541, plant="fopdt", Kc=12.17, Ti=85.05,
        Td=0.0, form="ideal", gain_of_tuning=0.00461, hint="the record gives no range, so take this tuning as a hint",
        present_Kc=0.514, present_Ti=math.inf, present_Td=0.0, present_form="series", evidence=0.07, predicts=0.11,
        notes="held; the record gives no range, so take this tuning as a hint",
    )  # fmt: skip
    pinned = replace(hinted, name="FIC2", identifiable=True, hint="", stiction=2.0, notes="")
    unknown = FleetRow("FIC3", verdict="undecided", oscillates=True, period=60.0)
    quiet = replace(unknown, name="FIC4", verdict="no_stiction", present_Kc=0.5, present_Ti=30.0, present_form="ideal")
    assert hinted.vague
    assert not pinned.vague
    page = render_site(Site("A site", "x", Settings(), (hinted, pinned, unknown, quiet)))
    text = re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", page))
    assert "2 loops have a proposed tuning, 1 of them no more than a hint." in text
    assert "1 loop oscillates without a sticking valve, own or other." in text
    assert "1 loop oscillates, and whether the valve sticks is undecided." in text
    rows = {row.split("<", 1)[0]: row for row in page.split("For tuning")[1].split('<th scope="row">')}
    assert "whether its own sticks is undecided" in rows["FIC3"]
    assert "without stiction" not in rows["FIC3"]
    assert "oscillates without stiction" in rows["FIC4"]
    assert "Kc 0.5 %/EU, Ti 30 s (ideal)" in rows["FIC4"]
    assert (
        "<td>Kc 0.514 %/EU, no integral action (series)</td><td>Kc 12.17 %/EU, Ti 85.05 s (ideal)</td>" in rows["FIC1"]
    )
    assert "cost J 0.0046 times that of the present tuning" in rows["FIC1"]
    assert "so take this tuning as a hint" in rows["FIC1"]
    assert "holds the loop without stiction" not in rows["FIC1"]
    dear = render_site(Site("A site", "x", Settings(), (replace(pinned, gain_of_tuning=1.27),)))
    assert "cost J 1.3 times that of the present tuning" in dear
    assert "model, as this one holds the loop without stiction too" in dear
    assert "hint" not in rows["FIC2"]
    assert ">0.454 (hint)<" in page
    assert ">2.00<" in page
    assert "7%" in text  # the evidence that the verdict rests on, not the screening's
    assert "11%" not in text


def test_a_loops_page_says_a_hint_beside_the_tuning_and_no_unit_of_nothing() -> None:
    record = wb.Record(np.sin(np.arange(400) / 9.0), np.cos(np.arange(400) / 9.0), 1.0)
    row = FleetRow(
        "FIC1", verdict="stiction", stiction=2.0, plant="fopdt", gain_of_tuning=0.0046, samples=400, sample_time=1.0,
        hours=0.1, saturated=0.0, pv_sd=0.7, op_travel=9.0, hint="the gain is open, so take this tuning as a hint",
        notes="held; the gain is open, so take this tuning as a hint",
    )  # fmt: skip
    page = render_loop(row, record, record, wb.detect(record).statistics, None, wb.PID(1.0, 20.0))
    text = re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", page))
    assert "is 0.0046 times that of the present tuning on this model. The gain is open" in text
    assert "Notes held " in text
    assert "2.00 % of travel, of the model below; a hint: the record does not pin it" in text
    assert "A repaired valve" not in text  # nothing that was computed says so
    assert "A repaired valve allows" in render_loop(
        row, record, record, wb.detect(record).statistics, None, wb.PID(1.0, 20.0), "A repaired valve allows more."
    )
    assert "PV, EU" in text
    assert "– %" not in text
    assert "bicoherence=True" not in text
