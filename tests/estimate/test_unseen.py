"""Dead bands that pass for a linear loop: the plant's ranges hold the plants that go with them, and it is said."""

from __future__ import annotations

import math

import numpy as np
import pytest

import workbench as wb
from workbench.estimate.fits.data import centre
from workbench.estimate.fits.fit import Fit, fit_linear
from workbench.estimate.ranges.scale import linear_intervals
from workbench.estimate.ranges.unseen import Unseen, unseen, words_of_likelier, words_of_unseen
from workbench.estimate.search.two_parameter import Band
from workbench.model.results import Intervals

PLANT = wb.FOPDT(0.37, 24.0, 2.0)
MOVED = [wb.Step(1.1), wb.Step(-1.65, at=670.0)]


def record_of(
    valve: wb.Ideal | wb.Deadband, noise: float = 0.076, seed: int = 0, samples: int = 1000, plant: wb.Plant = PLANT
) -> wb.Record:
    pid = wb.PID(1.2, 43.0) if isinstance(plant, wb.FOPDT) else wb.PID(2.0, 90.0)
    experiment = wb.Experiment(float(samples), setpoint=MOVED, noise=wb.Noise(noise, seed))
    run = wb.simulate(wb.Loop(plant, valve, pid, 1.0), experiment)
    return wb.Record(run.pv + 50.0, run.op + 40.0, 1.0, sp=run.sp + 50.0)


@pytest.mark.parametrize("seed", range(2))
def test_the_ranges_of_a_loop_that_looks_linear_hold_the_plant_behind_its_dead_band(seed: int) -> None:
    record = record_of(wb.Deadband(1.5), seed=seed)
    found = wb.estimate(record, plant="fopdt", valve="stenman")
    low, high = found.intervals.gain
    assert low <= PLANT.gain <= high
    assert found.intervals.time_constant[0] <= PLANT.time_constant <= found.intervals.time_constant[1]
    # A linear loop's own range does not: the band weakens and slows what PV shows of OP.
    data = centre(record, "fopdt")
    own = linear_intervals(data, fit_linear(data, 240.0), 240.0)
    assert own.gain[1] < PLANT.gain
    assert own.time_constant[0] > PLANT.time_constant
    assert not found.identifiable
    # Detection has no doubt of the second: the band itself, over a quarter of OP's range, is doubt enough.
    assert found.verdict == "undecided"
    assert found.reasons[0].startswith("dead bands of up to 1.93 % fit as well") == (seed == 1)
    # Who knows that the valve does not stick is given the linear loop's own.
    assert wb.estimate(record, plant="fopdt", valve="linear").intervals.gain[1] < PLANT.gain


@pytest.mark.parametrize("plant", [PLANT, wb.Integrating(0.02, 3.0)])
def test_a_healthy_loops_ranges_stay_close(plant: wb.Plant) -> None:
    record = record_of(wb.Ideal(), noise=0.02, plant=plant)
    kind = "fopdt" if isinstance(plant, wb.FOPDT) else "integrating"
    found = wb.estimate(record, plant=kind, valve="stenman")
    assert found.verdict == "no_stiction"
    low, high = found.intervals.gain
    assert low <= plant.gain <= high
    assert high - low < 0.05 * plant.gain
    assert not any("dead bands" in reason for reason in found.reasons)


def test_bands_are_those_within_the_likelihood_region() -> None:
    data = centre(record_of(wb.Ideal(), noise=0.02), "fopdt")
    linear = fit_linear(data, 240.0)
    found = unseen(data, linear, 240.0)
    assert found is not None
    # A band of a tenth of OP's range is seen, one of a hundredth is not.
    assert 0.01 * data.op_range < found.band < 0.1 * data.op_range
    assert found.plant.gain[0] < linear.gain < found.plant.gain[1]
    # A noisier record excludes less.
    noisy = centre(record_of(wb.Ideal(), noise=0.2), "fopdt")
    wider = unseen(noisy, fit_linear(noisy, 240.0), 240.0)
    assert wider is not None
    assert wider.band > found.band


def test_a_long_record_is_looked_at_too() -> None:
    data = centre(record_of(wb.Ideal(), noise=0.6, samples=12_000), "fopdt")
    linear = fit_linear(data, 240.0)
    found = unseen(data, linear, 240.0)
    assert found is not None
    assert found.plant.gain == pytest.approx((linear.gain, linear.gain), rel=0.05)


def test_without_a_part_of_op_in_pv_there_is_nothing_to_say() -> None:
    rng = np.random.default_rng(0)
    data = centre(wb.Record(rng.normal(size=200), rng.normal(size=200), 1.0), "fopdt")
    assert unseen(data, Fit(1.0, 5.0, 1.0, 0.0, 0.0, 0.0, 0.0), 30.0) is None


@pytest.mark.parametrize(
    ("own", "other", "told"),
    [((1.0, 1.1), (0.9, 1.1), True), ((1.0, 1.1), (0.98, 1.12), False), ((-1.1, -1.0), (-math.inf, -1.0), True)],
)
def test_only_what_matters_is_said(own: tuple[float, float], other: tuple[float, float], told: bool) -> None:
    best = Band(0.5, 0.0, 0, 1.0, 9, Fit(1.0, 5.0, 1.0, 1.0, 0.0, 0.0, 0.0))
    found = Unseen(0.7, Intervals(gain=other), best, 3.0)
    said = words_of_unseen(found, Intervals(gain=own), integrating=False)
    assert bool(said) == told
    assert not told or said[0].startswith("dead bands of up to 0.7 % fit as well")
    assert words_of_unseen(found, Intervals(), integrating=False) == ()


