"""Long dead times: they are searched where PV shows one, and no stem with another plant takes their place."""

from __future__ import annotations

import importlib

import numpy as np
import pytest

import workbench as wb
from workbench.estimate.estimate import _profile
from workbench.estimate.fits.data import Centred, centre
from workbench.estimate.loads.coloured import DELAYS, delays_about
from workbench.estimate.search.profile import EACH, _delays
from workbench.estimate.search.reach import searched
from workbench.estimate.search.stems import silent
from workbench.model.valve import Valve


def record_of(plant: wb.FOPDT | wb.Integrating, valve: Valve, size: float, samples: int, sd: float) -> wb.Record:
    lag = plant.time_constant if isinstance(plant, wb.FOPDT) else 1.0
    slow = 1.0 if isinstance(plant, wb.FOPDT) else 8.0 * plant.dead_time
    loop = wb.Loop(plant, valve, wb.PID(Kc=lag / (2.0 * plant.gain * plant.dead_time), Ti=max(lag, slow)), 1.0)
    moves = [wb.Step(size, at=0.05 * samples), wb.Step(-1.5 * size, at=0.5 * samples)]
    run = wb.simulate(loop, wb.Experiment(float(samples), moves, noise=wb.Noise(sd, 1)))
    return wb.Record(run.pv, run.op, 1.0, sp=run.sp)


@pytest.mark.parametrize(
    ("plant", "valve", "size", "samples", "sd"),
    [
        (wb.FOPDT(1.2, 60.0, 55.0), wb.Stenman(2.5), 6.0, 800, 0.05),
        (wb.FOPDT(1.5, 40.0, 80.0), wb.Choudhury(3.0, 1.2), 8.0, 900, 0.05),
        (wb.Integrating(0.02, 95.0), wb.Deadband(2.6), 15.0, 1000, 0.2),
    ],
    ids=["stenman", "two parameters", "dead band"],
)
def test_a_sticking_valve_and_its_plant_are_found(
    plant: wb.FOPDT | wb.Integrating, valve: Valve, size: float, samples: int, sd: float
) -> None:
    record = record_of(plant, valve, size, samples, sd)
    found = wb.estimate(record, plant="fopdt" if isinstance(plant, wb.FOPDT) else "integrating")
    assert found.valve.stick_band == pytest.approx(valve.stick_band, rel=0.05)
    assert found.plant.gain == pytest.approx(plant.gain, rel=0.05)
    assert found.plant.dead_time == pytest.approx(plant.dead_time, abs=2.0)
    low, high = found.intervals.dead_time
    assert low - 0.1 <= plant.dead_time <= high + 0.1


def test_a_dead_time_just_beyond_the_usual_ones_is_found_and_no_other_is_searched_where_one_is_asked_for() -> None:
    record = record_of(wb.FOPDT(1.5, 40.0, 32.0), wb.Stenman(2.0), 6.0, 600, 0.05)
    found = wb.estimate(record, plant="fopdt", valve="stenman")
    assert found.plant.dead_time == pytest.approx(32.0, abs=0.5)
    asked = _profile(centre(record, "fopdt"), 20.0, silent)
    assert asked is not None
    assert asked.limits.theta[1] == 20.0
    assert all(one.fit.theta <= 20.0 + 1e-6 for one in asked.fits)


def test_a_usual_dead_time_is_searched_once(monkeypatch: pytest.MonkeyPatch) -> None:
    module = importlib.import_module("workbench.estimate.search.reach")
    longest: list[float] = []
    search = module.search

    def noted(data: object, most: float, *rest: object) -> object:
        longest.append(most)
        return search(data, most, *rest)

    monkeypatch.setattr(module, "search", noted)
    wb.estimate(record_of(wb.FOPDT(1.5, 30.0, 8.0), wb.Stenman(2.0), 6.0, 1000, 0.05), plant="fopdt", valve="stenman")
    assert longest == [30.0]


@pytest.mark.parametrize(("tau", "theta", "thinned"), [(5.0, 1.0, 0), (120.0, 40.0, 1)])
def test_a_long_record_is_looked_at_thinned_where_its_window_holds_few_slips(
    tau: float, theta: float, thinned: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[int] = []
    thin = Centred.thinned

    def noted(data: Centred, every: int) -> Centred:
        asked.append(every)
        return thin(data, every)

    module = importlib.import_module("workbench.estimate.search.reach")
    search = module._searched
    seen: list[int] = []

    def searched_in(data: Centred, *rest: object) -> object:
        seen.append(data.samples)
        return search(data, *rest)

    monkeypatch.setattr(Centred, "thinned", noted)
    monkeypatch.setattr(module, "_searched", searched_in)
    data = centre(record_of(wb.FOPDT(1.5, tau, theta), wb.Stenman(2.0), 6.0, 6000, 0.05), "fopdt")
    found = searched(data, 30.0, 1500.0, silent)
    assert asked == [4]
    assert seen == [1500, *[1500] * thinned, 6000]
    assert found is not None
    assert found.best.fit.theta == pytest.approx(theta, abs=1.0)


def test_the_dead_times_scanned_are_each_up_to_some_and_then_by_a_share() -> None:
    assert _delays(30.0).tolist() == list(range(31))
    assert _delays(float(EACH)).tolist() == list(range(EACH + 1))
    long = _delays(250.0)
    assert long[: EACH + 1].tolist() == list(range(EACH + 1))
    assert long[-1] == 250
    assert (np.diff(long) >= 1).all()
    assert (np.diff(long)[EACH:] <= 0.04 * long[EACH:-1] + 1.0).all()


def test_about_a_long_dead_time_others_like_it_are_looked_at() -> None:
    assert delays_about(12.0, 30.0) == sorted({float(min(d, 30.0)) for d in DELAYS})
    about = delays_about(120.0, 130.0)
    assert {84.0, 120.0, 130.0} <= set(about)
    assert max(about) == 130.0


def test_a_usual_dead_time_is_met_in_a_long_record_whose_thinned_look_asks_for_longer_ones() -> None:
    # 24 slips in 20,000 samples: thinned, a stem with a long dead time fits; no other of 2 % more or less does.
    controller = wb.PID(Kc=0.904856581111127, Ti=353.64720407631125)
    loop = wb.Loop(wb.Integrating(0.01, 6.845850105669755), wb.Stenman(0.9770805368631066), controller, 1.0)
    moves, noise = [wb.Step(0.7300755621169038, at=100.0)], wb.Noise(0.07876110593140363, 544050456)
    run = wb.simulate(loop, wb.Experiment(20_000.0, setpoint=moves, noise=noise))
    data = centre(wb.Record(run.pv, run.op, 1.0, sp=run.sp), "integrating")
    found = searched(data, 30.0, 5000.0, silent)
    assert found is not None
    assert found.limits.theta[1] > 30.0
    assert found.best.d == pytest.approx(0.97708, rel=0.001)
    assert found.best.fit.gain == pytest.approx(0.01, rel=0.005)
    assert found.best.fit.theta == pytest.approx(6.85, abs=0.5)
