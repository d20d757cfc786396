"""Runs beside each other: what is read from results.json, what is held against the base, and what is said."""

from __future__ import annotations

import csv
import json
import math
import shutil
from collections.abc import Callable
from dataclasses import replace
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workbench.errors import InvalidValue
from workbench.model.experiment import Experiment, Noise, Ramp, Series, Step
from workbench.model.study import Study
from workbench.model.tuning import Objective
from workbench.report.compare import comparison, comparison_csv, difference_words, estimate_table, tables
from workbench.report.compare_page import comparison_page, drawn
from workbench.report.compared import read_all
from workbench.report.results import FORMAT, results_json
from workbench.report.trends import COLUMNS, experiment_content, read_signal, trends_content
from workbench.simulate.run import simulate

EVIL = "<script>alert(1)</script>"


@pytest.fixture
def put(tmp_path: Path) -> Callable[..., Path]:
    """Write a study's results.json into a folder of its own, with changes to its content."""

    def make(study: Study, folder: str = "made", **changes: Any) -> Path:
        content = json.loads(results_json(study)) | changes
        path = tmp_path / folder / "results.json"
        path.parent.mkdir(parents=True)
        path.write_text(json.dumps(content), encoding="utf-8")
        return path

    return make


def found(*paths: Path, **options: Any) -> Any:
    results, notes = read_all(paths)
    return comparison(results, notes=notes, **options)


# signals and experiments in results.json -----------------------------------------------------------------------------


@settings(deadline=None, max_examples=50)
@given(
    st.lists(st.floats(-1e3, 1e3) | st.sampled_from([math.nan, 1e12, 0.0]), min_size=1, max_size=2000),
    st.floats(0.01, 3600.0),
)
def test_a_signal_comes_back_as_a_figure_shows_it(values: list[float], step: float) -> None:
    from workbench.report.trends import _held, _signal

    signal = np.array(values)
    for write in (_signal, _held):
        time, back = read_signal(write(signal), step)
        at = np.round(time / step).astype(int)
        assert at[0] == 0
        assert at[-1] == len(values) - 1
        kept = np.where(np.abs(signal) <= 1e9, signal, np.nan)[at] if write is _signal else signal[at]
        finite = np.isfinite(kept)
        assert np.array_equal(finite, np.isfinite(back)) or write is _held
        assert np.allclose(back[finite], kept[finite], rtol=6e-4, atol=1e-12)


def test_extremes_survive_thinning(study: Study) -> None:
    run = simulate(study.cases[0].loop, replace(study.experiment, duration=20000.0, noise=Noise(0.3, 1)))  # type: ignore[type-var]
    one = trends_content(replace(study, cases=(replace(study.cases[0], run=run),)))[0]
    time, pv = read_signal(one["pv"], one["sample_time"])
    assert time.size <= 2 * COLUMNS + 4
    assert (pv.min(), pv.max()) == pytest.approx((run.pv.min(), run.pv.max()), rel=1e-3)
    assert one["sp"] == {"at": "0 19999", "value": "4 4"}


@pytest.mark.parametrize(
    "content",
    [
        {"at": "0..2", "value": "1 2"},
        {"at": "0 x", "value": "1 2"},
        {"at": "", "value": ""},
        {"at": "3 1", "value": "1 2"},
    ],
)
def test_a_signal_that_is_not_whole_is_refused(content: dict[str, str]) -> None:
    with pytest.raises(ValueError, match=r"samples|invalid literal"):
        read_signal(content, 1.0)


def test_the_experiment_is_told_in_full(study: Study) -> None:
    parts = (Step(1.0), Ramp(2.0, 1.0, 5.0), Series([0.0, 1.0, 2.0]))
    whole = experiment_content(replace(study, experiment=Experiment(50.0, parts, noise=Noise(0.1, 7), stem_offset=0.5)))
    assert whole is not None
    assert whole["setpoint"][0] == {"type": "step", "size": 1.0, "at": 0.0}
    assert whole["setpoint"][1] == {"type": "ramp", "size": 2.0, "start": 1.0, "end": 5.0}
    assert whole["setpoint"][2]["samples"] == 3
    assert whole["noise"] == {"sd": 0.1, "seed": 7}
    other = experiment_content(replace(study, experiment=Experiment(50.0, (*parts[:2], Series([0.0, 1.0, 2.5])))))
    assert other is not None
    assert other["setpoint"][2]["sha256"] != whole["setpoint"][2]["sha256"]
    assert experiment_content(replace(study, experiment=None)) is None


