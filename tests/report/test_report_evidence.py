"""What the report says and draws of a detection, and of what an estimate pins down."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import workbench as wb
from workbench.cli.output import estimate_lines
from workbench.errors import InvalidValue
from workbench.kpi.oscillation import autocorrelation
from workbench.model.detection import Detection
from workbench.model.plant import FOPDT
from workbench.model.results import Estimate, FittedModel, Intervals
from workbench.model.study import NamedEstimate, Study
from workbench.model.valve import Choudhury, Deadband, Ideal, Stenman
from workbench.report import figures
from workbench.report.detections import detection_table, detection_words
from workbench.report.estimates import candidates_table, estimate_sentences, estimate_table
from workbench.report.known import known_sentences
from workbench.report.page import figure_names, write_report

Make = Callable[..., Any]


@pytest.fixture(scope="module")
def found() -> Detection:
    """A sticky loop that cycles about a constant setpoint."""
    loop = wb.Loop(wb.FOPDT(2.0, 5.0, 1.0), wb.Choudhury(3.0, 2.0), wb.PID(Kc=0.5, Ti=6.0), 2.0)
    run = wb.simulate(loop, wb.Experiment(5000.0, noise=wb.Noise(0.03, 1), setpoint=wb.Step(3.0)))
    return wb.detect(wb.Record(run.pv[500:], run.op[500:], 2.0, sp=run.sp[500:]), bicoherence=True)


def lines(ax: Axes) -> dict[str, Any]:
    return {str(line.get_label()): line for line in ax.get_lines()}


def only(study: Study, *named: NamedEstimate) -> Study:
    return replace(study, cases=(), estimates=named)


def test_the_autocorrelation_is_drawn_with_its_crossings_and_the_period(found: Detection) -> None:
    drawn = lines(figures.autocorrelation_figure(found).axes[0])
    x, y = drawn["autocorrelation of PV"].get_data()
    assert y == pytest.approx(np.interp(x, 2.0 * np.arange(found.record.pv.size), autocorrelation(found.record.pv)))
    crossings = drawn["zero crossings"].get_xdata()
    assert found.oscillation.period == pytest.approx(2.0 * np.diff(crossings).mean())
    assert np.abs(np.interp(crossings, x, y)).max() < 1e-9
    period = next(line for name, line in drawn.items() if name.startswith("period "))
    assert period.get_xdata()[0] == pytest.approx(found.oscillation.period)


@pytest.mark.parametrize("samples", [150, 300, 2000])
def test_the_bicoherence_map_shades_exactly_what_exceeds_chance(found: Detection, samples: int) -> None:
    # Few samples: what chance shows lies above the lowest bands of the map.
    record = found.record
    found = wb.detect(wb.Record(record.pv[:samples], record.op[:samples], 2.0), bicoherence=True)
    bic = found.bicoherence
    assert bic is not None
    ax = figures.bicoherence_figure(found).axes[0]
    step = 1800.0 * bic.frequency_1.min()
    shaded = 0.0
    for patch in ax.patches:
        corners = patch.get_path().vertices.reshape(-1, 5, 2)
        shaded += float(np.prod(corners[:, 2] - corners[:, 0], axis=1).sum())
    assert shaded / step**2 == pytest.approx(np.count_nonzero(bic.values > bic.critical))
    darkest = int(np.argmax(bic.values))
    at = np.array([bic.frequency_1[darkest], bic.frequency_2[darkest]]) * 1800.0
    hit = [p for p in ax.patches if any(_inside(c, at) for c in p.get_path().vertices.reshape(-1, 5, 2))]
    assert hit == [ax.patches[-1]]
    legend = ax.get_legend()
    assert legend is not None
    assert legend.get_title().get_text().startswith("squared bicoherence; NGI ")


def _inside(corners: Any, at: Any) -> bool:
    return bool(np.all(corners[0] <= at) and np.all(at <= corners[2]))


def test_the_ellipse_is_drawn_through_the_width_that_is_told(found: Detection) -> None:
    ellipse = found.ellipse
    assert ellipse is not None
    ax = figures.apparent_stiction_figure(found).axes[0]
    drawn = lines(ax)
    x, y = drawn["ellipse of the cycle"].get_data()
    across = x[np.abs(y - ellipse.pv) < 0.05 * np.ptp(y)]
    assert across.max() - across.min() == pytest.approx(ellipse.apparent_stiction, rel=0.15)
    width = next(line for name, line in drawn.items() if name.startswith("width "))
    assert np.ptp(width.get_xdata()) == pytest.approx(ellipse.apparent_stiction)
    assert np.mean(width.get_xdata()) == pytest.approx(ellipse.op)


def test_plot_of_a_detection(found: Detection) -> None:
    axes = wb.plot(found)
    assert axes.shape == (3,)
    assert "zero crossings" in lines(axes[0])
    assert "ellipse of the cycle" in lines(axes[2])
    single = Figure().subplots()
    assert wb.plot(found, single) is single
    assert "zero crossings" in lines(single)
    with pytest.raises(InvalidValue, match="1 or 3"):
        wb.plot(found, Figure().subplots(1, 2))
    plain = wb.plot(replace(found, bicoherence=None, ellipse=None))
    assert len(plain[2].get_lines()) == 1


def test_a_bicoherence_that_is_not_there_says_why(found: Detection) -> None:
    record = found.record
    without = wb.plot(wb.detect(record))[1]
    assert [t.get_text() for t in without.texts] == ["not asked for: detect(record, bicoherence=True)"]
    short = wb.Record(record.pv[:100], record.op[:100], record.sample_time, sp=np.zeros(100))
    (said,) = wb.plot(wb.detect(short, bicoherence=True))[1].texts
    assert "the record is too short: 100 samples" in said.get_text()


def test_figures_are_of_the_stretch_that_the_statistics_are_of(found: Detection) -> None:
    part = replace(found, stretch=(1000, 1600))
    drawn = lines(figures.autocorrelation_figure(part).axes[0])["autocorrelation of PV"]
    x, y = drawn.get_data()
    own = autocorrelation(found.record.pv[1000:1600])
    assert y == pytest.approx(np.interp(x, 2.0 * np.arange(600), own))
    phase = figures.apparent_stiction_figure(part).axes[0].get_lines()[0].get_ydata()
    assert np.nanmax(phase) == found.record.pv[1000:1600].max()


def test_a_signal_without_period_is_drawn_and_says_so() -> None:
    ramp = wb.Record(np.linspace(0.0, 1.0, 200), np.linspace(0.0, 1.0, 200) ** 2, 1.0)
    ax = wb.plot(wb.detect(ramp))[0]
    assert "zero crossings" not in lines(ax)
    assert "no period" in ax.texts[0].get_text()


def test_the_table_holds_every_statistic_under_a_line_after_those_that_decide(found: Detection) -> None:
    table = detection_table(found)
    assert [row.label for row in table.rows] == [one.name for one in found.statistics]
    assert [row.label for row in table.rows if row.group] == ["Oscillation index"]
    sources = {row.label: row.cells[3].small for row in table.rows}
    assert sources["Cross-correlation, lags"] == "Horch 1999"
    assert sources["Stem test, likelihood"] == ""
    assert all(row.cells[1].text for row in table.rows)


def test_detection_is_told_beside_the_estimate(estimated: Make, found: Detection) -> None:
    estimate, _ = estimated()
    named = NamedEstimate("E", estimate)
    assert found.verdict == "stiction"
    assert detection_words(named, found).endswith("stiction, as the estimate does.")
    assert "which is the verdict that counts" in detection_words(named, replace(found, verdict="undecided"))
    part = detection_words(named, replace(found, stretch=(100, 1101)))
    assert "at constant SP from 200 s to 37 min" in part


def page_of(study: Study, folder: Path) -> str:
    write_report(study, folder)
    return (folder / "report.html").read_text(encoding="utf-8")


@pytest.mark.usefixtures("undrawn")
def test_the_page_holds_the_evidence_once_for_each_record(
    study: Study, estimated: Make, found: Detection, tmp_path: Path
) -> None:
    estimate, _ = estimated()
    first, second = (NamedEstimate(name, estimate, detection=found) for name in ("First", "Second"))
    html = page_of(only(study, first, second), tmp_path)
    assert html.count("<h4>Evidence without a model</h4>") == 2
    said = replace(estimate, reasons=(*found.reasons[:1], *estimate.reasons))
    once = page_of(only(study, NamedEstimate("First", said, detection=found)), tmp_path / "once")
    first_reason = found.reasons[0].split(" leaves ")[0].removeprefix("a ")
    assert once.count(first_reason) == html.count(first_reason), "what the verdict says already is not said again"
    assert html.count("Moves without answer, ρ₁") == 1
    assert "The record is that of First, and so is the evidence in it." in html
    names = {path.name for path in tmp_path.iterdir()}
    assert {"autocorrelation_first.svg", "bicoherence_first.svg", "ellipse_first.svg"} <= names
    assert not any(name.startswith(("bicoherence_second", "ellipse_second")) for name in names)
    content = json.loads((tmp_path / "results.json").read_text(encoding="utf-8"))["estimates"][0]["detection"]
    assert content["verdict"] == found.verdict
    assert {s["name"]: s["value"] for s in content["statistics"]}["Regularity"] == pytest.approx(
        found.oscillation.regularity
    )


def test_a_case_and_an_estimate_of_one_name_keep_their_figures(study: Study, estimated: Make, found: Detection) -> None:
    estimate, _ = estimated()
    both = replace(study, estimates=(NamedEstimate(study.cases[0].name, estimate, detection=found),))
    names = figure_names(both)
    every = [name for group in names.values() for own in group for name in own.values()]
    assert len(set(every)) == len(every)


@pytest.mark.usefixtures("undrawn")
def test_what_a_record_does_not_give_is_said_and_not_drawn(study: Study, estimated: Make, tmp_path: Path) -> None:
    estimate, _ = estimated()
    rng = np.random.default_rng(0)
    short = wb.detect(wb.Record(rng.normal(size=60), rng.normal(size=60), 1.0), bicoherence=True)
    html = page_of(only(study, NamedEstimate("Short", estimate, detection=short)), tmp_path / "a")
    assert "The record is too short for a bicoherence." in html
    assert "60 samples, at least 144 needed" in html
    assert not (tmp_path / "a" / "bicoherence_short.svg").exists()
    still = wb.detect(wb.Record(np.ones(60), rng.normal(size=60), 1.0), bicoherence=True)
    html = page_of(only(study, NamedEstimate("Still", estimate, detection=still)), tmp_path / "b")
    assert "PV is constant" in html
    assert not (tmp_path / "b" / "autocorrelation_still.svg").exists()
    html = page_of(only(study, NamedEstimate("None", estimate)), tmp_path / "c")
    assert "Evidence without a model" not in html
    assert "detection" not in json.loads((tmp_path / "c" / "results.json").read_text())["estimates"][0]


def test_a_healthy_valve_has_no_figure_of_a_fit_that_ignores_its_stiction(study: Study, estimated: Make) -> None:
    estimate, _ = estimated()
    healthy = replace(estimate, valve=Ideal(), verdict="no_stiction")
    own = figure_names(only(study, NamedEstimate("H", healthy)))["estimates"][0]
    assert {"linear", "stem"} & set(own) == set()
    measured = replace(healthy, record=replace(estimate.record, valve_position=estimate.record.op))
    assert "stem" in figure_names(only(study, NamedEstimate("H", measured)))["estimates"][0]


def model(valve: Any, aic: float, bic: float) -> FittedModel:
    return FittedModel(valve, FOPDT(2.0, 5.0, 1.0), 0.01, aic, bic, 12)


def test_models_are_compared_and_the_one_used_is_named(estimated: Make) -> None:
    estimate, _ = estimated()
    assert candidates_table(estimate) is None
    models = (
        model(Stenman(2.0), -4000.0, -3966.0),
        model(Choudhury(2.1, 1.9), -4002.0, -3963.0),
        model(Deadband(1.5), -300.0, -270.0),
        model(Ideal(), -200.0, -180.0),
    )
    table = candidates_table(replace(estimate, candidates=models))
    assert table is not None
    assert [row.label for row in table.rows] == [
        "One parameter (Stenman) (used)",
        "Two parameters (Choudhury)",
        "Dead band",
        "No stiction",
    ]
    assert [[c.text for c in row.cells if c.best] for row in table.rows] == [["−3,966"], ["−4,002"], [], []]
    assert [row.cells[-1].text for row in table.rows] == ["0", "3", "3,696", "3,786"]
    assert [row.cells[0].text for row in table.rows][1:] == ["S\u00a02.100, J\u00a01.900", "b\u00a01.500", "–"]
    assert len(table.heads) == len(table.rows[0].cells)


def known(estimate: Estimate, **changes: Any) -> str:
    return " ".join(known_sentences(replace(estimate, **changes)))


def test_what_is_pinned_down_is_named_by_the_width_of_its_range(estimated: Make) -> None:
    estimate, _ = estimated()
    ranges = Intervals(d=(1.99, 2.01), gain=(1.9, 2.2), time_constant=(2.0, 9.0), dead_time=None)
    text = known(estimate, intervals=ranges)
    assert re.search(r"Pinned down[^.]*: stiction d\.", text)
    assert re.search(r"Roughly known[^.]*: gain K\.", text)
    assert re.search(r"Hardly known[^.]*: time constant\.", text)
    assert "Given without a range: dead time." in text
    assert "The record gives no range for the dead time: tune by no rule from these figures." in text
    assert "upper end" not in text
    whole = known(estimate, intervals=replace(ranges, dead_time=(0.9, 1.1)))
    assert "upper end of the ranges of gain and dead time" in whole
    assert "More setpoint changes in the record would show the time constant better" in text


def test_a_time_below_the_sampling_is_known_by_its_range_in_samples(estimated: Make) -> None:
    estimate, _ = estimated()
    ranges = Intervals(d=(1.99, 2.01), gain=(1.98, 2.0), time_constant=(5.0, 5.1), dead_time=(0.0, 0.09))
    text = known(estimate, plant=FOPDT(1.99, 5.03, 0.01), intervals=ranges)
    assert re.search(r"Pinned down[^.]*: stiction d, gain K, time constant and dead time\.", text)
    vague = replace(ranges, dead_time=(0.0, 1.5))
    text = known(estimate, plant=FOPDT(1.99, 5.03, 1.0), intervals=vague)
    assert "dead time is of the size of the sampling, 1 s: a record sampled faster would tell" in text


def test_a_stiction_that_is_not_pinned_down_says_what_would_narrow_it(estimated: Make) -> None:
    estimate, _ = estimated(identifiable=False)
    text = known(estimate, intervals=Intervals(d=(1.5, 2.6), gain=(1.5, 2.7)))
    assert "the range of the stiction, not its value (gain times band: 4.0 EU)" in text
    assert "clearly more than 2 %" in text
    sharp = known(estimate, intervals=Intervals(d=(1.98, 2.02), gain=(0.8, 3.1)))
    assert "not its value" not in sharp
    assert "would tell more of the gain" in sharp
    two = known(estimate, valve=Choudhury(3.0, 1.0), intervals=Intervals(S=(2.95, 3.05), J=(0.2, 2.0)))
    assert "How far the stem jumps" in two


def test_an_undecided_record_claims_nothing(estimated: Make) -> None:
    estimate, _ = estimated(verdict="undecided", identifiable=False)
    text = known(estimate)
    assert text.startswith("Whether the valve sticks is open")
    assert "maintenance" not in text
    assert "tuning" not in text


@pytest.mark.slow
def test_hours_by_the_second_make_a_page_of_bounded_size(study: Study, estimated: Make, tmp_path: Path) -> None:
    samples, noise = 21_600, 50.0  # many more than a figure has places for, and each beside the last
    estimate, _ = estimated(samples)
    rng = np.random.default_rng(2)
    pv = estimate.record.pv + noise * rng.normal(size=samples)
    op = estimate.record.op + noise * rng.normal(size=samples)
    record = replace(estimate.record, pv=pv, op=op, valve_position=estimate.valve_position + 0.1)
    estimate = replace(estimate, record=record)
    detection = wb.detect(record, bicoherence=True)
    long = only(study, NamedEstimate("Day", estimate, detection=detection))
    html = page_of(long, tmp_path)
    assert {"autocorrelation_day.svg", "op_stem_day.svg", "linear_fit_day.svg"} <= {p.name for p in tmp_path.iterdir()}
    assert len(html.encode()) < 2_000_000
    assert (tmp_path / "results.json").stat().st_size < 50_000


def test_open_ranges_are_said_to_be_open(estimated: Make) -> None:
    ranges = Intervals(d=(1.99, 2.01), gain=(4.0, math.inf), time_constant=(30.0, math.inf), dead_time=(0.9, 1.1))
    estimate = replace(estimated()[0], intervals=ranges, verdict="stiction", identifiable=False)
    text = " ".join(known_sentences(estimate))
    assert re.search(r"Hardly known[^.]*: gain K and time constant\.", text)
    assert (
        "The record leaves the range of the gain K and time constant open: tune by no rule from these figures." in text
    )
    assert "upper end" not in text
    named = NamedEstimate("a", estimate)
    cells = {row.label: row.cells[1].text for row in estimate_table(named).rows}
    assert cells["Gain K"] == "4.000 or more"
    assert cells["Time constant"] == "30.00 or more"
    sentences = " ".join(estimate_sentences(named, linear=False))
    assert "leaves the range of the gain K and time constant open" in sentences
    assert "pins only the product" not in sentences
    bare = NamedEstimate("a", replace(estimate, intervals=Intervals()))
    assert "take its value as a hint" in " ".join(estimate_sentences(bare, linear=False))


def test_hidden_ranges_ask_for_more_digits_of_op(estimated: Make) -> None:
    estimate, _ = estimated(verdict="stiction", identifiable=False)
    text = known(estimate, intervals=Intervals())
    assert "The record gives no range for the gain K and dead time: tune by no rule from these figures." in text
    assert "A record of OP with more digits would tell more of the stiction." in text
    assert "upper end" not in text
    assert "setpoint change" not in text


def test_a_band_that_is_pinned_is_not_said_to_be_open(estimated: Make) -> None:
    estimate, _ = estimated(verdict="stiction", identifiable=False)
    wide = replace(estimate, intervals=replace(estimate.intervals, gain=(0.8, 3.1)))
    sentences = " ".join(estimate_sentences(NamedEstimate("a", wide), linear=False))
    assert "the record pins the stiction, but hardly the gain (0.800 to 3.10 EU/%)" in sentences
    assert "pins only the product" not in sentences
    assert any("the record pins the stiction, but hardly the gain" in line for line in estimate_lines(wide))
