"""`wb.detect`: verdicts on simulated and real loops, other causes in words, and bad records."""

from __future__ import annotations

import importlib
import math
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import workbench as wb
from workbench.detect import stem
from workbench.detect.detect import _cycle_said
from workbench.detect.stem import _starts, stem_test
from workbench.detect.verdict import Thresholds, accuses, decide, follows
from workbench.model.detection import Oscillation, StemEvidence, StemTest

RECORDS = Path(os.environ.get("WORKBENCH_RECORDS", Path(__file__).resolve().parents[2].parent / "shared" / "data"))
QUIET = Oscillation(0.0, math.nan, 0.0, 0.0)
FOUND = StemTest(
    predicting=200.0,
    loaded=200.0,
    waved=200.0,
    turned=50.0,
    squares=0.0,
    improvement=0.18,
    likelihood=200.0,
    simulated=0.4,
    adds=100.0,
    sure=100.0,
    instead=0.0,
    wide=200.0,
    wide_from=1.0,
    left=0.05,
    unexplained=0.3,
    unfollowed=0.06,
    band=2.0,
    jump=1.0,
    moves=40,
    samples=1000,
    time_constant=5.0,
    dead_time=1.0,
)
LINEAR = replace(FOUND, predicting=0.0, improvement=0.0, likelihood=0.0, simulated=0.0, adds=0.0, sure=0.0, wide=-50.0)


def run_of(valve: object, *, seed: int = 1, plant: object = None, load: float = 0.3, n: int = 1200) -> wb.Record:
    rng = np.random.default_rng(seed)
    drift = np.cumsum(rng.normal(size=n)) * load / math.sqrt(n)
    loop = wb.Loop(plant or wb.FOPDT(2.0, 5.0, 1.0), valve, wb.PID(Kc=0.5, Ti=15.0), 1.0)
    run = wb.simulate(
        loop, wb.Experiment(float(n), load=wb.Series(drift), noise=wb.Noise(0.1, seed), setpoint=wb.Step(3.0))
    )
    return wb.Record(run.pv + 50.0, run.op + 40.0, 1.0, sp=run.sp + 50.0)


@pytest.mark.parametrize("valve", [wb.Stenman(2.0), wb.Choudhury(2.0, 2.0), wb.Choudhury(3.0, 1.0)])
def test_a_sticky_valve_is_found(valve: object) -> None:
    found = wb.detect(run_of(valve))
    assert found.verdict == "stiction"
    assert found.test is not None
    assert found.test.predicting > 100.0
    assert found.test.band == pytest.approx(2.0 if valve != wb.Choudhury(3.0, 1.0) else 3.0, rel=0.1)
    assert any("sticks" in reason for reason in found.reasons)


def test_the_search_finds_the_stem_that_a_load_hides() -> None:
    # A slow load of the stick band's size: OP itself explains nothing of PV, and the true stem is hard to better.
    rng = np.random.default_rng(5)
    drift = np.cumsum(rng.normal(size=1500)) * 0.05
    loop = wb.Loop(wb.FOPDT(2.0, 5.0, 1.0), wb.Choudhury(3.0, 1.0), wb.PID(Kc=0.5, Ti=15.0), 1.0)
    run = wb.simulate(loop, wb.Experiment(1500.0, load=wb.Series(drift), noise=wb.Noise(0.1, 1)))
    record = wb.Record(run.pv, run.op, 1.0, sp=run.sp)
    found, told = wb.detect(record), wb.detect(record, fitted=(wb.Choudhury(3.0, 1.0), run.valve))
    assert found.verdict == "stiction"
    assert found.test is not None
    assert told.test is not None
    assert found.test.predicting >= 0.6 * told.test.predicting
    assert found.test.band == pytest.approx(3.0, rel=0.15)


