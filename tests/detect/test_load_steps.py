"""A stem that moves once or twice leaves PV as a load step does: it accuses only where load steps do not do as well."""

from dataclasses import replace

import numpy as np
import pytest

import workbench as wb
from workbench.detect.load_steps import load_steps, unforced
from workbench.detect.rivals import Loaded, Rivals
from workbench.detect.verdict import decide
from workbench.model.detection import Oscillation, StemTest
from workbench.model.record import FloatArray

FLOW = wb.Loop(wb.FOPDT(0.6, 2.4, 0.8), wb.Ideal(), wb.PID(Kc=1.18, Ti=2.6), 1.0)
LEVEL = wb.Loop(wb.Integrating(0.0111, 3.7), wb.Ideal(), wb.PID(Kc=4.15, Ti=147.0), 1.0)
SLOW = wb.Loop(wb.FOPDT(1.0, 12.0, 2.0), wb.Stenman(2.0), wb.PID(Kc=0.5, Ti=60.0), 1.0)


def record_of(loop: wb.Loop, experiment: wb.Experiment) -> wb.Record:
    run = wb.simulate(loop, experiment)
    return wb.Record(run.pv + 50.0, run.op + 40.0, 1.0, sp=run.sp + 50.0)


@pytest.mark.parametrize(
    ("loop", "load", "noise"),
    [
        (FLOW, [wb.Step(-10.9, 236.0)], wb.Noise(0.39, 2)),
        (LEVEL, [wb.Step(3.13, 386.0), wb.Step(-2.55, 718.0)], wb.Noise(0.215, 22)),
    ],
)
def test_a_healthy_loop_is_not_accused_of_its_load_steps(loop: wb.Loop, load: list[wb.Step], noise: wb.Noise) -> None:
    found = wb.detect(record_of(loop, wb.Experiment(750.0, load=load, noise=noise)))
    assert found.test.predicting > 30.0, "a stem predicts PV far better than the loop without its load steps"
    assert found.test.loaded < 0.0
    assert found.verdict != "stiction"


def test_a_stem_that_moves_often_is_weighed_against_load_steps_too() -> None:
    # A slow controller answers two load steps for long; a dead band in OP's likeness turns as often as noise does.
    loop = wb.Loop(wb.FOPDT(7.5, 1.0, 15.6), wb.Ideal(), wb.PID(Kc=0.0144, Ti=16.6), 1.0)
    load = [wb.Step(1.24, 142.0), wb.Step(7.32, 154.0)]
    found = wb.detect(record_of(loop, wb.Experiment(457.0, load=load, noise=wb.Noise(0.675, 2))))
    assert found.test.moves > 8
    assert found.test.predicting > 30.0, "a stem predicts PV far better than the loop without its load steps"
    assert found.test.loaded < 0.0
    assert max(found.test.sure, found.test.likelihood) <= found.test.loaded
    assert found.verdict != "stiction"


HIDDEN = [wb.Step(-5.0, 200.0), wb.Step(6.0, 450.0)]


@pytest.mark.parametrize(
    ("plant", "controller", "valve"),
    [
        (wb.FOPDT(1.5, 12.0, 3.0), wb.PID(0.8, 14.0), wb.Choudhury(1.5, 0.5)),
        (wb.Integrating(0.05, 4.0), wb.PID(1.5, 60.0), wb.Choudhury(3.0, 1.0)),
    ],
)
def test_a_valve_that_load_steps_hide_is_found_without_them(plant: wb.FOPDT, controller: wb.PID, valve: object) -> None:
    experiment = wb.Experiment(700.0, load=HIDDEN, noise=wb.Noise(0.1, 1))
    found = wb.detect(record_of(wb.Loop(plant, valve, controller, 1.0), experiment))
    assert found.verdict == "stiction"
    assert found.test.steps == 2
    assert found.reasons[0].startswith("beside 2 load steps, taken out of PV, a stem that sticks over")
    assert wb.detect(record_of(wb.Loop(plant, wb.Ideal(), controller, 1.0), experiment)).verdict != "stiction"


