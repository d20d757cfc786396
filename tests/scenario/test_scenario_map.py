"""`analyze: {map: ...}`: what it asks for, what it refuses, and that the map is of the loop and the cases."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import workbench as wb
from workbench.scenario.loader import load_scenario

BASE = """\
title: A map
loop:
  plant: {type: fopdt, gain: 1.0, time_constant: 5 s, dead_time: 1 s}
  valve: {type: stenman, d: 2 %}
  sample_time: 1 s
experiment: {duration: 100 s, setpoint: {step: 4, at: 0 s}}
cases:
  - {name: As found, Kc: 0.5, Ti: 20 s, Td: 0.5 s}
  - {name: Far off, Kc: 40, Ti: 4000 s}
analyze: {describing_function: false, limit_cycle: false, map: MAP}
"""


def written(folder: Path, entry: str, base: str = BASE) -> Path:
    path = folder / "map.yaml"
    path.write_text(base.replace("MAP", entry))
    return path


def test_true_maps_the_loop_over_ranges_that_hold_the_cases(tmp_path):
    plan = load_scenario(written(tmp_path, "true"))
    assert plan.cycle_map is not None
    assert (plan.cycle_map.points, plan.cycle_map.starts) == (60, 4)
    study = wb.run_scenario(written(tmp_path, "{points: 3, starts: 1}"))
    found = study.cycle_map
    assert found is not None
    assert (found.axis, found.outcome.shape, found.starts) == ("Ti", (3, 3), 1)
    assert found.contains(40.0, 4000.0)
    assert found.loop.controller.Td == 0.5, "the first case's"


def test_given_ranges_and_the_fixed_parameter_are_taken(tmp_path):
    told: list[tuple[str, float]] = []
    path = written(tmp_path, "{Kc: [0.4, 2], Td: [0 s, 2 s], at_Ti: 1 min, points: 3, starts: 1}")
    study = wb.run_scenario(path, progress=lambda words, share: told.append((words, share)))
    found = study.cycle_map
    assert found is not None
    assert found.axis == "Td"
    assert found.Kc == pytest.approx(np.geomspace(0.4, 2.0, 3))
    assert found.values.tolist() == [0.0, 1.0, 2.0]
    assert found.loop.controller.Ti == 60.0
    shares = [share for words, share in told if words == "map"]
    assert shares == sorted(shares)
    assert shares[-1] > shares[0]
    assert "map" in study.times
    found = wb.run_scenario(written(tmp_path, "{Ti: [5 s, 50 s], at_Td: 0 s, points: 2, starts: 1}")).cycle_map
    assert found is not None
    assert found.loop.controller.Td == 0.0
    assert found.values == pytest.approx([5.0, 50.0])


def test_false_and_nothing_draw_no_map(tmp_path):
    assert load_scenario(written(tmp_path, "false")).cycle_map is None
    plain = written(tmp_path, "", BASE.replace(", map: MAP", ""))
    assert load_scenario(plain).cycle_map is None


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ("{Kc: [2, 1]}", r"10:\d+: analyze\.map\.Kc: .* given; must be a pair \(low, high\) with low < high"),
        ("{Kc: [0, 1]}", r"analyze\.map\.Kc\[0\]: 0 given; must be above 0"),
        ("{Kc: [1]}", r"analyze\.map\.Kc"),
        ("{Ti: [5, 50]}", r"analyze\.map\.Ti"),
        ("{Ti: [5 s, 50 s], Td: [0 s, 1 s]}", r"analyze\.map\.Td: range given beside a range of Ti"),
        ("{Td: [0 s, 1 s], at_Td: 1 s}", r"analyze\.map\.at_Td: given, but Td is an axis of this map; at_Ti says"),
        ("{at_Ti: 5 s}", r"analyze\.map\.at_Ti: given, but Ti is an axis of this map; at_Td says"),
        ("{points: 1}", r"analyze\.map\.points"),
        ("{starts: 9}", r"analyze\.map\.starts"),
        ("{gain: 1}", r"analyze\.map\.gain"),
        ("60", r"analyze\.map: .*must be true, false, or a mapping \(a map written out\)"),
    ],
)
def test_what_a_map_cannot_be_is_refused_with_its_place(tmp_path, entry, message):
    with pytest.raises(wb.ScenarioError, match=message):
        load_scenario(written(tmp_path, entry))


def test_a_map_needs_cases(tmp_path):
    text = BASE[: BASE.index("cases:")] + "estimate: {simulate: true}\nanalyze: {map: true}\n"
    with pytest.raises(wb.ScenarioError, match=r"analyze\.map: .*without cases"):
        load_scenario(written(tmp_path, "", text))