@pytest.mark.parametrize("seed", range(2))
def test_a_sinusoidal_load_on_a_level_is_no_stiction(seed: int) -> None:
    wave = 3.0 * np.sin(2.0 * math.pi * np.arange(900) / (50.0 + 9.0 * seed))
    loop = wb.Loop(wb.Integrating(0.02, 4.0), wb.Ideal(), wb.PID(Kc=3.0, Ti=80.0), 1.0)
    run = wb.simulate(loop, wb.Experiment(900.0, load=wb.Series(wave), noise=wb.Noise(0.05, seed)))
    assert wb.detect(wb.Record(run.pv, run.op, 1.0, sp=run.sp)).verdict != "stiction"


@pytest.mark.parametrize("seed", range(2))
def test_a_healthy_valve_is_not_accused(seed: int) -> None:
    assert wb.detect(run_of(wb.Ideal(), seed=seed, load=2.0)).verdict != "stiction"


def test_noise_is_hardly_ever_called_stiction() -> None:
    # The likelihood's threshold lets about one in a hundred through, most of it in slow noise.
    accused = 0
    for seed, smooth in [(30858, 25), *((k, 1 + k) for k in range(0, 30, 3))]:
        rng = np.random.default_rng(seed)
        pv, op = (np.convolve(rng.normal(size=400), np.ones(smooth), "same") for _ in range(2))
        found = wb.detect(wb.Record(pv, op, 1.0))
        accused += found.verdict == "stiction"
        assert found.reasons
    assert accused == 0


def test_scaling_and_shifting_change_nothing() -> None:
    record = run_of(wb.Stenman(2.0))
    other = wb.Record(7.0 * record.pv - 3.0, record.op + 11.0, 60.0, sp=7.0 * record.sp - 3.0)
    first, second = wb.detect(record), wb.detect(other)
    assert first.verdict == second.verdict
    assert second.test.likelihood == pytest.approx(first.test.likelihood, rel=1e-3)
    assert second.test.time_constant == pytest.approx(60.0 * first.test.time_constant, rel=1e-3)


def test_stretches_that_nobody_recorded_do_not_count() -> None:
    record = run_of(wb.Stenman(2.0))
    pv, op = record.pv.copy(), record.op.copy()
    for first in (200, 500, 900):
        pv[first : first + 40], op[first : first + 40] = pv[first], op[first]
    held = stem_test(pv, op, None, 1.0, math.nan, 1.0)
    assert held.samples < 1200 - 3 * 39
    assert wb.detect(wb.Record(pv, op, 1.0, sp=record.sp)).verdict == "stiction"


def test_a_long_record_is_looked_at_in_stretches() -> None:
    record = run_of(wb.Stenman(2.0), n=9600)
    found = wb.detect(record)
    assert found.verdict == "stiction"
    assert 0 < found.test.samples <= 9000


@pytest.mark.parametrize(
    ("sures", "sure"), [([45.0, 0.3, 0.1], 0.3), ([16.0, 27.0, 28.0], 27.0), ([320.0, 39.0], 39.0), ([31.0], 31.0)]
)
def test_the_clearest_of_several_stretches_accuses_nobody(monkeypatch, sures: list[float], sure: float) -> None:
    """Each stretch is searched anew, and what another loop sends may look like a stem for a while."""
    stretches = iter([replace(FOUND, sure=one, likelihood=0.0, predicting=0.0) for one in sures])
    monkeypatch.setattr(stem, "_stretch", lambda *_: next(stretches))
    pv = np.random.default_rng(0).normal(size=3000 * len(sures))
    test = stem_test(pv, -pv, None, 1.0, math.nan, 1.0)
    assert test.sure == pytest.approx(sure)
    assert accuses(test) == (sure >= 20.0)


def test_a_recorded_stem_decides() -> None:
    record = run_of(wb.Ideal())
    follows = replace(record, valve_position=record.op)
    assert wb.detect(follows).verdict == "no_stiction"
    assert "it follows" in wb.detect(follows).reasons[0]


ALONE = {"sure": 0.0, "adds": 0.0}
LITTLE = {"unexplained": 0.04, "wide": -5.0}
TWO = {"improvement": 0.0, "likelihood": 0.0, "simulated": 0.01, "predicting": 31.0, "sure": 31.0}
SMOOTH = {**LITTLE, "improvement": 0.0, "likelihood": 0.0}


