"""Objectives: eq. (2), weighted figures of the run, and their sums by another way."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import workbench as wb
from workbench.model.tuning import WEIGHABLE
from workbench.simulate import sums as kernel
from workbench.simulate.batch import kernel_weights, sums, weigh, worst
from workbench.simulate.coefficients import coefficients
from workbench.simulate.signals import signals

PID = wb.PID(1.5, 12.0, 0.7, derivative_on="pv")
LOOP = wb.Loop(wb.FOPDT(1.3, 6.0, 2.3), wb.Choudhury(3.0, 1.0), PID, 0.5)
TASK = wb.Experiment(150.0, wb.Step(4.0, 3.0), wb.Step(1.0, 80.0), wb.Noise(0.05, 3))


@pytest.mark.parametrize("name", WEIGHABLE)
@pytest.mark.parametrize("valve", [wb.Stenman(1.0), wb.Choudhury(3.0, 1.0), wb.Ideal()])
def test_each_figure_weighs_as_the_run_reports_it(name, valve):
    loop = wb.Loop(LOOP.plant, valve, PID, 0.5)
    figure = getattr(wb.simulate(loop, TASK).kpis, name)
    J = wb.evaluate(loop, TASK, wb.Objective.of(**{name: 2.0}))[0]
    np.testing.assert_allclose(J, 2.0 * figure, rtol=1e-11)
    assert figure > 0.0


def test_a_valve_at_rest_makes_no_reversals():
    # As it comes to rest it follows what rounding makes of OP: which of these moves change sign is chance.
    loop = wb.Loop(wb.FOPDT(1.0, 5.0, 1.0), wb.Ideal(), wb.PID(1.5, 5.0), 1.0)
    task = wb.Experiment(1000.0, wb.Step(3.7))
    run = wb.simulate(loop, task)
    moves = np.diff(run.valve, prepend=0.0)
    signs = np.sign(moves[np.abs(moves) > 1e-7])
    reversals = np.count_nonzero(signs[1:] != signs[:-1])
    assert run.kpis.reversals == wb.evaluate(loop, task, wb.Objective.of(reversals=1.0))[0] == reversals


def test_figures_add_to_equation_two():
    both = wb.Objective(0.5, 0.1, 0.5, 0.2, {"iae": 0.3, "valve_travel": 0.05})
    parts = wb.Objective(0.5, 0.1, 0.5, 0.2), wb.Objective.of(iae=0.3, valve_travel=0.05)
    total = sum(wb.evaluate(LOOP, TASK, part)[0] for part in parts)
    np.testing.assert_allclose(wb.evaluate(LOOP, TASK, both)[0], total, rtol=1e-13)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.sampled_from(WEIGHABLE), min_size=1, unique=True), st.integers(1, 300))
def test_an_objective_never_falls_as_samples_are_added(names, count):
    # This is what lets a search give a run up early.
    objective = wb.Objective(0.5, 0.1, 0.0, 0.2, dict.fromkeys(names, 1.0))
    s = signals(LOOP, TASK)
    weights = kernel_weights(objective, s.samples, 0.5)
    run = wb.simulate(LOOP, TASK)
    y = np.append(run.pv, run.final_pv)
    total, last, costs = np.zeros(kernel.SUMS), np.zeros(3), []
    none = np.zeros(count + 1)
    for begin in range(0, s.samples, count):
        end = min(begin + count, s.samples)
        part, ends = slice(begin, end), slice(begin, end + 1)
        kernel.add_sums(total, last, True, s.r[ends], none[: end - begin + 1], y[ends], run.op[part], run.valve[part])
        costs.append(kernel.weigh(total, weights, end, s.samples))
    assert (np.diff(costs) >= -1e-9 * costs[-1]).all()
    np.testing.assert_allclose(costs[-1], wb.evaluate(LOOP, TASK, objective)[0], rtol=1e-9)


def test_the_worst_of_a_group_is_the_greatest_of_its_costs_to_the_bit():
    objective = wb.Objective(0.5, 0.0, 0.5, 0.1, {"pv_sd": 3.0, "reversals": 0.5})
    tunings = np.column_stack(
        [np.linspace(0.2, 2.0, 4000), np.full(4000, 15.0), np.linspace(0.0, 1.0, 4000)]
    )  # enough samples that they are shared out over cores
    rows, s = coefficients(LOOP, 0.0, tunings), signals(LOOP, TASK)
    weights = kernel_weights(objective, s.samples, 0.5)
    costs = weigh(sums(rows, s, every=True), weights, s.samples)
    found, samples = worst(rows, 8, s, weights, np.full(500, np.inf))
    np.testing.assert_array_equal(found, costs.reshape(500, 8).max(axis=1))
    assert samples == 4000 * s.samples
    ceilings = np.full(500, np.median(found))
    below, fewer = worst(rows, 8, s, weights, ceilings)
    np.testing.assert_array_equal(below, np.where(found <= ceilings, found, np.inf))
    assert fewer < samples


def test_members_that_give_groups_up_are_run_first_without_changing_what_is_found():
    tunings = np.column_stack([np.linspace(0.5, 2.0, 400), np.full(400, 15.0), np.zeros(400)])
    tunings[5::8, 0] = 0.01  # of each group the sixth is hopeless
    rows, s = coefficients(LOOP, 0.0, tunings), signals(LOOP, TASK)
    weights = kernel_weights(wb.Objective(), s.samples, 0.5)
    costs = weigh(sums(rows, s), weights, s.samples).reshape(50, 8)
    ceilings = np.where(np.arange(50) < 40, np.delete(costs, 5, axis=1).max(axis=1), costs.max(axis=1))
    lost = np.zeros(8, np.int64)
    found, first = worst(rows, 8, s, weights, ceilings, lost)
    assert lost.tolist() == [0, 0, 0, 0, 0, 40, 0, 0]
    again, second = worst(rows, 8, s, weights, ceilings, lost)
    assert lost[5] == 20 + 40
    np.testing.assert_array_equal(found, np.where(costs.max(axis=1) <= ceilings, costs.max(axis=1), np.inf))
    np.testing.assert_array_equal(again, found)
    assert second < 0.6 * first


@pytest.mark.parametrize(
    ("given_", "where"),
    [
        ({"settling_time": 1.0}, "Objective.kpis"),
        ({"iae": -1.0}, "Objective.kpis.iae"),
        ({"iae": float("nan")}, "Objective.kpis.iae"),
        (3.0, "Objective.kpis"),
    ],
)
def test_wrong_figures_are_refused(given_, where):
    with pytest.raises(wb.InvalidValue) as caught:
        wb.Objective(kpis=given_)
    assert caught.value.where == where


def test_an_objective_without_any_weight_is_refused():
    with pytest.raises(wb.InvalidValue, match="at least one"):
        wb.Objective(0.0, 0.0, 0.0, 0.0, {"iae": 0.0})
