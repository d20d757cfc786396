"""Two-parameter valves and dead band: the path, its rectangle in (S, J), the search, and the choice by BIC."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import workbench as wb
from workbench.cli.output import estimate_lines
from workbench.estimate import record_fits
from workbench.estimate.fits.data import centre
from workbench.estimate.fits.fit import LEAST_TAU, Limits, fit_linear
from workbench.estimate.kernels.path import band_path, spans_of
from workbench.estimate.record_fits import Fits, closely, first_fits, leaves_noise_alone
from workbench.estimate.search.bands import noise_beside
from workbench.estimate.search.dense import densely
from workbench.estimate.search.models import bands_of
from workbench.estimate.search.nearer import search_short
from workbench.estimate.search.profile import search
from workbench.estimate.search.sought import like_stenman, sought
from workbench.estimate.search.two_parameter import band_stem, best_of, look
from workbench.model.valve import Choudhury
from workbench.simulate.run import valve_response

outputs = arrays(np.float64, st.integers(3, 60), elements=st.integers(-40, 40).map(lambda i: i / 8.0))
bands = st.floats(0.05, 6.0)


@settings(deadline=None, max_examples=60)
@given(op=outputs, S=bands, J=st.floats(0.0, 6.0))
def test_the_path_is_the_simulations(op: np.ndarray, S: float, J: float) -> None:
    # Off the eighths that OP moves by, so that rounding decides no slip.
    S, J = S + 1e-4, J + 3e-4
    x, slips = band_stem(op, S, J)
    assert np.abs(x - valve_response(Choudhury(S, J), op, float(op[0]))).max() < 1e-9
    assert (slips > 0) == bool(np.abs(op - op[0]).max() > 0.5 * (S + J))


@settings(deadline=None, max_examples=60)
@given(op=outputs, S=bands, J=st.floats(0.0, 6.0), a=st.floats(0.0, 0.999), b=st.floats(0.0, 0.999))
def test_the_same_slips_happen_within_the_rectangle(op: np.ndarray, S: float, J: float, a: float, b: float) -> None:
    x, y, box = np.empty(op.size), np.empty(op.size), np.empty(4)
    slips = band_path(op, spans_of(op), S, J, 0, 1.0, x, box)
    top = np.minimum(box, 50.0)
    other = (top[0] + a * (top[1] - top[0]), top[2] + b * (top[3] - top[2]))
    assert box[0] <= S < box[1]
    assert box[2] <= J < box[3]
    assert band_path(op, spans_of(op), other[0], other[1], 0, 1.0, y, box) == slips
    # Both paths are led alike; they stand apart by half the change of S - J.
    apart = 0.5 * abs((other[0] - other[1]) - (S - J))
    assert np.abs(np.abs(y - x) - apart).max() < 1e-9


def record_of(
    valve: wb.Choudhury | wb.Deadband | wb.Stenman, samples: int, sd: float = 0.1, seed: int = 2
) -> wb.Record:
    steps = [wb.Step(4.0 * (-1) ** i, at=float(t)) for i, t in enumerate(range(0, samples, max(samples // 3, 400)))]
    loop = wb.Loop(wb.FOPDT(2.0, 5.0, 1.0), valve, wb.PID(Kc=0.5, Ti=20.0), 1.0)
    run = wb.simulate(loop, wb.Experiment(float(samples), setpoint=steps, noise=wb.Noise(sd, seed)))
    return wb.Record(run.pv + 50.0, run.op + 40.0, 1.0)


@pytest.mark.parametrize(("S", "J"), [(3.0, 1.0), (2.0, 2.0)])
def test_stick_band_and_slip_jump_are_found_under_noise(S: float, J: float) -> None:
    record = record_of(wb.Choudhury(S, J), 1000)
    found = wb.estimate(record, plant="fopdt")
    assert isinstance(found.valve, wb.Choudhury)
    assert pytest.approx((S, J), rel=0.02) == (found.valve.S, found.valve.J)
    assert found.plant.gain == pytest.approx(2.0, rel=0.02)
    assert found.plant.time_constant == pytest.approx(5.0, rel=0.05)
    assert found.noise_sd == pytest.approx(0.1, rel=0.2)
    assert found.intervals.S is not None
    assert found.intervals.J is not None
    assert found.intervals.S[0] <= found.valve.S <= found.intervals.S[1]
    assert found.intervals.J[0] <= found.valve.J <= found.intervals.J[1]
    assert found.intervals.d is None
    assert found.residual_variance == pytest.approx(float(np.mean((record.pv - found.prediction) ** 2)), rel=1e-4)


def test_where_a_stenman_valve_leaves_noise_alone_no_other_valve_is_looked_for_far_away() -> None:
    for valve, alone in ((wb.Stenman(2.0), True), (wb.Choudhury(3.0, 1.0), False), (wb.Choudhury(0.05, 0.05), False)):
        data = centre(record_of(valve, 1000), "fopdt")
        found = search(data, 30.0, lambda _: None)
        assert found is not None
        assert leaves_noise_alone(data, found, fit_linear(data, 30.0)) is alone
        if alone:
            # Nor would any have been found: the whole search finds none that leaves as little.
            coarse = look(data, 30.0)
            within = sought(data, 30.0, None, contested=False)
            bands = bands_of(data, coarse, within, Limits((LEAST_TAU, 1000.0), (0.0, 30.0)))
            assert min(one.best.fit.sse for one in bands.values()) > 1.5 * found.best.fit.sse
            assert [b.S for b in like_stenman(found, data, 30.0)] == [found.best.d]


def fits_of(record: wb.Record) -> Fits:
    data = centre(record, "fopdt")
    return first_fits(data, "auto", search(data, 30.0, lambda _: None), fit_linear(data, 30.0))


def test_where_the_first_stems_lead_to_one_that_leaves_noise_alone_it_is_the_whole_searchs(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    walked: list[int] = []
    monkeypatch.setattr(record_fits, "densely", lambda data, *_: walked.append(data.samples) or ())
    # Of the last the stem moves too seldom, or another valve explains it.
    for valve, samples, clear in (
        (wb.Choudhury(3.0, 1.0), 1000, True),
        (wb.Choudhury(9.0, 3.0), 300, False),
        (wb.Ideal(), 1000, False),
    ):
        fits = fits_of(record_of(valve, samples))
        walked.clear()
        found = closely(fits, "auto")
        assert (walked == []) is clear
        if clear:
            whole = bands_of(fits.data, fits.coarse, fits.within, fits.limits)
            least = min(one.best.fit.sse for one in whole.values())
            assert min(one.best.fit.sse for one in found.bands.values()) < 1.002 * least


def test_a_stem_whose_first_slip_was_taken_wrong_gets_the_right_one_and_its_jump() -> None:
    # Sixteen moves, the noise a twentieth of PV's swing: close about the first stems J is a tenth off, and what is left
    # is white.
    valve = wb.Choudhury(S=3.2677040043672565, J=2.442817063287025)
    plant = wb.FOPDT(1.8739763457775191, 4.833984615989547, 2.0986470782482747)
    loop = wb.Loop(plant, valve, wb.PID(0.16407472040984897, 7.711074491182484), 1.0)
    moves = [wb.Step(6.478373769302014), wb.Step(-9.71756065395302, at=671.0)]
    noise = wb.Noise(0.6633683622628652, 2106641045)
    run = wb.simulate(loop, wb.Experiment(1000.0, setpoint=moves, noise=noise))
    fits = fits_of(wb.Record(run.pv + 50.0, run.op + 40.0, 1.0, sp=run.sp + 50.0))
    about = search_short(fits.data, fits.coarse, None, fits.limits, near=True)[0]
    assert abs(best_of(about).J - valve.J) > 0.1 * valve.J
    assert noise_beside(fits.data, best_of(about))
    found = closely(fits, "auto").bands["choudhury"].best
    assert pytest.approx(valve.S, rel=0.005) == found.S
    assert pytest.approx(valve.J, rel=0.02) == found.J


def test_a_dead_band_is_found_and_told_from_stiction() -> None:
    found = wb.estimate(record_of(wb.Deadband(2.0), 1400), plant="fopdt")
    assert isinstance(found.valve, wb.Deadband)
    assert found.valve.b == pytest.approx(2.0, rel=0.03)
    assert found.candidates[0].valve == found.valve
    assert found.plant.gain == pytest.approx(2.0, rel=0.03)


def test_the_lowest_bic_is_chosen_and_the_table_is_whole() -> None:
    record = record_of(wb.Stenman(2.0), 1000)
    found = wb.estimate(record, plant="fopdt")
    assert isinstance(found.valve, wb.Stenman)
    names = [type(m.valve).__name__ for m in found.candidates]
    assert sorted(names) == ["Choudhury", "Deadband", "Ideal", "Stenman"]
    assert found.candidates[0].valve == found.valve
    bics = [m.bic for m in found.candidates]
    assert bics == sorted(bics)
    # No jump is one of any, where neither is searched for to its end too.
    left = {type(m.valve).__name__: m.residual_variance for m in found.candidates}
    assert 3.0 * left["Stenman"] < left["Choudhury"] <= (1.0 + 1e-4) * left["Deadband"]
    free = {"Ideal": 6, "Stenman": 7, "Deadband": 7, "Choudhury": 8}
    for model in found.candidates:
        p = free[type(model.valve).__name__]
        # Its variance is that of the samples that count, in the measure of the disturbance that the best stem leaves.
        counted = np.exp((model.aic - 2.0 * p) / 1000.0)
        assert counted == pytest.approx(model.residual_variance, rel=0.05)
        assert model.bic - model.aic == pytest.approx(p * (np.log(1000.0) - 2.0))
    printed = "\n".join(estimate_lines(found))
    assert "BIC" in printed
    assert "dead band" in printed


def test_the_valve_asked_for_is_the_valve_given() -> None:
    record = record_of(wb.Choudhury(3.0, 1.0), 300)
    kinds = {"stenman": wb.Stenman, "deadband": wb.Deadband, "choudhury": wb.Choudhury, "linear": wb.Ideal}
    for name, kind in kinds.items():
        found = wb.estimate(record, valve=name, plant="fopdt")
        assert isinstance(found.valve, kind)
        assert not (name == "linear" and found.identifiable)
    with pytest.raises(wb.InvalidValue, match=r"estimate\.valve"):
        wb.estimate(record, valve="kano")


def test_a_long_record_is_searched_in_its_most_active_stretch() -> None:
    found = wb.estimate(record_of(wb.Stenman(2.0), 2000), plant="fopdt")
    assert isinstance(found.valve, wb.Stenman)
    assert found.valve.d == pytest.approx(2.0, rel=0.01)
    assert {type(m.valve).__name__ for m in found.candidates} >= {"Stenman", "Ideal", "Choudhury"}


@pytest.mark.parametrize("valve", [wb.Choudhury(0.8, 0.92), wb.Choudhury(3.0, 1.0)], ids=["overshooting", "usual"])
def test_a_record_that_starts_within_a_cycle_needs_no_start_to_be_guessed(valve: wb.Choudhury) -> None:
    loop = wb.Loop(wb.FOPDT(2.3, 5.6, 2.6), valve, wb.PID(Kc=0.25, Ti=6.0), 1.0)
    steps = [wb.Step(2.0), wb.Step(-3.0, 1400.0)]
    run = wb.simulate(loop, wb.Experiment(2000.0, setpoint=steps, noise=wb.Noise(0.03, 5)))
    found = wb.estimate(wb.Record(run.pv[1000:], run.op[1000:], 1.0, sp=run.sp[1000:]), plant="fopdt")
    assert found.verdict == "stiction"
    assert found.valve.stick_band == pytest.approx(valve.S, rel=0.02)
    assert found.plant.gain == pytest.approx(2.3, rel=0.03)


def test_a_part_with_too_few_slips_to_tell_does_not_widen_what_the_whole_says() -> None:
    # Both setpoint moves lie in the first half; the second hardly slips and would take most bands.
    loop = wb.Loop(wb.FOPDT(2.0, 5.0, 1.0), wb.Deadband(2.0), wb.PID(Kc=0.5, Ti=20.0), 1.0)
    steps = [wb.Step(4.0), wb.Step(-6.0, 150.0), wb.Step(5.0, 300.0)]
    run = wb.simulate(loop, wb.Experiment(1000.0, setpoint=steps, noise=wb.Noise(0.1, 3)))
    found = wb.estimate(wb.Record(run.pv, run.op, 1.0, sp=run.sp), plant="fopdt", valve="deadband")
    assert found.verdict == "stiction"
    assert found.intervals.S is not None
    low, high = found.intervals.S
    assert low <= 2.0 <= high
    assert high - low < 0.3


def test_a_jump_that_few_samples_fix_is_met_although_no_grid_holds_it() -> None:
    # The true sequence of slips lasts for .7 % of J, beside many others.
    loop = wb.Loop(wb.FOPDT(0.49, 25.7, 1.5), wb.Choudhury(2.81, 0.6655), wb.PID(Kc=1.08, Ti=45.2), 1.0)
    moves = [wb.Step(1.83), wb.Step(-2.75, at=487.0)]
    run = wb.simulate(loop, wb.Experiment(1000.0, setpoint=moves, noise=wb.Noise(0.026, 1)))
    record = wb.Record(np.round(run.pv / 0.02) * 0.02 + 50.0, run.op + 40.0, 1.0)
    found = wb.estimate(record, plant="fopdt")
    assert isinstance(found.valve, wb.Choudhury)
    assert found.valve.stick_band == pytest.approx(2.81, rel=0.03)
    assert found.plant.gain == pytest.approx(0.49, rel=0.03)
    assert found.plant.time_constant == pytest.approx(25.7, rel=0.1)


def test_a_wide_stem_that_slips_twice_a_cycle_is_found_without_a_setpoint_move() -> None:
    # Fourteen moves of a stem whose S is nine tenths of what OP moves: S is known to a hundredth or not at all.
    loop = wb.Loop(wb.FOPDT(1.0, 8.0, 4.0), wb.Choudhury(4.0, 2.2), wb.PID(0.5, 25.0), 1.0)
    run = wb.simulate(loop, wb.Experiment(2000.0, setpoint=wb.Step(3.0), noise=wb.Noise(0.1, 3)))
    found = wb.estimate(wb.Record(run.pv[500:], run.op[500:], 1.0, sp=run.sp[500:]), plant="fopdt")
    assert isinstance(found.valve, wb.Choudhury)
    assert found.valve.stick_band == pytest.approx(4.0, rel=0.01)
    assert found.plant.gain == pytest.approx(1.0, rel=0.1)


@pytest.mark.parametrize(
    ("plant", "valve", "pid", "step", "noise"),
    [
        (wb.FOPDT(0.294, 11.6, 1.18), wb.Kano(8.85, 8.05), wb.PID(2.24, 19.4), 3.9, wb.Noise(0.25, 3)),
        (wb.FOPDT(0.684, 26.0, 3.31), wb.Choudhury(0.517, 0.229), wb.PID(2.93, math.inf), 0.53, wb.Noise(0.0304, 2)),
    ],
)
def test_slips_that_few_stick_bands_and_jumps_hold_are_met_though_the_best_of_the_coarse_grid_is_far_off(
    plant: wb.FOPDT, valve: wb.Kano | wb.Choudhury, pid: wb.PID, step: float, noise: wb.Noise
) -> None:
    moves = [wb.Step(step), wb.Step(-1.5 * step, at=1000.0)]
    run = wb.simulate(wb.Loop(plant, valve, pid, 1.0), wb.Experiment(1600.0, setpoint=moves, noise=noise))
    data = centre(wb.Record(run.pv[600:] + 50.0, run.op[600:] + 40.0, 1.0), "fopdt")
    limits = Limits((LEAST_TAU, float(data.samples)), (0.0, 30.0))
    coarse = look(data, 30.0)
    found = best_of(search_short(data, coarse, None, limits, densely(data, coarse, 30.0))[0])
    assert abs(found.S - valve.S) < 0.03 * valve.S
    assert abs(found.J - valve.J) < 0.03 * valve.S
    assert found.fit.gain == pytest.approx(plant.gain, rel=0.05)
    # Without it the search ends elsewhere, with far more of PV left.
    other = best_of(search_short(data, coarse, None, limits)[0])
    assert data.samples * math.log(other.fit.sse / found.fit.sse) > 100.0


def test_no_dense_grid_is_walked_where_nothing_moves_or_the_record_is_long() -> None:
    data = centre(record_of(wb.Choudhury(3.0, 1.0), 1600), "fopdt")
    assert densely(data, look(data, 30.0), 30.0) == ()
    part = data.part(0, 1000)
    assert densely(part, [], 30.0) == ()
    assert densely(part, look(part, 30.0), 30.0)


@pytest.mark.parametrize("first", [-1, 0, 13])
def test_a_stem_that_rests_through_spans_goes_as_one_that_is_looked_at_sample_by_sample(first: int) -> None:
    rng = np.random.default_rng(4)
    rested = 0
    for n in (7, 40, 203):
        op = np.round(4.0 * np.cumsum(rng.normal(0.0, 0.3, n))) / 8.0  # that meets the edges of its bands exactly
        spans = spans_of(op)
        never = np.vstack([np.full(spans.shape[1], -np.inf), np.full(spans.shape[1], np.inf)])
        for S in (0.125, 0.5, 1.0, 2.5):
            for J in (0.0, 0.25 * S, S, 1.3 * S):
                ways = [(np.zeros(n), np.zeros(4)) for _ in range(2)]
                at = min(first, n - 1)
                one, other = (
                    band_path(op, those, S, J, at, 1.0, *way) for those, way in zip((spans, never), ways, strict=True)
                )
                assert one == other
                assert np.array_equal(ways[0][0], ways[1][0])
                assert np.array_equal(ways[0][1], ways[1][1])
                rested += int((np.diff(ways[0][0]) == 0.0).sum())
    assert rested > 1000
