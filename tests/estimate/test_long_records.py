"""Long records: what is summed once, sought in a stretch or asked of a window is what the plain way would give."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.signal import lfilter

import workbench as wb
from workbench.estimate import estimate
from workbench.estimate.fits.data import Centred, centre
from workbench.estimate.fits.fit import (
    LEAST_TAU,
    Fit,
    Limits,
    fit_in_stretch,
    fit_linear,
    fit_near,
    fit_path,
    fit_stems,
    grounded,
    halves_left,
    predict,
    start_range,
)
from workbench.estimate.fits.windows import EXACT, WHOLE, active_windows, stretch_of, stretch_with, windows_of
from workbench.estimate.kernels import long as long_kernel
from workbench.estimate.kernels.bands import screen_bands
from workbench.estimate.kernels.output_error import FIT, TAU, drive_of, oe_cost
from workbench.estimate.kernels.walk import AtDelays, at_delays
from workbench.estimate.record_fits import Fits, closely
from workbench.estimate.search import long_record, profile, sought
from workbench.estimate.search.bands import search_bands
from workbench.estimate.search.outwards import outwards
from workbench.estimate.search.profile import search
from workbench.estimate.search.stems import FIRST, HIGH, LOW, path_of, silent, walk, walk_starts
from workbench.estimate.search.two_parameter import best_start, fit_band
from workbench.model.results import FittedModel
from workbench.model.valve import Valve

outputs = arrays(np.float64, st.integers(30, 90), elements=st.integers(-40, 40).map(lambda i: i / 8.0))
LIMITS = Limits((0.05, 1000.0), (0.0, 20.0))


def loop_data(plant: str = "fopdt", samples: int = 2000, sd: float = 0.05) -> Centred:
    """A sticky loop's record, centred."""
    process: wb.FOPDT | wb.Integrating = wb.FOPDT(2.0, 6.0, 2.4)
    controller = wb.PID(Kc=0.4, Ti=15.0)
    if plant == "integrating":
        process, controller = wb.Integrating(0.1, 1.3), wb.PID(Kc=1.2, Ti=40.0)
    loop = wb.Loop(process, wb.Stenman(1.5), controller, 1.0)
    steps = [wb.Step(5.0), wb.Step(-7.0, at=0.4 * samples)]
    run = wb.simulate(loop, wb.Experiment(float(samples), setpoint=steps, noise=wb.Noise(sd, 3)))
    return centre(wb.Record(run.pv, run.op, 1.0), plant)


def check_starts(data: Centred, bands_tried: np.ndarray, delays: np.ndarray) -> None:
    firsts = data.starts.firsts
    shifted = at_delays(data.sums, delays)
    rows = walk_starts(data, firsts, bands_tried, shifted)
    met = 0
    for d in bands_tried.tolist():
        for first in firsts.tolist():
            plain = walk(data, first, d, math.nextafter(d, math.inf), 0.0, shifted)
            here = rows[(rows[:, 0] == first) & (rows[:, 1] == d)]
            assert len(here) == len(plain)
            if not len(plain):
                continue
            met += 1
            power = float(data.squares[-1])
            assert here[0, 4] == pytest.approx(plain[0, 4], rel=1e-9, abs=1e-10 * power)
            assert here[0, 5] == plain[0, 5]
            # The band holds up to the smallest slip, and is the path's own there and not beyond.
            again = path_of(data.u, math.nextafter(here[0, 2], 0.0), first)[0] if here[0, 2] < math.inf else None
            assert again is None or np.array_equal(again, path_of(data.u, d, first)[0])
            beyond = path_of(data.u, here[0, 2], first)[0]
            assert here[0, 2] == math.inf or not np.array_equal(beyond, path_of(data.u, d, first)[0])
    assert met == len(rows)