# reading -------------------------------------------------------------------------------------------------------------


def test_what_was_written_is_read(study: Study, put: Callable[..., Path]) -> None:
    (one,), notes = read_all([put(study)])
    assert notes == ()
    assert (one.label, one.title, one.told) == ("made", study.title, True)
    assert [e.name for e in one.entries] == [c.name for c in study.cases]
    first, case = one.entries[0], study.cases[0]
    assert (first.Kc, first.Ti, first.Td, first.form) == (0.5, 20.0, 0.0, "ideal")
    assert first.kpis["valve_travel"] == pytest.approx(case.run.kpis.valve_travel)
    assert math.isnan(first.kpis["oscillation_period"]) == math.isnan(case.run.kpis.oscillation_period)
    assert (first.cycle, first.predicted) == ("cycles", False)
    assert one.entries[1].predicted is None
    assert first.trend is not None
    assert first.trend.pv[1][-1] == pytest.approx(case.run.pv[-1], rel=1e-3)
    assert one.estimates[0].intervals["d"] == (1.99, 2.01)
    assert one.estimates[0].intervals["S"] is None


def test_settings_are_shown_with_every_digit_that_their_search_found(
    study: Study, put: Callable[..., Path], case: Callable[..., Any], tuned: Callable[..., Any]
) -> None:
    cliff = case("Cliff", 2.44719005808, 8.32616150835)
    least = replace(tuned(cliff.loop.controller, cliff.objective), nominal_only=True, digits=12)
    both = replace(study, cases=(study.cases[0], study.cases[2], replace(cliff, tuned=least)), estimates=())
    (table,) = tables(found(put(both)))
    texts = {row.label: [cell.text for cell in row.cells] for row in table.rows}
    assert texts["Kc"] == ["0.5", "2.351", "2.44719005808"]
    assert texts["Ti"] == ["20", "9.500", "8.32616150835"]


def test_folders_are_looked_into(study: Study, put: Callable[..., Path], tmp_path: Path) -> None:
    one, other = put(study, "site/a"), put(replace(study, name="b"), "site/b")
    fleet = tmp_path / "site" / "fleet"
    fleet.mkdir()
    (fleet / "fleet.csv").touch()
    results, notes = read_all([tmp_path / "site", one, one.parent])
    assert [r.path for r in results] == [one, other]
    assert notes == (f"{fleet}: a fleet's results, which are not compared here.",)


