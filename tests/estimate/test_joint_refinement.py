"""The joint refinement: plants and disturbances of known truth, its intervals, and what it does where it cannot."""

from __future__ import annotations

import importlib
import math
import subprocess
import sys
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import workbench as wb
from workbench.cli.output import estimate_lines
from workbench.estimate.fits.data import centre
from workbench.estimate.fits.fit import Fit, Limits
from workbench.estimate.search.paths import Path
from workbench.model.results import Estimate
from workbench.model.study import NamedEstimate, Study
from workbench.report.results import results_content

# `wb.estimate`, the function, hides the folder of its name from a plain import.
joint = importlib.import_module("workbench.estimate.methods.joint")


def coloured(a: float, sd: float, n: int, seed: int) -> np.ndarray:
    """An AR(1) signal of standard deviation sd."""
    rng = np.random.default_rng(seed)
    out = np.zeros(n)
    out[0] = rng.normal(0.0, sd)
    for k in range(1, n):
        out[k] = a * out[k - 1] + rng.normal(0.0, sd * math.sqrt(1.0 - a * a))
    return out


@cache
def run_of(
    valve: wb.Stenman | wb.Choudhury | wb.Ideal,
    plant: wb.FOPDT | wb.Integrating,
    load: float = 0.0,
    sd: float = 0.0,
    seed: int = 0,
    samples: int = 800,
    Kc: float = 0.5,
) -> wb.simulate:
    steps = [wb.Step(4.0, 20.0), wb.Step(-6.0, 0.55 * samples)]
    loop = wb.Loop(plant, valve, wb.PID(Kc=Kc, Ti=20.0), 1.0)
    disturbance = wb.Series(tuple(coloured(0.9, load, samples, seed).tolist())) if load else None
    experiment = wb.Experiment(float(samples), setpoint=steps, load=disturbance, noise=wb.Noise(sd, seed))
    return wb.simulate(loop, experiment)


def record_of(*given: object, **kind: object) -> wb.Record:
    run = run_of(*given, **kind)
    return wb.Record(run.pv + 50.0, run.op + 40.0, 1.0, sp=run.sp + 50.0)


PLANT = wb.FOPDT(2.0, 6.0, 1.6)


def check(found: Estimate, record: wb.Record) -> None:
    """What every refined estimate keeps to."""
    assert found.method == "joint"
    assert found.prediction.shape == found.valve_position.shape == (len(record),)
    assert np.isfinite(found.prediction).all()
    assert np.isfinite(found.valve_position).all()
    assert found.residual_variance == pytest.approx(float(np.mean((record.pv - found.prediction) ** 2)))
    intervals = found.intervals
    for name, value in (
        ("gain", found.plant.gain),
        ("time_constant", getattr(found.plant, "time_constant", None)),
        ("dead_time", found.plant.dead_time),
        ("d", getattr(found.valve, "d", None)),
        ("S", getattr(found.valve, "S", None)),
    ):
        pair = getattr(intervals, name)
        assert pair is None or pair[0] <= value <= pair[1], name


def test_a_record_without_noise_gives_the_plant_itself() -> None:
    record = record_of(wb.Stenman(2.0), PLANT)
    found = wb.estimate(record, method="joint", plant="fopdt")
    check(found, record)
    assert found.verdict == "stiction"
    assert found.plant.gain == pytest.approx(2.0, rel=1e-3)
    assert found.plant.time_constant == pytest.approx(6.0, rel=1e-3)
    assert found.plant.dead_time == pytest.approx(1.6, abs=2e-3)
    assert found.noise_model is not None
    assert found.noise_model.ar == ()
    assert found.noise_model.drift_interval is None
    assert np.abs(found.prediction - record.pv).max() < 0.01


