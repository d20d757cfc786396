"""The wrappers around numba: how often a function is compiled, and that none runs as it was before an edit."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from workbench.simulate.compiled import copy

HEAD = "from workbench.simulate.compiled import compiled, specialised\n"
Load = Callable[[str], ModuleType]


@pytest.fixture
def load(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Load:
    """Load a module of `tmp_path` from its file, as another process would."""
    monkeypatch.setattr(sys, "dont_write_bytecode", True)

    def loaded(name: str) -> ModuleType:
        spec = importlib.util.spec_from_file_location(name, tmp_path / f"{name}.py")
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        monkeypatch.setitem(sys.modules, name, module)
        spec.loader.exec_module(module)
        return module

    return loaded


def test_constants_are_values_but_where_a_copy_for_each_is_asked_for(tmp_path: Path, load: Load) -> None:
    body = "(kind: int, x: float) -> float:\n    return x + kind\n"
    calls = "value(1, x) + value(kind=2, x=x) + 10.0 * (constant(1, x) + constant(2, x))"
    text = f"@compiled\ndef value{body}@specialised\ndef constant{body}@compiled\ndef both(x):\n    return {calls}\n"
    (tmp_path / "constants.py").write_text(HEAD + text)
    module = load("constants")
    assert module.both(0.5) == 44.0
    assert len(module.value.signatures) == 1
    assert len(module.constant.signatures) == 2


def test_a_copy_is_of_the_values() -> None:
    source, target = np.arange(4.0), np.zeros(3)
    copy(source, target)
    assert target.tolist() == [0.0, 1.0, 2.0]


def test_an_edit_of_what_is_called_is_an_edit_of_what_calls(tmp_path: Path, load: Load) -> None:
    texts = {
        "amounts": "SHARE = 2.0\n",
        "inmost": "from amounts import SHARE\n@compiled\ndef share(x):\n    return SHARE * x\n",
        "between": "from inmost import share\n@compiled\ndef more(x):\n    return 1.0 + share(x)\n",
        "outmost": "from between import more\n@compiled\ndef most(x):\n    return 10.0 * more(x)\n",
    }

    def most() -> tuple[float, int]:
        """What the outmost function makes of 3, and how many of its signatures came from the cache."""
        module = [load(name) for name in texts][-1]
        return module.most(3.0), sum(module.most.stats.cache_hits.values())

    for name, text in texts.items():
        (tmp_path / f"{name}.py").write_text(HEAD + text)
    assert most() == (70.0, 0)
    assert most() == (70.0, 1)
    (tmp_path / "amounts.py").write_text(texts["amounts"].replace("2.0", "5.0"))
    assert most() == (160.0, 0)
    assert most() == (160.0, 1)
    (tmp_path / "inmost.py").write_text(HEAD + texts["inmost"].replace("SHARE * x", "SHARE * x + 1.0"))
    assert most() == (170.0, 0)
    assert most() == (170.0, 1)