def test_a_look_without_the_load_acquits_nobody() -> None:
    # The linear loop's load steps may take along what the valve did.
    experiment = wb.Experiment(700.0, load=HIDDEN, noise=wb.Noise(0.1, 0))
    for valve in (wb.Stenman(1.0), wb.Choudhury(1.5, 0.5)):
        loop = wb.Loop(wb.FOPDT(1.5, 12.0, 3.0), valve, wb.PID(0.8, 14.0), 1.0)
        found = wb.detect(record_of(loop, experiment))
        assert found.verdict == "undecided"
        assert found.test.steps == 0


@pytest.mark.parametrize("outside", [{"steps": 1}, {"swings": True}])
def test_a_stem_beside_a_load_of_its_own_must_be_sure(outside: dict[str, float]) -> None:
    quiet = Oscillation(0.0, np.nan, 0.0, 0.0)
    beside = replace(FOUND, **outside)
    assert decide(quiet, beside, None)[0] == "stiction"
    assert decide(quiet, replace(beside, sure=19.9), None)[0] == "undecided"
    assert decide(quiet, replace(FOUND, sure=19.9), None)[0] == "stiction"


@pytest.mark.parametrize(
    ("wide", "simulated", "likelihood", "verdict"),
    [
        (-5.0, 0.2, 9.0, "no_stiction"),
        (9.0, 0.2, 9.0, "no_stiction"),
        (11.0, 0.04, 9.0, "no_stiction"),
        (11.0, 0.06, 9.0, "undecided"),
        (11.0, 0.04, 11.0, "undecided"),
        (9.0, 0.04, 11.0, "no_stiction"),
    ],
)
def test_little_that_is_left_acquits_unless_a_wide_stem_explains_it(
    wide: float, simulated: float, likelihood: float, verdict: str
) -> None:
    quiet = Oscillation(0.0, np.nan, 0.0, 0.0)
    little = replace(FOUND, unexplained=0.01, wide=wide, simulated=simulated, likelihood=likelihood, predicting=9.0)
    little = replace(little, adds=9.0, sure=9.0, improvement=0.01, moves=20)
    assert decide(quiet, little, None)[0] == verdict


def test_a_valve_that_an_oscillation_from_outside_hides_is_found_beside_one() -> None:
    load = wb.Series((3.0 * np.sin(2.0 * np.pi * np.arange(1500) / 130.0)).tolist())
    experiment = wb.Experiment(1500.0, load=load, noise=wb.Noise(0.25, 7))
    loop = wb.Loop(wb.FOPDT(1.5, 20.0, 3.0), wb.Deadband(5.0), wb.PID(1.5, 24.0), 1.0)
    found = wb.detect(record_of(loop, experiment))
    assert found.verdict == "stiction"
    assert found.test.swings
    assert found.test.band == pytest.approx(5.0, rel=0.15)
    assert found.reasons[0].startswith("beside an oscillation from outside, a stem that sticks over")
    assert wb.detect(record_of(replace(loop, valve=wb.Ideal()), experiment)).verdict != "stiction"


def test_a_transient_that_has_died_out_overflows_nowhere() -> None:
    pv = np.full(34, 0.5)
    pv[[2, 6, 21, 23, 29, 30]] = 3.0, 0.0, 5.0, 0.0, 0.0, 1.0
    op = np.zeros(34)
    op[8] = 1.0
    assert wb.detect(wb.Record(pv, op, 1.0)).verdict == "undecided"


def test_a_step_that_comes_with_the_setpoint_is_no_loads() -> None:
    record = record_of(SLOW, wb.Experiment(750.0, setpoint=wb.Step(3.0, 100.0), noise=wb.Noise(0.2, 1)))
    found = wb.detect(record)
    assert found.verdict == "stiction"
    assert found.test.moves <= 4
    # Where nobody recorded the setpoint, its move may have been a load's.
    assert wb.detect(wb.Record(record.pv, record.op, 1.0)).test.loaded < found.test.loaded