@pytest.mark.parametrize(
    ("changed", "verdict"),
    [
        ({}, "stiction"),
        # By two rivals alone: enough; a little less of either.
        (TWO, "stiction"),
        ({"improvement": 0.0, "likelihood": 0.0, "simulated": 0.01, "predicting": 35.0, "sure": 19.0}, "undecided"),
        # A stem that moves seldom is asked for more.
        ({**TWO, "sure": 20.1, "moves": 9}, "stiction"),
        ({**TWO, "sure": 29.9, "moves": 8}, "undecided"),
        ({**TWO, "sure": 30.1, "moves": 8}, "stiction"),
        # PV's own turns do better.
        ({**TWO, "turned": 0.0}, "stiction"),
        ({**TWO, "turned": -0.1}, "undecided"),
        # A curved plant is no linear one either: no stem makes PV as it is.
        ({"improvement": 0.0, "likelihood": 0.0, "simulated": -0.01, "predicting": 31.0, "sure": 31.0}, "undecided"),
        # Too smooth for the simulated PV to show it.
        ({**SMOOTH, "simulated": 0.049, "predicting": 31.0, "sure": 31.0}, "no_stiction"),
        ({**SMOOTH, "simulated": 0.049, "predicting": 31.0, "sure": 31.0, "instead": 40.1}, "undecided"),
        ({**SMOOTH, "simulated": 0.049, "predicting": 31.0, "sure": 31.0, "instead": 39.9}, "no_stiction"),
        # Both rivals and the simulated PV speak for it: no acquittal, however little is left.
        ({**SMOOTH, "simulated": 0.051, "predicting": 31.0, "sure": 16.1}, "undecided"),
        ({**SMOOTH, "simulated": 0.051, "predicting": 31.0, "sure": 15.9}, "no_stiction"),
        ({**SMOOTH, "simulated": 0.051, "predicting": 31.0, "sure": 16.1, "turned": -0.1}, "no_stiction"),
        # By prediction and simulation together: the stem must add to the free predictor too.
        ({"predicting": 39.0, "sure": 15.0, "adds": 11.0}, "stiction"),
        ({"predicting": 39.0, "sure": 15.0, "adds": 9.0}, "undecided"),
        ({"predicting": 30.0, "likelihood": 26.0, "sure": 10.0}, "undecided"),
        # The linear loop leaves little: the stem must explain most of it.
        ({"unexplained": 0.04, "improvement": 0.1, "simulated": 0.3, "sure": 0.0}, "undecided"),
        ({**LITTLE, "improvement": 0.03, "likelihood": 30.0, "sure": 0.0, "adds": 19.9}, "no_stiction"),
        # It adds to the free predictor and to the simulated PV: a filter may hide how it slips.
        ({**LITTLE, "improvement": 0.03, "likelihood": 30.0, "sure": 0.0, "adds": 20.1}, "undecided"),
        (
            {**LITTLE, "improvement": 0.03, "likelihood": 30.0, "sure": 0.0, "adds": 20.1, "simulated": 0.24},
            "no_stiction",
        ),
        ({"unexplained": 0.04, "improvement": 0.1, "simulated": 0.6, "sure": 0.0}, "stiction"),
        # Or better both rivals by far, and the simulated PV.
        ({**LITTLE, "improvement": 0.03, "simulated": 0.051, "sure": 40.1}, "stiction"),
        ({**LITTLE, "improvement": 0.03, "simulated": 0.051, "sure": 39.9}, "undecided"),
        ({**LITTLE, "improvement": 0.03, "likelihood": 30.0, "simulated": 0.049, "sure": 31.9}, "no_stiction"),
        ({**LITTLE, "improvement": 0.03, "simulated": 0.049, "sure": 40.1}, "undecided"),
        ({**LITTLE, "improvement": 0.03, "simulated": 0.051, "sure": 40.1, "turned": -0.1}, "undecided"),
        # A curve shows, and the stem adds no more than chance beside it.
        ({"squares": 40.1, "adds": 9.9}, "undecided"),
        ({"squares": 39.9, "adds": 9.9}, "stiction"),
        ({"squares": 40.1, "adds": 10.1}, "stiction"),
        # By prediction alone: enough; a little less; many samples, of which it explains too little.
        ({**ALONE, "simulated": -1.0}, "stiction"),
        ({**ALONE, "simulated": -1.0, "predicting": 70.0}, "undecided"),
        ({**ALONE, "simulated": -1.0, "samples": 5000}, "undecided"),
        ({**ALONE, "simulated": -1.0, "moves": 2, "loaded": 39.0}, "undecided"),
        ({**ALONE, "simulated": -1.0, "moves": 2, "loaded": 41.0}, "stiction"),
        # Stems as wide are excluded: whose slips no search from OP meets is PV's own. A narrower one is no such stem.
        ({**ALONE, "simulated": -1.0, "wide": -3.9}, "undecided"),
        ({**ALONE, "simulated": -1.0, "wide": -3.8}, "stiction"),
        ({**ALONE, "simulated": -1.0, "wide": -3.9, "band": 0.9}, "stiction"),
    ],
)
def test_stiction_is_found_by_any_of_three_routes(changed: dict[str, float], verdict: str) -> None:
    assert decide(QUIET, replace(FOUND, **changed), None)[0] == verdict


