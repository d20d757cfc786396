"""What repair is worth: exact figures with an ideal valve, the best tuning of each, and the share left by tuning."""

from __future__ import annotations

import math
from dataclasses import asdict, replace

import pytest
from loops import paper_loop

import workbench as wb
from workbench.model.results import Kpis, Repair

EXPERIMENT = wb.Experiment(200.0, wb.Step(4.0), wb.Step(1.3, 100.0), wb.Noise(0.05, 1))
BOUNDS = wb.Bounds(Td=(0.0, 0.0))


@pytest.fixture(scope="module")
def repair() -> Repair:
    return wb.value_of_repair(paper_loop(0.5, 20.0), EXPERIMENT, bounds=BOUNDS, restarts=1, digits=2)


def assert_same(ours: Kpis, theirs: Kpis) -> None:
    assert asdict(ours) == pytest.approx(asdict(theirs), rel=0.0, abs=0.0, nan_ok=True)


def test_the_four_outcomes_are_exact_simulations(repair: Repair) -> None:
    weights = wb.Objective()
    for outcome, valve in (
        (repair.present, wb.Stenman(2.0)),
        (repair.repaired, wb.Ideal()),
        (repair.best, wb.Stenman(2.0)),
        (repair.best_repaired, wb.Ideal()),
    ):
        loop = replace(repair.loop, valve=valve, controller=outcome.controller)
        assert outcome.objective == wb.evaluate(loop, EXPERIMENT, weights)[0]
        assert_same(outcome.kpis, wb.simulate(loop, EXPERIMENT).kpis)
    assert repair.present.controller == repair.repaired.controller == repair.loop.controller
    assert repair.best.objective == pytest.approx(repair.tuned.objective, rel=1e-12)
    assert repair.best_repaired.objective == pytest.approx(repair.tuned_repaired.objective, rel=1e-12)


def test_best_is_best_and_the_share_says_what_is_left(repair: Repair) -> None:
    assert repair.best.objective < repair.present.objective
    assert repair.best_repaired.objective < repair.repaired.objective
    assert repair.best_repaired.objective < repair.best.objective
    expected = 1.0 - repair.best_repaired.kpis.mean_square_error / repair.best.kpis.mean_square_error
    assert 0.0 < repair.share("mean_square_error") < 1.0
    assert repair.share("mean_square_error") == pytest.approx(expected)
    with pytest.raises(wb.InvalidValue, match=r"figure: foo given; must be one of objective, error_variance"):
        repair.share("foo")
    assert repair.share("objective") == pytest.approx(1.0 - repair.best_repaired.objective / repair.best.objective)
    nothing = replace(repair, best=replace(repair.best, objective=0.0))
    assert math.isnan(nothing.share("objective"))


def test_a_search_that_has_been_made_is_used_again(repair: Repair) -> None:
    told: list[float] = []
    again = wb.value_of_repair(
        paper_loop(0.5, 20.0), EXPERIMENT, tuned=repair.tuned, progress=lambda _, share: told.append(share)
    )
    assert again.tuned is repair.tuned
    assert again.best_repaired.controller == repair.best_repaired.controller
    assert again.tuned_repaired.bounds == BOUNDS
    assert told == sorted(told)
    assert told[-1] == 1.0


def test_the_stem_offset_goes_with_the_stiction() -> None:
    experiment = replace(EXPERIMENT, stem_offset=1.0, noise=None)
    loop = paper_loop(0.5, 20.0)
    found = wb.value_of_repair(loop, experiment, bounds=wb.Bounds((0.5, 0.5), (20.0, 20.0), (0.0, 0.0)))
    ideal = replace(loop, valve=wb.Ideal())
    assert_same(found.best_repaired.kpis, wb.simulate(ideal, replace(experiment, stem_offset=0.0)).kpis)
    assert_same(found.present.kpis, wb.simulate(loop, experiment).kpis)


def test_bounds_left_out_hold_the_present_tuning() -> None:
    loop = paper_loop(12.0, 700.0)
    found = wb.value_of_repair(loop, wb.Experiment(60.0, wb.Step(4.0)), restarts=1, digits=2)
    assert found.tuned.bounds == wb.Bounds((0.0, 12.0), (5.0, 700.0), (0.0, 0.0))


def test_a_loop_without_integral_action_is_compared_with_the_best_of_bounds_that_have_some() -> None:
    loop, experiment = paper_loop(2.0, math.inf), wb.Experiment(60.0, wb.Step(4.0))
    found = wb.value_of_repair(loop, experiment, restarts=1, digits=2)
    assert found.tuned.bounds == wb.Bounds(Td=(0.0, 0.0))
    assert math.isinf(found.present.controller.Ti)
    assert math.isinf(found.repaired.controller.Ti)
    assert_same(found.present.kpis, wb.simulate(loop, experiment).kpis)
    assert found.best.objective < found.present.objective


def test_what_cannot_be_compared_is_refused(repair: Repair) -> None:
    loop = paper_loop(0.5, 20.0)
    with pytest.raises(wb.InvalidValue, match="nothing to repair"):
        wb.value_of_repair(replace(loop, valve=wb.Ideal()), EXPERIMENT)
    with pytest.raises(wb.InvalidValue, match="another loop"):
        wb.value_of_repair(replace(loop, valve=wb.Stenman(1.0)), EXPERIMENT, tuned=repair.tuned)
    with pytest.raises(wb.InvalidValue, match="another experiment"):
        wb.value_of_repair(loop, replace(EXPERIMENT, noise=None), tuned=repair.tuned)


def test_what_is_no_tuning_is_said() -> None:
    with pytest.raises(wb.InvalidValue, match=r"tuned: .*must be what `tune` returns, or None"):
        wb.value_of_repair(paper_loop(0.5, 20.0), EXPERIMENT, tuned=EXPERIMENT)  # type: ignore[arg-type]
