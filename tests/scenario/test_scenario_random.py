"""Random scenarios, mutations of good ones and random bytes: only our own errors come out of the loader."""

from __future__ import annotations

import contextlib
import json
import math
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from workbench.errors import ScenarioError
from workbench.scenario.loader import load_scenario, read_scenario

SCENARIOS = Path(__file__).parents[2] / "scenarios"
HERE = Path("scenario.yaml")

finite = st.floats(0.01, 100.0).map(lambda x: float(f"{x:.4g}"))


def seconds(low: float, high: float) -> st.SearchStrategy[str]:
    units = {"s": 1.0, "min": 60.0, "h": 3600.0, "ms": 1e-3}
    return st.tuples(st.floats(low, high), st.sampled_from(sorted(units))).map(
        lambda pair: f"{pair[0] / units[pair[1]]:.6g} {pair[1]}"
    )


@st.composite
def scenarios(draw: st.DrawFn) -> dict[str, object]:
    """A valid scenario as plain data."""
    tau = draw(seconds(2.0, 200.0))
    plant = draw(
        st.sampled_from(
            [
                {"type": "fopdt", "gain": draw(finite), "time_constant": tau, "dead_time": draw(seconds(1.1, 20.0))},
                {"type": "integrating", "gain": -draw(finite), "dead_time": 0},
            ]
        )
    )
    valve = draw(
        st.sampled_from(
            [
                {"type": "ideal"},
                {"type": "stenman", "d": draw(finite)},
                {"type": "he", "fs": 2.0, "fd": "0.7 %"},
                {"type": "choudhury", "S": f"{draw(finite)} %", "J": draw(finite)},
                {"type": "kano", "S": 3.0, "J": 1.0},
                {"type": "directional", "up": {"S": draw(finite), "J": 0.0}, "down": {"S": "2 %", "J": 0.5}},
                {"type": "deadband", "b": draw(finite)},
            ]
        )
    )
    parts = [{"step": draw(finite)}, {"ramp": -draw(finite), "start": "1 s", "end": "1 min"}, {"series": [1, 2.5, 0]}]
    names = draw(
        st.lists(
            st.text(st.characters(categories=["L", "N"]), min_size=1, max_size=8), min_size=1, max_size=4, unique=True
        )
    )
    cases: list[dict[str, object]] = []
    for name in names:
        kind = draw(st.integers(0, 4))
        if kind == 0:
            low = draw(st.floats(0.0, 1.0))
            cases.append({"name": name, "tune": {"bounds": {"Kc": [low, low + 50.0], "Ti": ["1 s", "10 h"]}, "Td": 0}})
        elif kind == 1:
            cases.append({"name": name, "proportional_band": "150 %", "Ti": "0.5 repeats/min", "form": "series"})
        elif kind == 2:
            # The plant may have no time constant: only this rule takes both.
            rule = {"name": "lambda", "lambda": draw(seconds(1.0, 100.0))}
            cases.append({"name": name, "rule": rule, "form": "parallel"})
        else:
            cases.append({"name": name, "Kc": 1.0 + draw(finite) / 10.0, "Ti": draw(seconds(2.0, 3000.0)), "Td": "2 s"})
    return {
        "title": draw(st.text(st.characters(categories=["L", "N", "P"]), min_size=1, max_size=30)),
        "loop": {
            "plant": plant,
            "valve": valve,
            "sample_time": "1 s",
            "pv_range": [0, 100],
            "controller": {
                "Kc": 1.0,
                "Ti": "20 s",
                "derivative_filter": draw(st.sampled_from(["none", 8, 10.0])),
                "action": "direct" if plant["gain"] < 0 else "reverse",
            },
        },
        "experiment": {
            "duration": f"{draw(st.integers(60, 500))} s",
            "setpoint": draw(st.sampled_from([parts[0], parts])),
            "noise": {"sd": draw(finite), "seed": draw(st.integers(0, 2**40))},
        },
        "cases": cases,
    }