def test_load_steps_that_are_not_clearly_worse_are_told() -> None:
    _, reasons = decide(QUIET, replace(FOUND, sure=0.0, adds=0.0, simulated=-1.0, moves=2, loaded=39.0), None)
    assert "moved 2 times only, and a linear loop under as few load steps or ramps is not clearly worse" in reasons[0]


def test_what_a_stem_makes_worse_is_more_and_not_less() -> None:
    _, reasons = decide(QUIET, replace(FOUND, improvement=-0.231, likelihood=0.0, simulated=-0.08, sure=31.0), None)
    assert "the stem that fits best throughout leaves 23.1% more unpredicted" in reasons[1]
    assert "and 8% more of simulated PV" in reasons[1]
    assert "leaves 18.1% less of PV unpredicted" in reasons[0]
    assert "0.0% less unpredicted" in decide(QUIET, replace(FOUND, improvement=-1e-5, sure=31.0), None)[1][1]


def test_an_op_that_hardly_ever_moves_tells_nothing() -> None:
    k = np.arange(600)
    pv = np.sin(2.0 * np.pi * k / 40.0) + 0.05 * np.random.default_rng(0).normal(size=600)
    for op, often in ((k >= 300, "once"), (k == 300, "2 times")):
        found = wb.detect(wb.Record(pv, 40.0 + op, 1.0))
        assert found.verdict == "undecided"
        assert f"OP moved {often} only in 600 samples" in found.reasons[0]


def test_a_slow_cycle_is_told_in_whole_seconds() -> None:
    (said,) = _cycle_said(Oscillation(0.6, 1290.0, 5.0, 40.0), True, 0.0)
    assert said == "PV oscillates with a period of 1,290 s (index 0.60)"


CYCLING = Oscillation(0.6, 20.0, 5.0, 40.0)


