"""The report on an ensemble: table, front, figure, advice, and what repair is worth over it."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from matplotlib.text import Annotation

import workbench as wb
from workbench.model.front import Front, FrontPoint, RobustRepair
from workbench.model.results import SolveStatus
from workbench.model.study import CaseResult, Study
from workbench.report.confidence import Judged, searches
from workbench.report.how import how_tables
from workbench.report.over_ensemble import (
    ensemble_tables,
    ensemble_text,
    front_table,
    front_text,
    named_points,
    robust_advice,
    robust_choice,
)
from workbench.report.page import write_report
from workbench.report.repair import robust_repair_table, robust_repair_text
from workbench.report.style import svg_text
from workbench.report.summary import summarise
from workbench.report.trade import FONT, LETTER, NamedPoint, trade_figure
from workbench.report.words import duration, figure


def made(study: Study) -> Study:
    """The made study with its last tuning robust: all cases over a small ensemble, a front, the value of repair."""
    loop = study.cases[0].loop
    ensemble = replace(wb.Ensemble.plant_ready(loop), duration=200.0, load_time=(50.0, 100.0), draws=20, seed=1)
    searched = replace(ensemble, seed=0)
    cases = [_measured(case, ensemble) for case in study.cases]
    best = cases[2]
    assert best.tuned is not None
    tuned = replace(
        best.tuned,
        ensemble=searched,
        constraints=wb.Constraints(max_sensitivity=9.0),
        robustness=best.robustness,
        start_robustness=cases[0].robustness,
    )
    cases[2] = replace(best, tuned=tuned)
    first, last = cases[0].robustness, best.robustness
    assert first is not None
    assert last is not None
    sticky = tuple(
        FrontPoint(replace(loop.controller, Kc=Kc, Ti=12.0), travel, error)
        for Kc, travel, error in (
            (0.3, 0.8 * first.travel_mean, 0.9 * first.mse_mean),
            (0.6, 0.95 * first.travel_mean, 0.5 * first.mse_mean),
            (2.0, 1.01 * last.travel_mean, 0.99 * last.mse_mean),
        )
    )
    repaired = tuple(FrontPoint(p.controller, 0.5 * p.valve_travel, 0.3 * p.mean_square_error) for p in sticky)
    front = Front(
        loop=loop,
        ensemble=searched,
        fresh=ensemble,
        constraints=wb.Constraints(max_sensitivity=9.0),
        bounds=wb.Bounds(Td=(0, 0)),
        digits=4,
        sticky=sticky,
        repaired=repaired,
        status=SolveStatus.SOLVED,
        message="made for a test",
        seed=0,
        evaluations=1,
        wall_time=1.0,
    )
    ideal = cases[2].robustness_repaired
    assert ideal is not None
    assert cases[0].robustness_repaired is not None
    repair = RobustRepair(first, cases[0].robustness_repaired, last, ideal, tuned, tuned)
    return replace(study, cases=tuple(cases), front=front, robust_repair=repair)


def _measured(case: CaseResult, ensemble: wb.Ensemble) -> CaseResult:
    ideal = replace(case.loop, valve=wb.Ideal())
    return replace(case, robustness=wb.assess(case.loop, ensemble), robustness_repaired=wb.assess(ideal, ensemble))


@pytest.fixture(scope="module")
def robust(study: Study) -> Study:
    return made(study)


def over(case: CaseResult) -> Any:
    assert case.robustness is not None
    return case.robustness


def test_a_cap_on_travel_that_the_fresh_draws_exceed_is_said_where_it_stands(robust: Study) -> None:
    best = robust.cases[2]
    assert best.tuned is not None
    mean = over(best).travel_mean

    def asked(cap: float, status: SolveStatus = SolveStatus.SOLVED) -> str:
        assert best.tuned is not None
        tuned = replace(best.tuned, status=status, constraints=wb.Constraints(max_sensitivity=9.0, valve_travel=cap))
        return ensemble_text(replace(robust, cases=(replace(best, tuned=tuned),)))[-1]

    assert asked(0.7 * mean).endswith(
        f"mean valve travel at most {figure(0.7 * mean, 3)} %. That holds for the 20 draws of its search alone: over "
        f"the draws shown here the mean is {figure(mean, 3)} %."
    )
    failed = asked(0.7 * mean, SolveStatus.INFEASIBLE)
    assert failed.endswith(f"%. Over the draws shown here the mean is {figure(mean, 3)} %.")
    assert "draws shown" not in asked(mean), "a cap that is kept needs no word"


def test_the_ensemble_and_what_was_asked_in_words(robust: Study) -> None:
    what, asked = ensemble_text(robust)
    assert "20 draws, the same for every tuning" in what
    assert "a setpoint step of 1 to 8 EU, up or down, at 0 s" in what
    assert "gain, time constant and dead time off by up to 20 % and stiction off by up to 30 %" in what
    assert "Optimised PI: the least mean of J over 20 draws, with every corner" in asked
    assert "Ms at most 9" in asked
    assert ensemble_text(replace(robust, cases=())) == []


def test_the_table_marks_the_least_error_that_keeps_the_constraints(robust: Study) -> None:
    (table,) = ensemble_tables(robust)
    assert [row.label for row in table.rows] == ["Case 1", "Case 2", "Optimised PI"]
    assert [row.cells[2].best for row in table.rows] == [False, False, True]
    assert table.rows[0].cells[2].text == f"{over(robust.cases[0]).mse_mean:.2f}"
    assert table.rows[0].cells[7].text == "none"
    assert len(table.heads) == len(table.rows[0].cells) == 10
    assert robust.front is not None
    tight = replace(robust, front=replace(robust.front, constraints=wb.Constraints(max_sensitivity=1.5)))
    (table,) = ensemble_tables(tight)
    assert [row.cells[2].best for row in table.rows] == [True, False, False]
    lost = replace(robust.cases[0], robustness=replace(over(robust.cases[0]), diverged=3, stable=False))
    (table,) = ensemble_tables(replace(robust, cases=(lost, *robust.cases[1:])))
    assert table.rows[0].cells[6].text == "unstable"
    assert table.rows[0].cells[7].text == "3 of 20"


def test_the_front_in_words(robust: Study) -> None:
    text = " ".join(front_text(robust))
    first = over(robust.cases[0])
    assert robust.front is not None
    ratio = first.mse_mean / robust.front.sticky[1].mean_square_error
    assert (
        f"Case 1 has {ratio:.1f} times the error of the tuning with equal travel: Kc 0.6000 %/EU, Ti 12.00 s." in text
    )
    assert "Case 2 moves the valve less than any tuning on the front." in text
    assert "Optimised PI has" not in text
    stopped = replace(robust.front, status=SolveStatus.TIME_LIMIT)
    assert "ended as “time limit”" in front_text(replace(robust, front=stopped))[0]
    empty = replace(robust.front, sticky=(), status=SolveStatus.INFEASIBLE)
    assert len(front_text(replace(robust, front=empty))) == 1
    table = front_table(robust.front)
    assert len(table.rows) == 3
    assert table.rows[0].cells[1].text == "Kc 0.3000 %/EU, Ti 12.00 s"


def test_a_repaired_valve_that_follows_noise_is_explained(robust: Study) -> None:
    assert robust.front is not None
    assert not any("noise" in text for text in front_text(robust))
    far = tuple(replace(p, valve_travel=9.0 * p.valve_travel) for p in robust.front.sticky)
    noisy = replace(robust, front=replace(robust.front, repaired=far))
    assert any("it follows the measurement noise" in text for text in front_text(noisy))


def test_a_search_whose_first_stage_kept_no_constraint_says_so(robust: Study) -> None:
    tuned = robust.cases[2].tuned
    assert tuned is not None
    none = replace(tuned, restarts=tuple(replace(r, refined=math.inf) for r in tuned.restarts))
    table = how_tables(replace(robust, cases=(replace(robust.cases[2], tuned=none),)))[0]
    rows = {row.label: row.cells[0].text for row in table.rows}
    assert rows["J over the restarts"] == "none kept the constraints, only the search from all of them"
    lost = replace(none, status=SolveStatus.INFEASIBLE)
    rows = {
        row.label: row.cells[0].text
        for row in how_tables(replace(robust, cases=(replace(robust.cases[2], tuned=lost),)))[0].rows
    }
    assert rows["J over the restarts"] == "none kept the constraints"
    # What was found on all draws is the best J, which none of the searches before came to.
    cells = how_tables(robust)[1].rows[0].cells
    assert [cells[1].small, cells[2].small] == ["on the first draws", "on all draws"]
    better = replace(tuned, nominal=0.9 * tuned.objective)
    assert better.agreeing == 0
    judged = Judged()
    searches(better, judged)
    assert "0 of 3 independent searches end within 0.1 % of the best J, the worst 11 % above it" in judged.reasons[0]


def test_what_one_experiment_likes_is_not_recommended(robust: Study) -> None:
    out = robust_advice(robust)
    price = " if 11 times the valve travel of Case 1 is acceptable"
    assert out[0].startswith(f"Set Kc 2.351 %/EU, Ti 9.500 s (Optimised PI){price}. Over 20 plants")
    assert "Against Case 1: error −" in out[0]
    assert summarise(robust).advice[1 : 1 + len(out)] == tuple(out) or summarise(robust).advice[: len(out)] == tuple(
        out
    )
    nominal = replace(robust.cases[2], name="Nominal", tuned=replace(robust.cases[2].tuned, ensemble=None))  # type: ignore[type-var]
    worse = replace(nominal, robustness=replace(over(nominal), diverged=2, stable=False))
    both = [robust_advice(replace(robust, cases=(*robust.cases, one))) for one in (nominal, worse)]
    assert any("Nominal is the best found for the one experiment; over the ensemble" in text for text in both[0])
    assert "Do not use Nominal: best in the one experiment, it does not hold every plant of the ensemble." in both[1]
    sharp = replace(nominal, robustness=replace(over(nominal), max_sensitivity=17.1))
    told = robust_advice(replace(robust, cases=(*robust.cases, sharp)))
    assert any("its Ms reaches 17.1 at the worst corner, above 9: not for a plant that may differ" in t for t in told)
    risky = replace(robust.cases[0], name="Risky", robustness=replace(over(robust.cases[2]), max_sensitivity=12.0))
    risky = replace(risky, robustness=replace(over(risky), mean_square_error=0.5 * over(risky).mean_square_error))
    told = robust_advice(replace(robust, cases=(*robust.cases, risky)))
    assert any(
        "Risky has less error" in text and "its Ms reaches 12.0 at the worst corner, above 9" in text for text in told
    )
    assert robust_advice(replace(robust, cases=robust.cases[:2])) == []


def test_in_place_of_what_the_sites_form_cannot_take_stands_what_is_nearest(robust: Study) -> None:
    best = robust.cases[2]
    near = replace(best, name="Near", tuned=None, nearest_to=best.name)
    told = replace(robust, cases=(*robust.cases, near))
    assert robust_choice(told) is near
    price = " if 11 times the valve travel of Case 1 is acceptable"
    assert robust_advice(told)[0].startswith(f"Set Kc 2.351 %/EU, Ti 9.5 s (Near){price}. Over 20 plants")
    assert "Against Case 1" in robust_advice(told)[0], "the nearest is no case as found"


def test_a_calmer_robust_tuning_is_offered_beside(robust: Study) -> None:
    best = robust.cases[2]
    calm = replace(over(best), valve_travel=0.4 * over(best).valve_travel)
    assert best.tuned is not None
    capped = replace(best.tuned, constraints=wb.Constraints(max_sensitivity=9.0, valve_travel=50.0))
    other = replace(best, name="Calm", tuned=capped, robustness=calm)
    text = " ".join(robust_advice(replace(robust, cases=(*robust.cases, other))))
    assert "Where wear counts more: Kc 2.351 %/EU, Ti 9.500 s (Calm)" in text
    # Beside the decision itself where that costs the valve several times its travel as found.
    first = robust.cases[0]
    for ratio, beside in ((3.0, True), (1.5, False)):
        found = replace(over(first), valve_travel=over(best).valve_travel / ratio)
        told = replace(robust, cases=(replace(first, robustness=found), best, other))
        assert ("Where wear counts more: " in robust_advice(told)[0]) is beside
        price = "(Optimised PI) if 3.0 times the valve travel of Case 1 is acceptable. Over 20 plants"
        assert (price in robust_advice(told)[0]) is beside
        alone = robust_advice(replace(told, cases=told.cases[:2]))[0]
        assert alone.endswith(" Otherwise keep Case 1.") is beside
        lost = replace(told.cases[0], robustness=replace(found, diverged=1))
        assert "acceptable" not in robust_advice(replace(told, cases=(lost, best)))[0]
        assert " ".join(robust_advice(told)).count("Where wear counts more: ") == 1
        assert f"plants and circumstances of {duration(over(best).ensemble.duration)} each" in robust_advice(told)[0]
    asked = ensemble_text(replace(robust, cases=(*robust.cases, other)))[-1]
    assert "mean valve travel at most 50.0 %" in asked


def test_repair_over_the_ensemble(robust: Study) -> None:
    assert robust.robust_repair is not None
    text = robust_repair_text(robust)
    share = 100.0 * robust.robust_repair.share
    assert f"{share:.0f} % of the error goes only with the repair" in text[1]
    # Under a cap on travel a repaired valve may do worse, since it answers the noise: that is said, not 0 %.
    repair = robust.robust_repair
    capped = replace(repair.tuned, constraints=wb.Constraints(valve_travel=50.0))
    worse = replace(repair.best_repaired, mean_square_error=2.0 * repair.best.mean_square_error)
    told = robust_repair_text(replace(robust, robust_repair=replace(repair, tuned=capped, best_repaired=worse)))[1]
    assert "EU²: within the constraints a repair lessens no error. Among them is a mean valve travel" in told
    assert "of at most 50.0 %: a repaired valve follows the noise" in told
    table = robust_repair_table(robust)
    assert table is not None
    assert len(table.heads) == 4
    assert robust_repair_table(replace(robust, robust_repair=None)) is None
    assert robust_repair_text(replace(robust, robust_repair=None)) == []


@pytest.mark.usefixtures("undrawn")
def test_the_page_holds_it_all(robust: Study, tmp_path: Path) -> None:
    write_report(robust, tmp_path)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "Over an ensemble of plants and circumstances" in page
    assert "Error against wear" in page
    assert (tmp_path / "tradeoff.svg").exists()


def test_the_trade_off_is_drawn_the_same_to_the_byte(robust: Study) -> None:
    assert robust.front is not None
    first, again = (svg_text(trade_figure(robust.front, named_points(robust)), "tradeoff", "Title") for _ in range(2))
    assert first == again


def test_a_page_without_an_ensemble_says_nothing_of_it(written: Path) -> None:
    assert "Over an ensemble" not in (written / "report.html").read_text(encoding="utf-8")
    assert not (written / "tradeoff.svg").exists()


def test_a_front_can_be_plotted(robust: Study) -> None:
    ax = wb.plot(robust.front)
    assert ax.get_xscale() == ax.get_yscale() == "log"  # type: ignore[union-attr]
    assert len(ax.lines) == 2  # type: ignore[union-attr]


def boxes(ax: Any) -> list[tuple[float, float, float, float]]:
    """The boxes of all labels on axes, in points, from the letters' mean width."""
    scale, out = 72.0 / ax.figure.dpi, []
    for text in ax.texts:
        assert isinstance(text, Annotation)
        x, y = ax.transData.transform(text.xy) * scale + np.array(text.xyann)
        out.append((x, y, x + LETTER * FONT * len(text.get_text()), y + 1.25 * FONT))
    return out


