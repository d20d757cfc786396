"""Friction that varies along the travel: the law written again, constant tables, long runs, and what it has not."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from loops import experiments, late_cycles, loops, numbers, paper_step

import workbench as wb
from workbench.simulate.run import valve_response

PLACES = (-6.0, -1.0, 4.0)
UNEVEN = wb.Positional(PLACES, (wb.Choudhury(4.0, 1.0), wb.Choudhury(2.0, 0.5), wb.Choudhury(3.0, 2.0)))
STAIRS = wb.Positional(PLACES, (wb.Stenman(3.0), wb.Stenman(1.0), wb.Stenman(2.0)))
alike = st.one_of(
    st.builds(wb.Stenman, d=numbers(0.1, 4.0)),
    st.builds(lambda fs, share: wb.He(fs, share * fs), fs=numbers(0.1, 4.0), share=numbers(0.0, 1.0)),
    st.builds(wb.Choudhury, S=numbers(0.1, 6.0), J=numbers(0.0, 6.0)),
    st.builds(wb.Deadband, b=numbers(0.1, 5.0)),
)


def wandering(seed: int, n: int = 600) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.cumsum(rng.normal(0.0, 0.7, n)) * 0.9 + 3.0 * np.sin(np.arange(n) / 17.0)


def two_parameter_path(valve: wb.Positional, op: np.ndarray) -> list[float]:
    """The law again, in S and J at the stem's place, with no code of the package."""
    x, last, direction, path = 0.0, 0.0, 0, []
    for u in op:
        S = float(np.interp(x, valve.positions, [one.S for one in valve.valves]))
        J = float(np.interp(x, valve.positions, [one.J for one in valve.valves]))
        if not (direction and (u - last) * direction > 0):
            direction = int(math.copysign(1, u - x)) if abs(u - x) > (S + J) / 2 else 0
        if direction:
            new = u - direction * (S - J) / 2
            x = new if (new - x) * direction >= 0 else x
        last = u
        path.append(x)
    return path


@pytest.mark.parametrize("seed", range(8))
def test_the_stem_follows_the_law_written_again(seed):
    op = wandering(seed)
    assert np.ptp(op) > 8.0
    np.testing.assert_allclose(valve_response(UNEVEN, op), two_parameter_path(UNEVEN, op), atol=1e-9)
    stem, x = valve_response(STAIRS, op), 0.0
    for u, ours in zip(op, stem, strict=True):
        d = float(np.interp(x, PLACES, [3.0, 1.0, 2.0]))
        x = x if abs(u - x) <= d else u
        assert ours == x


@given(loop=loops, valve=alike, experiment=experiments(100.0), at=st.sampled_from([(0.0,), (-1.5, 0.3, 2.0)]))
def test_the_same_friction_everywhere_is_that_valve(loop, valve, experiment, at):
    same = replace(loop, valve=wb.Positional(at, (valve,) * len(at)))
    ours, theirs = wb.simulate(same, experiment), wb.simulate(replace(loop, valve=valve), experiment)
    for name in ("pv", "op", "valve", "branch"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name))


@given(loop=loops, experiment=experiments(100.0))
def test_the_loop_runs_the_valve_that_stands_alone(loop, experiment):
    run = wb.simulate(replace(loop, valve=UNEVEN), experiment)
    np.testing.assert_array_equal(run.valve, valve_response(UNEVEN, run.op))


def test_a_moving_stem_waits_where_friction_grows_along_its_way():
    valve = wb.Positional((0.0, 10.0), (wb.Choudhury(0.2, 0.0), wb.Choudhury(16.0, 0.0)))
    op = np.concatenate([[8.0], 8.0 + 0.01 * np.arange(1, 200)])
    stem = valve_response(valve, op)
    assert stem[0] == 8.0 - 0.1
    assert (np.diff(stem) >= 0.0).all()
    assert stem[20] == stem[0]


@pytest.mark.parametrize(
    "valve", [wb.Positional(PLACES, (wb.Choudhury(4.0, 2.0), wb.Choudhury(2.0, 1.0), wb.Choudhury(3.0, 2.0))), STAIRS]
)
def test_the_long_run_is_that_of_plain_simulation_and_depends_on_the_place(valve):
    loop = wb.Loop(wb.FOPDT(1.0, 20.0, 6.0), valve, wb.PID(0.8, 60.0), 1.0)
    task = wb.Experiment(400_000.0, setpoint=wb.Step(2.1))
    found = wb.limit_cycle(loop, task)
    assert found.closed_form is None
    start = found.starts[0]
    assert start.outcome == "cycles"
    # The cycle drifts on for longer than this run.
    assert start.pv_peak_to_peak == pytest.approx(late_cycles(wb.simulate(loop, task), 300_000.0)[1], rel=0.15)
    other = wb.limit_cycle(loop, replace(task, setpoint=wb.Step(-5.1))).starts[0]
    assert other.pv_peak_to_peak > 1.15 * start.pv_peak_to_peak


