"""The report on rules and on what repair is worth."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

import workbench as wb
from workbench.analyze.standing import standing
from workbench.model.results import Repair
from workbench.model.rule import Rule
from workbench.model.study import Study
from workbench.model.valve import Ideal
from workbench.report.page import write_report
from workbench.report.repair import repair_sentence, repair_tables, repair_text
from workbench.report.summary import summarise
from workbench.report.words import rule_words
from workbench.tune.repair import outcome, repaired_outcome


@pytest.fixture(scope="module")
def repaired(study: Study) -> Study:
    """The made study with its cases' repaired outcomes, and the best PI for the repaired loop near enough."""
    first, best = study.cases[0], study.cases[2]
    assert study.experiment is not None
    assert study.objective is not None
    assert best.tuned is not None
    cases = tuple(replace(c, repaired=repaired_outcome(c.loop, study.experiment, study.objective)) for c in study.cases)
    controller = replace(first.loop.controller, Kc=2.4, Ti=6.5)
    ideal = replace(first.loop, valve=Ideal(), controller=controller)
    repair = Repair(
        loop=first.loop,
        experiment=study.experiment,
        weights=study.objective,
        present=outcome(first.loop, study.experiment, study.objective),
        repaired=repaired_outcome(first.loop, study.experiment, study.objective),
        best=outcome(best.loop, study.experiment, study.objective),
        best_repaired=outcome(ideal, study.experiment, study.objective),
        tuned=best.tuned,
        tuned_repaired=replace(best.tuned, controller=controller),
    )
    return replace(study, cases=(replace(cases[0], rule=wb.Simc()), *cases[1:]), repair=repair)


def test_the_tables(repaired: Study) -> None:
    four, cases = repair_tables(repaired)
    rows = {row.label: [cell.text for cell in row.cells] for row in four.rows}
    assert rows["Kc"] == ["0.5", "0.5", "2.351", "2.400"]
    assert rows["J"][0] == "226.6"
    assert rows["Valve travel"][0] == "12.18"
    assert [row.label for row in cases.rows] == ["Case 1", "Case 2", "Optimised PI"]
    kpis = repaired.cases[0].repaired
    assert kpis is not None
    assert f"{kpis.kpis.mean_square_error:.4f} repaired" in cases.rows[0].cells[1].small
    assert repair_tables(replace(repaired, repair=None)) == []


@pytest.mark.usefixtures("undrawn")
def test_the_page_tells_it_and_escapes_nothing_away(repaired: Study, tmp_path: Path) -> None:
    write_report(repaired, tmp_path)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "<h2>What repair is worth</h2>" in page
    assert "Every case with the valve repaired" in page
    assert "SIMC with a closed-loop time constant equal to the dead time (S. Skogestad" in page
    assert any(
        line.startswith("What repair is worth: with an ideal valve Case 1") for line in summarise(repaired).advice
    )


def of_error(repair: Repair, left: float, after: float) -> Repair:
    best = replace(repair.best, kpis=replace(repair.best.kpis, mean_square_error=left, error_variance=left))
    kpis = replace(repair.best_repaired.kpis, mean_square_error=after, error_variance=after)
    return replace(repair, best=best, best_repaired=replace(repair.best_repaired, kpis=kpis))


@pytest.mark.parametrize(
    ("left", "after", "words"),
    [
        (0.2, 0.05, "75 % goes only with the repair"),
        (0.2, 0.199, "does as well as a repair: mean square error 0.2000 EU² against 0.1990 EU²"),
        (0.2, 0.3, "does as well as a repair"),
        (0.0, 0.0, "leaves no error that a repair could remove"),
    ],
)
def test_no_more_is_claimed_than_the_figures_say(repaired: Study, left: float, after: float, words: str) -> None:
    assert repaired.repair is not None
    told = replace(repaired, repair=of_error(repaired.repair, left, after))
    assert words in repair_sentence(told)
    assert words in repair_text(told)[1]


def test_a_loop_that_only_stiction_holds_is_unstable_once_repaired(repaired: Study) -> None:
    first, best = repaired.cases[0], repaired.cases[2]
    fast = [replace(case, standing=standing(case.loop.with_controller(wb.PID(5.0, 5.0)))) for case in (first, best)]
    told = replace(repaired, cases=tuple(fast))
    four, cases = repair_tables(told)
    assert {row.cells[1].text for row in four.rows[3:]} == {"unstable"}
    assert "unstable" not in {row.cells[0].text for row in four.rows}
    assert [cell.text for cell in cases.rows[0].cells] == ["unstable"] * 3
    assert cases.rows[0].cells[2].small == "12.18 sticky"
    text = repair_sentence(told)
    assert text.startswith("What repair is worth: with an ideal valve Case 1 is unstable. ")
    assert "the sticky valve (a loop that only stiction holds)" in text


def test_an_unfinished_search_is_said(repaired: Study) -> None:
    assert repaired.repair is not None
    assert len(repair_text(repaired)) == 2
    unfinished = replace(repaired.repair.tuned_repaired, status=wb.SolveStatus.TIME_LIMIT)
    told = repair_text(replace(repaired, repair=replace(repaired.repair, tuned_repaired=unfinished)))
    assert "The search with the repaired valve ended as “time limit”" in told[2]


@pytest.mark.parametrize(
    ("rule", "words"),
    [
        (wb.Simc(2.0), "SIMC with a closed-loop time constant of 2 s (S. Skogestad"),
        (wb.Lambda(3.0), "lambda = 3 time constants"),
        (wb.Amigo("PID"), "AMIGO, PID ("),
        (wb.ZieglerNichols("ultimate"), "ultimate gain, PI ("),
        (wb.DetunedIntegral(10.0), "10 times as long"),
        (wb.NoCrossing(), "Ti 2 times time constant plus dead time"),
    ],
)
def test_rules_in_words(rule: Rule, words: str) -> None:
    assert words in rule_words(rule)
    assert rule_words(rule).endswith(f"({rule.source})")
