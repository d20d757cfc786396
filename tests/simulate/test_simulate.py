"""`wb.simulate` and its batch forms: the paper's figures, profiles, seeds, refusals."""

from __future__ import annotations

import numpy as np
import pytest
from loops import paper_loop, paper_step

import workbench as wb
from workbench.simulate.signals import noise_signal, profile_signal, sample_count

CASES = {1: (0.5, 20.0, 0.0), 2: (0.5, 200.0, 0.0), 3: (0.5, 20.0, 6.0), 4: (2.01, 301.0, 0.0), 5: (1.32, 196.0, 1.0)}


@pytest.mark.parametrize(("case", "travel"), [(1, 12.18), (2, 4.01)])
def test_valve_travel_of_table_2_to_the_digit(case, travel):
    run = wb.simulate(paper_loop(*CASES[case]), paper_step())
    assert round(run.kpis.valve_travel, 2) == travel
    assert round(run.kpis.controller_travel, 2) != travel


@pytest.mark.parametrize(("case", "J"), [(1, 226.6), (2, 1220.2), (3, 223.5), (4, 303.6), (5, 320.5)])
def test_cost_of_the_papers_cases(case, J):
    assert round(float(wb.evaluate(paper_loop(*CASES[case]), paper_step(), wb.Objective())[0]), 1) == J


def test_shapes_and_types_of_a_run():
    run = wb.simulate(paper_loop(0.5, 20.0), paper_step(100.0))
    for name in ("time", "sp", "pv", "op", "valve", "load"):
        signal = getattr(run, name)
        assert signal.shape == (100,)
        assert signal.dtype == np.float64
    assert run.time[-1] == 99.0
    assert (run.sp == 4.0).all()


def test_noise_is_the_published_generator_and_part_of_pv():
    experiment = wb.Experiment(50.0, noise=wb.Noise(sd=0.3, seed=7))
    run = wb.simulate(wb.Loop(wb.FOPDT(1.0, 5.0), wb.Stenman(50.0), wb.PID(0.1, 50.0), 1.0), experiment)
    expected = np.random.default_rng(7).normal(0.0, 0.3, 51)
    np.testing.assert_array_equal(run.pv, expected[:50])
    assert run.final_pv == expected[50]
    np.testing.assert_array_equal(noise_signal(None, 3), np.zeros(4))


def test_profiles_add_up():
    parts = [wb.Step(2.0, at=3.0), wb.Ramp(4.0, 2.0, 6.0), wb.Series([1.0, 0.0], times=[0.0, 4.5])]
    signal = profile_signal(parts, 8, 1.0)
    np.testing.assert_allclose(signal, [1, 1, 1, 4, 5, 5, 6, 6, 6])
    np.testing.assert_array_equal(profile_signal([wb.Series([1.0, 2.0])], 4, 1.0), [1, 2, 2, 2, 2])


def test_a_step_has_happened_in_the_sample_at_its_time_despite_rounding():
    signal = profile_signal([wb.Step(1.0, at=0.3)], 10, 0.1)
    assert 3 * 0.1 != 0.3
    np.testing.assert_array_equal(np.flatnonzero(signal), np.arange(3, 11))


def test_batches_equal_single_runs():
    loop, experiment = paper_loop(0.5, 20.0), paper_step(300.0)
    tunings = np.array(list(CASES.values()))
    batch = wb.simulate_batch(loop, experiment, tunings=tunings)
    costs = wb.evaluate(loop, experiment, wb.Objective(), tunings)
    for i, tuning in enumerate(CASES.values()):
        run = wb.simulate(paper_loop(*tuning), experiment)
        np.testing.assert_array_equal(batch.pv[i], run.pv)
        assert batch.kpis[i] == run.kpis or np.isnan(run.kpis.oscillation_period)
        assert costs[i] == wb.evaluate(paper_loop(*tuning), experiment, wb.Objective())[0]
    noisy = wb.Experiment(300.0, setpoint=wb.Step(4.0), noise=wb.Noise(0.1))
    seeds = wb.simulate_batch(loop, noisy, seeds=[3, 4])
    again = wb.simulate(loop, wb.Experiment(300.0, setpoint=wb.Step(4.0), noise=wb.Noise(0.1, seed=4)))
    np.testing.assert_array_equal(seeds.pv[1], again.pv)
    assert (seeds.pv[0] != seeds.pv[1]).any()
    for some in ([3, 4], [0]):
        array = wb.simulate_batch(loop, noisy, seeds=np.array(some))
        np.testing.assert_array_equal(array.pv, wb.simulate_batch(loop, noisy, seeds=some).pv)