def test_one_step_is_found_where_it_was_with_its_size() -> None:
    rng = np.random.default_rng(3)
    n, tau, at, size = 600, 8.0, 250, -3.0
    op = np.cumsum(rng.normal(size=n)) * 0.3
    moved = size * (1.0 - np.exp(-np.arange(1, n - at + 1) / tau))
    lag, pv = 0.0, np.zeros(n)
    for k in range(3, n):
        pv[k] = lag
        lag = lag * np.exp(-1.0 / tau) + (1.0 - np.exp(-1.0 / tau)) * 2.0 * op[k - 3]
    pv[at:] += moved
    taus, delays = np.array([1.0, 4.0, tau, 20.0]), np.arange(6)
    everywhere = np.ones(n, dtype=bool)
    given = pv + 0.05 * rng.normal(size=n), op, np.ones(1), everywhere
    (part, times), *more = load_steps(*given, everywhere, taus, delays, 1.0, 2)
    np.testing.assert_allclose(part[at:], moved, atol=0.1)
    assert np.ptp(part[:at]) == 0.0
    assert times == [at]
    assert len(more) == 1
    # No plant has a gain of the other sign; where no place is free there is no step.
    assert not list(load_steps(*given, everywhere, taus, delays, -1.0, 1))
    assert not list(load_steps(*given, ~everywhere, taus, delays, 1.0, 1))


def test_no_load_is_sought_about_a_setpoint_move_until_pv_has_arrived() -> None:
    sp, pv = np.zeros(100), np.zeros(100)
    sp[40:] = 2.0
    pv[55:] = 2.1
    free = unforced(sp, pv, 5)
    assert np.flatnonzero(~free).tolist() == list(range(35, 61))
    # Never arrived: none until the end. No setpoint, or one that stands still: everywhere.
    assert np.flatnonzero(~unforced(sp, np.zeros(100), 5)).tolist() == list(range(35, 100))
    assert unforced(None, pv, 5).all()
    assert unforced(np.ones(100), pv, 5).all()


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
    moves=2,
    samples=1000,
    time_constant=5.0,
    dead_time=1.0,
)


@pytest.mark.parametrize(
    ("loaded", "verdict"), [(-50.0, "undecided"), (9.9, "undecided"), (10.1, "stiction"), (200.0, "stiction")]
)
def test_the_stem_must_beat_load_steps_by_more_than_chance(loaded: float, verdict: str) -> None:
    said, reasons = decide(Oscillation(0.0, np.nan, 0.0, 0.0), replace(FOUND, loaded=loaded), None)
    assert said == verdict
    assert ("moved 2 times only, and a linear loop under as few load steps or ramps" in reasons[0]) == (
        verdict == "undecided"
    )


def test_a_transient_that_has_died_out_before_the_first_sample_that_counts_explains_nothing() -> None:
    rng = np.random.default_rng(3)
    op, live = np.cumsum(rng.normal(size=600)), np.arange(600) >= 300
    pv = np.concatenate([[0.0], op[:-1]]) + 3.0 * (np.arange(600) >= 450) + 0.05 * rng.normal(size=600)
    free = np.ones(600, dtype=bool)
    ((part, _),) = load_steps(pv, op, np.ones(1), live, free, np.array([0.7]), np.arange(3), 1.0, 1)
    np.testing.assert_allclose(part[455:], np.full(145, part[-1]), atol=0.1)
    assert part[-1] == pytest.approx(3.0, abs=0.5)
    assert not part[:449].any()


