"""The README's example of a scenario held by tests passes, and its study is asked by the names of its cases."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

import workbench as wb

ROOT = Path(__file__).parents[2]


def example() -> dict[str, Any]:
    """The names of the README's example."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    found = re.search(r"## Scenarios as tests\n.*?```python\n(.*?)```", text, re.DOTALL)
    assert found is not None
    names: dict[str, Any] = {}
    exec(compile(found[1], "README.md", "exec"), names)
    return names


def test_the_readmes_regressions_hold(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    names = example()
    study = names["study"].__wrapped__()
    tests = [run for name, run in names.items() if name.startswith("test_")]
    assert len(tests) == 2
    for run in tests:
        run(study)
    with pytest.raises(wb.InvalidValue, match=r"Study\.case: Base case given; must be one of Base case \(Fig\. 6\), "):
        study.case("Base case")