def test_batch_in_another_form_equals_single_runs():
    experiment = paper_step(200.0)
    loop = wb.Loop(wb.FOPDT(1.0, 5.0, 1.4), wb.Choudhury(3.0, 1.0), wb.PID(1.0, 10.0, 1.0, form="series"), 1.0)
    J = wb.evaluate(loop, experiment, wb.Objective(), [[1.0, 10.0, 1.0], [0.8, 12.0, 0.0]])
    assert J[0] == wb.evaluate(loop, experiment, wb.Objective())[0]
    assert J[1] == wb.evaluate(loop.with_controller(wb.PID(0.8, 12.0)), experiment, wb.Objective())[0]


def test_an_unstable_run_costs_infinity_and_raises_nothing():
    J = wb.evaluate(paper_loop(200.0, 5.0), paper_step(), wb.Objective())
    assert J[0] == np.inf


def test_sample_count_refuses_a_broken_last_sample():
    assert sample_count(0.3, 0.1) == 3
    assert sample_count(1e6, 0.1) == 10_000_000
    with pytest.raises(wb.InvalidValue, match=r"100\.5 s given; must be a whole number of samples of 1 s"):
        wb.simulate(paper_loop(0.5, 20.0), paper_step(100.5))


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: wb.simulate(3, paper_step()), "loop: 3 given; must be a Loop"),
        (lambda: wb.simulate(paper_loop(0.5, 20.0), 1000.0), "experiment: 1000.0 given; must be an Experiment"),
        (lambda: wb.simulate(paper_loop(0.5, 20.0), wb.Experiment(1e13)), "at most 20,000,000 samples"),
        (lambda: wb.evaluate(paper_loop(0.5, 20.0), paper_step(), {"w1": 1.0}), "must be an Objective"),
        (lambda: wb.evaluate(paper_loop(0.5, 20.0), paper_step(), wb.Objective(), [["a", 1, 2]]), "numbers of shape"),
        (lambda: wb.evaluate(paper_loop(0.5, 20.0), paper_step(), wb.Objective(), [["1", 20, 0]]), "numbers of shape"),
        (lambda: wb.evaluate(paper_loop(0.5, 20.0), paper_step(), wb.Objective(), [[10**400, 2, 0]]), "of shape"),
        (lambda: wb.simulate_batch(paper_loop(0.5, 20.0), wb.Experiment(5.0, noise=wb.Noise(1.0)), seeds=3), "seeds"),
        (lambda: wb.limit_cycle(3), "must be a Loop"),
        (lambda: wb.describing_function(None), "must be a Loop"),
        (
            lambda: wb.simulate(
                wb.Loop(wb.FOPDT(1, 5), wb.Stenman(5), wb.PID(1, 5, output_limits=(-1, 1)), 1),
                wb.Experiment(5.0, stem_offset=4.0),
            ),
            "within the output limits",
        ),
    ],
)
def test_what_is_no_loop_or_no_experiment_is_refused(call, words):
    with pytest.raises(wb.InvalidValue, match=words):
        call()


@pytest.mark.parametrize(
    ("call", "words"),
    [
        ({}, "either tunings or seeds"),
        ({"tunings": [[1.0, 10.0, 0.0]], "seeds": [1]}, "either tunings or seeds"),
        ({"tunings": [1.0, 10.0, 0.0]}, "shape"),
        ({"tunings": [[1.0, -10.0, 0.0]]}, "Ti > 0"),
        ({"tunings": np.empty((0, 3))}, "at least one"),
        ({"seeds": [1]}, "noise"),
    ],
)
def test_batch_refusals(call, words):
    with pytest.raises(wb.InvalidValue, match=words):
        wb.simulate_batch(paper_loop(0.5, 20.0), paper_step(50.0), **call)