names = st.text(st.characters(whitelist_categories=("Lu", "Ll", "Nd")), min_size=1, max_size=20)
near = st.builds(NamedPoint, names, st.floats(20.0, 300.0), st.floats(0.1, 3.0), st.booleans())


CROWDED = [NamedPoint("0", x, y) for x, y in ((70.0, 2.0), (75.0, 2.0), (79.0, 2.5), (84.0, 2.5), (90.0, 2.25))]


@given(st.lists(near, max_size=12))
@example([*CROWDED, NamedPoint(14 * "0", 161.0, 2.5)])
@settings(max_examples=15, deadline=None)
def test_labels_never_overlap_and_stay_inside(robust: Study, points: list[NamedPoint]) -> None:
    assert robust.front is not None
    ax = trade_figure(robust.front, points).axes[0]
    placed = boxes(ax)
    assert len(placed) == len(points)
    for a, b in combinations(placed, 2):
        assert a[2] <= b[0] or b[2] <= a[0] or a[3] <= b[1] or b[3] <= a[1]
    frame = ax.get_window_extent()
    scale = 72.0 / ax.figure.dpi  # type: ignore[union-attr]
    for x0, y0, x1, y1 in placed:
        assert frame.x0 * scale <= x0 <= x1 <= frame.x1 * scale
        assert frame.y0 * scale <= y0 <= y1 <= frame.y1 * scale


