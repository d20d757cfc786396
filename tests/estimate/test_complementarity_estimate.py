"""The complementarity form of estimation: its equations, what it claims, and what the valve's own law says of that."""

from __future__ import annotations

import importlib
import json
import math
from dataclasses import replace
from functools import cache

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import workbench as wb
from workbench.cli.output import estimate_json, estimate_lines
from workbench.estimate.fits.data import Centred, centre
from workbench.estimate.fits.fit import Limits, fit_linear, fit_path, start_range
from workbench.estimate.methods import refined
from workbench.estimate.search.paths import Path
from workbench.estimate.search.stems import path_of
from workbench.model.results import Intervals
from workbench.model.status import SolveStatus

complementarity = importlib.import_module("workbench.estimate.methods.complementarity")

PLANT = wb.FOPDT(2.0, 6.0, 1.6)
LEVEL = wb.Integrating(0.05, 2.4)


@cache
def record_of(plant: wb.FOPDT | wb.Integrating, valve: wb.Stenman | wb.Ideal, sd: float, seed: int = 0) -> wb.Record:
    n, Kc = 300, 0.5 if isinstance(plant, wb.FOPDT) else 1.5
    steps = [wb.Step(4.0, 20.0), wb.Step(-6.0, 165.0)]
    loop = wb.Loop(plant, valve, wb.PID(Kc=Kc, Ti=20.0), 1.0)
    run = wb.simulate(loop, wb.Experiment(float(n), setpoint=steps, noise=wb.Noise(sd, seed)))
    return wb.Record(run.pv + 50.0, run.op + 40.0, 1.0, sp=run.sp + 50.0)


def fitted(data: Centred, d: float, first: int, theta: float) -> Path:
    """The exact stem of d from `first` on, with the plant fitted to it."""
    x, slips = path_of(data.u, d, first)
    bounds = start_range(data.u, first, d, d)
    if first > 0:
        # What the fit allows beyond the exact range, the program does not.
        middle = sum(bounds) / 2.0
        bounds = (middle, middle)
    fit = fit_path(data, x, first, bounds, limits_of(data), theta)
    return Path(wb.Stenman(d), x, first, bounds, fit, slips, (d, d))


def limits_of(data: Centred) -> Limits:
    return Limits((0.05, float(data.samples)), (0.0, 30.0))


@pytest.mark.parametrize("a", [(1.0,), (1.0, -0.6, 0.2)], ids=["white", "coloured"])
@pytest.mark.parametrize("plant", [PLANT, LEVEL], ids=["fopdt", "integrating"])
@pytest.mark.parametrize("later", [False, True])
def test_a_stem_by_the_law_solves_the_program_at_its_own_cost(
    plant: wb.FOPDT | wb.Integrating, a: tuple[float, ...], later: bool
) -> None:
    record = record_of(plant, wb.Stenman(2.0), 0.05)
    data = centre(record, "fopdt" if isinstance(plant, wb.FOPDT) else "integrating").whitened(np.array(a), 5)
    first = int(np.flatnonzero(np.abs(data.u - data.u[0]) > 1.9)[0]) if later else 0
    path = fitted(data, 1.9, first, plant.dead_time)
    m = math.floor(path.fit.theta)
    problem = complementarity._program(data, m, at_op=not later)
    values = complementarity._values(data, complementarity.warm(data, path), limits_of(data), m)
    pair = problem.pairs[0]
    look = ca.Function(
        "look", [problem.nlp.x], [problem.nlp.objective, problem.nlp.groups[0].expression, pair.G, pair.H]
    )
    objective, law, G, H = (np.asarray(part).ravel() for part in look(values.start))
    assert np.abs(law).max() < 1e-9
    if later:
        # Before its first slip the stem rests; where it does so is the record's guess, not the law's.
        G, H = G[4 * (first + 1) :], H[4 * (first + 1) :]
    assert min(G.min(), H.min()) > -1e-12
    assert np.abs(G * H).max() < 1e-12
    assert objective[0] * data.variance * data.samples == pytest.approx(path.fit.sse, rel=1e-6)
    assert (values.lower <= values.start).all()
    assert (values.start <= values.upper).all()


def check(found: wb.estimate, record: wb.Record) -> None:
    assert found.method == "complementarity"
    assert found.prediction.shape == found.valve_position.shape == (len(record),)
    assert np.isfinite(found.prediction).all()
    assert found.residual_variance == pytest.approx(float(np.mean((record.pv - found.prediction) ** 2)))