@settings(deadline=None, max_examples=30)
@given(scenarios())
def test_valid_scenarios_load(data: dict[str, object]) -> None:
    # JSON is YAML: what is written here is what the loader must understand.
    plan = read_scenario(json.dumps(data), HERE)
    assert [case.name for case in plan.cases] == [case["name"] for case in data["cases"]]  # type: ignore[attr-defined]
    assert plan.loop is not None
    assert plan.experiment is not None
    for case in plan.cases:
        assert case.controller.Kc > 0.0
        assert case.tune is None or case.tune.bounds.contains(case.controller)


WRONG = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-5, 5),
    st.floats(),
    st.text(max_size=12),
    st.sampled_from(["5 s", "-1 s", "none", "2 %", "1e999 s", "yes", "0", "repeats/min", "ideal", "<fopdt>", "*"]),
    st.just([]),
    st.just({}),
    st.lists(st.integers(-3, 3), max_size=3),
    st.dictionaries(st.sampled_from(["type", "step", "tune", "name", "Kc", "<<"]), st.integers(0, 2), max_size=2),
)


def paths(data: object, here: tuple[object, ...] = ()) -> list[tuple[object, ...]]:
    children = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    found = [here]
    for key, value in children:
        found += paths(value, (*here, key))
    return found


def put(data: object, path: tuple[object, ...], value: object, rename: str | None) -> object:
    if not path:
        return value
    copied = json.loads(json.dumps(data))
    inside = copied
    for key in path[:-1]:
        inside = inside[key]
    if rename is not None and isinstance(inside, dict):
        inside[rename] = inside.pop(path[-1])
    else:
        inside[path[-1]] = value
    return copied


@settings(deadline=None, max_examples=75, suppress_health_check=[HealthCheck.too_slow])
@given(scenarios(), st.data())
def test_mutated_scenarios_give_only_our_errors(data: dict[str, object], drawn: st.DataObject) -> None:
    for _ in range(drawn.draw(st.integers(1, 2))):
        path = drawn.draw(st.sampled_from(paths(data)))
        rename = drawn.draw(st.none() | st.text(max_size=5))
        mutated = put(data, path, drawn.draw(WRONG), rename)
        data = mutated if isinstance(mutated, dict) else {"title": mutated}
    text = json.dumps(data)
    try:
        plan = read_scenario(text, HERE)
    except ScenarioError as error:
        for line in str(error).splitlines():
            where, _, what = line.partition(": ")
            name, row, column = where.rsplit(":", 2)
            assert name == "scenario.yaml"
            assert int(row) >= 1
            assert int(column) >= 1
            assert what
    else:
        # What loads holds nothing that the model would refuse.
        assert plan.experiment is None or math.isfinite(plan.experiment.duration)


@settings(deadline=None, max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(content=st.binary(max_size=200) | st.text(max_size=200).map(lambda text: text.encode()))
def test_random_bytes_give_only_our_errors(tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "noise.yaml"
    file.write_bytes(content)
    with pytest.raises(ScenarioError):
        load_scenario(file)


YAML_LIKE = st.text(alphabet="abK: {}[],-&*!|>%@`'\"#?\n\t .0123456789~<=\\\u2028\u00e4\x00\ufeff", max_size=120)


@settings(deadline=None, max_examples=400)
@given(YAML_LIKE)
def test_text_that_looks_like_yaml_gives_only_our_errors(text: str) -> None:
    with pytest.raises(ScenarioError):
        read_scenario(text, HERE)


@settings(deadline=None, max_examples=120)
@given(st.sampled_from(["table_2", "stick_slip", "identify_benchmark"]), st.data())
def test_shipped_scenarios_with_a_stretch_replaced(name: str, drawn: st.DataObject) -> None:
    text = (SCENARIOS / f"{name}.yaml").read_text(encoding="utf-8")
    begin = drawn.draw(st.integers(0, len(text)))
    end = min(len(text), begin + drawn.draw(st.integers(0, 20)))
    changed = text[:begin] + drawn.draw(YAML_LIKE) + text[end:]
    with contextlib.suppress(ScenarioError):
        read_scenario(changed, SCENARIOS / f"{name}.yaml")