def test_files_of_one_name_are_told_apart_by_their_folders(study: Study, put: Callable[..., Path]) -> None:
    results, _ = read_all([put(study, "before/made"), put(study, "after/made")])
    assert [r.label for r in results] == ["before/made", "after/made"]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", r"broken JSON \(EOF"),
        ('{"name": "x", "cas', r"broken JSON .* must be a results\.json of `workbench run`.*half-written"),
        ("[1, 2]", "input should be an object"),
        ("{}", r"name: field required"),
        ('{"name": "x", "title": "x", "loop": null, "cases": []}', "results without cases and estimates"),
        ('{"format": 99, "what": "another version writes"}', "format 99 given; must be at most"),
        ('{"name": "x", "title": "x", "loop": null, "cases": [{"name": 3}]}', r"cases\[0\]\.name: input should be"),
    ],
)
def test_what_is_no_results_file_is_named(text: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "results.json"
    path.write_text(text)
    with pytest.raises(InvalidValue, match=said) as error:
        read_all([path])
    assert str(error.value).startswith(str(path))
    assert "\n" not in str(error.value)


def test_a_half_written_file_is_refused_wherever_it_ends(study: Study, put: Callable[..., Path]) -> None:
    path = put(study)
    content = path.read_bytes()
    for end in range(0, len(content) - 1, max(1, len(content) // 40)):
        path.write_bytes(content[:end])
        with pytest.raises(InvalidValue, match="broken JSON"):
            read_all([path])


def test_wrong_places_are_named(study: Study, put: Callable[..., Path], tmp_path: Path) -> None:
    with pytest.raises(InvalidValue, match=r"no such file or folder given; must be a results\.json"):
        read_all([tmp_path / "none"])
    (tmp_path / "empty").mkdir()
    with pytest.raises(InvalidValue, match=r"a folder without results\.json"):
        read_all([tmp_path / "empty"])
    (tmp_path / "empty" / "fleet.parquet").touch()
    with pytest.raises(InvalidValue, match=r"a fleet's results given; .*workbench fleet --previous"):
        read_all([tmp_path / "empty"])
    content = json.loads(results_json(study))
    content["trends"][0]["pv"] = {"at": "0..5", "value": "1"}
    with pytest.raises(InvalidValue, match="trends of Case 1: 6 samples and 1 values"):
        read_all([put(study, "torn", trends=content["trends"])])
    with pytest.raises(InvalidValue, match="cases without a loop"):
        read_all([put(study, "bare", loop=None)])
    content["cases"][0]["kpis"]["iae"] = "much"
    with pytest.raises(InvalidValue, match=r"cases\[0\]\.kpis\.iae: input should be a valid number"):
        read_all([put(study, "text", cases=content["cases"])])


# what compares -------------------------------------------------------------------------------------------------------


def test_differences_are_from_the_base(study: Study, put: Callable[..., Path]) -> None:
    path = put(study)
    made = found(path)
    first, second, best = made.lines
    assert made.base is first
    assert difference_words(first, first, "valve_travel") == ""
    assert difference_words(second, first, "valve_travel") == "−67 %"
    assert difference_words(best, first, "objective") == "−95 %"
    made = found(path, base="Case 2")
    assert difference_words(made.lines[0], made.base, "valve_travel") == "3.0 times"
    assert tables(made)[0].heads == ("Case 2", "Case 1", "Optimised PI")
    assert found(path, base="made").base.name == "Case 1"


def test_a_time_beside_none_has_no_difference(study: Study, put: Callable[..., Path]) -> None:
    cases = json.loads(results_json(study))["cases"]
    for case, time in zip(cases, ("none", 20.0, "Infinity"), strict=True):  # the last as earlier versions wrote it
        case["kpis"]["settling_time"], case["settling_doubt"] = time, None
    made = found(put(study, cases=cases))
    assert [difference_words(line, made.base, "settling_time") for line in made.lines] == ["", "", "unchanged"]


def test_a_settling_time_that_does_not_last_is_marked_as_in_the_report(study: Study, put: Callable[..., Path]) -> None:
    made = found(put(study))
    first, _, best = made.lines
    assert (first.doubt("settling_time"), first.doubt("iae")) == ("not for good: it cycles", "")
    assert math.isfinite(first.figure("settling_time"))
    assert math.isfinite(best.figure("settling_time"))
    assert difference_words(best, first, "settling_time") == ""
    cells = {row.label: row.cells for row in tables(made)[0].rows}["Settling time"]
    assert cells[0].small == "not for good: it cycles"
    rows = list(csv.DictReader(StringIO(comparison_csv(made))))
    assert rows[0]["settling_doubt"] == "not for good: it cycles"
    assert rows[2]["settling_time_difference"] == ""
    calm = replace(study, cases=tuple(replace(case, limit_cycle=None) for case in study.cases))
    made = found(put(calm, "calm"))
    assert not any(line.doubt("settling_time") for line in made.lines[::2])
    assert difference_words(made.lines[2], made.base, "settling_time") == "−99.6 %"


def test_cases_are_chosen_by_name(study: Study, put: Callable[..., Path]) -> None:
    one, other = put(study, "a"), put(replace(study, name="b"), "b")
    made = found(one, other, include=["b: *", "Case 1"])
    assert [line.name for line in made.lines] == ["made: Case 1", "b: Case 1", "b: Case 2", "b: Optimised PI"]
    assert found(one, other, base="b: Case 2").base.results.label == "b"
    with pytest.raises(InvalidValue, match="--base: Case 1 given; must say which one: made: Case 1; b: Case 1"):
        found(one, other, base="Case 1")
    with pytest.raises(InvalidValue, match="--base: Case 9 given; must be a case that is there: made: Case 1; "):
        found(one, other, base="Case 9")
    with pytest.raises(InvalidValue, match=r"--include: Kase\* given; must fit one of made: Case 1"):
        found(one, other, include=["Kase*"])


@pytest.mark.parametrize(
    ("experiment", "said"),
    [
        (Experiment(500.0, Step(4.0)), "another one in duration"),
        (Experiment(1000.0, Step(5.0), Step(1.0, 10.0)), "another one in setpoint and load"),
        (Experiment(1000.0, Step(4.0), noise=Noise(0.1)), "another one in noise"),
        (Experiment(1000.0, Step(4.0), noise=Noise(0.0, 4)), ""),
    ],
)
def test_another_experiment_is_not_held_against_the_base(
    experiment: Experiment, said: str, study: Study, put: Callable[..., Path]
) -> None:
    made = found(put(study, "a"), put(replace(study, name="b", experiment=experiment), "b"))
    line = made.lines[3]
    assert line.results.label == "b"
    assert said in line.apart
    assert bool(difference_words(line, made.base, "iae")) == (not said)
    assert any(said in note for note in made.notes) == bool(said) or not said
    row = next(r for r in csv.DictReader(StringIO(comparison_csv(made))) if r["scenario"] == "b")
    assert bool(row["iae_difference"]) == (not said)
    assert row["compared"] == ("false" if said else "true")


def test_an_earlier_versions_file_is_shown_but_not_held_against_others(study: Study, put: Callable[..., Path]) -> None:
    old = json.loads(results_json(study))
    for name in ("format", "experiment", "trends"):
        del old[name]
    path = put(study, "now")
    older = path.parent.parent / "then" / "results.json"
    older.parent.mkdir()
    older.write_text(json.dumps(old))
    made = found(path, older)
    assert all("does not say its experiment" in line.apart for line in made.lines[3:])
    curves, said = drawn(made)
    assert len(curves) == 3
    assert said == ["The figure shows those that are held against the base."]
    said = {cell.small for row in tables(made)[0].rows for cell in row.cells[3:]}
    assert said == {"", "not for good: it cycles"}, "no difference, but what its own report says"
    alone = found(older)
    assert not alone.notes
    assert drawn(alone)[0] == []
    assert drawn(alone)[1][0].endswith("the file holds no signals to draw; run its scenario again.")
    assert difference_words(alone.lines[1], alone.base, "iae")
    assert FORMAT == 2


def test_what_counts_samples_is_not_held_against_another_sampling(study: Study, put: Callable[..., Path]) -> None:
    loop = json.loads(results_json(study))["loop"]
    slow = put(study, "slow", name="slow", loop=loop | {"sample_time": 2.0, "valve": {"type": "stenman", "d": 3.0}})
    made = found(put(study, "a"), slow)
    line = made.lines[3]
    assert not line.compares("valve_travel")
    assert difference_words(line, made.base, "iae") == "unchanged"
    table = tables(made)[0]
    cells = {row.label: row.cells[3] for row in table.rows}
    assert cells["Valve travel"].small == "not compared"
    assert cells["Sample time"].text == "2 s"
    assert cells["Valve"].text == "stenman, d 3"
    assert any("sampled every 2 s, the base every 1 s" in note for note in made.notes)
    assert any("another valve than the base's (stenman, d 3)" in note for note in made.notes)


def test_another_objective_or_plant_or_draw_is_said(study: Study, put: Callable[..., Path]) -> None:
    noisy = replace(study, experiment=replace(study.experiment, noise=Noise(0.1, 1)))  # type: ignore[type-var]
    other = replace(noisy, name="b", objective=Objective(1.0, 0.0, 0.0, 0.0))
    other = replace(other, experiment=replace(study.experiment, noise=Noise(0.1, 2)))  # type: ignore[type-var]
    loop = json.loads(results_json(study))["loop"]
    path = put(
        other, "b", loop=loop | {"plant": {"type": "fopdt", "gain": 2.0, "time_constant": 5.0, "dead_time": 1.0}}
    )
    made = found(put(noisy, "a"), path)
    assert difference_words(made.lines[4], made.base, "objective") == ""
    assert difference_words(made.lines[4], made.base, "iae")
    told = " ".join(made.notes)
    assert "J has other weights" in told
    assert "another plant than the base's (fopdt, gain 2, time constant 5, dead time 1" in told
    assert "another draw of the noise" in told


def test_a_note_names_a_run_in_place_of_all_its_cases(study: Study, put: Callable[..., Path]) -> None:
    other = replace(study, experiment=Experiment(500.0, Step(4.0)))
    one = replace(other, cases=other.cases[1:2])
    paths = [put(study, "a"), put(replace(other, name="b"), "b"), put(replace(one, name="c"), "c")]
    (note,) = found(*paths).notes
    assert note.startswith("all of b; c: Case 2: not held against the base: its experiment is another one in duration")
    content = json.loads(paths[1].read_text())
    content["trends"] = [one for one in content["trends"] if one["case"] == "Optimised PI"]
    content["experiment"] = json.loads(paths[0].read_text())["experiment"]
    paths[1].write_text(json.dumps(content))
    assert drawn(found(*paths[:2]))[1] == [
        "b (Case 1; Case 2): the file holds no signals to draw; run its scenario again."
    ]
    # Of one run the cases are named, as there is no other to tell it from.
    alone = found(paths[1])
    assert drawn(alone)[1] == ["Case 1; Case 2: the file holds no signals to draw; run its scenario again."]


def test_many_cases_stand_in_several_tables_each_with_the_base(study: Study, put: Callable[..., Path]) -> None:
    cases = tuple(replace(study.cases[0], name=f"Case {i}") for i in range(14))
    made = found(put(replace(study, cases=cases)), base="Case 3")
    parts = tables(made)
    assert [len(table.heads) for table in parts] == [6, 6, 4]
    assert {table.heads[0] for table in parts} == {"Case 3"}
    assert sorted(head for table in parts for head in table.heads[1:]) == sorted({c.name for c in cases} - {"Case 3"})
    curves, said = drawn(made)
    assert [c.name for c in curves][:2] == ["Case 3", "Case 0"]
    assert len(curves) == 8
    assert said == ["The figure shows the first 8 of 14 cases; --include chooses others."]


def test_estimates_stand_beside_each_other(study: Study, put: Callable[..., Path]) -> None:
    later = replace(
        study.estimates[0],
        found=replace(study.estimates[0].found, valve=replace(study.estimates[0].found.valve, d=2.6)),
    )
    made = found(put(study, "a"), put(replace(study, name="b", estimates=(later,)), "b"))
    table = estimate_table(made)
    assert table is not None
    rows = {row.label: row for row in table.rows}
    assert rows["Stiction d"].cells[0].small == "1.990 to 2.010"
    assert rows["Stiction d"].cells[1].text == "2.600"
    assert rows["Stiction d"].cells[1].small.endswith("; +30 %")
    alone = found(put(replace(study, name="c", cases=()), "c"))
    assert alone.base is None
    assert tables(alone) == []
    assert drawn(alone) == ([], [])
    assert "<svg" not in comparison_page(alone)
    with pytest.raises(InvalidValue, match="--base: Case 1 given; must be left out: there are no cases"):
        found(alone.results[0].path, base="Case 1")


# the page and the CSV ------------------------------------------------------------------------------------------------


def test_text_is_text_and_the_page_is_the_same_each_time(study: Study, put: Callable[..., Path]) -> None:
    cases = (replace(study.cases[0], name=EVIL), replace(study.cases[1], name="=1+1"))
    made = found(put(replace(study, name=EVIL, title=EVIL, cases=cases), "evil"), put(study, "good"))
    page = comparison_page(made)
    assert EVIL not in page
    assert page.count("<svg") == 1
    assert page.count("&lt;script&gt;") > 5
    assert page == comparison_page(made)
    assert "http" not in page.replace("http://www.w3.org", "")
    rows = list(csv.DictReader(StringIO(comparison_csv(made))))
    assert [row["name"] for row in rows[:2]] == [EVIL, "'=1+1"]
    assert [row["base"] for row in rows[:2]] == ["true", "false"]
    assert float(rows[1]["valve_travel_difference"]) == pytest.approx(
        study.cases[1].run.kpis.valve_travel - study.cases[0].run.kpis.valve_travel
    )
    assert rows[-1]["kind"] == "estimate"
    assert rows[-1]["verdict"] == "stiction"
    assert rows[-1]["d"] == "2.003"


def test_names_in_a_legend_are_told_apart(study: Study, put: Callable[..., Path]) -> None:
    long = tuple(replace(case, name=f"A case with a long name {i}") for i, case in enumerate(study.cases))
    one = put(replace(study, cases=long), "before/made")
    other = one.parents[2] / "after" / "made"
    shutil.copytree(one.parent, other)
    curves, _ = drawn(found(one, other))
    assert curves[0].name == "A case with a … (before/made)"
    assert curves[3].name == "A case with a … (after/made)"
    assert "after/made" in comparison_page(found(one, other))
