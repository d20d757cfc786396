"""Cascades against an independent simulation, a fine-step integration, and what can be said by hand."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from cascades import cascade_experiments, cascades, flow_and_temperature, independent_cascade
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import workbench as wb
from workbench.simulate import cascade_kernel as kernel
from workbench.simulate.cascade import CascadeState, cascade_signals, chain

STEP = wb.Experiment(1000.0, setpoint=wb.Step(5.0))


@settings(max_examples=60)
@given(cascade=cascades(), experiment=cascade_experiments())
def test_a_cascade_is_the_law_written_independently(cascade, experiment):
    run, s = wb.simulate(cascade, experiment), cascade_signals(cascade, experiment)
    other = independent_cascade(cascade, s)
    n = s.samples
    sizes = [float(np.abs(signal).max()) for signal in (run.primary.pv, run.secondary.pv, run.secondary.op)]
    assume(max(sizes) < 1e4)
    assume(other["margin"][0] > 1e-7)
    tolerance = 1e-9 * max(1.0, *sizes)
    for name, ours in (
        ("y1", run.primary.pv - s.noise1[:n]),
        ("u1", run.primary.op),
        ("r2", run.secondary.sp),
        ("y2", run.secondary.pv - s.noise2[:n]),
        ("u2", run.secondary.op),
        ("x", run.secondary.valve),
    ):
        np.testing.assert_allclose(ours, other[name], rtol=0.0, atol=tolerance, err_msg=name)
    np.testing.assert_allclose(run.primary.valve * cascade.scale, run.secondary.pv - s.noise2[:n], atol=tolerance)


@pytest.mark.parametrize(
    ("inner", "outer"),
    [
        (wb.FOPDT(1.3, 4.0, 1.4), wb.FOPDT(0.7, 25.0, 3.3)),
        (wb.FOPDT(1.3, 4.0, 0.0), wb.Integrating(0.05, 2.5)),
        (wb.Integrating(0.2, 0.3), wb.FOPDT(0.7, 9.0, 1.0)),
    ],
)
def test_the_chain_is_both_plants_in_continuous_time(inner, outer):
    # The primary's PV between and at the samples: both differential equations in steps of a thousandth.
    base = flow_and_temperature()
    cascade = wb.Cascade(
        dataclasses.replace(base.primary, plant=outer, sample_time=1.0),
        dataclasses.replace(base.secondary, plant=inner),
    )
    rng = np.random.default_rng(1)
    v = rng.normal(0.0, 1.0, 30)
    c = chain(cascade)
    m = int(c[kernel.CHAIN_DELAY])
    w = y = 0.0
    ours = []
    for k in range(30):
        near, far = (v[j] if j >= 0 else 0.0 for j in (k - m, k - m - 1))
        y = c[kernel.A10] * w + c[kernel.A11] * y + c[kernel.NEAR_Y] * near + c[kernel.FAR_Y] * far
        w = c[kernel.A00] * w + c[kernel.NEAR_W] * near + c[kernel.FAR_W] * far
        ours.append(y)
    steps = 1000
    h = 1.0 / steps

    def slope(plant, value, pushed):
        return (
            plant.gain * pushed
            if isinstance(plant, wb.Integrating)
            else (plant.gain * pushed - value) / plant.time_constant
        )

    y2, y1 = np.zeros(30 * steps + 1), np.zeros(30 * steps + 1)
    late2, late1 = round(inner.dead_time * steps), round(outer.dead_time * steps)
    for i in range(30 * steps):
        pushed = v[(i - late2) // steps] if i >= late2 else 0.0
        middle = y2[i] + 0.5 * h * slope(inner, y2[i], pushed)
        y2[i + 1] = y2[i] + h * slope(inner, middle, pushed)
        begin, end = (y2[j - late1] if j >= late1 else 0.0 for j in (i, i + 1))
        half = y1[i] + 0.5 * h * slope(outer, y1[i], begin)
        y1[i + 1] = y1[i] + h * slope(outer, half, 0.5 * (begin + end))
    np.testing.assert_allclose(ours, y1[steps::steps], atol=2e-6)


@settings(max_examples=40)
@given(cascade=cascades(), experiment=cascade_experiments(100.0), cut=st.integers(1, 19))
def test_a_cascade_in_pieces_and_in_python_equals_the_cascade_in_one(cascade, experiment, cut):
    s = cascade_signals(cascade, experiment)
    whole, branch = CascadeState(cascade).run(s)
    at, parts, state = cut * cascade.every, [], CascadeState(cascade)
    assume(at < s.samples)
    for part in (slice(0, at + 1), slice(at, None)):
        piece = dataclasses.replace(s, **{f.name: getattr(s, f.name)[part] for f in dataclasses.fields(s)})
        parts.append(state.run(piece)[0])
    for name in ("u1", "r2", "u2", "x"):
        np.testing.assert_array_equal(np.concatenate([p[name] for p in parts]), whole[name])
    np.testing.assert_array_equal(np.concatenate([parts[0]["y1"][:-1], parts[1]["y1"]]), whole["y1"])
    fresh = CascadeState(cascade)
    again = {name: np.empty_like(signal) for name, signal in whole.items()}
    codes = np.empty_like(branch)
    kernel.run_cascade.py_func(  # type: ignore[attr-defined]
        fresh.primary,
        fresh.secondary,
        fresh.chain,
        fresh.every,
        *(s.r, s.added, s.load, s.noise1, s.noise2),
        *(fresh.state1, fresh.state2, fresh.past2, fresh.link, fresh.tail),
        *(again[name] for name in ("y1", "u1", "r2", "y2", "u2", "x", "v")),
        codes,
    )
    for name, signal in whole.items():
        np.testing.assert_array_equal(again[name], signal)
    np.testing.assert_array_equal(codes, branch)


def test_the_primary_acts_every_nth_sample_and_is_held_between():
    run = wb.simulate(flow_and_temperature(every=5), STEP)
    scans = run.primary.op.reshape(-1, 5)
    assert (scans == scans[:, :1]).all()
    # Proportional, and one scan's integral step: 1.5 (5) (1 + 5/80).
    assert run.primary.op[0] == pytest.approx(1.5 * 5.0 * (1.0 + 5.0 / 80.0), rel=1e-12)
    np.testing.assert_array_equal(run.secondary.sp, run.primary.op)
    scaled = wb.simulate(flow_and_temperature(wb.PID(3.0, 80.0), scale=0.5), STEP)
    np.testing.assert_allclose(scaled.secondary.sp, run.secondary.sp, rtol=1e-12)
    np.testing.assert_array_equal(scaled.secondary.sp, 0.5 * scaled.primary.op)


def test_without_stiction_the_primary_settles_and_rejects_both_loads():
    loads = wb.CascadeExperiment(
        4000.0, setpoint=wb.Step(5.0), load=wb.Step(-3.0, at=1500.0), primary_load=wb.Step(2.0, at=2500.0)
    )
    run = wb.simulate(flow_and_temperature(valve=wb.Ideal()), loads)
    for time in (1499, 2499, 3999):
        assert run.primary.pv[time] == pytest.approx(5.0, abs=1e-3)
    # The flow that keeps the temperature is the same but for the load at its own plant, which is beyond the flow meter.
    assert run.secondary.pv[2499] == pytest.approx(5.0 / 1.2, abs=1e-3)
    assert run.secondary.pv[3999] == pytest.approx(5.0 / 1.2 - 2.0, abs=1e-3)
    assert run.secondary.op[2499] == pytest.approx(5.0 / 1.2 + 3.0, abs=1e-3)
    # A load at the valve is the secondary's to reject: the temperature hardly sees it.
    assert np.abs(run.primary.pv[1500:2500] - 5.0).max() < 0.4
    assert np.abs(run.primary.pv[2500:] - 5.0).max() > 0.6
    assert run.primary.kpis.settling_time < 1500.0


def test_a_saturated_secondary_holds_the_primarys_integral():
    limited = wb.PID(0.5, 5.0, output_limits=(-3.0, 3.0))
    steps = [wb.Step(5.0), wb.Step(-4.0, at=1500.0)]
    experiment = wb.Experiment(3000.0, setpoint=steps)
    runs = {
        how: wb.simulate(flow_and_temperature(secondary=limited, valve=wb.Ideal(), anti_windup=how), experiment)
        for how in ("clamp", "none")
    }
    # The valve at 3 % gives 3.6 EU of 5: the error of 1.4 EU lasts, and an integral that is not held runs away.
    for run in runs.values():
        assert (run.secondary.op[500:1500] == 3.0).all()
    held, wound = runs["clamp"].primary.op, runs["none"].primary.op
    assert held[1499] == pytest.approx(held[1000], abs=1e-5)
    slope = 1.5 * 5.0 / 80.0 * 1.4 / 5.0
    assert (wound[1499] - wound[999]) / 500.0 == pytest.approx(slope, rel=0.01)
    late = slice(1500, 1700)
    assert np.abs(runs["clamp"].primary.pv[late] - 1.0).sum() < 0.7 * np.abs(runs["none"].primary.pv[late] - 1.0).sum()


def test_the_sticky_valves_cycle_shows_in_both_loops():
    run = wb.simulate(flow_and_temperature(), wb.Experiment(5000.0, setpoint=wb.Step(5.0)))
    late = slice(2000, None)
    assert np.ptp(run.secondary.pv[late]) > 0.9
    assert np.ptp(run.secondary.sp[late]) > 0.05
    assert 0.01 < np.ptp(run.primary.pv[late]) < np.ptp(run.secondary.pv[late])
    assert run.secondary.kpis.valve_travel == pytest.approx(np.abs(np.diff(run.secondary.valve, prepend=0.0)).sum())


@pytest.mark.parametrize(
    ("make", "where"),
    [
        (lambda c: wb.Cascade(c.secondary, c.secondary), r"Cascade\.primary\.valve"),
        (lambda c: wb.Cascade("loop", c.secondary), r"Cascade\.primary"),
        (lambda c: dataclasses.replace(c, scale=0.0), r"Cascade\.scale"),
        (lambda c: dataclasses.replace(c, scale=math.nan), r"Cascade\.scale"),
        (lambda c: dataclasses.replace(c, anti_windup="back_calculation"), r"Cascade\.anti_windup"),
        (
            lambda c: dataclasses.replace(c, primary=dataclasses.replace(c.primary, sample_time=2.5)),
            r"Cascade\.primary\.sample_time",
        ),
        (
            lambda c: dataclasses.replace(c, primary=dataclasses.replace(c.primary, sample_time=0.5)),
            r"Cascade\.primary\.sample_time",
        ),
        (
            lambda c: dataclasses.replace(c, secondary=dataclasses.replace(c.secondary, fail_open=True)),
            r"Cascade\.secondary\.fail_open",
        ),
        (lambda c: dataclasses.replace(c, primary=dataclasses.replace(c.primary, scan=2)), r"Cascade\.primary\.scan"),
        (lambda c: wb.simulate(c, wb.Experiment(1002.0)), r"Experiment\.duration"),
        (lambda c: wb.simulate(c, wb.Experiment(1000.0, stem_offset=1.5)), r"Experiment\.stem_offset"),
        (lambda c: wb.simulate(c, "step"), "experiment"),
        (
            lambda c: wb.simulate(c.secondary, wb.CascadeExperiment(100.0, primary_load=wb.Step(1.0))),
            r"CascadeExperiment\.primary_load: .* beside a Loop",
        ),
        (
            lambda c: wb.tune(c.secondary, wb.CascadeExperiment(100.0, secondary_noise=wb.Noise(0.1))),
            r"CascadeExperiment\.secondary_noise: .* beside a Loop",
        ),
        (lambda _: wb.CascadeExperiment(100.0, secondary_noise=0.1), r"CascadeExperiment\.secondary_noise"),
        (lambda _: wb.CascadeExperiment(100.0, primary_load=wb.Step(1.0, 200.0)), r"CascadeExperiment\.primary_load"),
    ],
)
def test_what_is_no_cascade_or_does_not_fit_one_is_refused(make, where):
    with pytest.raises(wb.InvalidValue, match=where):
        make(flow_and_temperature())