# Letters in a name, valve travel, error: where a long name fits beside the front only over another case.
BESIDE_A_FRONT = [
    [(20, 96.6, 0.43), (5, 180.9, 0.208), (9, 29.1, 1.112), (12, 24.9, 1.337), (9, 69.2, 0.567), (4, 46.3, 1.445),
     (22, 20.2, 1.816), (4, 81.1, 0.505), (4, 54.9, 0.71), (13, 218.6, 0.43)],
    [(20, 291.6, 0.158), (4, 90.5, 0.403), (7, 66.0, 0.542), (4, 137.6, 0.43), (20, 237.6, 0.181), (15, 21.3, 1.413),
     (5, 22.1, 1.736), (7, 282.1, 0.226), (20, 87.7, 0.385)],
]  # fmt: skip


@pytest.mark.parametrize("cases", BESIDE_A_FRONT)
def test_a_label_covers_no_other_case(robust: Study, cases: list[tuple[int, float, float]]) -> None:
    assert robust.front is not None
    pid = robust.front.sticky[0].controller
    travels = np.geomspace(10.0, 300.0, 60).tolist()
    sticky = tuple(FrontPoint(pid, x, 2.0 * (10.0 / x) ** 0.8) for x in travels)
    repaired = tuple(FrontPoint(pid, 0.6 * x, (10.0 / x) ** 0.9) for x in travels)
    points = [NamedPoint("n" * letters, x, y) for letters, x, y in cases]
    ax = trade_figure(replace(robust.front, sticky=sticky, repaired=repaired), points).axes[0]
    at = ax.transData.transform([(x, y) for _, x, y in cases]) * 72.0 / ax.figure.dpi  # type: ignore[union-attr]
    for x0, y0, x1, y1 in boxes(ax):
        assert not any(x0 - 3.0 < x < x1 + 3.0 and y0 - 3.0 < y < y1 + 3.0 for x, y in at)


