"""Load steps that nobody recorded: found where they are, told with their size, and never made of a coloured load."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import workbench as wb
from workbench.cli.output import estimate_lines
from workbench.estimate import record_fits
from workbench.estimate.fits.data import Centred, centre
from workbench.estimate.fits.fit import Limits, autoregression, fit_linear, fit_path
from workbench.estimate.loads import settled as turns
from workbench.estimate.loads.settled import _of_band
from workbench.estimate.loads.steps import Loads, Stem, _beside, _explained, _refined, loads_of
from workbench.estimate.record_fits import Fits
from workbench.estimate.search import profile
from workbench.estimate.search.candidates import Candidate
from workbench.estimate.search.stems import path_of
from workbench.estimate.search.two_parameter import band_stem, best_start, fit_band
from workbench.model.loads import LoadStep
from workbench.model.results import FittedModel

PLANTS = [wb.FOPDT(1.5, 12.0, 3.0), wb.Integrating(0.02, 3.0)]


def loop_of(plant: wb.FOPDT | wb.Integrating, valve: wb.Choudhury | wb.Stenman) -> wb.Loop:
    controller = wb.PID(Kc=0.6, Ti=15.0) if isinstance(plant, wb.FOPDT) else wb.PID(Kc=2.5, Ti=80.0)
    return wb.Loop(plant, valve, controller, 1.0)


MOVE = wb.Step(-6.0, 500.0)


def run_of(loop: wb.Loop, load: wb.Step | wb.Series | None, seed: int = 4, move: wb.Step = MOVE) -> wb.Run:
    steps = [wb.Step(5.0), move]
    return wb.simulate(loop, wb.Experiment(1000.0, setpoint=steps, load=load, noise=wb.Noise(0.05, seed)))


def record_of(run: wb.Run) -> wb.Record:
    return wb.Record(run.pv + 50.0, run.op + 40.0, 1.0, sp=run.sp + 50.0)


def fitted(record: wb.Record, kind: str, valve: str = "auto") -> tuple[FittedModel, Fits]:
    """The likeliest model of an estimate beside its load steps, and all its fits: without ranges and verdict."""
    data = centre(record, kind)
    first = record_fits.first_fits(data, valve, profile.search(data, 30.0), fit_linear(data, 240.0))
    fits = record_fits.closely(first, valve)
    return next(iter(fits.models.values())), fits


@pytest.mark.parametrize("plant", PLANTS, ids=["fopdt", "integrating"])
def test_a_step_is_found_at_its_time_with_its_size_beside_the_true_stem(plant: wb.FOPDT | wb.Integrating) -> None:
    loop = loop_of(plant, wb.Choudhury(3.0, 1.0))
    run = run_of(loop, wb.Step(1.2, 700.0))
    kind = "integrating" if isinstance(plant, wb.Integrating) else "fopdt"
    data = centre(record_of(run), kind)
    stem = run.valve - 0.5 * (run.op.max() + run.op.min())
    limits, free = Limits((0.05, 1000.0), (0.0, 30.0)), (-math.inf, math.inf)
    fit = fit_path(data, stem, 0, free, limits, 3.0, tau=12.0)
    found = loads_of(data, Stem(stem, 0, fit), limits, 0, 2)
    assert len(found.steps) == 1
    step = found.steps[0]
    # PV begins to answer a dead time after the load has changed.
    assert step.at == pytest.approx(703.0, abs=3.0)
    assert step.size == pytest.approx(1.2, rel=0.1)
    assert np.std(found.left) == pytest.approx(0.05, rel=0.1)
    # What the step adds to PV is the plant's answer to it.
    k = np.arange(1000.0)
    after = np.maximum(k - 703.0, 0.0)
    true = 1.2 * (0.02 * after if kind == "integrating" else 1.5 * (1.0 - np.exp(-after / 12.0)))
    assert np.abs(found.pv - true).max() < 0.12 * np.abs(true).max()


@pytest.mark.parametrize(("J", "asked"), [(1.0, 0), (0.0, 1)], ids=["slips", "dead band"])
def test_no_stem_is_sought_beside_steps_where_the_leads_slips_leave_noise_alone(J: float, asked: int) -> None:
    run = run_of(loop_of(PLANTS[1], wb.Choudhury(3.0, J)), wb.Step(1.2, 700.0))
    data, limits = centre(record_of(run), "integrating"), Limits((0.05, 1000.0), (0.0, 30.0))
    start = best_start(data, (3.0, J), (12.0, 3.0))[1:]
    lead = _of_band(data, fit_band(data, 3.0, J, start, limits, (12.0, 3.0)))
    spans: list[tuple[int, int]] = []

    def further(span: tuple[int, int]) -> list[Stem]:
        spans.append(span)
        return []

    found = loads_of(data, lead, limits, 0, 2, further)
    assert len(found.steps) == 1
    assert np.std(found.left) == pytest.approx(0.05, rel=0.1)
    assert len(spans) == asked


@pytest.mark.parametrize(("plant", "late"), [(PLANTS[0], 0.3), (PLANTS[1], 2.6)], ids=["fopdt", "integrating"])
def test_a_step_that_pv_answers_between_samples_is_found_there(plant: wb.FOPDT | wb.Integrating, late: float) -> None:
    plant = replace(plant, dead_time=late)
    loop = loop_of(plant, wb.Choudhury(3.0, 1.0))
    experiment = wb.Experiment(1000.0, setpoint=[wb.Step(5.0), MOVE], load=wb.Step(1.2, 700.0), noise=wb.Noise(0.01, 1))
    run = wb.simulate(loop, experiment)
    data = centre(record_of(run), "integrating" if isinstance(plant, wb.Integrating) else "fopdt")
    stem = run.valve - 0.5 * (run.op.max() + run.op.min())
    limits, free = Limits((0.05, 1000.0), (0.0, 30.0)), (-math.inf, math.inf)
    found = loads_of(data, Stem(stem, 0, fit_path(data, stem, 0, free, limits, 3.0, tau=12.0)), limits, 0, 2)
    # One step, though two at the samples about it would add up to one between them.
    assert [step.at for step in found.steps] == [pytest.approx(700.0 + late, abs=0.1)]
    assert found.steps[0].size == pytest.approx(1.2, rel=1e-3)
    fit = fit_path(data.less(found.pv, found.answers), stem, 0, free, limits, 3.0, tau=12.0)
    assert fit.gain == pytest.approx(plant.gain, rel=1e-3)


def test_an_estimate_allows_for_the_step_and_says_so() -> None:
    record = record_of(run_of(loop_of(PLANTS[0], wb.Stenman(1.5)), wb.Step(1.2, 700.0)))
    found = wb.estimate(record, plant="fopdt", valve="stenman")
    assert found.verdict == "stiction"
    assert [round(step.at, -1) for step in found.load_steps] == [700.0]
    assert found.load_steps[0].interval[0] < found.load_steps[0].size < found.load_steps[0].interval[1]
    assert found.valve.stick_band == pytest.approx(1.5, rel=0.03)
    assert found.plant.gain == pytest.approx(1.5, rel=0.05)
    # The prediction holds the step: what is left is the noise, before it and after it.
    left = record.pv - found.prediction
    assert np.std(left[20:]) == pytest.approx(0.05, rel=0.1)
    assert abs(left[720:].mean()) < 0.02
    assert any(line.startswith("Load") and line.endswith("nobody recorded it") for line in estimate_lines(found))
    # Its size is PV's answer over the gain.
    blind = replace(found, intervals=replace(found.intervals, gain=(0.0, math.inf)))
    for doubtful in (blind, replace(found, verdict="undecided")):
        (line,) = [line for line in estimate_lines(doubtful) if line.startswith("Load")]
        assert line.endswith("nobody recorded it (sizes are a hint only, as the gain is)")


@pytest.mark.parametrize(
    ("plant", "valve", "controller", "load", "named"),
    [
        (wb.Integrating(0.02, 3.0), wb.Stenman(2.0), wb.PID(2.0, 60.0), wb.Step(3.0, 400.0), "stenman"),
        (wb.Integrating(0.05, 5.0), wb.Choudhury(3.0, 1.0), wb.PID(1.0, 80.0), wb.Step(2.0, 500.0), "auto"),
    ],
    ids=["stenman", "two-parameter"],
)
def test_a_level_under_a_large_load_is_not_taken_for_another(
    plant: wb.Integrating, valve: wb.Valve, controller: wb.PID, load: wb.Step, named: str
) -> None:
    """Its PV runs away from the level that it had, which neither the first stem nor an autoregression stands."""
    run = run_of(wb.Loop(plant, valve, controller, 1.0), load, seed=3, move=wb.Step(-3.0, 600.0))
    found, fits = fitted(record_of(run), "integrating", named)
    assert len(fits.steps) == 1
    assert fits.steps[0].size == pytest.approx(load.size, rel=0.05)
    assert fits.steps[0].at == pytest.approx(load.at + plant.dead_time, abs=4.0)
    assert found.slips >= 10
    assert found.valve.stick_band == pytest.approx(valve.stick_band, rel=0.03)
    assert found.plant.gain == pytest.approx(plant.gain, rel=0.05)


def test_a_load_step_of_a_level_is_found_beside_its_slips() -> None:
    # Once it was not: the stem's band came out right, the gain a twentieth.
    loop = wb.Loop(wb.Integrating(0.03, 4.0), wb.Choudhury(4.0, 1.5), wb.PID(Kc=3.0, Ti=60.0), 1.0)
    steps, load = wb.Step(3.0, at=20.0), wb.Step(1.5, at=500.0)
    run = wb.simulate(loop, wb.Experiment(1000.0, setpoint=steps, load=load, noise=wb.Noise(0.05, 1)))
    record = wb.Record(run.pv, run.op, 1.0, sp=run.sp)
    found = wb.estimate(record, plant="integrating")
    assert found.verdict == "stiction"
    assert found.plant.gain == pytest.approx(0.03, rel=0.01)
    assert pytest.approx((4.0, 1.5), rel=0.01) == (found.valve.S, found.valve.J)
    assert [(step.at, step.size) for step in found.load_steps] == [
        (pytest.approx(504.0, abs=1.0), pytest.approx(1.5, rel=0.01))
    ]
    # The prediction holds the step here too, beside which a two-parameter stem is told.
    left = record.pv - found.prediction
    assert np.std(left[20:]) == pytest.approx(0.05, rel=0.1)
    assert abs(left[520:].mean()) < 0.02


def test_a_step_is_kept_while_the_stem_beside_it_is_not_quite_known() -> None:
    # Without noise the next stem's errors were taken for colour: the step was dropped, and a sinusoid found in its
    # place beside a gain of a twentieth.
    loop = wb.Loop(wb.Integrating(0.00443, 9.568), wb.Choudhury(0.7549, 0.8521), wb.PID(Kc=11.584, Ti=77.95), 1.0)
    run = wb.simulate(loop, wb.Experiment(2000.0, setpoint=wb.Step(0.01133), load=wb.Step(-0.101, 1777.0)))
    record = wb.Record(run.pv[1250:] + 50.0, run.op[1250:] + 40.0, 1.0, sp=run.sp[1250:] + 50.0)
    found, fits = fitted(record, "integrating")
    assert found.plant.gain == pytest.approx(0.00443, rel=0.01)
    assert pytest.approx(0.7549, rel=0.01) == found.valve.S
    assert [(step.at, step.size) for step in fits.steps] == [
        (pytest.approx(536.6, abs=1.0), pytest.approx(-0.101, rel=0.01))
    ]


@pytest.mark.parametrize("seed", range(2))
def test_no_step_is_made_of_noise_or_of_a_load_that_drifts(seed: int) -> None:
    rng = np.random.default_rng(seed)
    load = np.zeros(1000)
    for k in range(1, 1000):
        load[k] = 0.95 * load[k - 1] + 0.1 * rng.normal()
    for disturbance in (None, wb.Series(tuple(load.tolist()))):
        run = run_of(loop_of(PLANTS[0], wb.Stenman(1.5)), disturbance, seed=seed)
        data = centre(record_of(run), "fopdt")
        stem = run.valve - 0.5 * (run.op.max() + run.op.min())
        limits, free = Limits((0.05, 1000.0), (0.0, 30.0)), (-math.inf, math.inf)
        fit = fit_path(data, stem, 0, free, limits, 3.0, tau=12.0)
        assert loads_of(data, Stem(stem, 0, fit), limits, 0, 2).steps == ()


def test_the_past_tells_no_more_than_the_record_resolves() -> None:
    smooth = np.sin(2.0 * np.pi * np.arange(1000) / 300.0)
    floor = 1e-2
    a, bic = autoregression(smooth, floor)
    assert a.size > 1
    assert bic >= 1000.0 * math.log(floor)
    # Below the floor by itself it is as likely as what is there already.
    assert autoregression(0.1 * smooth, floor) == (pytest.approx([1.0]), pytest.approx(1000.0 * math.log(floor)))


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("factor", [1e160, math.inf, math.nan])
def test_what_a_model_that_runs_away_leaves_is_no_colour(factor: float) -> None:
    a, bic = autoregression(np.full(100, factor), 1e-12)
    assert (a.tolist(), bic) == ([1.0], math.inf)


def test_where_the_search_without_steps_ends_as_a_dead_band_the_steps_stay(monkeypatch: pytest.MonkeyPatch) -> None:
    """There the valve that was chosen beside them is no more among the models."""
    record = record_of(run_of(loop_of(PLANTS[0], wb.Choudhury(3.0, 1.0)), None))
    _, fits = fitted(record, "fopdt")
    assert "choudhury" in fits.bands
    dead = {name: bands for name, bands in fits.bands.items() if name == "deadband"}
    few = replace(fits.bands["choudhury"].best, slips=6)
    ranged = record_fits.with_ranges(fits, "choudhury")[1]
    monkeypatch.setattr(record_fits, "_ranged", lambda *_: replace(ranged, best=few))
    stepped = replace(fits, steps=(LoadStep(500.0, 1.0, (0.9, 1.1)),), bare=lambda: replace(fits, bands=dead))
    assert record_fits.with_ranges(stepped, "choudhury")[0] is stepped


def test_beside_steps_no_stem_comes_to_a_jump_that_op_never_makes() -> None:
    """Beyond it the size of the jump is a gain of its own: a search for both went to thousands of per cent."""
    run = run_of(loop_of(PLANTS[0], wb.Choudhury(3.0, 1.0)), wb.Step(1.2, 700.0))
    data = centre(record_of(run), "fopdt")
    stem, better = band_stem(data.u, 0.4 * data.op_range, data.op_range)[0], run.valve - run.valve.mean()
    limits, free = Limits((0.05, 1000.0), (0.0, 30.0)), (-math.inf, math.inf)
    fit = fit_path(data, stem, 0, free, limits, 3.0, tau=12.0)
    S, J = 0.4 * data.op_range, data.op_range
    # The further the jump, the nearer is this stem to the true one.
    lead = Stem(stem, 0, fit, lambda _, f: better + (stem - better) / f**4, free=2, valve=(S, J, -1, 0.0))
    alone = _beside(data, stem, 0, fit, limits, 0, [703])
    moved = _refined(data, lead, alone, limits, 0)
    assert moved.power(0) < alone.power(0)
    assert 1.0 < S * moved.wider / data.op_range + J * moved.further / data.op_range < 2.0
    unbound = _refined(replace(data, op_range=1e9), lead, alone, limits, 0)
    assert S * unbound.wider + J * unbound.further > 2.0 * data.op_range


def test_a_step_that_the_leading_stem_made_up_for_is_found_beside_one_that_leaves_hardly_more() -> None:
    loop = wb.Loop(wb.FOPDT(0.674881, 21.3368, 4.55789), wb.Deadband(4.81975), wb.PID(Kc=0.642898, Ti=12.4367), 1.0)
    setpoint, load = [wb.Step(6.81583), wb.Step(-10.2238, 376.0)], wb.Step(0.54121, 449.0)
    run = wb.simulate(loop, wb.Experiment(1000.0, setpoint=setpoint, load=load, noise=wb.Noise(0.2194, 2018511134)))
    data = centre(wb.Record(run.pv, run.op, 1.0), "fopdt")
    fits = record_fits.first_fits(data, "auto", profile.search(data, 30.0), fit_linear(data, 30.0))
    bands, limits = record_fits._clearly(fits), fits.limits
    lead, dead = (_of_band(data, bands[name].best) for name in ("choudhury", "deadband"))
    assert lead.fit.sse < dead.fit.sse
    assert loads_of(data, lead, limits, 0, 2, strict=False).steps == ()
    (step,) = loads_of(data, lead, limits, 0, 2, strict=False, others=[dead]).steps
    assert step.at == pytest.approx(449.0 + 4.6, abs=8.0)
    assert step.size == pytest.approx(0.54, rel=0.25)


LONG = 3600  # samples
TIGHT = wb.Loop(wb.FOPDT(1.0, 12.0, 2.0), wb.Stenman(2.5), wb.PID(Kc=2.0, Ti=12.0), 1.0)


def starting(seed: int) -> tuple[wb.Record, wb.Run]:
    """A long record of a loop at rest, whose cycle an early step of the load starts."""
    run = wb.simulate(TIGHT, wb.Experiment(float(LONG), load=wb.Step(4.0, 60.0), noise=wb.Noise(0.024, seed)))
    return record_of(run), run


@pytest.mark.parametrize("missed", [0, 1])
def test_a_step_early_in_a_long_record_is_found_beside_a_stem_that_may_miss_the_slip_after_it(missed: int) -> None:
    record, run = starting(2)
    data, limits = centre(record, "fopdt"), Limits((0.05, float(LONG)), (0.0, 30.0))
    first = (np.flatnonzero(np.diff(run.valve)) + 1)[missed]

    def begun(first: int, _: float) -> Stem:
        x = path_of(data.u, 2.5, first)[0]
        fit = fit_path(data, x, first, (-math.inf, math.inf), limits, 2.0, tau=12.0)
        return Stem(x, first, fit, lambda wider, _: path_of(data.u, 2.5 * wider, first)[0], free=1, begun=begun)

    (step,) = loads_of(data, begun(int(first), 0.0), limits, 10, 2).steps
    assert step.at == pytest.approx(62.0, abs=0.5)
    assert step.size == pytest.approx(4.0, rel=0.02)


@pytest.mark.parametrize(("begin", "found"), [(50, True), (66, False)])
def test_a_step_before_those_that_are_sought_is_none_at_the_first_of_them(begin: int, found: bool) -> None:
    record, run = starting(2)
    data, limits = centre(record, "fopdt"), Limits((0.05, float(LONG)), (0.0, 30.0))
    first = int(np.flatnonzero(np.diff(run.valve))[0]) + 1
    x = path_of(data.u, 2.5, first)[0]
    fit = fit_path(data, x, first, (-math.inf, math.inf), limits, 2.0, tau=12.0)
    stem, bare = Stem(x, first, fit), _beside(data, x, first, fit, limits, 10, [])
    assert (_explained(data, stem, bare, limits, 10, (begin, LONG - 20), 2, False) is not None) == found


@pytest.mark.parametrize("seed", [1, 2])
def test_the_gain_is_known_where_an_early_step_starts_the_cycle(seed: int) -> None:
    model, fits = fitted(starting(seed)[0], "fopdt", "stenman")
    (step,) = fits.steps
    assert step.at == pytest.approx(62.0, abs=0.5)
    assert step.size == pytest.approx(4.0, rel=0.03)
    assert model.plant.gain == pytest.approx(1.0, rel=0.01)
    assert model.valve.stick_band == pytest.approx(2.5, rel=0.002)


@pytest.mark.parametrize("doubt", [0.0, 0.01])
def test_what_is_left_out_at_the_start_is_the_dead_time_of_a_model_that_explains_pv(
    doubt: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Asked(Exception):
        """The samples that are left out are known."""

    def asked(data: Centred, lead: Stem, limits: Limits, skip: int, *_: object, **__: object) -> Loads:
        raise Asked(skip)

    data = replace(centre(starting(2)[0], "fopdt"), doubt=doubt)
    linear, found = fit_linear(data, 240.0), profile.search(data, 30.0)
    assert found is not None
    assert found.best.fit.sse < 0.5 * linear.sse
    longest = max(linear.theta, found.best.fit.theta) if doubt else found.best.fit.theta
    monkeypatch.setattr(turns, "loads_of", asked)
    with pytest.raises(Asked) as known:
        turns.settled(data, found, {}, linear, 30.0, record_fits.sought(data, 30.0, found.best.fit, contested=False))
    assert known.value.args == (math.ceil(min(longest, 30.0)) + 2,)


def test_a_step_among_the_first_hundredths_of_a_levels_record_is_found() -> None:
    level = wb.Loop(wb.Integrating(0.027, 4.3), wb.Stenman(1.3), wb.PID(Kc=0.8, Ti=150.0), 1.0)
    run = wb.simulate(level, wb.Experiment(float(LONG), load=wb.Step(2.3, 58.0), noise=wb.Noise(0.03, 3)))
    data, limits = centre(record_of(run), "integrating"), Limits((0.05, float(LONG)), (0.0, 30.0))
    first = int(np.flatnonzero(np.diff(run.valve))[0]) + 1
    x = path_of(data.u, 1.3, first)[0]
    fit = fit_path(data, x, first, (-math.inf, math.inf), limits, 4.3, tau=1.0)
    # What 60 samples of a ramp are beside 3,600 is a millionth of its power, and no rounding.
    (step,) = loads_of(data, Stem(x, first, fit), limits, 10, 2).steps
    assert step.at == pytest.approx(62.3, abs=1.0)
    assert step.size == pytest.approx(2.3, rel=0.1)


@pytest.mark.parametrize(
    ("loop", "experiment", "begin"),
    [
        # The stem of a search beside steps, whose first slip comes a sample late, is the one to go on from.
        (
            wb.Loop(wb.Integrating(0.0247, 8.4), wb.Stenman(1.0566), wb.PID(Kc=0.913, Ti=177.2), 1.0),
            wb.Experiment(2000.0, wb.Step(0.467), wb.Step(-0.398, 1280.0)),
            1000,
        ),
        # It slips first three samples early, which a second step makes up for.
        (
            wb.Loop(wb.Integrating(0.02452, 0.8606), wb.Stenman(1.23976), wb.PID(Kc=1.45971, Ti=111.76), 1.0),
            wb.Experiment(1000.0, [wb.Step(0.24525), wb.Step(-0.36788, 564.0)], wb.Step(0.61834, 182.0)),
            0,
        ),
    ],
    ids=["late", "early"],
)
def test_a_first_slip_at_the_wrong_sample_is_moved_and_no_step_made_of_it(
    loop: wb.Loop, experiment: wb.Experiment, begin: int
) -> None:
    run = wb.simulate(loop, experiment)
    record = wb.Record(run.pv[begin:] + 50.0, run.op[begin:] + 40.0, 1.0, sp=run.sp[begin:] + 50.0)
    model, fits = fitted(record, "integrating")
    (step,), load = fits.steps, experiment.load
    assert isinstance(load, wb.Step)
    assert step.at == pytest.approx(load.at - begin + loop.plant.dead_time, abs=0.01)
    assert step.size == pytest.approx(load.size, rel=1e-3)
    assert model.plant.gain == pytest.approx(loop.plant.gain, rel=1e-3)
    assert isinstance(model.valve, wb.Stenman)


def test_a_first_slip_is_moved_with_the_valve_as_it_is_by_then() -> None:
    d, load, first = 1.7483, wb.Step(0.5959, 848.0), 212
    loop = wb.Loop(wb.Integrating(0.0186072, 6.0711), wb.Stenman(d), wb.PID(Kc=3.1619, Ti=67.988), 1.0)
    run = wb.simulate(loop, wb.Experiment(1000.0, [wb.Step(0.13415), wb.Step(-0.20122, 673.0)], load))
    data = centre(record_of(run), "integrating")
    limits = Limits((0.05, 1000.0), (0.0, 30.0))
    # It slips a sample late, and its band, some thousandths too wide, has some of the later slips at other samples too.
    x, slips = path_of(data.u, 1.0037 * d, first + 1)
    fit = fit_path(data, x, first + 1, (-math.inf, math.inf), limits, 6.0, tau=1.0)
    lead = turns._of_path(data, Candidate(first + 1, 1.0037 * d, 1.0037 * d, slips, fit))
    loads = loads_of(data, lead, limits, 32, 2, strict=False)
    (step,) = loads.steps
    assert step.size == pytest.approx(load.size, rel=1e-3)
    assert loads.beside is not None
    assert loads.beside[0][2] == first
    assert loads.beside[0][0] == pytest.approx(d, rel=1e-3)