@pytest.mark.parametrize(
    ("cycle", "changed", "verdict", "why"),
    [
        # A wide stem is excluded, whether PV cycles or not.
        (QUIET, {"wide": -4.0}, "no_stiction", "sticks over 1 % or more is excluded"),
        (CYCLING, {"wide": -4.0}, "no_stiction", "tight tuning"),
        # It is not: a quiet PV acquits, a cycle does not, nor does what chance does not give.
        (QUIET, {"wide": -3.0}, "no_stiction", "no better than chance"),
        (CYCLING, {"wide": -3.0}, "undecided", "PV cycles: the record does not tell why"),
        (QUIET, {"wide": 11.0}, "undecided", "cannot be excluded: it predicts PV rather better"),
        # PV follows OP: then a wide stem that predicts as well is not chance.
        (QUIET, {"wide": 1.0}, "undecided", "PV follows OP, yet such a stem"),
        (QUIET, {"wide": 1.0, "unfollowed": 0.0507}, "no_stiction", "no better than chance"),
        # The linear loop explains PV.
        (CYCLING, {"wide": 20.0, "unexplained": 0.04}, "no_stiction", "tight tuning"),
        (QUIET, {"wide": 20.0, "unexplained": 0.04}, "no_stiction", "has nothing to explain"),
        # Too short to have shown a stem that matters: ln(1/0.91) of each sample must reach the likelihood, 30.
        (QUIET, {"wide": -1.0, "samples": 319}, "no_stiction", "no better than chance"),
        (QUIET, {"wide": -1.0, "samples": 318}, "undecided", "318 samples are too few"),
        (QUIET, {"wide": -4.0, "samples": 318}, "no_stiction", "is excluded"),
        # Two moves: PV is seen to follow OP, or not.
        (QUIET, {"moves": 2}, "no_stiction", "is excluded"),
        (QUIET, {"moves": 2, "unfollowed": 0.0501}, "undecided", "a stem that moved 2 times fits as well"),
        (QUIET, {"moves": 0, "unexplained": 0.01}, "undecided", "never moved"),
        # Nor does what few moves leave acquit, however little that is.
        (QUIET, {"moves": 1, "unexplained": 0.01, "unfollowed": 0.0501}, "undecided", "that moved once fits as well"),
        (QUIET, {"moves": 4, "unexplained": 0.01, "wide": 11.0}, "undecided", "that moved 4 times fits as well"),
        (QUIET, {"moves": 5, "unexplained": 0.01, "wide": 11.0}, "no_stiction", "has nothing to explain"),
    ],
)
def test_no_stiction_must_be_earned(cycle: Oscillation, changed: dict[str, float], verdict: str, why: str) -> None:
    found, reasons = decide(cycle, replace(LINEAR, **changed), None)
    assert found == verdict
    assert why in reasons[0]


def test_a_smooth_cycle_is_acquitted_only_where_the_loop_can_make_it() -> None:
    own, slow = Oscillation(0.9, 20.0, 5.0, 40.0), Oscillation(0.9, 60.0, 5.0, 40.0)
    assert decide(own, LINEAR, None)[0] == "no_stiction"
    assert "tight tuning" in decide(own, LINEAR, None)[1][0]
    assert decide(slow, LINEAR, None)[0] == "undecided"
    assert decide(slow, LINEAR, None, Thresholds(slow=11.0))[0] == "no_stiction"
    # A lag of many periods is told as what it is to the cycle.
    for periods, lag in ((9.0, f"time constant {9.0 * own.period:g} s"), (11.0, "a process that integrates")):
        level = replace(LINEAR, time_constant=periods * own.period)
        assert f"which a linear loop with {lag} and dead time" in decide(own, level, None)[1][0]


def test_a_stem_that_sticks_on_record_is_found_whatever_pv_says() -> None:
    assert decide(QUIET, LINEAR, StemEvidence(2.0, 1.0, 0.2, 0.01))[0] == "stiction"
    assert decide(QUIET, FOUND, StemEvidence(2.0, 1.0, 0.2, 0.19))[0] == "stiction"


def test_a_pv_that_stands_still_while_op_ramps_decides_nothing() -> None:
    pv = np.concatenate([np.linspace(1.0, 0.0, 60), np.zeros(300)])
    found = wb.detect(wb.Record(pv, np.linspace(5.0, 80.0, 360), 1.0))
    assert found.verdict == "undecided"
    assert "a valve that no longer moves" in found.reasons[0]


def test_what_rounding_leaves_of_pv_shows_no_loop_at_work() -> None:
    assert follows(replace(LINEAR, left=4e-32, unfollowed=1e-31)) == 0.0
    assert follows(replace(LINEAR, left=4e-32, unfollowed=1e-3)) > 1000.0
    ramp = np.arange(400.0)
    assert wb.detect(wb.Record(ramp, 0.1 * ramp, 1.0)).verdict == "undecided"