def test_a_label_beside_another_point_has_a_line_to_its_own(robust: Study) -> None:
    assert robust.front is not None
    points = [NamedPoint("Lambda", 134.0, 0.43), NamedPoint("Robust PI, travel of Case 5", 140.0, 0.385, tuned=True)]
    points += [NamedPoint("Robust PI", 232.0, 0.264, tuned=True), NamedPoint("Robust PID", 238.0, 0.255, tuned=True)]
    pid = robust.front.sticky[0].controller
    line = tuple(FrontPoint(pid, x, 0.385 * (140.0 / x) ** 0.7) for x in np.geomspace(4.0, 240.0, 50).tolist())
    ax = trade_figure(replace(robust.front, sticky=line, repaired=()), points).axes[0]
    scale = 72.0 / ax.figure.dpi  # type: ignore[union-attr]
    at = [ax.transData.transform((p.valve_travel, p.mean_square_error)) * scale for p in points]
    for text, (x0, y0, x1, y1) in zip(ax.texts, boxes(ax), strict=True):
        assert isinstance(text, Annotation)
        away = [math.hypot(max(x0 - x, x - x1, 0.0), max(y0 - y, y - y1, 0.0)) for x, y in at]
        own = [p.name for p in points].index(text.get_text())
        assert text.arrow_patch is not None or min(away[:own] + away[own + 1 :]) >= 2.0 * away[own]


def test_what_log_axes_do_not_hold_is_left_out(robust: Study) -> None:
    assert robust.front is not None
    points = [NamedPoint("gone", math.inf, 1.0), NamedPoint("idle", 0.0, 1.0), NamedPoint("there", 30.0, 1.0)]
    ax = trade_figure(robust.front, points).axes[0]
    assert [text.get_text() for text in ax.texts] == ["there"]
    assert len(named_points(robust)) == 3
