"""Runs side by side in the kernel's lanes: each of them the run that it is alone, to the bit."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from loops import experiments, loops, paper_loop, paper_step

import workbench as wb
from workbench.simulate import batch_kernel, kernel
from workbench.simulate.batch import kernel_weights, sums, weigh, worst
from workbench.simulate.batch_kernel import LANES
from workbench.simulate.coefficients import coefficients, rest
from workbench.simulate.signals import Signals, signals
from workbench.simulate.sums import FEW_SUMS, SUMS, add_sums


def tunings_near(loop: wb.Loop, count: int, seed: int) -> np.ndarray:
    """The loop's own tuning, and others of up to twice and down to half of its numbers."""
    pid = loop.controller
    factors = 2.0 ** np.random.default_rng(seed).uniform(-1.0, 1.0, (count, 3))
    factors[0] = 1.0
    return factors * np.array([pid.Kc, pid.Ti, pid.Td])


def alone(rows: np.ndarray, s: Signals) -> np.ndarray:
    """The first sums of each row from its own trajectory, as the kernel makes it one sample after the other."""
    n = s.samples
    found = np.zeros((rows.shape[0], SUMS))
    for row, out in zip(rows, found, strict=True):
        state, past = rest(row)
        y, u, x, v = np.empty(n + 1), np.empty(n), np.empty(n), np.empty(n)
        kernel.run_loop(row, s.r, s.load, s.noise, state, past, y, u, x, v, np.empty(n, np.int8))
        add_sums(out, np.array([row[kernel.BIAS], 0.0, 0.0]), False, s.r, s.noise, y, u, x)
    return found[:, :FEW_SUMS]


@given(loop=loops, experiment=experiments(), count=st.integers(1, 40), seed=st.integers(0, 99))
def test_sums_of_many_runs_are_those_of_each_alone(loop, experiment, count, seed):
    s = signals(loop, experiment)
    rows = coefficients(loop, experiment.stem_offset, tunings_near(loop, count, seed))
    with np.errstate(over="ignore", invalid="ignore"):
        np.testing.assert_array_equal(sums(rows, s), alone(rows, s))


@settings(max_examples=60)
@given(
    loop=loops,
    experiment=experiments(),
    groups=st.integers(1, 25),
    group=st.integers(1, 20),
    seed=st.integers(0, 99),
    share=st.sampled_from([0.0, 0.3, 0.8, 1.0]),
)
def test_worst_cases_in_lanes_are_those_of_whole_runs(loop, experiment, groups, group, seed, share):
    s = signals(loop, experiment)
    rows = coefficients(loop, 0.0, tunings_near(loop, groups * group, seed))
    weights = kernel_weights(wb.Objective(w1=0.5, w2=0.1, w3=0.5, w4=0.2), s.samples, loop.sample_time)
    with np.errstate(over="ignore", invalid="ignore"):
        costs = weigh(alone(rows, s), weights, s.samples).reshape(groups, group)
        expected = costs.max(axis=1)
        # Some ceilings met exactly, some too low, some far above.
        rng = np.random.default_rng(seed)
        ceilings = np.where(rng.random(groups) < share, expected, rng.uniform(0.0, 2.0, groups) * expected)
        ceilings[rng.random(groups) < 0.2] = np.inf
        lost = np.zeros(group, np.int64)
        found, samples = worst(rows, group, s, weights, ceilings, lost)
    np.testing.assert_array_equal(found, np.where(expected <= ceilings, expected, np.inf))
    assert lost.sum() == np.count_nonzero(~(expected <= ceilings) & ~np.isinf(ceilings)) or np.isinf(expected).any()
    assert samples <= rows.shape[0] * s.samples