def test_disturbance_and_drift_that_were_added_are_found() -> None:
    run = run_of(wb.Stenman(2.0), PLANT, samples=400)
    n = coloured(0.8, 0.3, 400, 5)
    drift = 2.0 / 400.0
    record = wb.Record(run.pv + 50.0 + n + drift * run.time, run.op + 40.0, 1.0)
    found = wb.estimate(record, method="joint", valve="stenman", plant="fopdt")
    check(found, record)
    noise = found.noise_model
    assert noise is not None
    assert len(noise.ar) == 1
    assert noise.ar[0] == pytest.approx(0.8, abs=0.06)
    assert noise.innovation_sd == pytest.approx(0.3 * 0.6, rel=0.1)
    assert noise.drift_interval is not None
    assert noise.drift_interval[0] <= drift <= noise.drift_interval[1]
    assert noise.drift == pytest.approx(drift, rel=0.5)
    # The disturbance is no part of the model's prediction; PV is met within it.
    assert found.noise_sd == pytest.approx(0.3, rel=0.2)
    lines = "\n".join(estimate_lines(found))
    assert "autoregressive, coefficients 0.7" in lines or "autoregressive, coefficients 0.8" in lines
    assert "PV drifts by" in lines
    named = NamedEstimate("loop", found)
    content = results_content(Study("s", "", "", "", None, None, (named,), ()))["estimate"]
    assert content["noise_model"]["ar"] == noise.ar


def test_under_a_coloured_load_the_plant_is_near_and_the_intervals_hold() -> None:
    # In closed loop OP carries the load: with a white disturbance the same fit is biased.
    truth = {"gain": 2.0, "time_constant": 6.0, "dead_time": 1.6}
    record = record_of(wb.Stenman(1.5), PLANT, load=0.3, sd=0.05, samples=500)
    found = wb.estimate(record, method="joint", valve="stenman", plant="fopdt")
    check(found, record)
    assert found.noise_model is not None
    assert found.noise_model.ar
    pairs = [getattr(found.intervals, name) for name in truth]
    assert all(low <= true <= high for (low, high), true in zip(pairs, truth.values(), strict=True))
    # The same path and start with a disturbance of order 0.
    data = centre(record, "fopdt")
    x = found.valve_position - data.op_middle
    fit = Fit(0.0, 6.0, 1.6, 2.0, 0.0, 2.0 * float(x[0]), 0.0)
    path = Path(found.valve, x, 0, (-math.inf, math.inf), fit, found.slips)
    program = joint._Program(data, Limits((0.05, 500.0), (0.0, 30.0)))
    plain = program.solve(joint.Refined(path, fit, 0.0, (), False, math.inf), 0, False)[0].fit

    def error(time_constant: float, dead_time: float) -> float:
        return abs(time_constant / 6.0 - 1.0) + abs(dead_time - 1.6) / 6.0

    assert error(found.plant.time_constant, found.plant.dead_time) < min(0.06, 0.5 * error(plain.tau, plain.theta))


def test_an_integrating_plant_and_a_two_parameter_valve_are_refined_too() -> None:
    plant = wb.Integrating(0.05, 2.4)
    record = record_of(wb.Choudhury(3.0, 1.0), plant, sd=0.02, Kc=0.8)
    found = wb.estimate(record, method="joint", plant="integrating", valve="choudhury")
    check(found, record)
    assert isinstance(found.plant, wb.Integrating)
    assert isinstance(found.valve, wb.Choudhury)
    assert found.plant.gain == pytest.approx(0.05, rel=0.05)
    assert found.plant.dead_time == pytest.approx(2.4, abs=0.5)
    assert abs(found.valve.S - 3.0) < 0.3
    assert found.noise_model is not None
    assert found.noise_model.drift == 0.0


