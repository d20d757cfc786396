"""The table of statistics: it holds what the detection holds, by the published limits, and says why where it cannot."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import workbench as wb
from workbench.detect.evidence import statistics_of
from workbench.detect.verdict import Thresholds
from workbench.model.detection import Bicoherence, Detection, Statistic, StemEvidence

LIMITS = Thresholds()


@pytest.fixture(scope="module")
def sticky() -> Detection:
    loop = wb.Loop(wb.FOPDT(2.0, 5.0, 1.0), wb.Choudhury(2.0, 2.0), wb.PID(Kc=0.5, Ti=15.0), 1.0)
    run = wb.simulate(loop, wb.Experiment(1200.0, noise=wb.Noise(0.05, 1), setpoint=wb.Step(3.0)))
    return wb.detect(wb.Record(run.pv, run.op, 1.0, sp=run.sp), bicoherence=True)


def table(found: Detection, *, asked: bool = True) -> dict[str, Statistic]:
    rows = statistics_of(found, asked)
    assert len({row.name for row in rows}) == len(rows)
    return {row.name: row for row in rows}


def test_every_statistic_is_told_with_its_value(sticky: Detection) -> None:
    rows = {row.name: row for row in sticky.statistics}
    assert sticky.test is not None
    assert sticky.bicoherence is not None
    assert rows["Stem test, prediction"].value == 100.0 * sticky.test.improvement
    assert rows["Stem test, likelihood"].value == sticky.test.likelihood
    assert rows["Stem test, two rivals"].value == sticky.test.sure
    assert rows["Stem test, what it adds"].value == sticky.test.adds
    assert rows["Stem test, steady wave"].value == sticky.test.waved
    assert rows["Stem test, in OP's place"].value == sticky.test.instead
    assert rows["Oscillation period"].value == sticky.oscillation.period
    assert rows["Regularity"].value == sticky.oscillation.regularity
    assert (rows["Cross-correlation, lags"].value, rows["Cross-correlation, values"].value) == sticky.correlation
    assert (rows["Triangles in OP"].value, rows["Triangles in PV"].value) == (sticky.triangle, sticky.triangle_pv)
    assert tuple(rows[f"Moves without answer, {name}"].value for name in ("ρ₁", "ρ₃")) == sticky.movement
    assert (rows["Non-Gaussianity NGI"].value, rows["Nonlinearity NLI"].value) == (
        sticky.bicoherence.ngi,
        sticky.bicoherence.nli,
    )
    deciding = [row.decides for row in sticky.statistics]
    assert deciding == sorted(deciding, reverse=True)
    assert any(deciding)
    assert not all(deciding)


def test_the_stem_test_is_judged_by_the_thresholds_of_the_verdict(sticky: Detection) -> None:
    assert sticky.test is not None
    at = replace(sticky.test, improvement=LIMITS.predicts, likelihood=LIMITS.likelihood - 1e-9)
    rows = table(replace(sticky, test=at))
    assert rows["Stem test, prediction"].says == "enough for stiction"
    assert rows["Stem test, likelihood"].says == "too little for stiction"
    assert f"{LIMITS.likelihood:g}" in rows["Stem test, likelihood"].limits
    assert rows["Stem test, two rivals"].says == "enough for stiction"
    outdone = table(replace(sticky, test=replace(at, waved=LIMITS.chance - 1e-9, instead=LIMITS.sole)))
    assert outdone["Stem test, steady wave"].says == "such a load does as well"
    assert outdone["Stem test, in OP's place"].says == "too much to exclude stiction"
    # Both rivals speak for a stem, and simulated PV against all: the verdict does not find stiction by that.
    worse = table(replace(sticky, test=replace(at, simulated=-0.01)))
    assert worse["Stem test, two rivals"].says == "enough, yet simulated PV does not bear it out: not for stiction"
    less = table(replace(sticky, test=replace(at, sure=LIMITS.surely(at) - 1e-9)))
    assert less["Stem test, two rivals"].says == "too little for stiction"
    assert f"by prediction alone {LIMITS.sole:g}" in worse["Stem test, load steps"].limits


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"wide": -4.0, "wide_from": 1.5}, "a band of 1.5 % or more is excluded"),
        ({"wide": -4.0, "unfollowed": 0.0501}, "no more than chance"),
        ({"wide": -1.0}, "no more than chance"),
        ({"wide": 1.0}, "wide bands are not excluded"),
        ({"wide": 1.0, "unfollowed": 0.0501}, "no more than chance"),
        ({"wide": 11.0, "unfollowed": 0.0501}, "wide bands are not excluded"),
    ],
)
def test_wide_bands_are_judged_as_the_verdict_judges_them(
    sticky: Detection, changed: dict[str, float], says: str
) -> None:
    assert sticky.test is not None
    test = replace(sticky.test, **{"left": 0.05, "unfollowed": 0.06, "samples": 1000, **changed})
    assert table(replace(sticky, test=test))["Stem test, wide bands"].says == says


@pytest.mark.parametrize(
    ("lags", "values", "says"),
    [
        (0.7, 0.35, ("for stiction", "for stiction")),
        (0.5, 0.2, ("no decision", "no decision")),
        (0.3, 0.07, ("against stiction", "against stiction")),
        # Horch's two limits differ: a half is open for the lags and beyond the limit for the values.
        (0.5, 0.5, ("no decision", "for stiction")),
    ],
)
def test_cross_correlation_is_judged_by_its_own_limits(
    sticky: Detection, lags: float, values: float, says: tuple[str, str]
) -> None:
    rows = table(replace(sticky, correlation=(lags, values)))
    assert tuple(rows[f"Cross-correlation, {name}"].says for name in ("lags", "values")) == says


@pytest.mark.parametrize(("index", "says"), [(0.61, "for"), (0.5, "no decision"), (0.39, "against")])
def test_triangles_are_judged_by_their_limits(sticky: Detection, index: float, says: str) -> None:
    assert table(replace(sticky, triangle=index))["Triangles in OP"].says.startswith(says)


def test_bicoherence_counts_with_both_indices_and_a_long_record(sticky: Detection) -> None:
    def of(ngi: float, nli: float, samples: int) -> dict[str, Statistic]:
        one = np.zeros(1)
        wave = np.sin(np.arange(samples) / 7.0)
        record = wb.Record(wave, wave, 1.0)
        bicoherence = Bicoherence(one, one, one, ngi, nli, 0.1, 30)
        return table(replace(sticky, record=record, stretch=(0, samples), bicoherence=bicoherence))

    assert of(0.1, 0.02, 5000)["Nonlinearity NLI"].says == "nonlinear"
    assert of(0.1, 0.005, 5000)["Nonlinearity NLI"].says == "not shown to be nonlinear"
    assert of(0.0, 0.02, 5000)["Nonlinearity NLI"].says == "not shown to be nonlinear"
    assert of(0.0, 0.02, 5000)["Non-Gaussianity NGI"].says == "Gaussian: linear"
    assert "fewer samples than the authors' 4,096" in of(0.1, 0.02, 1000)["Nonlinearity NLI"].says
    assert "as the loop shows it" in of(0.1, 0.02, 5000)["Apparent stiction"].says
    assert "no measure of stiction" in of(0.0, 0.02, 5000)["Apparent stiction"].says


@pytest.mark.parametrize(
    ("follows", "sticks", "says"),
    [(0.005, 0.001, "the stem follows OP"), (0.2, 0.05, "it sticks over 2 %"), (0.2, 0.15, "no decision")],
)
def test_a_recorded_stem_is_told(sticky: Detection, follows: float, sticks: float, says: str) -> None:
    record = replace(sticky.record, valve_position=sticky.record.op)
    found = replace(sticky, record=record, stem=StemEvidence(2.0, 1.0, follows, sticks))
    assert table(found)["Recorded stem"].says == says
    assert "Recorded stem" not in table(sticky)


def test_what_is_not_defined_says_why() -> None:
    rng = np.random.default_rng(0)
    noise = wb.detect(wb.Record(rng.normal(size=100), rng.normal(size=100), 1.0), bicoherence=True)
    rows = {row.name: row for row in noise.statistics}
    assert all(row.says.startswith("not defined here: ") == math.isnan(row.value) for row in noise.statistics)
    assert "PV's cycle is" in rows["Triangles in OP"].says or "PV shows no cycle" in rows["Triangles in OP"].says
    assert (
        rows["Nonlinearity NLI"].says == "not defined here: the record is too short: 100 samples, at least 144 needed"
    )
    plain = wb.detect(wb.Record(rng.normal(size=200), rng.normal(size=200), 1.0))
    assert "not asked for" in {row.name: row for row in plain.statistics}["Apparent stiction"].says
    assert not any("bicoherence=True" in row.says for row in plain.statistics)


@pytest.mark.parametrize("samples", [143, 144])
def test_the_shortest_record_with_a_bicoherence_is_the_one_named(samples: int) -> None:
    rng = np.random.default_rng(1)
    found = wb.detect(wb.Record(rng.normal(size=samples), rng.normal(size=samples), 1.0), bicoherence=True)
    assert (found.bicoherence is None) == (samples < 144)


def test_signals_that_never_move_define_nothing() -> None:
    still = wb.detect(wb.Record(np.ones(200), np.linspace(0.0, 1.0, 200), 1.0))
    assert all(row.says.startswith("not defined here: ") and math.isnan(row.value) for row in still.statistics)


def cycling(periods: float, n: int, level: float) -> np.ndarray:
    return level + np.sin(2.0 * math.pi * periods * np.arange(n) / n)


def test_the_statistics_of_a_cycle_are_of_a_stretch_at_constant_setpoint() -> None:
    rng = np.random.default_rng(3)
    pv = np.concatenate([rng.normal(size=450), cycling(12.0, 420, 50.0), rng.normal(size=130)])
    sp = np.repeat([0.0, 50.0, 0.0], [450, 420, 130])
    op = np.roll(pv, 9) + 0.01 * rng.normal(size=1000)
    found = wb.detect(wb.Record(pv, op, 1.0, sp=sp), bicoherence=True)
    # The longest stretch holds noise alone, the last is too short; over the whole record the steps outweigh the cycle.
    assert found.stretch == (450, 870)
    assert found.cycle.period == pytest.approx(35.0, rel=0.03)
    assert found.oscillation.period != pytest.approx(35.0, rel=0.2)
    alone = wb.detect(wb.Record(pv[450:870], op[450:870], 1.0, sp=sp[450:870]), bicoherence=True)
    assert alone.stretch == (0, 420)
    assert alone.correlation == found.correlation
    assert alone.movement == found.movement
    assert alone.load_index == found.load_index
    assert (alone.triangle, alone.histogram, alone.ellipse) == (found.triangle, found.histogram, found.ellipse)


def test_a_setpoint_that_moves_all_the_time_leaves_the_whole_record() -> None:
    wave = cycling(12.0, 600, 0.0)
    for sp in (np.linspace(0.0, 1.0, 600), np.repeat([0.0, 1.0, 0.0, 1.0], 150), None):
        assert wb.detect(wb.Record(wave, np.roll(wave, 9), 1.0, sp=sp)).stretch == (0, 600)