def test_a_pv_that_a_load_step_explains_altogether_leaves_nothing_to_look_at() -> None:
    # One sample of each signal stands out; a step of the load and what fades make up for PV to the last bit.
    pv, op = np.full(35, 334.0), np.ones(35)
    pv[9], op[2] = 409.0, 0.0
    assert wb.detect(wb.Record(pv, op, 1.0)).verdict == "undecided"


# Healthy flows under two ramps of the load: when each begins and ends, and by how much it moves, %.
RAMPED = [
    (wb.FOPDT(1.5, 4.0, 0.8), wb.PID(Kc=1.23, Ti=5.3), ((45, 139, 7.2), (208, 464, -8.2))),
    (wb.FOPDT(1.5, 5.4, 0.8), wb.PID(Kc=1.55, Ti=5.9), ((197, 357, -3.0), (431, 556, -5.9))),
]


def ramps_of(ends: tuple[tuple[int, int, float], ...], n: int) -> FloatArray:
    load = np.zeros(n)
    for begin, end, size in ends:
        load += size * np.clip((np.arange(n) - begin) / (end - begin), 0.0, 1.0)
    return load


@pytest.mark.parametrize(("plant", "controller", "ends"), RAMPED)
def test_a_healthy_loop_is_not_accused_of_ramps_of_its_load(
    plant: wb.FOPDT, controller: wb.PID, ends: tuple[tuple[int, int, float], ...]
) -> None:
    # A stem that rests while OP ramps leaves PV as a load that ramps the other way.
    load = wb.Series(ramps_of(ends, 600))
    experiment = wb.Experiment(600.0, load=load, noise=wb.Noise(0.005, 1))
    found = wb.detect(record_of(wb.Loop(plant, wb.Ideal(), controller, 1.0), experiment))
    assert found.test.predicting > 50.0, "a stem predicts PV far better than the loop without its ramps"
    assert found.test.loaded < 0.0, "and load steps do not as well"
    assert found.verdict == "undecided"
    assert any("load steps or ramps" in reason for reason in found.reasons)


def test_a_ramp_is_found_where_it_begins() -> None:
    every, lag, load = np.ones(500, dtype=bool), np.zeros(500), ramps_of(((200, 500, 5.0),), 500)
    for k in range(499):
        lag[k + 1] = 0.8 * lag[k] + 0.2 * load[k]
    u = np.sin(0.3 * np.arange(500.0))
    asked = np.ones(1), every, every, np.array([-1.0 / np.log(0.8)]), np.array([1]), 0.0, 1
    ((step, _),), ((ramp, _),) = (list(load_steps(lag, u, *asked, kind)) for kind in (False, True))
    np.testing.assert_allclose(ramp - ramp[0], lag, atol=1e-6)
    assert float((lag - step).var()) > 0.1 * float(lag.var())


def test_the_linear_loop_is_set_beside_load_steps_once_for_all_stems(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[bytes, ...]] = []
    under_load = Rivals.under_load

    def counted(self: Rivals, x: FloatArray, a: FloatArray, *rest: object, **ramps: bool) -> Loaded:
        asked.append((self.y.tobytes(), x.tobytes(), a.tobytes(), repr((rest[-1], ramps)).encode()))
        return under_load(self, x, a, *rest, **ramps)

    monkeypatch.setattr(Rivals, "under_load", counted)
    loop = wb.Loop(wb.FOPDT(1.5, 20.0, 2.0), wb.Ideal(), wb.PID(Kc=1.0, Ti=20.0), 1.0)
    k = np.arange(1200)
    load = wb.Series((2.0 * np.sin(2.0 * np.pi * k / 95.0) + 3.0 * (k >= 700)).tolist())
    run = wb.simulate(loop, wb.Experiment(1200.0, [wb.Step(4.0, 100.0)], load, wb.Noise(0.1, 1)))
    wb.detect(wb.Record(run.pv + 50.0, run.op + 40.0, 1.0, sp=run.sp + 50.0))
    assert len(asked) == len(set(asked)) > 0