def test_without_stiction_the_linear_model_is_refined() -> None:
    record = record_of(wb.Ideal(), PLANT, load=0.5, sd=0.02, seed=11, samples=400)
    plain, found = (
        wb.estimate(record, method=method, valve="linear", plant="fopdt") for method in ("profile", "joint")
    )
    check(found, record)
    assert isinstance(found.valve, wb.Ideal)
    assert found.verdict == plain.verdict
    assert found.slips == 0
    np.testing.assert_array_equal(found.valve_position, record.op)
    assert found.plant.gain == pytest.approx(2.0, rel=0.1)
    assert found.plant.time_constant == pytest.approx(6.0, rel=0.15)
    assert found.plant.dead_time == pytest.approx(1.6, abs=0.3)
    # Both find the colour of the load together with the plant.
    for one in (plain, found):
        assert abs(one.plant.time_constant - 6.0) + abs(one.plant.dead_time - 1.6) < 0.06


def test_a_long_record_is_refined_on_its_most_active_stretch(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(joint, "LONGEST", 500)
    record = record_of(wb.Stenman(2.0), PLANT, sd=0.05, samples=1100)
    found = wb.estimate(record, method="joint", valve="stenman", plant="fopdt")
    check(found, record)
    assert any("the joint refinement used its samples" in reason for reason in found.reasons)
    assert found.plant.gain == pytest.approx(2.0, rel=0.02)
    assert found.plant.time_constant == pytest.approx(6.0, rel=0.05)
    assert found.noise_sd == pytest.approx(0.05, rel=0.2)


def test_where_no_program_is_solved_the_profile_stands(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(joint, "OPTIONS", replace(joint.OPTIONS, max_iterations=0))
    record = record_of(wb.Stenman(2.0), PLANT, sd=0.05)
    plain, found = (
        wb.estimate(record, method=method, valve="stenman", plant="fopdt") for method in ("profile", "joint")
    )
    assert found.plant == plain.plant
    assert found.noise_model is None
    assert "iteration limit" in found.reasons[-1]


def test_ctrl_c_stops_the_refinement(monkeypatch: pytest.MonkeyPatch) -> None:
    stopped = joint.SolveStatus.INTERRUPTED
    solve = joint.Solver.solve
    monkeypatch.setattr(joint.Solver, "solve", lambda self, values: replace(solve(self, values), status=stopped))
    with pytest.raises(KeyboardInterrupt):
        wb.estimate(record_of(wb.Stenman(2.0), PLANT, sd=0.05), method="joint", valve="stenman", plant="fopdt")


@given(partial=st.lists(st.floats(-0.998, 0.998), max_size=4))
def test_every_disturbance_is_stationary(partial: list[float]) -> None:
    a = joint._coefficients(partial)
    assert len(a) == len(partial)
    assert np.abs(np.roots([1.0, *(-v for v in a)])).max(initial=0.0) < 1.0
    if partial:
        assert a[-1] == partial[-1]


@settings(max_examples=3)
@given(kinds=st.tuples(*[st.sampled_from(["noise", "walk", "spike", "steps", "sine"])] * 2), seed=st.integers(0, 50))
def test_adversarial_records_are_refined_or_left(kinds: tuple[str, str], seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = 30
    made = {
        "noise": rng.normal(0.0, 1.0, n),
        "walk": np.cumsum(rng.normal(0.0, 1.0, n)),
        "spike": np.where(np.arange(n) == rng.integers(0, n), 1e6, 0.0),
        "steps": np.repeat(rng.normal(0.0, 2.0, n // 10), 10),
        "sine": np.sin(2.0 * np.pi * np.arange(n) / 17.0),
    }
    record = wb.Record(made[kinds[0]], made[kinds[1]], 2.0)
    found = wb.estimate(record, method="joint", plant="fopdt")
    assert np.isfinite(found.prediction).all()
    assert found.verdict in ("stiction", "no_stiction", "undecided")


def test_other_methods_load_neither_casadi_nor_what_else_takes_long() -> None:
    code = (
        "import sys, numpy as np, workbench as wb; k = np.arange(30.0); "
        "wb.estimate(wb.Record(np.sin(k / 5.0), np.cos(k / 5.0), 1.0), plant='fopdt', valve='stenman'); "
        "assert not {'casadi', 'scipy.signal', 'scipy.stats', 'matplotlib'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=120)
