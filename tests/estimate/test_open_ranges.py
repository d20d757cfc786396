"""Ranges that a record does not close: open at the search's limits and beyond what can be shown, and said to be so."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import workbench as wb
from workbench.cli.output import estimate_json, estimate_lines
from workbench.estimate.fits.data import centre
from workbench.estimate.fits.fit import LEAST_TAU, Fit
from workbench.estimate.ranges.scale import ranges_of
from workbench.model.results import Intervals

LONGEST = 30.0  # samples, of dead times searched
SAMPLES, TS = 200, 2.0


def record(seed: int = 0) -> wb.Record:
    rng = np.random.default_rng(seed)
    op = 50.0 + 2.0 * np.sin(0.1 * np.arange(SAMPLES))
    return wb.Record(10.0 + 3.0 * np.cos(0.1 * np.arange(SAMPLES)) + 0.1 * rng.normal(size=SAMPLES), op, TS)


def fit(gain: float = 1.5, tau: float = 10.0, theta: float = 3.0) -> Fit:
    return Fit(1.0, tau, theta, gain, 0.0, 0.0, 0.0)


def ranges(fits: list[Fit], errors: tuple[float, float, float] = (0.1, 1.0, 0.2), plant: str = "fopdt") -> Intervals:
    return ranges_of(centre(record(), plant), fits, errors, None, LONGEST)


def test_ranges_within_what_the_record_shows_are_closed() -> None:
    found = ranges([fit(), fit(gain=1.7, tau=12.0)])
    assert found.gain == pytest.approx((1.5 - 0.196, 1.7 + 0.196))
    assert found.time_constant == pytest.approx((TS * (10.0 - 1.96), TS * (12.0 + 1.96)))
    assert found.dead_time == pytest.approx((TS * (3.0 - 0.392), TS * (3.0 + 0.392)))


def test_a_time_constant_at_its_limit_opens_the_gain_too() -> None:
    found = ranges([fit(tau=float(SAMPLES))])
    assert found.time_constant == pytest.approx((TS * (SAMPLES - 1.96), math.inf))
    assert found.gain == pytest.approx((1.5 - 0.196, math.inf))
    # One that is alike the best is enough, and a negative gain is open downward.
    found = ranges([fit(gain=-1.5), fit(gain=-1.5, tau=float(SAMPLES))])
    assert found.gain == pytest.approx((-math.inf, -1.5 + 0.196))
    # A plant that follows at once: 0 is the end.
    assert ranges([fit(tau=LEAST_TAU)]).time_constant == pytest.approx((0.0, TS * (LEAST_TAU + 1.96)))


def test_a_dead_time_at_its_limit_is_open() -> None:
    assert ranges([fit(theta=LONGEST)]).dead_time == pytest.approx((TS * (LONGEST - 0.392), math.inf))
    closed = ranges([fit(theta=LONGEST - 1.0)]).dead_time
    assert closed is not None
    assert math.isfinite(closed[1])
    # An integrating plant has no time constant to open its gain.
    found = ranges([fit(gain=0.01, tau=float(SAMPLES))], (0.001, math.nan, 0.2), "integrating")
    assert found.time_constant is None
    assert found.gain == pytest.approx(((0.01 - 0.00196) / TS, (0.01 + 0.00196) / TS))


@settings(deadline=None, max_examples=60)
@given(
    st.lists(
        st.tuples(st.floats(-1e9, 1e9), st.floats(LEAST_TAU, SAMPLES), st.floats(0.0, LONGEST)), min_size=1, max_size=4
    ),
    st.tuples(*[st.floats(0.0, 1e16) | st.just(math.nan) for _ in range(3)]),
    st.sampled_from(["fopdt", "integrating"]),
)
def test_no_end_lies_beyond_what_the_record_can_show(
    plants: list[tuple[float, float, float]], errors: tuple[float, float, float], plant: str
) -> None:
    data = centre(record(), plant)
    found = ranges_of(data, [fit(*one) for one in plants], errors, None, LONGEST)
    reach = float(np.ptp(data.y)) / data.op_range * (1.0 / TS if plant == "integrating" else SAMPLES)
    for pair, most in ((found.time_constant, SAMPLES * TS), (found.dead_time, SAMPLES * TS), (found.gain, reach)):
        assert pair is None or (pair[0] <= pair[1] and all(math.isinf(e) or abs(e) <= most * (1 + 1e-9) for e in pair))
    gains = [one[0] / (TS if plant == "integrating" else 1.0) for one in plants]
    if found.gain is not None:
        assert found.gain[0] <= min(gains)
        assert max(gains) <= found.gain[1]


def test_a_level_taken_for_a_lag_says_what_it_does_not_tell() -> None:
    loop = wb.Loop(wb.Integrating(0.01, 3.0), wb.Stenman(2.0), wb.PID(Kc=8.0, Ti=60.0), 1.0)
    experiment = wb.Experiment(300.0, [wb.Step(2.0), wb.Step(-2.0, at=150.0)], noise=wb.Noise(0.02, 1))
    run = wb.simulate(loop, experiment)
    found = wb.estimate(wb.Record(run.pv, run.op, 1.0, sp=run.sp), valve="stenman", plant="fopdt")
    assert found.intervals.time_constant is not None
    assert found.intervals.time_constant[1] == math.inf
    assert found.intervals.gain is not None
    assert found.intervals.gain[1] == math.inf
    assert not found.identifiable
    assert any("the time constant has no upper end" in reason for reason in found.reasons)
    # What is written and printed holds no number for it.
    content = json.loads(estimate_json(found))
    assert content["intervals"]["time_constant"][1] == "none"
    assert any(line.strip().startswith("gain: ") and " or more (" in line for line in estimate_lines(found))
    assert "or more" in found._repr_html_()


def test_a_dead_time_cut_short_identifies_nothing() -> None:
    loop = wb.Loop(wb.FOPDT(1.5, 6.0, 6.0), wb.Stenman(1.5), wb.PID(Kc=0.5, Ti=9.0), 1.0)
    experiment = wb.Experiment(600.0, [wb.Step(4.0), wb.Step(-3.0, at=300.0)], noise=wb.Noise(0.02, 1))
    run = wb.simulate(loop, experiment)
    seen = wb.Record(run.pv, run.op, 1.0, sp=run.sp)
    free = wb.estimate(seen, plant="fopdt", valve="stenman")
    assert free.identifiable
    assert free.intervals.dead_time is not None
    assert math.isfinite(free.intervals.dead_time[1])
    cut = wb.estimate(seen, plant="fopdt", valve="stenman", max_dead_time=3.0)
    assert cut.intervals.dead_time is not None
    assert cut.intervals.dead_time[1] == math.inf
    assert not cut.identifiable
    assert any("the dead time is not identified" in reason for reason in cut.reasons)


def disturbed(
    plant: wb.Plant, valve: object = None, setpoint: object = None, n: int = 900, level: float = 0.3
) -> wb.Run:
    """A loop under a slow load of its own colour, with little noise."""
    rng, load = np.random.default_rng(4), np.zeros(n)
    for k in range(1, n):
        load[k] = 0.95 * load[k - 1] + level * rng.normal()
    Kc, Ti = (0.8, 9.0) if isinstance(plant, wb.FOPDT) else (2.0, 30.0)
    action = "reverse" if plant.gain > 0.0 else "direct"
    loop = wb.Loop(plant, valve or wb.Ideal(), wb.PID(Kc, Ti, action=action), 1.0)
    return wb.simulate(loop, wb.Experiment(float(n), setpoint, wb.Series(load.tolist()), wb.Noise(0.05, 3)))


BLIND = "no setpoint move is recorded and OP only answers PV"


@pytest.mark.parametrize(
    ("plant", "valve"), [(wb.FOPDT(2.0, 8.0, 2.0), "auto"), (wb.Integrating(-0.05, 2.0), "linear")]
)
def test_a_linear_loop_that_nobody_moves_shows_its_gains_sign_alone(plant: wb.Plant, valve: str) -> None:
    # What the controller makes of the load passes for the plant: a gain an eighth of the true one and less.
    run = disturbed(plant, n=500)
    kind = "fopdt" if isinstance(plant, wb.FOPDT) else "integrating"
    sp = run.sp + 50.0 if valve == "linear" else None
    found = wb.estimate(wb.Record(run.pv + 50.0, run.op + 50.0, 1.0, sp=sp), plant=kind, valve=valve)
    assert found.verdict != "stiction"
    assert any(BLIND in reason for reason in found.reasons)
    assert not any("looks the same" in reason for reason in found.reasons)
    assert found.intervals.gain is not None
    low, high = np.sort(math.copysign(1.0, plant.gain) * np.array(found.intervals.gain))
    assert low == pytest.approx(0.0, abs=0.02 * abs(plant.gain))
    assert high == math.inf
    assert found.intervals.dead_time == (0.0, math.inf)
    assert found.intervals.time_constant == ((0.0, math.inf) if kind == "fopdt" else None)
    assert not found.identifiable


def test_a_linear_loop_whose_setpoint_moves_shows_its_plant() -> None:
    plant = wb.FOPDT(2.0, 8.0, 2.0)
    run = disturbed(plant, setpoint=[wb.Step(8.0, at=100.0 * k) for k in range(1, 8, 2)])
    found = wb.estimate(wb.Record(run.pv + 50.0, run.op + 50.0, 1.0, sp=run.sp + 50.0), plant="fopdt", valve="linear")
    assert not any(BLIND in reason for reason in found.reasons)
    assert found.intervals.gain is not None
    low, high = found.intervals.gain
    assert 1.0 < low <= 2.0 <= high < 3.0


def test_an_op_that_is_moved_by_hand_shows_its_plant() -> None:
    # The setpoint stands still too: the controller is out.
    rng = np.random.default_rng(1)
    op = 40.0 + np.repeat(rng.normal(size=30), 20)
    response = wb.simulate(
        wb.Loop(wb.FOPDT(2.0, 8.0, 2.0), wb.Ideal(), wb.PID(0.0, math.inf), 1.0),
        wb.Experiment(600.0, load=wb.Series((op - 40.0).tolist()), noise=wb.Noise(0.1, 2)),
    )
    found = wb.estimate(wb.Record(response.pv + 50.0, op, 1.0, sp=np.full(600, 50.0)), plant="fopdt", valve="linear")
    assert not any(BLIND in reason for reason in found.reasons)
    assert found.intervals.gain is not None
    assert found.intervals.gain == pytest.approx((2.0, 2.0), rel=0.05)


@pytest.mark.slow
def test_where_nothing_decides_the_ranges_hold_the_linear_loops_plant_too() -> None:
    run = disturbed(wb.FOPDT(2.0, 8.0, 2.0), setpoint=[wb.Step(3.0, 120.0), wb.Step(-3.0, 350.0)], n=700)
    how = {"record": wb.Record(run.pv + 50.0, run.op + 50.0, 1.0, sp=run.sp + 50.0), "plant": "fopdt"}
    found = wb.estimate(**how, valve="stenman")
    assert found.verdict == "undecided"
    assert "a linear loop without stiction is not clearly less likely: the plant's ranges hold that one's too" in (
        found.reasons
    )
    straight = wb.estimate(**how, valve="linear").intervals
    for name in ("gain", "time_constant", "dead_time"):
        (low, high), (least, most) = getattr(found.intervals, name), getattr(straight, name)
        assert low <= least <= most <= high