def test_a_saturated_output_and_a_cycling_setpoint_are_said() -> None:
    record = run_of(wb.Ideal())
    clipped = replace(record, op=np.clip(record.op, np.median(record.op), None))
    assert any("may be saturated" in reason for reason in wb.detect(clipped).reasons)
    wave = np.sin(2.0 * math.pi * np.arange(1200) / 50.0)
    noise = np.random.default_rng(2).normal(size=(2, 1200)) * 0.05
    driven = wb.Record(wave + noise[0], wave + noise[1], 1.0, sp=wave)
    assert any("outer loop" in reason for reason in wb.detect(driven).reasons)


def test_records_that_tell_nothing() -> None:
    ramp = np.linspace(0.0, 1.0, 100)
    assert "PV is constant" in wb.detect(wb.Record(np.ones(100), ramp, 1.0)).reasons[0]
    assert wb.detect(wb.Record(ramp, np.ones(100), 1.0)).test is None
    with pytest.raises(wb.RecordError, match="29 samples given; at least 30"):
        wb.detect(wb.Record(ramp[:29], ramp[:29], 1.0))
    with pytest.raises(wb.InvalidValue, match=r"detect\.record"):
        wb.detect("loop.csv")


@pytest.mark.parametrize("bicoherence", [False, True])
def test_values_that_no_plant_has_are_refused_in_a_line(bicoherence: bool) -> None:
    record = run_of(wb.Stenman(2.0), n=400)
    for scale in (1e-8, 1e36):
        scaled = replace(record, pv=record.pv * scale, sp=record.sp * scale)
        assert wb.detect(scaled, bicoherence=bicoherence).verdict == "stiction"
    # Smaller than rounding is constant, for detection as for the estimate.
    still = wb.detect(replace(record, pv=record.pv * 1e-300, sp=record.sp * 1e-300), bicoherence=bicoherence)
    assert still.test is None
    assert "PV is constant" in still.reasons[0]
    for scaled in (replace(record, pv=record.pv * 1e300), replace(record, sp=record.sp * 1e300)):
        for ask in (wb.detect, wb.estimate):
            with pytest.raises(wb.RecordError, match="no signal of a plant"):
                ask(scaled)


def test_a_model_given_to_the_stem_test_is_tried_beside_its_own() -> None:
    loop = wb.Loop(wb.FOPDT(2.0, 5.0, 1.0), wb.Deadband(3.0), wb.PID(Kc=0.5, Ti=15.0), 1.0)
    run = wb.simulate(loop, wb.Experiment(600.0, setpoint=wb.Step(4.0), noise=wb.Noise(0.1, 1)))
    record = wb.Record(run.pv, run.op, 1.0, sp=run.sp)
    band = wb.detect(record, fitted=(wb.Deadband(3.0), run.valve))
    pair = wb.detect(record, fitted=(wb.Choudhury(3.0, 0.0), run.valve))
    # One law under two names.
    assert band.test.likelihood == pair.test.likelihood
    assert band.test.likelihood >= wb.detect(record).test.likelihood
    for wrong in ((wb.Kano(2.0, 1.0), run.valve), (wb.Stenman(2.0), run.valve[1:]), (wb.Stenman(2.0), "stem")):
        with pytest.raises(wb.InvalidValue, match=r"detect\.fitted"):
            wb.detect(record, fitted=wrong)


