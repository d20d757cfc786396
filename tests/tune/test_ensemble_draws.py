"""An ensemble's draws: within their ranges, reproducible, and figures that are those of ordinary simulations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from loops import paper_loop

import workbench as wb
from workbench.errors import InvalidValue
from workbench.tune import ensemble as ensemble_module
from workbench.tune.ensemble import Circumstances, corner_loops, draws, statistic

LOOP = paper_loop(0.5, 20.0, derivative_on="pv", derivative_filter=10.0)
READY = wb.Ensemble.plant_ready(LOOP)


@pytest.fixture(scope="module")
def many():
    return draws(LOOP, replace(READY, draws=400))


def test_draws_fill_their_ranges(many):
    def spans(values, low, high):
        values = np.array(values)
        assert low <= values.min() < low + 0.03 * (high - low)
        assert high - 0.03 * (high - low) < values.max() <= high
        assert values.mean() == pytest.approx((low + high) / 2.0, abs=0.06 * (high - low))

    steps = np.array([d.experiment.setpoint.size for d in many])
    loads = np.array([d.experiment.load.size for d in many])
    spans(np.abs(steps), 1.0, 8.0)
    spans(np.abs(loads), 0.5, 2.0)
    assert 0.4 < (steps > 0).mean() < 0.6
    assert 0.4 < (loads > 0).mean() < 0.6
    assert 0.4 < (steps * loads > 0).mean() < 0.6
    times = [d.experiment.load.at for d in many]
    spans(times, 200.0, 500.0)
    assert all(t == round(t) for t in times)
    spans([d.experiment.noise.sd for d in many], 0.02, 0.1)
    assert len({d.experiment.noise.seed for d in many}) == len(many)
    spans([d.loop.plant.gain for d in many], 0.8, 1.2)
    spans([d.loop.plant.time_constant for d in many], 4.0, 6.0)
    spans([d.loop.plant.dead_time for d in many], 0.8, 1.2)
    spans([d.loop.valve.d for d in many], 1.4, 2.6)
    spans([d.experiment.stem_offset / d.loop.valve.d for d in many], -1.0, 1.0)


def test_fewer_draws_are_the_first_and_seeds_differ(many):
    assert draws(LOOP, replace(READY, draws=7)) == many[:7]
    assert set(draws(LOOP, replace(READY, draws=7, seed=1))).isdisjoint(many)


@pytest.mark.parametrize(
    "valve",
    [
        wb.Stenman(2.0),
        wb.Choudhury(S=3.0, J=1.0),
        wb.Deadband(1.0),
        wb.Ideal(),
        wb.He(2.0, 1.0),
        wb.Kano(3.0, 1.0),
        wb.Directional(wb.Choudhury(3.0, 1.0), wb.Deadband(2.0)),
    ],
)
@pytest.mark.parametrize("plant", [wb.FOPDT(1.0, 5.0, 1.0), wb.Integrating(0.05, 2.0)])
def test_figures_are_those_of_ordinary_runs(valve, plant):
    loop = replace(LOOP, valve=valve, plant=plant)
    ensemble = replace(wb.Ensemble.plant_ready(loop), draws=6, duration=300.0, load_time=(60.0, 150.0))
    objective = wb.Objective(w1=0.3, w2=0.01, w3=0.7, w4=0.1)
    found = wb.assess(loop, ensemble, objective)
    members = draws(loop, ensemble)
    runs = [wb.simulate(d.loop, d.experiment) for d in members]
    costs = [float(wb.evaluate(d.loop, d.experiment, objective)[0]) for d in members]
    assert found.mean_square_error == pytest.approx([r.kpis.mean_square_error for r in runs], rel=1e-12)
    assert found.valve_travel == pytest.approx([r.kpis.valve_travel for r in runs], rel=1e-12)
    assert found.objective == pytest.approx(np.mean(costs), rel=1e-12)
    assert found.stable
    assert found.diverged == 0
    corners = [wb.margins(c) for c in corner_loops(loop, ensemble)]
    assert len(corners) == (13 if isinstance(plant, wb.FOPDT) else 7)
    assert found.max_sensitivity == pytest.approx(max(m.max_sensitivity for m in corners), rel=1e-6)
    assert found.gain_margin == pytest.approx(min(m.gain_margin for m in corners), rel=2e-3)
    assert found.phase_margin == pytest.approx(min(m.phase_margin for m in corners), abs=0.2)


@pytest.mark.parametrize("count", [2, 21])
def test_many_tunings_meet_the_same_draws(count):
    given = Circumstances(LOOP, replace(READY, draws=5))
    tunings = np.linspace([0.5, 20.0, 0.0], [2.5, 5.0, 0.4], count)
    together = given.terms(tunings)
    assert together.shape == (count, 5, 6)
    for k in range(count):
        np.testing.assert_array_equal(given.terms(tunings[k : k + 1])[0], together[k])


def test_draws_kept_from_one_controller_are_those_of_another():
    limited = wb.PID(
        0.8, 15.0, 0.3, form="series", output_limits=(-3.0, 8.0), compensator=wb.ConstantReinforcement(0.4)
    )
    loop, ensemble = LOOP.with_controller(limited), replace(READY, draws=6)
    before = wb.assess(LOOP, ensemble)
    found = wb.assess(loop, ensemble)
    runs = [wb.simulate(draw.loop, draw.experiment).kpis for draw in draws(loop, ensemble)]
    assert found.valve_travel == pytest.approx([kpis.valve_travel for kpis in runs], rel=1e-12)
    np.testing.assert_array_equal(wb.assess(LOOP, ensemble).valve_travel, before.valve_travel)
    # A stem rests where OP may stand, whatever has been drawn for others.
    narrow = LOOP.with_controller(replace(LOOP.controller, output_limits=(-0.1, 0.1)))
    runs = [wb.simulate(draw.loop, draw.experiment).kpis for draw in draws(narrow, ensemble)]
    assert wb.assess(narrow, ensemble).valve_travel == pytest.approx([kpis.valve_travel for kpis in runs], rel=1e-12)


def test_an_ensemble_too_large_to_be_kept_is_drawn_again(monkeypatch):
    small = wb.assess(LOOP, replace(READY, draws=7))
    monkeypatch.setattr(ensemble_module, "KEPT_SAMPLES", 0)
    again = wb.assess(LOOP, replace(READY, draws=7))
    np.testing.assert_array_equal(small.mean_square_error, again.mean_square_error)


@pytest.mark.parametrize("limits", [(-1.0, 50.0), (-50.0, 0.5)])
def test_a_stem_rests_where_op_may_stand(limits):
    loop = replace(paper_loop(0.2, 20.0), controller=wb.PID(0.2, 20.0, output_limits=limits))
    offsets = [one.experiment.stem_offset for one in draws(loop, READY)]
    assert min(offsets) >= limits[0]
    assert max(offsets) <= limits[1]
    assert {min(offsets), max(offsets)} & set(limits)
    assert np.isfinite(wb.assess(loop, READY).mse_median)


def test_a_valve_that_may_not_be_is_no_draw_and_that_is_said():
    steep = wb.Positional((0.0, 10.0), (wb.Stenman(1.0), wb.Stenman(10.0)))
    with pytest.raises(
        InvalidValue, match=r"^Ensemble\.stiction: 0\.3 given; must leave .* of 1\.\d\d times the loop's"
    ):
        wb.assess(replace(LOOP, valve=steep), READY)
    assert np.isfinite(wb.assess(replace(LOOP, valve=steep), replace(READY, stiction=0.05)).mse_median)


def test_an_unstable_loop_is_counted_not_hidden():
    found = wb.assess(paper_loop(8.0, 5.0), replace(READY, draws=10))
    assert not found.stable
    assert found.diverged == 10
    assert found.max_sensitivity == np.inf


def test_the_worst_dead_time_may_be_a_whole_number_of_samples():
    loop = LOOP.with_controller(wb.PID(2.639, 8.962, 0.7033, derivative_on="pv"))
    # Stable at both ends of the dead time's range and unstable between them.
    held = [wb.margins(replace(loop, plant=wb.FOPDT(1.2, 4.0, theta))).stable for theta in (0.8, 1.0, 1.2)]
    assert held == [True, False, True]
    assert not wb.assess(loop, replace(READY, draws=1)).stable
    long = replace(LOOP, plant=wb.FOPDT(1.0, 20.0, 7.4))
    delays = {c.plant.dead_time for c in corner_loops(long, READY)}
    assert delays == {7.4 * 0.8, 6.0, 7.4, 8.0, 7.4 * 1.2}


def test_statistics():
    costs = np.array([[1.0, 2.0, 3.0, 10.0], [1.0, 2.0, np.inf, 10.0]])
    ensemble = replace(READY, draws=4)
    assert statistic(costs, ensemble).tolist() == [4.0, np.inf]
    assert statistic(costs, replace(ensemble, statistic="percentile", level=0.5)).tolist() == [2.5, np.inf]
    assert statistic(costs, replace(ensemble, statistic="cvar", level=0.5)).tolist() == [6.5, np.inf]
    assert statistic(costs, replace(ensemble, statistic="cvar", level=0.99)).tolist() == [10.0, np.inf]


# Median and 90th percentile of the mean square error and median travel of 2,000 draws, found by an independent
# simulator; with the share that two samples of this size may differ by.
PUBLISHED = {
    (0.5, 20.0, 0.0): (0.87, 1.54, 26.0),
    (0.5, 20.0, 6.0): (0.80, 1.44, 46.0),
    (2.01, 301.0, 0.0): (0.73, 1.74, 190.0),
    (2.5, 5.0, 0.0): (0.180, 0.279, 378.0),
    (0.83, 5.0, 0.0): (0.41, 0.64, 133.0),
    (2.64, 9.9, 0.70): (0.127, 0.207, 491.0),
}


@pytest.mark.parametrize("tuning", PUBLISHED)
def test_the_paper_loops_ensemble_gives_the_known_figures(tuning):
    Kc, Ti, Td = tuning
    loop = LOOP.with_controller(replace(LOOP.controller, Kc=Kc, Ti=Ti, Td=Td))
    found = wb.assess(loop, replace(READY, draws=2000, seed=7))
    assert (found.mse_median, found.mse_p90, found.travel_median) == pytest.approx(PUBLISHED[tuning], rel=0.06)


def test_what_is_no_ensemble_or_objective_is_said() -> None:
    with pytest.raises(InvalidValue, match=r"ensemble: .*must be an Ensemble or None"):
        wb.assess(LOOP, wb.Experiment(100.0))
    with pytest.raises(InvalidValue, match=r"objective: .*must be an Objective or None"):
        wb.assess(LOOP, None, wb.Bounds())