@settings(deadline=None, max_examples=40)
@given(op=outputs, integrating=st.booleans())
def test_paths_that_meet_are_summed_as_each_by_itself(op: np.ndarray, integrating: bool) -> None:
    if np.ptp(op) == 0.0:
        return
    y = np.cos(np.arange(op.size)) + np.arange(op.size) % 3
    data = centre(wb.Record(y, op, 1.0), "integrating" if integrating else "fopdt")
    check_starts(data, np.linspace(0.05, 1.0, 12) * data.op_range, np.array([0, 1, 2, 5, 11]))


@pytest.mark.parametrize("plant", ["fopdt", "integrating"])
def test_paths_of_a_loop_are_summed_as_each_by_itself(plant: str) -> None:
    data = loop_data(plant)
    check_starts(data, np.geomspace(0.01, 0.9, 9) * data.op_range, np.arange(0, 31, 4))


def test_a_late_dead_time_leaves_out_what_it_moves_out_of_the_record() -> None:
    data = loop_data(samples=60)
    check_starts(data, np.array([0.02, 0.2, 0.5]) * data.op_range, np.array([0, 7, 40, 55]))


@pytest.mark.parametrize("plant", ["fopdt", "integrating"])
def test_a_stretch_that_is_all_of_a_record_fits_as_a_short_record_does(plant: str) -> None:
    data = loop_data(plant, samples=800)
    paths = np.array([[0.0, d, 1.001 * d, 2.0] for d in (0.8, 1.5, 2.2)])
    plain = fit_stems(data, paths, LIMITS, evaluations=60)
    for (one, slips), (other, same) in zip(fit_in_stretch(data, paths, LIMITS, (0, 800), 60), plain, strict=True):
        assert slips == same
        assert one.sse == pytest.approx(other.sse, rel=1e-12)
        assert (one.tau, one.theta) == pytest.approx((other.tau, other.theta), rel=1e-12)


def test_a_plant_sought_in_a_stretch_is_the_stretchs_own_and_its_cost_the_records() -> None:
    data = loop_data().whitened(np.array([1.0, -0.3]), 4)
    x, slips = path_of(data.u, 1.5, 0)
    begin, stop = 700, 1300
    ((fit, same),) = fit_in_stretch(data, np.array([[0.0, 1.5, 1.5001, 2.0]]), LIMITS, (begin, stop), 80)
    out = np.empty(FIT)
    drive = np.empty(data.samples)
    drive_of(x, 0, data.a, drive)
    whole = oe_cost(
        data.target, drive, 0, -np.inf, np.inf, data.sign, False, fit.tau, fit.theta, data.a, data.skip, out
    )
    assert (fit.sse, same) == (whole, slips)
    part, within = data.target[begin:stop], drive[begin:stop]

    def there(tau: float, theta: float) -> float:
        return oe_cost(part, within, 0, -np.inf, np.inf, data.sign, False, tau, theta, data.a, 1, out)

    around = [there(fit.tau * f, fit.theta + s) for f, s in ((1.01, 0), (0.99, 0), (1, 0.03), (1, -0.03))]
    assert there(fit.tau, fit.theta) < min(around)


@pytest.mark.parametrize("plant", ["fopdt", "integrating"])
@pytest.mark.parametrize(("d", "wide"), [(1.5, 1.0), (1.495, 1.0), (1.5, 0.0)])
def test_the_quadratic_reaches_what_the_simplex_reaches(plant: str, d: float, wide: float) -> None:
    """Also where the dead time is held at the end of its range (wide = 0)."""
    data = loop_data(plant)
    x, _ = path_of(data.u, d, 0)
    limits = Limits(LIMITS.tau, (0.0, 1.0 + 19.0 * wide))
    free = (-math.inf, math.inf)
    best = fit_path(data, x, 0, free, limits, 1.0, tau=6.0, evaluations=400, tolerance=1e-13)
    near = Fit(0.0, 1.04 * best.tau, min(best.theta + 0.1, limits.theta[1]), 0.0, 0.0, 0.0, 0.0)
    began = fit_near(data, x, 0, free, limits, near, 0)
    found = fit_near(data, x, 0, free, limits, near, 4)
    assert best.gain != 0.0
    assert began.sse > (1.0 + 1e-5) * best.sse or (wide == 0.0 and best.tau == 6.0)
    assert found.sse <= (1.0 + 1e-6) * best.sse
    assert limits.theta[0] <= found.theta <= limits.theta[1]
    assert fit_near(data, x, 0, free, limits, found, 3).sse <= found.sse


