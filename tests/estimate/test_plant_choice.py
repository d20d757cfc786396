"""First order or integrating, where the plant is not named: on loops of known truth."""

from __future__ import annotations

import importlib

import numpy as np
import pytest
from typer.testing import CliRunner

import workbench as wb
from workbench.cli import app
from workbench.estimate import estimate as search
from workbench.estimate.answer import answer_of
from workbench.estimate.estimate import WORDS_OF_ENDLESS, linear_loop
from workbench.estimate.fits.data import centre
from workbench.estimate.plants import foretelling_bic, likelier_kind
from workbench.estimate.record_fits import Fits

SAMPLES = 350


def record_of(
    plant: wb.FOPDT | wb.Integrating, valve: object, seed: int, load: float = 0.0, samples: int = SAMPLES
) -> wb.Record:
    Kc, Ti, scale = (0.5, 15.0, 2.0) if isinstance(plant, wb.FOPDT) else (0.8, 60.0, 1.0)
    loop = wb.Loop(plant, valve, wb.PID(Kc=Kc, Ti=Ti), 1.0)
    rng = np.random.default_rng(seed)
    disturbance = np.zeros(samples)
    for k in range(1, samples):
        disturbance[k] = 0.8 * disturbance[k - 1] + rng.normal(0.0, 0.6 * load)
    steps = [wb.Step(3.0 * scale, 40.0), wb.Step(-4.0 * scale, 0.55 * samples)]
    experiment = wb.Experiment(
        float(samples), setpoint=steps, load=wb.Series(tuple(disturbance.tolist())), noise=wb.Noise(0.03 * scale, seed)
    )
    run = wb.simulate(loop, experiment)
    return wb.Record(run.pv + 50.0, run.op + 40.0, 1.0)


PLANTS = (wb.FOPDT(2.0, 8.0, 1.5), wb.Integrating(0.06, 2.5))


@pytest.mark.parametrize("plant", PLANTS)
def test_the_plant_of_a_record_without_stiction_is_chosen_and_said(plant: wb.FOPDT | wb.Integrating) -> None:
    found = wb.estimate(record_of(plant, wb.Ideal(), 1))
    assert type(found.plant) is type(plant)
    assert found.plant.gain == pytest.approx(plant.gain, rel=0.1)
    first_order = any(reason.startswith("a first-order process has the lower BIC, by ") for reason in found.reasons)
    integrating = any(
        reason == WORDS_OF_ENDLESS or reason.startswith("an integrating process has the lower BIC, by ")
        for reason in found.reasons
    )
    assert integrating == isinstance(plant, wb.Integrating)
    assert not (first_order and integrating)


