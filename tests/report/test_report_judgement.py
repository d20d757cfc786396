"""What the report does not claim: of loops under noise, of late settling, of bounds, of controllers that do nothing."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from workbench.cli.output import estimate_lines
from workbench.model.experiment import Experiment, Noise, Step
from workbench.model.study import CaseResult, NamedEstimate, Study
from workbench.model.tuning import Bounds, Objective
from workbench.model.valve import Deadband
from workbench.report import figures, words
from workbench.report.confidence import Judged, searches
from workbench.report.cycles import cycle_tables
from workbench.report.estimates import estimate_table
from workbench.report.how import how_tables
from workbench.report.judge import at_odds, best_case, df_disagrees, on_bounds, quiet, run_travel, settling_doubt
from workbench.report.reference import reference_sentences
from workbench.report.shared import loop_lines
from workbench.report.summary import summarise
from workbench.report.tables import Table, case_tables
from workbench.report.templating import environment
from workbench.simulate.run import simulate
from workbench.ui.given import table_content

SHOWS = "{% from 'macros.html.j2' import table_of %}{{ table_of(table, '') }}"

Make = Callable[..., Any]


def of(study: Study, *cases: CaseResult, **extra: Any) -> Study:
    return replace(study, cases=cases, estimates=(), **extra)


def row(study: Study, label: str) -> Any:
    return next(r for table in case_tables(study) for r in table.rows if r.label == label)


def noisy(case: CaseResult, sd: float = 1.5, load: Step | None = None) -> tuple[CaseResult, Experiment]:
    experiment = Experiment(duration=1000.0, setpoint=Step(4.0), load=load, noise=Noise(sd, 1))
    return replace(case, run=simulate(case.loop, experiment)), experiment


def test_a_controller_that_does_nothing_is_not_recommended(study: Study, case: Make) -> None:
    # Its error is constant from the first sample: no variance at all.
    idle = case("Idle", 0.1, math.inf, objective=None)
    working = case("Working", 0.5, 20.0, objective=None)
    assert idle.run.kpis.error_variance < working.run.kpis.error_variance
    told = of(study, idle, working, objective=None)
    assert best_case(told) is told.cases[1]
    assert summarise(told).advice[0].startswith("Least error and least wear in this experiment: Working")
    assert not any(cell.best for cell in row(told, "Error variance").cells)
    assert [cell.best for cell in row(told, "Mean square error").cells] == [False, True]


@pytest.mark.parametrize(
    ("sd", "load", "text"),
    [
        (0.0, None, ""),
        (0.1, None, "without noise"),
        (0.0, Step(1.0), "without further disturbance"),
        (0.1, Step(1.0), "without noise and further disturbance"),
    ],
)
def test_what_the_verdict_leaves_out(sd: float, load: Step | None, text: str) -> None:
    assert quiet(Experiment(duration=10.0, load=load, noise=Noise(sd))) == text


def test_a_verdict_without_noise_is_not_told_of_a_noisy_run(study: Study, cycle: Make) -> None:
    case, experiment = noisy(study.cases[0])
    case = replace(case, describing_function=None, limit_cycle=cycle(case.loop, "settles"))
    assert at_odds(case, experiment)
    rate = words.figure(run_travel(case, experiment), 3)
    summary = summarise(of(study, case, experiment=experiment))
    assert "Case 1: without noise the loop comes to rest." in summary.found
    moving = f"Case 1: the run itself shows otherwise, late in it the valve keeps moving, by {rate} % an hour."
    assert moving in summary.found
    assert any(
        f"comes to rest without noise; in the run itself the valve travels {rate} %" in t for t in summary.advice
    )

    cycling = replace(case, limit_cycle=replace(cycle(case.loop), travel_per_hour=8.06))
    told = of(study, cycling, experiment=experiment)
    summary = summarise(told)
    assert summary.found[0].startswith("Without noise, the loop keeps cycling: Case 1")
    assert any(f"travels {rate} % an hour, not 8.06 %." in t for t in summary.found)
    assert any("the cycle remains (without noise)" in t and f"in the run itself {rate} %" in t for t in summary.advice)
    rows = {r.label: r.cells[0].text for r in cycle_tables(told)[0].rows}
    assert rows["Late in the run itself: valve travel an hour"] == rate


def test_the_answer_to_a_late_load_is_not_taken_for_lasting_motion(study: Study, cycle: Make) -> None:
    case, experiment = noisy(study.cases[0], load=Step(1.0, 900.0))
    case = replace(case, limit_cycle=cycle(case.loop, "settles"))
    assert math.isnan(run_travel(case, experiment))
    assert not at_odds(case, experiment)


def test_settling_is_told_with_its_band_and_not_praised_where_it_does_not_last(study: Study) -> None:
    settling = row(study, "Settling time")
    assert settling.unit == "from the last step into ±1 EU"
    first, _, best = study.cases
    assert math.isfinite(first.run.kpis.settling_time)
    assert settling.cells[0].small == "not for good: it cycles"
    printed = of(study, replace(first, reference={"settling_time": 90.0}), best)
    assert row(printed, "Settling time").cells[0].small == "not for good: it cycles; publ. 90.0 s"
    assert not any(cell.best for cell in settling.cells)
    alone = of(study, replace(first, limit_cycle=None), replace(best, limit_cycle=None))
    assert [c.best for c in row(alone, "Settling time").cells].count(True) == 1
    late = replace(first, limit_cycle=None)
    late = replace(late, run=replace(late.run, kpis=replace(late.run.kpis, settling_time=950.0)))
    assert settling_doubt(late, study.experiment) == "only at the run's end"


def test_a_parameter_on_its_bound_is_said(study: Study) -> None:
    best = study.cases[2]
    tuned = best.tuned
    assert tuned is not None
    assert on_bounds(tuned) == []
    narrow = replace(tuned, bounds=Bounds(Kc=(2.351, 2.351), Ti=(9.5, 60.0), Td=(0.0, 10.0)))
    assert on_bounds(narrow) == ["Ti on its lower bound of 9.5 s"]
    told = of(study, study.cases[0], replace(best, tuned=narrow))
    sentence = "Optimised PI: the search ended with Ti on its lower bound of 9.5 s; a better tuning may lie beyond."
    assert sentence in summarise(told).found
    rows = {r.label: r.cells[0].text for r in how_tables(told)[0].rows}
    assert rows["Settings on a bound"] == "Ti on its lower bound of 9.5 s"


def test_limits_and_anti_windup_are_shown(study: Study) -> None:
    def limited(case: CaseResult, **extra: Any) -> CaseResult:
        pid = replace(case.loop.controller, output_limits=(-8.0, 8.0), **extra)
        return replace(case, loop=replace(case.loop.with_controller(pid), pv_range=(0.0, 200.0)))

    one, two = study.cases[:2]
    shared = dict(loop_lines(of(study, limited(one), limited(two))))
    assert "output limits −8 to 8 %, anti-windup clamp" in shared["Controller"]
    assert shared["PV range"] == "0 to 200 EU"
    back = limited(two, anti_windup="back_calculation", tracking_time=5.0)
    differing = of(study, limited(one), back, one)
    assert [c.text for c in row(differing, "Output limits").cells] == ["−8 to 8 %", "−8 to 8 %", "none"]
    assert [c.text for c in row(differing, "Anti-windup").cells] == ["clamp", "back-calculation", "–"]
    assert [c.text for c in row(differing, "Tracking time").cells] == ["–", "5 s", "–"]
    assert "tracking" not in dict(loop_lines(differing))["Controller"]
    assert "limits" not in dict(loop_lines(study))["Controller"]


def test_two_tunings_are_both(study: Study) -> None:
    assert summarise(of(study, *study.cases[:2])).found[0].startswith("Both tunings keep the loop cycling")


def test_converted_settings_are_readable() -> None:
    assert words.setting(100.0 / 150.0) == "0.666667"
    assert words.setting(2.35168213, 4) == "2.35168213"


def test_one_printed_digit_is_no_agreement_to_the_digit(study: Study) -> None:
    assert words.difference(0.9, 1.0, 0) == "rounds to the published figure"
    assert words.difference(0.995, 1.0, 0) == "to the digit"
    case = replace(study.cases[0], reference={"reversals": 3.0, "valve_travel": 12.0})
    assert words.difference(12.18, 12.0, 0) == "to the digit"
    kpis = replace(case.run.kpis, mean_square_error=0.54)
    crude = replace(case, run=replace(case.run, kpis=kpis), reference={"mean_square_error": 0.5})
    told = reference_sentences(of(study, crude))
    assert told[0].startswith("None of the 1 published figures comes out to the digit")
    assert told[0].endswith("1 of them is met only within the one digit printed.")


def test_an_unstable_case_is_never_bold_and_does_not_stretch_the_figure(study: Study, case: Make) -> None:
    wild = case("Wild", 50.0, 5.0)
    wild = replace(wild, run=replace(wild.run, kpis=replace(wild.run.kpis, reversals=0)))
    told = of(study, wild, *study.cases)
    for one in case_tables(told)[0].rows:
        assert not one.cells[0].best, one.label
    above, near, below, _ = figures.overlay_figure(told.cases).axes
    assert near.get_ylim()[1] < 20.0
    assert above.get_ylim()[1] < 20.0
    assert below.get_ylim()[1] < 40.0
    assert any("Wild: beyond this axis" in text.get_text() for text in above.texts)
    assert not any("beyond" in t.get_text() for t in figures.overlay_figure(study.cases).axes[0].texts)


def test_a_prediction_that_wanders_away_with_a_load_is_not_held_against_the_linear_fit(estimated: Make) -> None:
    found, _ = estimated()
    spread = float(np.var(found.record.pv))

    def table(**changes: object) -> tuple[dict[str, list[str]], str]:
        made = estimate_table(NamedEstimate("E", replace(found, **changes)))
        return {row.label: [cell.text for cell in row.cells] for row in made.rows}, made.note

    rows, note = table()
    assert note == ""
    assert "–" not in (rows["Residual variance"][0], rows["AIC"][0])
    rows, note = table(residual_variance=19.0 * spread, verdict="undecided")
    assert "wanders away with the load" in note
    assert table_content(Table((), (), note=note))["note"] == note
    assert note in environment().from_string(SHOWS).render(table=Table((), (), note=note)).replace("&#39;", "'")
    assert note.count(".") == 1
    assert rows["Residual variance"][0] == rows["AIC"][0] == "–"
    assert rows["Residual variance"][-1] != "–"
    lines = " ".join(estimate_lines(replace(found, residual_variance=19.0 * spread, verdict="undecided")))
    assert "wanders away from PV with the load" in lines
    assert "PV is met within" not in lines
    assert "PV is met within" in " ".join(estimate_lines(found))
    # A model that is of no use is told as such by these very figures.
    rows, note = table(residual_variance=19.0 * spread, verdict="stiction", candidates=())
    assert note == ""
    assert rows["Residual variance"][0] != "–"


def test_a_bias_that_is_rounding_error_is_0(study: Study, estimated: Make) -> None:
    found, _ = estimated()
    tiny = replace(found, bias=-3.25e-8)
    rows = {r.label: r.cells[0].text for r in estimate_table(NamedEstimate("E", tiny)).rows}
    assert rows["Bias (PV at stem 0)"] == "0"
    assert np.ptp(found.record.pv) > 1.0


def test_what_no_tuning_removes_is_not_said_of_an_undecided_valve(study: Study, estimated: Make) -> None:
    found, _ = estimated(verdict="undecided")
    mine = replace(found, valve=study.cases[0].loop.valve)
    told = replace(study, estimates=(NamedEstimate("E", mine),))
    assert any("What no tuning removes" in t for t in summarise(study).advice)
    assert not any("What no tuning removes" in t for t in summarise(told).advice)


def test_unstable_crossings_are_no_prediction_of_a_cycle(study: Study, df: Make, cycle: Make) -> None:
    case = study.cases[0]
    nan = math.nan
    wild = replace(df(case.loop, cycle=True), period=nan, amplitude=nan, pv_amplitude=nan, linear_stable=False)
    case = replace(case, describing_function=wild, limit_cycle=cycle(case.loop))
    assert not df_disagrees(case)
    told = of(study, case)
    rows = {r.label: r.cells[0].text for r in cycle_tables(told)[0].rows}
    assert rows["Describing function"] == "unstable crossings only"
    alone = "Case 1: the loop would be unstable with an ideal valve too, so its cycle is not the valve's alone."
    assert alone in summarise(told).found


def test_how_a_tuning_was_found_names_its_searches_its_weights_and_its_worst_case(study: Study) -> None:
    tables = how_tables(study)
    rows = {r.label: r.cells[0].text for r in tables[0].rows}
    near = "within the larger of ±0.1 % and half the last digit of each setting"
    assert rows["Worst J near the settings"].endswith(near)
    assert "J of this search" not in rows
    assert tables[1].heads[0] == "search"
    best = study.cases[2]
    assert best.tuned is not None
    own = replace(best, tuned=replace(best.tuned, weights=Objective(w1=0.5, w3=0.5, w4=0.05)))
    rows = {r.label: r.cells[0].text for r in how_tables(of(study, study.cases[0], own))[0].rows}
    assert rows["J of this search"] == (
        "0.5 Σ (SP − PV)² + 0.05 Σ (OP move)² + 0.5 (SP − PV)² at the end, sums over samples"
    )


def test_what_no_settings_can_be_below_is_told_and_settles_whether_searches_agree(study: Study) -> None:
    tuned = study.cases[2].tuned
    assert tuned is not None
    apart = tuple(replace(tuned.restarts[0], seed=k, refined=(1.0 + 0.2 * k) * tuned.nominal) for k in range(3))
    tuned = replace(tuned, restarts=apart, bounds=Bounds(Kc=(0.0, 8.0), Ti=(1.0, 6000.0), Td=(0.0, 0.0)))

    def judged(bound: float | None) -> Judged:
        told = Judged()
        searches(replace(tuned, worst_bound=bound), told)
        return told

    assert "no settings" not in judged(None).reasons[0]
    assert judged(None).open_points == ["the searches do not agree"]
    near, far = judged(0.995 * tuned.worst), judged(0.9 * tuned.worst)
    assert (
        "; a run in every neighbourhood of the bounds (Kc from 0.008 on) shows that no settings have a worst J below "
        f"{words.figure(0.995 * tuned.worst)} (these: {words.figure(tuned.worst)})" in near.reasons[0]
    )
    assert near.open_points == []
    assert far.open_points == ["the searches do not agree"]


def test_where_the_worst_case_is_sought_without_a_margin() -> None:
    assert words.nearby(0.0) == "within half the last digit of each setting"
    assert words.nearby(0.002).startswith("within the larger of ±0.2 % and")


def test_a_dead_bands_range_stands_in_its_table(estimated: Make) -> None:
    found, _ = estimated()
    dead = replace(found, valve=Deadband(3.5), intervals=replace(found.intervals, d=None, S=(3.4, 5.6)))
    rows = {row.label: row.cells[1].text for row in estimate_table(NamedEstimate("FIC1", dead)).rows}
    assert rows["Dead band b"] == "3.400 to 5.600"