@pytest.mark.parametrize("valve", [wb.Ideal(), wb.Stenman(2.0), wb.He(2.0, 0.5), wb.Choudhury(4.0, 1.0)])
@pytest.mark.parametrize("Td", [0.0, 1.5])
def test_lanes_are_taken_and_equal_their_python_source(valve, Td):
    loop = wb.Loop(wb.FOPDT(1.0, 5.0, 1.3), valve, wb.PID(0.8, 15.0, Td, output_limits=(-3.0, 6.0)), 1.0)
    s = signals(loop, wb.Experiment(90.0, wb.Step(4.0), wb.Step(1.0, at=40.0), wb.Noise(0.05, 1)))
    rows = coefficients(loop, 0.0, tunings_near(loop, LANES, 3))
    taken = np.zeros((LANES, SUMS))
    assert batch_kernel._run_abreast(rows, np.zeros(LANES, np.int64), s.r, s.load, s.noise, taken) == LANES
    kind = kernel.TWO_PARAMETER if isinstance(valve, wb.Choudhury) else kernel.STAIRS
    m = int(rows[0, kernel.DELAY])
    lanes, v = np.zeros(batch_kernel.ABREAST), np.zeros((90 + m + 2) * LANES)
    for j in range(LANES):
        batch_kernel._enter(rows[j], lanes, j)
    for a, b in ((0, 50), (50, 90)):
        source = batch_kernel._abreast.py_func  # type: ignore[attr-defined]
        source(rows[0], s.r[a:b], s.load[a:b], s.noise[a:b], lanes, v, kind, a == 0)
    python = np.zeros((LANES, SUMS))
    for j in range(LANES):
        batch_kernel._leave(rows[0], lanes, v, j, s.r[90], s.noise[90], python[j])
    np.testing.assert_array_equal(taken, python)
    np.testing.assert_array_equal(python[:, :FEW_SUMS], alone(rows, s))


def test_what_lanes_do_not_know_is_run_alone():
    few = np.zeros((6, FEW_SUMS))
    s = signals(paper_loop(0.5, 20.0), paper_step(50.0))

    def taken(loop: wb.Loop, count: int = 6, which: np.ndarray | None = None) -> int:
        rows = coefficients(loop, 0.0, tunings_near(loop, count, 0))
        return batch_kernel._run_abreast(
            rows, np.zeros(6, np.int64) if which is None else which, s.r, s.load, s.noise, few
        )

    plain = paper_loop(0.5, 20.0)
    assert taken(plain) == 6
    # Too few to be worth it; and only those of one experiment together.
    assert taken(plain, count=4) == 0
    assert taken(plain, which=np.array([0, 0, 0, 0, 0, 1])) == 5
    assert taken(wb.Loop(plain.plant, wb.Kano(4.0, 1.0), plain.controller, 1.0)) == 0
    for other in (
        {"output_limits": (-3.0, 3.0), "anti_windup": "back_calculation"},
        {"compensator": wb.IntegralDeadband(0.5)},
        {"output_resolution": 0.5},
    ):
        assert taken(paper_loop(0.5, 20.0, **other)) == 0
    assert taken(wb.Loop(plain.plant, plain.valve, plain.controller, 1.0, scan=2)) == 0


def test_runs_of_several_experiments_and_plants_stay_apart():
    experiments = [wb.Experiment(200.0, wb.Step(size), noise=wb.Noise(0.05, i)) for i, size in enumerate((4.0, -2.0))]
    some, rows, which = (
        [paper_loop(0.5, 20.0), wb.Loop(wb.FOPDT(1.2, 4.0, 2.4), wb.Stenman(1.5), wb.PID(1, 9), 1.0)],
        [],
        [],
    )
    given = [signals(some[0], one) for one in experiments]
    for loop in some:
        for i in range(2):
            rows.append(coefficients(loop, 0.0, tunings_near(loop, 18, i)))
            which += [i] * 18
    together = Signals(*(np.array([getattr(s, name) for s in given]) for name in ("r", "load", "noise")))
    found = sums(np.concatenate(rows), together, np.array(which))
    expected = [alone(part, given[i % 2]) for i, part in enumerate(rows)]
    np.testing.assert_array_equal(found, np.concatenate(expected))