def test_the_other_kind_is_searched_only_where_the_first_leaves_something(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[bool] = []

    def answered(record: wb.Record, how: tuple[str, str], fits: Fits, *more: object) -> object:
        asked.append(fits.data.integrating)
        return answer_of(record, how, fits, *more)

    monkeypatch.setattr(search, "answer_of", answered)
    loops = ((PLANTS[0], wb.PID(Kc=0.5, Ti=15.0), 2.0), (PLANTS[1], wb.PID(Kc=0.8, Ti=60.0), 1.0))
    for plant, controller, scale in loops:
        steps = [wb.Step(3.0 * scale, 40.0), wb.Step(-4.0 * scale, 275.0)]
        experiment = wb.Experiment(500.0, steps, noise=wb.Noise(0.03 * scale, 2))
        run = wb.simulate(wb.Loop(plant, wb.Stenman(2.0), controller, 1.0), experiment)
        record = wb.Record(run.pv + 50.0, run.op + 40.0, 1.0, sp=run.sp + 50.0)
        asked.clear()
        found = wb.estimate(record)
        level = isinstance(plant, wb.Integrating)
        # A level that is seen not to level off is never searched as a lag.
        assert asked == [level]
        assert found.plant.gain == pytest.approx(plant.gain, rel=0.1)
        assert (WORDS_OF_ENDLESS in found.reasons) == level
        assert not any("has the lower BIC" in reason for reason in found.reasons)
        by_name = wb.estimate(record, plant="integrating" if level else "fopdt")
        assert found.plant == by_name.plant
        assert found.valve == by_name.valve
        assert found.intervals == by_name.intervals


def test_a_load_step_does_not_make_a_level_of_a_lag() -> None:
    # Beside the stem stands a step of the load: both kinds of plant are compared without it.
    loop = wb.Loop(wb.FOPDT(2.0, 8.0, 1.5), wb.Stenman(2.0), wb.PID(Kc=0.5, Ti=15.0), 1.0)
    steps = [wb.Step(6.0, 40.0), wb.Step(-8.0, 275.0)]
    experiment = wb.Experiment(600.0, steps, load=wb.Step(1.5, 400.0), noise=wb.Noise(0.06, 5))
    run = wb.simulate(loop, experiment)
    found = wb.estimate(wb.Record(run.pv, run.op, 1.0))
    assert isinstance(found.plant, wb.FOPDT)
    assert found.plant.gain == pytest.approx(2.0, rel=0.05)


def test_the_other_plant_foretells_worse_under_a_load() -> None:
    # Along the stem of its own fit each plant is judged by what it foretells one sample ahead.
    record = record_of(PLANTS[1], wb.Stenman(2.0), 3, load=0.2)
    bic = {}
    for name in ("fopdt", "integrating"):
        one = wb.estimate(record, plant=name, valve="stenman")
        bic[name] = foretelling_bic(centre(record, name), one.plant, one.valve, one.valve_position, one.prediction)
    assert bic["integrating"] < bic["fopdt"] - 10.0


def test_where_the_stem_rested_before_its_first_move_is_fitted_and_decides_nothing() -> None:
    # Of a record that begins within the cycle nobody knows it, and the place that is told is one that the valve holds.
    loop = wb.Loop(PLANTS[0], wb.Stenman(2.0), wb.PID(Kc=0.5, Ti=15.0), 1.0)
    run = wb.simulate(loop, wb.Experiment(1000.0, wb.Step(6.0), noise=wb.Noise(0.06, 5)))
    record = wb.Record(run.pv[500:], run.op[500:], 1.0)
    stem, data, bics = run.valve[500:], centre(record, "fopdt"), []
    first = int(np.argmax(stem != stem[0]))
    assert first > 5
    for aside in (0.0, 1.0):
        moved = stem + aside * (np.arange(500) < first)
        bics.append(foretelling_bic(data, PLANTS[0], wb.Stenman(2.0), moved, run.pv[500:]))
    assert bics[1] == pytest.approx(bics[0], abs=0.01)


def test_the_joint_refinement_follows_the_choice() -> None:
    shares: list[float] = []
    found = wb.estimate(record_of(PLANTS[1], wb.Stenman(2.0), 2), method="joint", progress=shares.append)
    assert found.method == "joint"
    assert isinstance(found.plant, wb.Integrating)
    assert found.noise_model is not None
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


def test_a_record_without_information_is_refused_as_ever() -> None:
    with pytest.raises(wb.RecordError, match="OP is constant"):
        wb.estimate(wb.Record(np.arange(100.0), np.full(100, 45.0), 1.0), plant="auto")


def test_the_command_takes_joint_and_auto(tmp_path: object) -> None:
    record = record_of(PLANTS[0], wb.Stenman(2.0), 1, samples=500)
    path = f"{tmp_path}/loop.csv"
    rows = [f"{k},{pv},{op}" for k, (pv, op) in enumerate(zip(record.pv, record.op, strict=True))]
    with open(path, "w", encoding="utf-8") as file:  # noqa: PTH123
        file.write("\n".join(["time,PV,OP", *rows]) + "\n")
    result = CliRunner().invoke(app, ["estimate", path, "--method", "joint", "--plant", "auto", "--out", f"{tmp_path}"])
    assert result.exit_code == 0, result.output
    assert "first order plus dead time" in result.output
    assert "one sample ahead PV is foretold within" in result.output
    assert "Parts" in result.output


@pytest.mark.parametrize("plant", PLANTS)
def test_a_linear_loop_by_itself_is_the_model_that_the_estimate_gives_it(plant: wb.FOPDT | wb.Integrating) -> None:
    record = record_of(plant, wb.Ideal(), 4, load=0.2, samples=200)
    alone = linear_loop(record, "auto")
    found = wb.estimate(record, plant="fopdt" if isinstance(plant, wb.FOPDT) else "integrating", valve="linear")
    assert type(alone.plant) is type(plant)
    assert alone.plant == found.plant
    assert np.array_equal(alone.prediction, found.prediction)
    with pytest.raises(wb.InvalidValue, match=r"linear_loop\.plant"):
        linear_loop(record, "second order")


@pytest.mark.parametrize(
    ("plant", "controller", "first"),
    [
        (wb.FOPDT(2.0, 5.0, 1.0), wb.PID(Kc=0.5, Ti=20.0), "fopdt"),
        (wb.Integrating(0.01, 10.0), wb.PID(Kc=2.0, Ti=200.0), "integrating"),
    ],
)
def test_the_plant_that_the_linear_fits_show_is_searched_alone_where_it_leaves_noise(
    plant: wb.FOPDT | wb.Integrating, controller: wb.PID, first: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    module = importlib.import_module("workbench.estimate.estimate")
    begun: list[str] = []
    begin = module._begun

    def noted(record: wb.Record, kind: str, *rest: object) -> object:
        begun.append(kind)
        return begin(record, kind, *rest)

    monkeypatch.setattr(module, "_begun", noted)
    moves = [wb.Step(8.0), wb.Step(-6.0, at=480.0)]
    run = wb.simulate(
        wb.Loop(plant, wb.Stenman(2.0), controller, 1.0), wb.Experiment(800.0, moves, noise=wb.Noise(0.1, 1))
    )
    assert type(wb.estimate(wb.Record(run.pv, run.op, 1.0)).plant) is type(plant)
    assert begun == [first]


@pytest.mark.slow
def test_a_lag_whose_linear_fit_never_levels_off_is_told_by_its_stem() -> None:
    # A level leaves hardly more than the lag where nobody reckons with the stem, and more than noise where one does.
    loop = wb.Loop(wb.FOPDT(1.0, 8.0, 4.0), wb.Choudhury(4.0, 2.2), wb.PID(0.5, 25.0), 1.0)
    run = wb.simulate(loop, wb.Experiment(2000.0, setpoint=wb.Step(3.0), noise=wb.Noise(0.1, 0)))
    record = wb.Record(run.pv[500:], run.op[500:], 1.0, sp=run.sp[500:])
    assert linear_loop(record, "fopdt").plant.time_constant >= 0.5 * 1500.0
    found = wb.estimate(record)
    assert isinstance(found.plant, wb.FOPDT)
    assert found.plant.time_constant == pytest.approx(8.0, rel=0.1)


def test_a_lag_as_long_as_the_record_is_no_likelier_than_a_level_that_leaves_less_of_pv() -> None:
    # Without noise, and beside a load step too small to be found, what each stem leaves foretells itself.
    loop = wb.Loop(wb.Integrating(0.003283, 0.1332), wb.Choudhury(3.5755, 4.1444), wb.PID(Kc=25.741, Ti=47.33), 1.0)
    setpoint, load = [wb.Step(0.15814), wb.Step(-0.2372, 556.0)], wb.Step(-0.009893, 747.0)
    run = wb.simulate(loop, wb.Experiment(800.0, setpoint=setpoint, load=load))
    found = wb.estimate(wb.Record(run.pv + 50.0, run.op + 40.0, 1.0, sp=run.sp + 50.0))
    assert isinstance(found.plant, wb.Integrating)
    assert found.plant.gain == pytest.approx(0.003283, rel=0.01)


@pytest.mark.parametrize(
    ("by", "levels_off", "sticks", "less", "kind"),
    [
        (-1.0, True, True, False, "fopdt"),  # no more than a bare mention
        (-5.0, True, True, True, "integrating"),  # as likely, with a parameter less
        (-5.0, True, False, True, "fopdt"),  # without a stem it takes more
        (-11.0, True, False, True, "integrating"),
        (99.0, False, True, True, "integrating"),  # a time constant as long as the record is none
        (101.0, False, True, True, "fopdt"),
        (101.0, False, True, False, "integrating"),
    ],
)
def test_a_lag_and_a_level_that_are_hardly_told_apart(
    by: float, kind: str, *, levels_off: bool, sticks: bool, less: bool
) -> None:
    assert likelier_kind(by, levels_off=levels_off, sticks=sticks, less=less) == kind