@pytest.mark.parametrize(("plant", "kind"), [(PLANT, "fopdt"), (LEVEL, "integrating")], ids=["fopdt", "integrating"])
def test_from_the_profile_the_program_ends_beside_it_and_the_profile_stands(
    plant: wb.FOPDT | wb.Integrating, kind: str
) -> None:
    record = record_of(plant, wb.Stenman(2.0), 0.1)
    shares: list[float] = []
    plain = wb.estimate(record, plant=kind, valve="stenman")
    found = wb.estimate(record, plant=kind, method="complementarity", progress=shares.append)
    check(found, record)
    program = found.complementarity
    assert program is not None
    assert program.status.success
    assert program.residual < 1e-6
    assert program.complementarity < 1e-6
    assert abs(program.d / 2.0 - 1.0) < 0.05
    assert program.plant.gain == pytest.approx(plant.gain, rel=0.05)
    assert program.cost == pytest.approx(program.profile_cost, rel=0.05)
    assert program.exact_cost == pytest.approx(program.profile_cost, rel=1e-3)
    assert not program.taken
    assert (found.plant, found.valve, found.verdict) == (plain.plant, plain.valve, plain.verdict)
    assert shares == sorted(shares)
    assert sum(0.5 < share < 1.0 for share in shares) >= 2
    content = json.loads(estimate_json(found))["complementarity"]
    assert content["status"] == "solved"
    assert content["d"] == pytest.approx(program.d)
    assert any(line.startswith("Program    solved after") for line in estimate_lines(found))
    assert "complementarity" not in json.loads(estimate_json(plain))


def test_a_better_path_than_the_one_it_started_from_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    record = record_of(PLANT, wb.Stenman(2.0), 0.1)
    plain = wb.estimate(record, valve="stenman", plant="fopdt")
    data = centre(record, "fopdt")
    shares: list[float] = []
    first = int(np.flatnonzero(np.abs(data.u - data.u[0]) > 2.0)[0])
    poor = fitted(data, 1.99, first, 1.6)
    assert poor.fit.sse / data.samples > 2.0 * plain.residual_variance
    found = refined.by_complementarity(data, plain, [poor], limits_of(data), shares.append)
    program = found.complementarity
    assert program is not None
    assert program.taken
    assert program.exact_cost is not None
    assert program.exact_cost < program.profile_cost
    assert isinstance(found.valve, wb.Stenman)
    assert found.valve.d == pytest.approx(program.d, rel=1e-5)
    assert found.residual_variance == pytest.approx(program.exact_cost, rel=1e-6)
    assert found.intervals.d is not None
    assert found.intervals.d[0] <= found.valve.d <= found.intervals.d[1]
    assert "its better fit is shown" in found.reasons[-1]
    # Where OP is not known closely its ranges are wider, as the profile's are, and none where that has none.
    doubt = 0.05
    wide = refined.by_complementarity(replace(data, doubt=doubt), plain, [poor], limits_of(data), shares.append)
    assert wide.plant == found.plant
    assert wide.intervals.gain is not None
    assert wide.intervals.gain[1] - wide.intervals.gain[0] > 3.9 * doubt * found.plant.gain / found.valve.d
    assert wide.intervals.d is not None
    assert wide.intervals.d[0] == pytest.approx(min(plain.intervals.d[0], found.valve.d - 1.96 * doubt), abs=1e-4)
    hidden = replace(plain, intervals=Intervals())
    lost = refined.by_complementarity(replace(data, doubt=doubt), hidden, [poor], limits_of(data), shares.append)
    assert lost.complementarity.taken
    assert lost.intervals == Intervals()
    # Not so where the program was not solved.
    monkeypatch.setattr(complementarity, "OPTIONS", replace(complementarity.OPTIONS, max_iterations=0))
    kept = refined.by_complementarity(data, plain, [poor], limits_of(data), shares.append)
    assert kept.complementarity is not None
    assert kept.complementarity.status is SolveStatus.ITERATION_LIMIT
    assert not kept.complementarity.taken
    assert (kept.valve, kept.plant) == (plain.valve, plain.plant)
    assert kept.reasons[-1] == "the complementarity program ended as iteration limit: the profile's own fit is shown"


def test_a_d_by_which_the_stem_never_moves_has_no_exact_path() -> None:
    data = centre(record_of(PLANT, wb.Stenman(2.0), 0.1), "fopdt")
    linear = fit_linear(data, 30.0)
    start = complementarity.cold(data, linear, 0.1 * data.op_range)
    still = replace(start, d=1.1 * data.op_range)
    assert complementarity._exact(data, still, limits_of(data)) is None
    assert complementarity._exact(data, start, limits_of(data)).slips > 10