@pytest.mark.parametrize("plant", ["fopdt", "integrating"])
@pytest.mark.parametrize(("a", "skip"), [((1.0,), 0), ((1.0,), 7), ((1.0, -1.2, 0.4), 2), ((1.0, -0.7), 60)])
def test_what_halves_leave_is_what_the_prediction_leaves_filtered(plant: str, a: tuple[float, ...], skip: int) -> None:
    data = loop_data(plant, samples=700).whitened(np.array(a), skip)
    for first in (0, int(data.starts.firsts[4])):
        x, _ = path_of(data.u, 1.4, first)
        bounds = start_range(data.u, first, 1.4, 1.41)
        fit = fit_path(data, x, first, bounds, LIMITS, 2.3, tau=5.0, evaluations=20)
        squares = data.innovations(predict(data, x, first, fit)[0]) ** 2
        expected = squares[:350].sum(), squares[350:].sum()
        assert halves_left(data, x, first, fit) == pytest.approx(expected, rel=1e-8)


def test_what_halves_leave_is_known_of_a_fast_plant_behind_a_long_filter() -> None:
    # Its transient, grown back through a filter of more than 37 terms, was beyond all numbers: a division by zero.
    a = np.convolve([1.0, -1.0], 0.9 ** np.arange(60))
    data = loop_data(samples=700).whitened(a, 0)
    x, _ = path_of(data.u, 1.4, 0)
    fit = grounded(data, x, 0, Fit(math.nan, LEAST_TAU, 2.3, 1.0, math.nan, math.nan, math.nan))
    squares = data.innovations(predict(data, x, 0, fit)[0]) ** 2
    assert halves_left(data, x, 0, fit) == pytest.approx((squares[:350].sum(), squares[350:].sum()), rel=1e-6)


def test_compiled_kernels_of_long_records_and_python_agree() -> None:
    data = loop_data(samples=120)
    x, _ = path_of(data.u, 1.5, 0)
    free, white = (-math.inf, math.inf), np.ones(1)
    out, again = np.empty(FIT), np.empty(FIT)
    given = (data.y, x, 0, *free, 0.0, False, 5.0, 2.0, LIMITS.tau, LIMITS.theta, 0.02, 2, white, 0)
    assert long_kernel.fit_near(*given, out) == long_kernel.fit_near.py_func(*given, again)  # type: ignore[attr-defined]
    halves = (data.y, x, 0, out, False, white, 0, 60)
    assert long_kernel.halves_left(*halves) == long_kernel.halves_left.py_func(*halves)  # type: ignore[attr-defined]


def test_windows_are_the_liveliest_and_apart_and_a_stretch_is_lively() -> None:
    rng = np.random.default_rng(2)
    u, y = 0.01 * rng.normal(size=40_000), 0.01 * rng.normal(size=40_000)
    for begin, much in ((8000, 3.0), (20_000, 5.0), (31_000, 4.0)):
        u[begin : begin + 1000] += much * np.sin(0.1 * np.arange(1000))
        y[begin : begin + 1000] += much * np.cos(0.1 * np.arange(1000))
    data = centre(wb.Record(y, u, 1.0), "fopdt")
    windows = windows_of(data)
    for (begin, stop), there in zip(windows, (20_000, 31_000, 8000), strict=True):
        assert stop - begin == EXACT
        assert begin < there + 1000
        assert stop > there
    begin, stop = stretch_of(data)
    assert (begin, stop - begin) == (pytest.approx(20_000, abs=5000), 5000)
    for slips, size in ((1000, 3000), (120, 4000), (2, 6000), (0, 6000)):
        begin, stop = stretch_with(data, slips)
        assert (begin, stop - begin) == (pytest.approx(20_000, abs=6000), size)
    quiet = centre(wb.Record(np.where(np.arange(40_000) < 9000, y, 0.0), u, 1.0), "fopdt")
    assert [float(part.y[0]) for _, part in active_windows(quiet)] == [quiet.y[windows_of(quiet)[0][0]]]