def test_the_signature_shows_the_friction_of_the_place():
    flat = wb.signature(wb.Positional((0.0,), (wb.Choudhury(3.0, 1.0),)))
    assert (flat.dead_band, flat.resolution) == (
        wb.signature(wb.Choudhury(3.0, 1.0)).dead_band,
        wb.signature(wb.Choudhury(3.0, 1.0)).resolution,
    )
    steep = wb.signature(wb.Positional((-8.0, 8.0), (wb.Choudhury(2.0, 1.0), wb.Choudhury(6.0, 1.0))))
    # The ramp turns high where the stick band is wide, and low where it is narrow.
    assert steep.dead_band_down > 1.5 * steep.dead_band_up


def test_linear_methods_say_that_they_have_nothing_to_say():
    loop = wb.Loop(wb.FOPDT(1.0, 5.0, 1.0), UNEVEN, wb.PID(0.5, 20.0), 1.0)
    with pytest.raises(wb.InvalidValue, match="depends on where along the travel"):
        wb.describing_function(loop)
    with pytest.raises(wb.InvalidValue, match="depends on where along the travel"):
        wb.apply_rule(loop, wb.NoCrossing())
    tuned = wb.tune(loop, paper_step(100.0), bounds=wb.Bounds(Td=(0, 0)), restarts=1, digits=2, max_evaluations=3000)
    assert "do not know the valve Positional" in tuned.message
    assert tuned.guard_margin >= 0.0
    plane = wb.cycle_map(loop, Kc=(0.1, 2.0), Ti=(5.0, 60.0), points=2, starts=1)
    assert plane.count("cycles") + plane.count("settles") + plane.count("depends") > 0


def test_a_random_stiction_keeps_the_shape():
    loop = wb.Loop(wb.FOPDT(1.0, 5.0, 1.0), UNEVEN, wb.PID(0.5, 20.0), 1.0)
    assert wb.assess(loop).diverged == 0
    assert UNEVEN.hold == pytest.approx(0.8 * 1.25 + 0.2 * 2.5)
    assert (UNEVEN.stick_band, UNEVEN.slip_jump, STAIRS.sticks_at_once) == (4.0, 0.5, True)
    with pytest.raises(wb.InvalidValue, match="stem_offset"):
        wb.simulate(loop, wb.Experiment(10.0, stem_offset=1.6))


TWO = (wb.Choudhury(2.0, 1.0), wb.Choudhury(3.0, 1.0))


@pytest.mark.parametrize(
    ("make", "where"),
    [
        (lambda: wb.Positional((), ()), "Positional.positions"),
        (lambda: wb.Positional((0.0, 1.0), TWO[:1]), "Positional.valves"),
        (lambda: wb.Positional((1.0, 0.0), TWO), "Positional.positions[1]"),
        (lambda: wb.Positional((0.0, math.nan), TWO), "Positional.positions[1]"),
        (lambda: wb.Positional((0.0, 1.0), (TWO[0], wb.Stenman(1.0))), "Positional.valves[1]"),
        (lambda: wb.Positional((0.0, 1.0), (wb.Kano(2.0, 1.0), wb.Kano(2.0, 1.0))), "Positional.valves[0]"),
        (lambda: wb.Positional((0.0, 0.5), TWO), "Positional.valves[1]"),
        (lambda: wb.Positional(0.0, TWO), "Positional.positions"),
        (lambda: wb.Positional(tuple(range(65)), TWO[:1] * 65), "Positional.positions"),
    ],
)
def test_tables_without_meaning_are_refused(make, where):
    with pytest.raises(wb.InvalidValue) as caught:
        make()
    assert caught.value.where == where


def test_places_are_looked_up_as_they_are_told():
    values = tuple(one.hold for one in UNEVEN.valves)
    for a, b in pairwise((-7.0, -6.0, -2.2, -1.0, 0.0, 3.9, 4.0, 9.0)):
        for x in (a, b):
            assert UNEVEN.between(x, values) == pytest.approx(float(np.interp(x, PLACES, values)))