@pytest.mark.parametrize(("noise", "most"), [(0.1, True), (0.3, False)], ids=["little noise", "much noise"])
def test_where_a_models_stem_leaves_no_doubt_no_other_is_tried(
    noise: float, most: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    loop = wb.Loop(wb.FOPDT(2.0, 5.0, 1.0), wb.Stenman(2.0), wb.PID(Kc=0.5, Ti=15.0), 1.0)
    run = wb.simulate(loop, wb.Experiment(600.0, setpoint=wb.Step(4.0), noise=wb.Noise(noise, 1)))
    record = wb.Record(run.pv, run.op, 1.0, sp=run.sp)
    searched = []
    module = importlib.import_module("workbench.detect.stem_search")
    met = module.Search.met
    monkeypatch.setattr(module.Search, "met", lambda search: searched.append(search) or met(search))
    told = wb.detect(record, fitted=(wb.Stenman(2.0), run.valve))
    assert told.verdict == "stiction"
    assert not searched
    assert (told.test.improvement >= 0.5) == most
    assert math.isnan(told.test.wide)
    (wide,) = (one for one in told.statistics if one.name == "Stem test, wide bands")
    assert wide.says == "not asked: the model's stem leaves no doubt"
    # One that explains nothing leaves the search what it is by itself.
    wrong = wb.detect(record, fitted=(wb.Stenman(0.01), run.op.copy()))
    assert len(searched) == 1
    assert wrong.test == wb.detect(record).test
    # That is kept for the next stem, and the same as anew.
    assert len(searched) == 1
    module.search_of.cache_clear()
    assert wrong.test == wb.detect(record).test
    assert len(searched) == 2


def test_others_are_tried_beside_a_models_stem_that_leaves_more_than_noise(monkeypatch: pytest.MonkeyPatch) -> None:
    loop = wb.Loop(wb.FOPDT(2.0, 5.0, 1.0), wb.Stenman(2.0), wb.PID(Kc=0.5, Ti=15.0), 1.0)
    drift = 0.05 * np.cumsum(np.random.default_rng(1).normal(size=600))
    searched = []
    module = importlib.import_module("workbench.detect.stem_search")
    met = module.Search.met
    monkeypatch.setattr(module.Search, "met", lambda search: searched.append(search) or met(search))
    for load, looked in ((np.zeros(600), 0), (drift - drift.mean(), 1)):
        searched.clear()
        noise = wb.Noise(0.3, 1)
        run = wb.simulate(loop, wb.Experiment(600.0, wb.Step(4.0), wb.Series(load.tolist()), noise))
        found = wb.detect(wb.Record(run.pv, run.op, 1.0, sp=run.sp), fitted=(wb.Stenman(2.0), run.valve))
        assert found.verdict == "stiction"
        assert len(searched) == looked


def test_an_op_that_hardly_moves_tells_nothing_about_the_valve() -> None:
    record = run_of(wb.Ideal())
    mean = float(record.op.mean())
    for width, verdict in ((0.09, "undecided"), (0.11, "no_stiction")):
        squeezed = replace(record, op=mean + (record.op - mean) * width / float(np.ptp(record.op)))
        found = wb.detect(squeezed)
        assert found.verdict == verdict
        assert ("less than a valve resolves (0.1 %)" in found.reasons[0]) == (verdict == "undecided")


@pytest.mark.parametrize("samples", [30, 60, 200])
def test_a_short_record_whose_stem_never_moved_is_undecided(samples: int) -> None:
    loop = wb.Loop(wb.FOPDT(2.0, 5.0, 1.0), wb.Stenman(4.0), wb.PID(Kc=0.5, Ti=15.0), 1.0)
    run = wb.simulate(loop, wb.Experiment(float(samples), noise=wb.Noise(0.5, 1)))
    assert not np.ptp(run.valve)
    found = wb.detect(wb.Record(run.pv, run.op, 1.0, sp=run.sp))
    assert found.verdict == "undecided"
    assert any("too short" in reason or "cannot be excluded" in reason for reason in found.reasons)


def test_a_healthy_valve_at_work_is_acquitted_even_in_a_short_record() -> None:
    loop = wb.Loop(wb.FOPDT(2.0, 5.0, 1.0), wb.Ideal(), wb.PID(Kc=0.5, Ti=15.0), 1.0)
    run = wb.simulate(loop, wb.Experiment(60.0, setpoint=wb.Step(5.0, at=5.0), noise=wb.Noise(0.05, 1)))
    found = wb.detect(wb.Record(run.pv, run.op, 1.0, sp=run.sp))
    assert found.verdict == "no_stiction"
    assert "or more is excluded" in found.reasons[0]


@settings(deadline=None, max_examples=6)
@given(seed=st.integers(0, 2**32 - 1), smooth=st.integers(1, 12), n=st.integers(30, 300))
def test_a_short_record_of_noise_is_never_a_verdict_but_by_exclusion(seed: int, smooth: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    pv, op = (np.convolve(rng.normal(size=n), np.ones(smooth), "same") for _ in range(2))
    found = wb.detect(wb.Record(pv, op, 1.0))
    assert found.verdict != "stiction"
    assert found.verdict == "undecided" or any(
        said in " ".join(found.reasons) for said in ("is excluded", "nothing to explain")
    )


def test_bicoherence_and_ellipse_come_when_asked_for() -> None:
    record = run_of(wb.Choudhury(2.0, 2.0), load=0.0)
    assert wb.detect(record).bicoherence is None
    found = wb.detect(record, bicoherence=True)
    assert found.bicoherence is not None
    assert found.ellipse is None or found.ellipse.apparent_stiction > 0.0


@pytest.mark.slow
def test_verdicts_on_real_loops() -> None:
    if not RECORDS.is_dir():
        pytest.skip(f"no folder of real records at {RECORDS}; set WORKBENCH_RECORDS")
    for kind, least in (("isdb", 6), ("plant", 36)):
        rows = (RECORDS / kind / "labels.csv").read_text(encoding="utf-8").splitlines()
        place = rows[0].split(",").index("label")
        cells = [row.split(",") for row in rows[1:]]
        answers = [(c[place], wb.detect(wb.read_record(RECORDS / kind / c[0])).verdict) for c in cells]
        assert sum(label == verdict for label, verdict in answers) >= least
        assert {verdict for label, verdict in answers if verdict != label} <= {"undecided"}


def test_a_slow_cycle_recorded_closely_is_looked_at_in_all_its_samples() -> None:
    # A level whose dead band cycles once in some 330 samples, under a slow load: every third sample is not enough.
    rng, load, pole = np.random.default_rng(1), np.zeros(3000), math.exp(-1.0 / 200.0)
    for k in range(1, 3000):
        load[k] = pole * load[k - 1] + 0.33 * math.sqrt(1.0 - pole**2) * rng.normal()
    loop = wb.Loop(wb.Integrating(0.0175, 5.4), wb.Deadband(3.8), wb.PID(2.8, 129.0), 1.0)
    run = wb.simulate(loop, wb.Experiment(3000.0, load=wb.Series(load.tolist()), noise=wb.Noise(0.07, 1)))
    found = wb.detect(wb.Record(run.pv + 50.0, run.op + 50.0, 1.0, sp=run.sp + 50.0))
    assert found.oscillation.period > 300.0
    assert found.test is not None
    assert found.test.samples > 2900
    assert found.verdict == "stiction"


def test_a_day_at_rest_is_looked_at_where_op_moves() -> None:
    # Evenly spaced, three stretches of 15,000 samples hold neither move of the setpoint.
    moves = [wb.Step(8.0, at=4000.0), wb.Step(-6.0, at=9600.0)]
    verdicts = []
    for valve in (wb.Deadband(3.0), wb.Ideal()):
        loop = wb.Loop(wb.FOPDT(2.0, 5.0, 1.0), valve, wb.PID(Kc=0.5, Ti=20.0), 1.0)
        run = wb.simulate(loop, wb.Experiment(15_000.0, setpoint=moves, noise=wb.Noise(0.1, 1)))
        verdicts.append(wb.detect(wb.Record(run.pv, run.op, 1.0)).verdict)
    assert verdicts == ["stiction", "no_stiction"]


def test_stretches_of_a_long_record_do_not_overlap_and_stay_where_op_moves_alike() -> None:
    rng = np.random.default_rng(0)
    op = rng.normal(size=12_000)
    assert _starts(op) == [0, 4500, 9000]
    assert _starts(op[:4000]) == [0, 1000]
    op[3400:4100] += 20.0  # over the end of the first third
    op[8200:8300] += 20.0
    assert _starts(op) == [1000, 4000, 8000]