def test_what_it_claims_beyond_the_profile_the_valve_does_not_do() -> None:
    found = wb.estimate(record_of(PLANT, wb.Stenman(2.0), 0.2, 3), method="complementarity", plant="fopdt")
    program = found.complementarity
    assert program is not None
    assert program.status.success
    assert program.cost < program.profile_cost
    assert program.partial > 0
    assert program.exact_cost is not None
    assert program.exact_cost >= program.profile_cost * (1.0 - 1e-6)
    assert not program.taken
    assert any(f"in {program.partial} samples, which no such valve does" in reason for reason in found.reasons)


def test_a_cold_start_is_judged_by_the_same_law() -> None:
    data = centre(record_of(PLANT, wb.Stenman(2.0), 0.1), "fopdt").part(0, 60)
    start = complementarity.cold(data, fit_linear(data, 30.0), 0.1 * data.op_range)
    shares: list[float] = []
    found = complementarity.solved(data, start, limits_of(data), 1, complementarity.COLD, shares.append)
    assert found.result.iterations > 100
    assert len(shares) == len(found.result.steps) - 1 >= 3
    exact = found.exact
    assert exact is not None
    assert exact.valve.d == pytest.approx(found.point.d, abs=2e-6 * data.op_range)
    x, slips = path_of(data.u, exact.valve.d, exact.first)
    np.testing.assert_array_equal(exact.x, x)
    assert exact.slips == slips
    # The program's own stem is not one that the law makes.
    assert np.abs(found.point.x - x)[exact.first :].max() > 0.01


def test_without_a_sticking_stem_there_is_nothing_to_start_from() -> None:
    record = record_of(PLANT, wb.Ideal(), 0.1)
    found = wb.estimate(record, method="complementarity", plant="fopdt")
    check(found, record)
    assert found.verdict == "no_stiction"
    assert found.complementarity is None
    assert any("none for the complementarity program to start from" in reason for reason in found.reasons)


def test_the_plant_may_be_chosen_first() -> None:
    found = wb.estimate(record_of(LEVEL, wb.Stenman(2.0), 0.05), method="complementarity", plant="auto")
    assert isinstance(found.plant, wb.Integrating)
    assert found.complementarity is not None


def test_ctrl_c_stops_the_program(monkeypatch: pytest.MonkeyPatch) -> None:
    solve = complementarity.RelaxedSolver.solve
    stopped = SolveStatus.INTERRUPTED
    monkeypatch.setattr(complementarity, "OPTIONS", replace(complementarity.OPTIONS, max_iterations=0))
    monkeypatch.setattr(
        complementarity.RelaxedSolver, "solve", lambda self, values: replace(solve(self, values), status=stopped)
    )
    with pytest.raises(KeyboardInterrupt):
        wb.estimate(record_of(PLANT, wb.Stenman(2.0), 0.1), method="complementarity", plant="fopdt")


def test_what_it_does_not_take_is_refused_before_any_work() -> None:
    record = record_of(PLANT, wb.Stenman(2.0), 0.1)
    shares: list[float] = []
    for valve in ("choudhury", "deadband", "linear"):
        with pytest.raises(wb.InvalidValue, match=r"estimate\.valve.*knows the Stenman valve alone"):
            wb.estimate(record, method="complementarity", valve=valve, progress=shares.append)
    long = wb.Record(np.tile(record.pv, 6), np.tile(record.op, 6), 1.0, source="long.csv")
    with pytest.raises(wb.RecordError, match=r"long\.csv: 1800 samples given; .* at most 1,500"):
        wb.estimate(long, method="complementarity", progress=shares.append)
    assert shares == []


@pytest.mark.slow
@settings(max_examples=3)
@given(kinds=st.tuples(*[st.sampled_from(["noise", "walk", "spike", "steps", "sine"])] * 2), seed=st.integers(0, 50))
def test_adversarial_records_are_answered(kinds: tuple[str, str], seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = 40
    made = {
        "noise": rng.normal(0.0, 1.0, n),
        "walk": np.cumsum(rng.normal(0.0, 1.0, n)),
        "spike": np.where(np.arange(n) == rng.integers(0, n), 1e6, 0.0),
        "steps": np.repeat(rng.normal(0.0, 2.0, n // 10), 10),
        "sine": np.sin(2.0 * np.pi * np.arange(n) / 17.0),
    }
    found = wb.estimate(wb.Record(made[kinds[0]], made[kinds[1]], 2.0), method="complementarity")
    assert np.isfinite(found.prediction).all()
    assert found.verdict in ("stiction", "no_stiction", "undecided")
