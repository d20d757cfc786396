"""The value types: what they accept, keep, and refuse in one clear sentence."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

import workbench as wb

NAN = math.nan


@pytest.mark.parametrize(
    ("build", "where", "allowed"),
    [
        (lambda: wb.FOPDT(0.0, 5.0), "FOPDT.gain", "must not be 0"),
        (lambda: wb.FOPDT(NAN, 5.0), "FOPDT.gain", "finite"),
        (lambda: wb.FOPDT(1.0, 0.0), "FOPDT.time_constant", "> 0"),
        (lambda: wb.FOPDT(1.0, 5.0, -1.0), "FOPDT.dead_time", ">= 0"),
        (lambda: wb.FOPDT(True, 5.0), "FOPDT.gain", "number"),
        (lambda: wb.FOPDT("1", 5.0), "FOPDT.gain", "number"),
        (lambda: wb.Integrating(math.inf), "Integrating.gain", "finite"),
        (lambda: wb.Stenman(-1.0), "Stenman.d", ">= 0"),
        (lambda: wb.Choudhury(1.0, -0.1), "Choudhury.J", ">= 0"),
        (lambda: wb.Deadband(NAN), "Deadband.b", "finite"),
        (lambda: wb.He(-1.0, 0.0), "He.fs", ">= 0"),
        (lambda: wb.He(1.0, 1.1), "He.fd", "at most fs"),
        (lambda: wb.Kano(1.0, NAN), "Kano.J", "finite"),
        (lambda: wb.Kano(1.0, 1.1), "Kano.J", "at most S"),
        (lambda: wb.Directional(wb.Choudhury(1.0, 1.0), wb.Stenman(1.0)), "Directional.down", "Choudhury"),
        (lambda: wb.Directional(wb.Choudhury(1.0, 0.0), wb.Choudhury(0.5, 2.0)), "Directional.down", "at most 1.5 %"),
        (lambda: wb.PID(-1.0, 5.0), "PID.Kc", "direct"),
        (lambda: wb.PID(10**400, 5.0), "PID.Kc", "finite"),
        (lambda: wb.PID(1.0, 0.0), "PID.Ti", "> 0"),
        (lambda: wb.PID(1.0, 5.0, -1.0), "PID.Td", ">= 0"),
        (lambda: wb.PID(1.0, 5.0, form="isa"), "PID.form", "ideal, series, parallel"),
        (lambda: wb.PID(1.0, 5.0, derivative_on="sp"), "PID.derivative_on", "error, pv"),
        (lambda: wb.PID(1.0, 5.0, derivative_filter=0.0), "PID.derivative_filter", "> 0"),
        (lambda: wb.PID(1.0, 5.0, setpoint_weight=1.5), "PID.setpoint_weight", "<= 1"),
        (lambda: wb.PID(1.0, 5.0, action="up"), "PID.action", "reverse, direct"),
        (lambda: wb.PID(1.0, 5.0, output_limits=(5.0, 1.0)), "PID.output_limits", "low < high"),
        (lambda: wb.PID(1.0, 5.0, output_limits=(1.0, 5.0)), "PID.output_limits", "enclose 0"),
        (lambda: wb.PID(1.0, 5.0, output_limits=3.0), "PID.output_limits", "pair"),
        (lambda: wb.PID(1.0, 5.0, anti_windup="none"), "PID.anti_windup", "clamp"),
        (lambda: wb.PID(1.0, 5.0, tracking_time=0.0), "PID.tracking_time", "> 0"),
        (lambda: wb.Step(NAN), "Step.size", "finite"),
        (lambda: wb.Step(1.0, at=-1.0), "Step.at", ">= 0"),
        (lambda: wb.Ramp(1.0, 5.0, 5.0), "Ramp.end", "after the start"),
        (lambda: wb.Series([]), "Series.values", "at least one"),
        (lambda: wb.Series("12"), "Series.values", "sequence"),
        (lambda: wb.Series([1.0, NAN]), r"Series.values\[1\]", "finite"),
        (lambda: wb.Series([1.0], times=[0.0, 1.0]), "Series.times", "as many"),
        (lambda: wb.Series([1.0, 2.0], times=[1.0, 1.0]), r"Series.times\[1\]", "after the time before"),
        (lambda: wb.Noise(-0.1), "Noise.sd", ">= 0"),
        (lambda: wb.Noise(0.1, seed=-1), "Noise.seed", "whole number"),
        (lambda: wb.Noise(0.1, seed=1.5), "Noise.seed", "whole number"),
        (lambda: wb.Experiment(0.0), "Experiment.duration", "> 0"),
        (lambda: wb.Experiment(10.0, setpoint=4.0), "Experiment.setpoint", "Step, Ramp or Series"),
        (lambda: wb.Experiment(10.0, setpoint=[4.0]), "Experiment.setpoint", "Step, Ramp or Series"),
        (lambda: wb.Experiment(10.0, load=wb.Step(1.0, at=11.0)), "Experiment.load", "within"),
        (lambda: wb.Experiment(10.0, noise=0.1), "Experiment.noise", "Noise"),
        (lambda: wb.Objective(w1=-1.0), "Objective.w1", ">= 0"),
        (lambda: wb.Objective(0.0, 0.0, 0.0, 0.0), "Objective", "at least one"),
        (lambda: wb.Bounds(Kc=(2.0, 1.0)), "Bounds.Kc", "low <= high"),
        (lambda: wb.Bounds(Ti=(0.0, 10.0)), "Bounds.Ti", "above 0"),
        (lambda: wb.Bounds(Td=(0.0, NAN)), r"Bounds.Td\[1\]", "finite"),
        (lambda: wb.Bounds(Kc=(1.0,)), "Bounds.Kc", "pair"),
        (lambda: wb.Loop(wb.Stenman(1.0), wb.Ideal(), wb.PID(1.0, 5.0), 1.0), "Loop.plant", "FOPDT"),
        (lambda: wb.Loop(wb.FOPDT(1.0, 5.0), None, wb.PID(1.0, 5.0), 1.0), "Loop.valve", "valve"),
        (lambda: wb.Loop(wb.FOPDT(1.0, 5.0), wb.Ideal(), 1.0, 1.0), "Loop.controller", "PID"),
        (lambda: wb.Loop(wb.FOPDT(1.0, 5.0), wb.Ideal(), wb.PID(1.0, 5.0), 0.0), "Loop.sample_time", "> 0"),
        (
            lambda: wb.Loop(wb.FOPDT(1, 5, 1e9), wb.Ideal(), wb.PID(1, 5), 1),
            "Loop.plant.dead_time",
            "at most 1,000,000",
        ),
        (lambda: wb.Record(pv=[1.0, NAN], op=[1.0, 1.0], sample_time=1.0), r"Record.pv\[1\]", "finite"),
        (lambda: wb.Record(pv=[1.0], op=[1.0, 1.0], sample_time=1.0), "Record.op", "samples of PV"),
        (lambda: wb.Record(pv=[], op=[], sample_time=1.0), "Record.pv", "at least one"),
        (lambda: wb.Record(pv=[[1.0]], op=[1.0], sample_time=1.0), "Record.pv", "one dimension"),
        (lambda: wb.Record(pv=["a"], op=[1.0], sample_time=1.0), "Record.pv", "numbers"),
        (lambda: wb.Record(pv=["1.5"], op=[1.0], sample_time=1.0), "Record.pv", "real numbers"),
        (lambda: wb.Record(pv=[1.0 + 2.0j], op=[1.0], sample_time=1.0), "Record.pv", "real numbers"),
        (lambda: wb.Record(pv=[1.0], op=np.array([True]), sample_time=1.0), "Record.op", "real numbers"),
        (lambda: wb.Record(pv=[1.0], op=np.array([True], dtype=object), sample_time=1.0), "Record.op", "real numbers"),
        (lambda: wb.Record(pv=[1.0], op=np.array(["1"], dtype=object), sample_time=1.0), "Record.op", "real numbers"),
        (lambda: wb.Record(pv=[1.0, None], op=[1.0, 1.0], sample_time=1.0), r"Record.pv\[1\]", "finite"),
        (lambda: wb.Record(pv=[1.0], op=[1.0], sample_time=1.0, mode=("AUTO", "MAN")), "Record.mode", "samples of PV"),
        (lambda: wb.Record(pv=[1.0], op=[1.0], sample_time=1.0, mode=5), "Record.mode", "a sequence of texts"),
        (
            lambda: wb.Record(pv=[1.0], op=[1.0], sample_time=1.0, rest=5),
            "Record.rest",
            "a sequence, each a Record",
        ),
        (lambda: wb.Record(pv=[1.0], op=[1.0], sample_time=1.0, rest="abc"), "Record.rest", "a Record"),
        (lambda: wb.Record(pv=[1.0], op=[1.0], sample_time=1.0, rest=(5,)), r"Record.rest\[0\]", "a Record"),
        (lambda: wb.Record(pv=[1.0], op=[1.0], sample_time=1.0, notes="abc"), "Record.notes", "a text"),
        (lambda: wb.Record(pv=[1.0], op=[1.0], sample_time=1.0, counts=5), "Record.counts", "a mapping"),
        (lambda: wb.read_record(None), "path", "must be the path of a CSV or Parquet file"),
        (lambda: wb.read_record(5), "path", "must be the path of a CSV or Parquet file"),
        (lambda: wb.read_record(b"x"), "path", "must be the path of a CSV or Parquet file"),
        (lambda: wb.read_record(""), "path", "must be the path of a CSV or Parquet file"),
        (lambda: wb.load_scenario(5), "path", "must be the path of a scenario file"),
        (lambda: wb.load_scenario(""), "path", "must be the path of a scenario file"),
        (lambda: wb.run_scenario(5), "scenario", "must be a Scenario or the path of a scenario file"),
    ],
)
def test_what_is_not_allowed_is_refused_with_where_given_and_allowed(build, where, allowed):
    with pytest.raises(wb.InvalidValue, match=rf"^{where}: .* given; .*{allowed}") as caught:
        build()
    assert isinstance(caught.value, ValueError)
    assert isinstance(caught.value, wb.WorkbenchError)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("kind", [np.float64, np.float32, np.int64, np.uint8, object])
def test_masked_values_of_a_record_are_missing(kind):
    values = np.arange(4).astype(kind)
    with pytest.raises(wb.InvalidValue, match=r"^Record\.pv\[2\]: nan given; must be a finite number$"):
        wb.Record(pv=np.ma.masked_array(values, values == 2), op=values, sample_time=1.0)
    assert wb.Record(pv=np.ma.masked_array(values), op=values, sample_time=1.0).pv.tolist() == [0.0, 1.0, 2.0, 3.0]


def test_a_masked_array_of_truth_values_is_none_of_numbers():
    masked = np.ma.masked_array([True, False], [True, False])
    with pytest.raises(wb.InvalidValue, match=r"^Record\.pv: MaskedArray of bool given; must be an array of real"):
        wb.Record(pv=masked, op=[1.0, 2.0], sample_time=1.0)


def test_values_are_frozen_comparable_and_hashable():
    loop = wb.Loop(wb.FOPDT(1, 5, 1), wb.Stenman(2), wb.PID(1, 20), 1)
    assert loop == wb.Loop(wb.FOPDT(1.0, 5.0, 1.0), wb.Stenman(2.0), wb.PID(1.0, 20.0), 1.0)
    assert isinstance(loop.plant.gain, float)
    assert hash(loop) == hash(dataclasses.replace(loop))
    with pytest.raises(dataclasses.FrozenInstanceError):
        loop.sample_time = 2.0
    experiment = wb.Experiment(10.0, setpoint=[wb.Step(1.0), wb.Step(2.0, at=3.0)])
    assert hash(experiment) == hash(wb.Experiment(10.0, setpoint=(wb.Step(1.0), wb.Step(2.0, at=3.0))))
    assert wb.Experiment(10.0, setpoint=wb.Step(4.0)).setpoint == wb.Step(4.0)


def test_numpy_scalars_are_numbers():
    assert wb.FOPDT(np.float64(2.0), np.int64(5)).time_constant == 5.0
    assert wb.Noise(0.1, seed=np.int64(3)).seed == 3


def test_valves_know_band_jump_and_hold():
    for valve, figures in [
        (wb.Ideal(), (0.0, 0.0, 0.0)),
        (wb.Stenman(2.0), (2.0, 2.0, 2.0)),
        (wb.Choudhury(5.0, 1.0), (5.0, 1.0, 3.0)),
        (wb.Deadband(3.0), (3.0, 0.0, 1.5)),
        (wb.He(4.0, 1.0), (5.0, 3.0, 4.0)),
        (wb.Kano(5.0, 1.0), (5.0, 1.0, 1.0)),
        (wb.Directional(wb.Choudhury(5.0, 1.0), wb.Deadband(3.0)), (4.0, 0.0, 1.5)),
    ]:
        assert (valve.stick_band, valve.slip_jump, valve.hold) == figures


def test_a_record_owns_its_arrays():
    pv = np.array([1.0, 2.0, 3.0])
    record = wb.Record(pv=pv, op=[1, 2, 3], sample_time=10.0, start=5.0, counts={"rows": 3})
    pv[0] = 99.0
    assert record.pv[0] == 1.0
    assert len(record) == 3
    np.testing.assert_array_equal(record.time, [5.0, 15.0, 25.0])
    with pytest.raises(ValueError, match="read-only"):
        record.pv[0] = 2.0
    with pytest.raises(TypeError):
        record.counts["rows"] = 4


def test_bounds_know_what_they_contain():
    bounds = wb.Bounds(Td=(0.0, 0.0))
    assert bounds.contains(wb.PID(0.5, 20.0))
    assert not bounds.contains(wb.PID(0.5, 4.0))
    assert not bounds.contains(wb.PID(0.5, 20.0, 1.0))


def test_coarse_sampling_is_noted():
    pid, valve = wb.PID(1.0, 5.0), wb.Ideal()
    assert wb.Loop(wb.FOPDT(1.0, 5.0, 1.0), valve, pid, 1.0).sampling_note() is None
    assert wb.Loop(wb.FOPDT(1.0, 5.0), valve, pid, 1.0).sampling_note() is None
    assert "time constant (5 s)" in (wb.Loop(wb.FOPDT(1.0, 5.0), valve, pid, 10.0).sampling_note() or "")
    assert "dead time (1 s)" in (wb.Loop(wb.Integrating(1.0, 1.0), valve, pid, 2.0).sampling_note() or "")


def test_a_profile_of_one_part_is_the_same_in_a_list_as_by_itself():
    alone = wb.Experiment(10.0, setpoint=wb.Step(1.0), load=wb.Ramp(1.0, 2.0, 5.0))
    listed = wb.Experiment(10.0, setpoint=[wb.Step(1.0)], load=(wb.Ramp(1.0, 2.0, 5.0),))
    assert listed == alone
    assert hash(listed) == hash(alone)
    assert listed.setpoint_parts == alone.setpoint_parts == (wb.Step(1.0),)
    assert wb.Experiment(10.0, setpoint=[]) == wb.Experiment(10.0)
