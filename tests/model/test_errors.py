"""How a value that is refused is shown: in one line, whatever was given."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import workbench as wb
from workbench.errors import LONGEST, shown

LOOP = wb.Loop(wb.FOPDT(1.0, 5.0, 1.0), wb.Stenman(2.0), wb.PID(0.5, 20.0), 1.0)
EXPERIMENT = wb.Experiment(20.0, wb.Step(4.0))
CASCADE = wb.Cascade(wb.Loop(wb.FOPDT(1.2, 60.0, 10.0), wb.Ideal(), wb.PID(1.5, 80.0), 5.0), LOOP)


class Unshowable:
    def __repr__(self) -> str:
        raise RuntimeError


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (3, "3"),
        (0.25, "0.25"),
        ("PID", "PID"),
        (None, "None"),
        ((5.0, 0.1), "(5.0, 0.1)"),
        (wb.Stenman(2.0), "Stenman(d=2.0)"),
        (np.zeros((2, 2)), "array([[0., 0.], [0., 0.]])"),
        ("two\nlines", r"two\nlines"),
        pytest.param("a" * 81, "a" * 77 + "...", id="long text"),
        ([0] * 500, "list"),
        ({n: n for n in range(500)}, "dict"),
        (np.arange(500.0), "ndarray"),
        (Unshowable(), "Unshowable"),
    ],
)
def test_a_value_is_shown_short_or_by_its_type(value: object, text: str) -> None:
    assert shown(value) == text


def test_a_number_that_cannot_be_written_out_is_shown_by_its_type() -> None:
    assert shown(10**5000) == "int"


BAD: list[object] = [wb.Record(np.arange(500.0), np.arange(500.0), sample_time=1.0), np.arange(500.0), ["a\nb"] * 90]
ENTRIES: list[Callable[..., object]] = [
    lambda bad: wb.tune(bad, EXPERIMENT),
    lambda bad: wb.tune(LOOP, EXPERIMENT, bad),
    lambda bad: wb.tune(LOOP, EXPERIMENT, bounds=bad),
    lambda bad: wb.tune(LOOP, EXPERIMENT, robust=bad),
    lambda bad: wb.simulate(bad, EXPERIMENT),
    lambda bad: wb.limit_cycle(bad),
    lambda bad: wb.describing_function(bad),
    lambda bad: wb.margins(bad),
    lambda bad: wb.cycle_map(bad),
    lambda bad: wb.assess(bad),
    lambda bad: wb.pareto_front(bad),
    lambda bad: wb.pareto_front(LOOP, bounds=bad),
    lambda bad: wb.pareto_front(LOOP, known=[bad]),
    lambda bad: wb.signature(bad),
    lambda bad: wb.value_of_repair(LOOP, EXPERIMENT, bad),
    lambda bad: wb.tune_cascade(CASCADE, EXPERIMENT, bad),
    lambda bad: wb.FOPDT(bad, 5.0, 1.0),
]


@pytest.mark.parametrize("entry", ENTRIES)
def test_every_entry_refuses_a_large_value_in_one_short_line(entry: Callable[..., object]) -> None:
    for bad in BAD:
        with pytest.raises(wb.InvalidValue) as caught:
            entry(bad)
        assert len(caught.value.given) <= LONGEST
        assert len(str(caught.value)) <= 200
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "entry",
    [
        lambda told: wb.tune(LOOP, EXPERIMENT, progress=told),
        lambda told: wb.tune_cascade(CASCADE, EXPERIMENT, progress=told),
        lambda told: wb.pareto_front(LOOP, progress=told),
        lambda told: wb.value_of_repair(LOOP, EXPERIMENT, progress=told),
        lambda told: wb.cycle_map(LOOP, progress=told),
        lambda told: wb.limit_cycle(LOOP, progress=told),
        lambda told: wb.cascade_cycle(CASCADE, EXPERIMENT, progress=told),
        lambda told: wb.run_scenario("no.yaml", progress=told),
    ],
)
def test_progress_that_cannot_be_called_is_refused(entry: Callable[..., object]) -> None:
    with pytest.raises(wb.InvalidValue, match=r"progress: 5 given; must be a function or None"):
        entry(5)