def test_a_dead_band_that_is_likelier_than_the_linear_loop_is_told_and_not_acquitted() -> None:
    record = record_of(wb.Deadband(0.8), noise=0.04, seed=2)
    # The linear loop leaves noise alone, and detection nothing to explain.
    assert wb.detect(record).verdict == "no_stiction"
    found, straight = wb.estimate(record, plant="fopdt"), wb.estimate(record, plant="fopdt", valve="linear")
    assert found.verdict == "undecided"
    assert found.reasons[0].startswith("a stem that sticks over ")
    assert found.valve.stick_band == pytest.approx(0.8, rel=0.25)
    assert found.plant.gain == pytest.approx(PLANT.gain, rel=0.05)
    assert straight.plant.gain < 0.9 * PLANT.gain
    assert_held(found, PLANT)
    assert not found.identifiable
    # Nor where a dead band is asked for, or the one that is there.
    assert isinstance(wb.estimate(record, plant="fopdt", valve="deadband").valve, wb.Deadband)


def test_a_wide_dead_band_that_the_linear_loops_colour_hides_is_told_and_not_acquitted() -> None:
    plant = wb.FOPDT(1.15751, 8.76474, 1.20639)
    loop = wb.Loop(plant, wb.Deadband(3.45822), wb.PID(Kc=0.667897, Ti=11.4104), 1.0)
    moves = [wb.Step(11.5945), wb.Step(-17.3917, at=1688.0)]
    run = wb.simulate(loop, wb.Experiment(2000.0, moves, wb.Step(-1.23474, 1436.0), wb.Noise(0.348, 0)))
    record = wb.Record(run.pv[1000:] + 50.0, run.op[1000:] + 40.0, 1.0, sp=run.sp[1000:] + 50.0)
    found = wb.estimate(record, plant="fopdt")
    # The linear loop leaves little of PV, and in the measure of that the band does not leave less; it leaves noise.
    assert "a sticking stem has nothing to explain" in " ".join(found.reasons)
    assert found.verdict == "undecided"
    assert found.reasons[0].startswith("a stem that sticks over ")
    assert found.valve.stick_band == pytest.approx(3.45822, rel=0.2)
    assert_held(found, plant)


def test_how_far_a_dead_band_is_ahead_of_the_linear_loop_is_that_of_their_sums_of_squares() -> None:
    ahead = []
    for valve in (wb.Ideal(), wb.Deadband(0.8)):
        data = centre(record_of(valve, noise=0.02, seed=1), "fopdt")
        linear = fit_linear(data, 240.0)
        found = unseen(data, linear, 240.0)
        assert found is not None
        assert found.ahead == pytest.approx(1000 * math.log(linear.sse / found.best.fit.sse), rel=1e-9)
        ahead.append(found.ahead)
    assert ahead[0] < 10.0
    assert ahead[1] > 30.0
    assert "log likelihood ratio 17" in words_of_likelier(wb.Deadband(0.8), 17.2)


def assert_held(found: wb.Estimate, plant: wb.FOPDT) -> None:
    """Each of the plant's parameters lies in its range."""
    ranges = found.intervals
    for truth, pair in (
        (plant.gain, ranges.gain),
        (plant.time_constant, ranges.time_constant),
        (plant.dead_time, ranges.dead_time),
    ):
        assert pair[0] <= truth <= pair[1]


def late(run: wb.Run) -> wb.Record:
    """The second 1,000 samples."""
    pv, op, sp = (signal[1000:2000] for signal in (run.pv, run.op, run.sp))
    return wb.Record(pv + 50.0, op + 40.0, 1.0, sp=sp + 50.0)


def test_a_band_that_is_crossed_once_and_one_way_is_told_by_no_start_that_lies_beyond_it() -> None:
    """OP goes one way: a stem that lies at that end of its band to begin with never crosses it, and any band does."""
    plant = wb.FOPDT(0.35, 37.0, 1.9)
    loop = wb.Loop(plant, wb.Deadband(1.15), wb.PID(Kc=1.33, Ti=45.0), 1.0)
    setpoint = [wb.Step(0.31), wb.Step(-0.465, at=1357.0)]
    run = wb.simulate(loop, wb.Experiment(2000.0, setpoint=setpoint, noise=wb.Noise(0.0092, 0)))
    found = wb.estimate(late(run), plant="fopdt")
    assert_held(found, plant)
    assert found.verdict == "undecided"
    assert not found.identifiable


def test_beside_a_load_step_each_band_has_a_step_of_its_own() -> None:
    """The linear loop's step was twice the load's: with that taken out no band fitted."""
    plant = wb.FOPDT(1.49175, 30.2633, 2.70859)
    loop = wb.Loop(plant, wb.Deadband(0.791), wb.PID(Kc=0.243075, Ti=48.3316), 1.0)
    setpoint, load = [wb.Step(1.04908), wb.Step(-1.57362, 1319.0)], wb.Step(0.179422, 1229.0)
    run = wb.simulate(loop, wb.Experiment(2000.0, setpoint=setpoint, load=load, noise=wb.Noise(0.0180325, 556988177)))
    found = wb.estimate(late(run), plant="fopdt", valve="stenman")
    assert len(found.load_steps) == 1
    assert_held(found, plant)
    assert found.verdict == "undecided"
    assert any("dead bands of up to" in reason for reason in found.reasons)