def test_a_linear_plant_of_a_long_record_is_as_good_as_its_own_searched_on_all_of_it() -> None:
    loop = wb.Loop(wb.FOPDT(1.0, 12.0, 5.3), wb.Ideal(), wb.PID(Kc=0.8, Ti=14.0), 1.0)
    steps = [wb.Step(3.0), wb.Step(-4.0, at=5200.0), wb.Step(4.0, at=9000.0)]
    run = wb.simulate(loop, wb.Experiment(12_000.0, setpoint=steps, noise=wb.Noise(0.3, 5)))
    data = centre(wb.Record(run.pv, run.op, 1.0), "fopdt")
    found = fit_linear(data, 240.0)
    free = (-math.inf, math.inf)
    truth = fit_path(data, data.u, 0, free, Limits((0.05, 12_000.0), (0.0, 240.0)), 5.3, tau=12.0, tolerance=1e-10)
    assert found.sse <= (1.0 + 1e-7) * truth.sse
    assert (found.tau, found.theta) == pytest.approx((12.0, 5.3), rel=0.1)


def sticky(valve: Valve, seed: int = 1, samples: int = 4000, load: float = 0.0) -> wb.Record:
    """A sticky loop's long record; load: standard deviation of an autoregressive one, %."""
    rng = np.random.default_rng(seed)
    moves = rng.normal(size=samples)
    load_of = np.zeros(samples)
    for k in range(1, samples):
        load_of[k] = 0.97 * load_of[k - 1] + load * math.sqrt(1.0 - 0.97**2) * moves[k]
    steps = [wb.Step(6.0 * (-1) ** i, at=float(t)) for i, t in enumerate(range(0, samples, samples // 4))]
    loop = wb.Loop(wb.FOPDT(2.0, 5.0, 1.6), valve, wb.PID(Kc=0.5, Ti=20.0), 1.0)
    profile = wb.Series(load_of.tolist()) if load else None
    run = wb.simulate(loop, wb.Experiment(float(samples), setpoint=steps, load=profile, noise=wb.Noise(0.05, seed)))
    return wb.Record(run.pv, run.op, 1.0)


def begun(record: wb.Record, kind: str) -> estimate._Begun:
    """The beginning of an estimate with one kind of plant."""
    line = estimate._straight(record, centre(record, kind), None)
    return estimate._begun(record, kind, line, estimate._Asked("profile", "auto", None, None), silent)


def likeliest(record: wb.Record, kind: str = "fopdt") -> tuple[FittedModel, Fits]:
    """The likeliest model of an estimate with one kind of plant, and all its fits: without ranges and verdict."""
    fits = closely(begun(record, kind).fits, "auto")
    return next(iter(fits.models.values())), fits


def looks(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The sizes of the records that are looked at for two-parameter stems from now on."""
    seen: list[int] = []
    real = sought.window_of

    def counted(part: Centred, *asked: Any) -> sought.Window:
        seen.append(part.samples)
        return real(part, *asked)

    monkeypatch.setattr(sought, "window_of", counted)
    return seen


def test_each_window_is_looked_at_once_whatever_the_measure(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = looks(monkeypatch)
    found, _ = likeliest(sticky(wb.Choudhury(3.0, 1.2), seed=2, samples=12_000, load=0.6))
    assert 1 <= len(seen) <= 3
    assert set(seen) == {EXACT}
    assert isinstance(found.valve, wb.Choudhury)
    assert pytest.approx(3.0, rel=0.05) == found.valve.S


def test_windows_are_not_asked_for_what_the_first_settles(monkeypatch: pytest.MonkeyPatch) -> None:
    record = sticky(wb.Stenman(2.0), samples=12_000)
    seen = looks(monkeypatch)
    free = wb.estimate(record, plant="fopdt")
    assert isinstance(free.valve, wb.Stenman)
    assert len(seen) == 1
    # A valve that is asked for has no rival.
    seen.clear()
    asked = wb.estimate(record, plant="fopdt", valve="choudhury")
    assert isinstance(asked.valve, wb.Choudhury)
    assert len(seen) > 1
    by_name = {type(model.valve).__name__: model.residual_variance for model in free.candidates}
    assert asked.residual_variance <= by_name["Choudhury"] * (1.0 + 1e-9)
    assert by_name["Stenman"] < asked.residual_variance


def test_a_slow_loops_few_slips_are_searched_in_all_of_a_long_record() -> None:
    """Cycles of hundreds of samples: no window holds slips enough, and a stem thinned slips at other times."""
    samples = 6000
    loop = wb.Loop(wb.FOPDT(1.2, 40.0, 60.0), wb.Choudhury(3.0, 1.2), wb.PID(Kc=0.2778, Ti=40.0), 1.0)
    steps = [wb.Step(6.0, at=100.0), wb.Step(-9.0, at=2700.0)]
    run = wb.simulate(loop, wb.Experiment(float(samples), setpoint=steps, noise=wb.Noise(0.2, 3)))
    found, _ = likeliest(wb.Record(run.pv, run.op, 1.0, sp=run.sp))
    assert isinstance(found.valve, wb.Choudhury)
    assert pytest.approx(3.0, rel=0.02) == found.valve.S
    assert pytest.approx(1.2, abs=0.05) == found.valve.J
    assert found.plant.gain == pytest.approx(1.2, rel=0.02)
    assert found.plant.dead_time == pytest.approx(60.0, abs=1.0)


def test_what_is_known_is_not_seen_thinned_and_a_hopeless_stem_is_not_searched_on() -> None:
    data = loop_data(samples=12_000)
    known = sought.sought(data, 20.0, None, False, lambda *_: [])
    assert len(known.windows) > 1
    assert known.thinned == ()
    nothing = sought.Sought(data.y, False, (), True, False, ((1.5, 1.5, 6.0, 2.4),))
    assert search_bands(data, [], nothing, LIMITS, None, rival=1e-9) is None
    found = search_bands(data, [], nothing, LIMITS, None)
    assert found is not None
    assert pytest.approx(1.5, rel=0.02) == found.best.S


@pytest.mark.parametrize("many", [1, 4])
def test_stems_that_see_all_of_op_are_averaged(many: int) -> None:
    data = loop_data(samples=1200)
    op = np.repeat(data.u, many)
    found = [np.empty((3, 4, 3)) for _ in range(2)]
    grid, poles, delays = np.array([[0.5, 0.0], [1.0, 0.0], [2.0, 0.0]]), np.exp([-1.0, -0.2]), np.array([0, 2, 5])
    for u, out in zip((data.u, op), found, strict=True):
        screen_bands(data.target, u, grid, poles, delays, data.sign, data.a, 0, out)
    np.testing.assert_allclose(found[0], found[1], rtol=1e-9)


def test_a_thinned_record_has_means_of_pv_about_what_op_spans() -> None:
    data = centre(sticky(wb.Stenman(2.0), samples=2000), "fopdt").whitened(np.array([1.0, -0.5]), 10)
    thin = data.thinned(3)
    assert thin.samples == 666
    assert thin.a.size == 1
    assert thin.skip == 4
    for k in (1, 5, 300, 665):
        assert thin.y[k] == pytest.approx(data.y[3 * k - 1 : 3 * k + 2].mean(), rel=1e-9)
        assert thin.u[k] == data.u[3 * k + 1]
    assert thin.y[0] == pytest.approx(data.y[:2].mean(), rel=1e-9)
    assert np.array_equal(data.thinned(1).y, data.y)


def level_data(samples: int) -> tuple[wb.Record, Centred]:
    """A level whose valve sticks over 3 % and jumps by 3.5 %: one slip that is wrong moves PV from there on."""
    loop = wb.Loop(wb.Integrating(0.01, 10.0), wb.Choudhury(3.0, 3.5), wb.PID(Kc=2.0, Ti=200.0), 1.0)
    steps = [wb.Step(8.0), wb.Step(-6.0, at=0.6 * samples)]
    run = wb.simulate(loop, wb.Experiment(float(samples), setpoint=steps, noise=wb.Noise(0.1, 1)))
    record = wb.Record(run.pv, run.op, 1.0)
    return record, centre(record, "integrating")


@pytest.mark.parametrize(("begin", "S", "J"), [(51_000, 2.99937, 3.50916), (70_500, 3.00329, 3.51232)])
def test_a_stem_is_followed_from_a_window_to_a_day_of_a_level(begin: int, S: float, J: float) -> None:
    # Between the truth and what a window of 1,500 samples shows lie stems that are right in hundreds of slips and not
    # in the next; and where one is wrong, one that rests over half of the record leaves less.
    _, data = level_data(86_400)
    window, limits = (begin, begin + EXACT), Limits((0.05, 86_400.0), (0.0, 30.0))
    part = data.part(*window)
    within = Limits((0.05, float(EXACT)), (0.0, 30.0))
    seed = fit_band(part, S, J, best_start(part, (S, J), (1.0, 10.0))[1:], within, (1.0, 10.0))
    met, right = outwards(data, window, seed, None, limits)
    best = min(met, key=lambda b: b.fit.sse)
    assert right
    assert pytest.approx(3.0, rel=5e-4) == best.S
    assert pytest.approx(3.5, rel=1e-2) == best.J
    assert best.fit.sse / data.samples == pytest.approx(0.01, rel=0.05)


def test_a_long_level_is_seen_in_its_windows_and_not_searched_as_a_lag() -> None:
    record, _ = level_data(12_000)
    assert estimate._slow(begun(record, "fopdt"))
    found, _ = likeliest(record, "integrating")
    assert found.plant.gain == pytest.approx(0.01, rel=0.02)
    assert isinstance(found.valve, wb.Choudhury)
    assert pytest.approx((3.0, 3.5), rel=0.01) == (found.valve.S, found.valve.J)


@pytest.mark.slow
def test_a_slow_cycle_of_few_slips_is_found_in_all_of_its_record() -> None:
    plant, valve = wb.Integrating(0.0054, 10.5), wb.Choudhury(2.1, 0.75)
    loop = wb.Loop(plant, valve, wb.PID(Kc=4.3, Ti=173.0), 1.0)
    steps = [wb.Step(0.12), wb.Step(-0.18, at=928.0)]
    run = wb.simulate(loop, wb.Experiment(1600.0, setpoint=steps, noise=wb.Noise(0.016, 1)))
    found = wb.estimate(wb.Record(run.pv, run.op, 1.0), plant="integrating")
    assert isinstance(found.valve, wb.Choudhury)
    assert pytest.approx(2.1, rel=0.01) == found.valve.S
    assert found.plant.gain == pytest.approx(0.0054, rel=0.02)


@pytest.mark.slow
def test_a_load_step_in_a_long_record_is_found_beside_its_valve() -> None:
    loop = wb.Loop(wb.FOPDT(0.97, 14.2, 2.9), wb.Choudhury(3.9, 1.4), wb.PID(Kc=0.48, Ti=12.6), 1.0)
    steps = [wb.Step(8.5), wb.Step(-12.7, at=1123.56)]
    experiment = wb.Experiment(1800.0, setpoint=steps, load=wb.Step(0.8, at=648.0), noise=wb.Noise(0.25, 1))
    run = wb.simulate(loop, experiment)
    found, fits = likeliest(wb.Record(run.pv, run.op, 1.0))
    assert pytest.approx(3.9, rel=0.02) == found.valve.stick_band
    assert found.plant.gain == pytest.approx(0.97, rel=0.02)
    (step,) = fits.steps
    assert step.size == pytest.approx(0.8, rel=0.1)
    assert step.at == pytest.approx(650.9, abs=10.0)


@pytest.mark.slow
def test_a_valve_and_its_gain_are_known_in_a_long_record_under_a_slow_load() -> None:
    # As if the load were white the gain comes out at a third: a larger jump takes what the load does.
    loop = wb.Loop(wb.FOPDT(2.0, 6.0, 2.0), wb.Choudhury(5.0, 5.0), wb.PID(Kc=0.6, Ti=8.0), 1.0)
    n, pole = WHOLE + 400, math.exp(-1.0 / 240.0)
    kicks = np.random.default_rng(3).normal(0.0, 0.75 * math.sqrt(1.0 - pole * pole), n)
    load = wb.Series(lfilter([1.0], [1.0, -pole], kicks).tolist())
    experiment = wb.Experiment(float(n), load=load, noise=wb.Noise(0.3, 1))
    run = wb.simulate(loop, experiment)
    found = wb.estimate(
        wb.Record(run.pv + 50.0, run.op + 50.0, 1.0, sp=run.sp + 50.0), plant="fopdt", valve="choudhury"
    )
    assert (found.verdict, found.identifiable) == ("stiction", True)
    assert pytest.approx(5.0, rel=0.005) == found.valve.stick_band
    assert found.plant.gain == pytest.approx(2.0, rel=0.03)
    assert found.intervals.gain is not None
    assert found.intervals.gain[0] <= 2.0 <= found.intervals.gain[1]


def test_paths_close_about_one_that_a_part_shows_join_those_of_a_long_record() -> None:
    data = loop_data(samples=2000)
    rows = long_record.scan_long(data, np.arange(6), 6.0, silent)[0]
    far = rows[np.abs(np.log(rows[:, LOW] / 1.5)) > 0.1]
    seen = search(data, 6.0)
    assert seen is not None
    joined = long_record.rows_beside(data, far, seen.best)
    assert (np.diff(joined[:, 4]) >= 0.0).all()
    assert joined[0, LOW] == pytest.approx(1.5, rel=0.005)
    assert {tuple(row) for row in far.tolist()} <= {tuple(row) for row in joined.tolist()}


@pytest.mark.parametrize(
    ("valve", "samples"), [(wb.Stenman(2.0), 2000), (wb.Choudhury(3.0, 1.2), 2000), (wb.Deadband(1.5), 4000)]
)
def test_long_records_give_the_valve_within_its_range(valve: Valve, samples: int) -> None:
    found = wb.estimate(sticky(valve, samples=samples), plant="fopdt")
    assert type(found.valve) is type(valve)
    assert found.verdict != "no_stiction"
    band = getattr(valve, "d", getattr(valve, "S", getattr(valve, "b", math.nan)))
    low, high = found.intervals.d or found.intervals.S or (math.nan, math.nan)
    assert 0.999 * low <= band <= 1.001 * high
    assert high - low < 0.08 * band
    assert found.plant.gain == pytest.approx(2.0, rel=0.03)
    assert found.plant.dead_time == pytest.approx(1.6, abs=0.2)


@pytest.mark.parametrize(("samples", "dead_time", "setpoint", "seed"), [(3001, 3.0, 3.0, 0), (2200, 5.0, 2.0, 4)])
def test_a_cycle_without_a_setpoint_move_gives_the_band_back(
    samples: int, dead_time: float, setpoint: float, seed: int
) -> None:
    # In a quiet cycle stems of other starts never meet the true one: each start is tried, at every dead time.
    loop = wb.Loop(wb.FOPDT(1.5, 8.0, dead_time), wb.Stenman(2.0), wb.PID(Kc=0.4, Ti=8.0), 1.0)
    run = wb.simulate(loop, wb.Experiment(samples + 300.0, setpoint=wb.Step(setpoint), noise=wb.Noise(0.05, seed)))
    found = wb.estimate(wb.Record(run.pv[300:], run.op[300:], 1.0), plant="fopdt")
    assert isinstance(found.valve, wb.Stenman)
    assert found.valve.d == pytest.approx(2.0, rel=0.01)
    assert found.plant.gain == pytest.approx(1.5, rel=0.03)
    assert found.identifiable


def test_paths_without_end_are_kept_once_too() -> None:
    rows = np.zeros((5, 1 + max(FIRST, LOW, HIGH)))
    rows[:, FIRST], rows[:, LOW], rows[:, HIGH] = [1, 0, 0, 1, 0], [5.0, 4.0, 3.0, 4.5, 1.0], [math.inf] * 4 + [2.0]
    kept = long_record._each_once(rows)
    assert kept[:, [FIRST, LOW]].tolist() == [[0.0, 1.0], [0.0, 3.0], [1.0, 4.5]]


def test_a_dead_time_that_is_held_leaves_the_quadratic_to_the_time_constant() -> None:
    x = np.repeat([0.0, 2.0, -1.0, 1.5, 0.0], 400)
    y, out = np.zeros(x.size), np.empty(FIT)
    for k in range(1, x.size):
        y[k] = y[k - 1] + (x[k - 1] - y[k - 1]) / 41.0
    white, inf = np.ones(1), math.inf
    limits = ((0.05, 2000.0), (0.0, 0.0))
    long_kernel.fit_near(y, x, 0, -inf, inf, 0.0, False, 45.0, 0.0, *limits, 0.05, 4, white, 0, out)
    assert out[TAU] == pytest.approx(-1.0 / math.log(1.0 - 1.0 / 41.0), rel=1e-4)


def test_a_band_with_a_lower_one_step_cost_leaves_the_best_one_its_paths() -> None:
    # A slow loop of 33 slips: of one sample's step of PV noise is nearly all, and bands 10 % too wide look better.
    loop = wb.Loop(wb.FOPDT(1.2, 40.0, 60.0), wb.Stenman(2.0), wb.PID(Kc=40.0 / 144.0, Ti=40.0), 1.0)
    moves = [wb.Step(6.0, at=100.0), wb.Step(-9.0, at=9000.0)]
    run = wb.simulate(loop, wb.Experiment(20_000.0, setpoint=moves, noise=wb.Noise(0.2456, 3)))
    found = search(centre(wb.Record(run.pv, run.op, 1.0, sp=run.sp), "fopdt"), 80.0)
    assert found is not None
    assert found.best.d == pytest.approx(2.0, rel=0.002)
    assert found.best.fit.gain == pytest.approx(1.2, rel=0.01)


@pytest.mark.parametrize(
    ("theta", "looked_at"), [(406.0, [400, 412]), (412.0, [412]), (443.5, [437, 450]), (20.0, range(16, 25))]
)
def test_windows_narrow_dead_times_to_those_about_theirs_however_far_apart(
    theta: float, looked_at: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    data, delays = loop_data(samples=2_000), profile._delays(450.0)
    glimpse = long_record._Glimpse((1.5,), (theta,), clear=True)
    shifted: list[list[int]] = []

    def at(sums: np.ndarray, some: np.ndarray) -> AtDelays:
        shifted.append(some.tolist())
        return at_delays(sums, some)

    monkeypatch.setattr(long_record, "_glimpses", lambda *_: [glimpse])
    monkeypatch.setattr(long_record, "at_delays", at)
    rows, likely = long_record.scan_long(data, delays, 450.0, lambda _: None)
    assert shifted == [list(looked_at)]
    assert len(rows) > 0
    assert likely[0] == 1.5
