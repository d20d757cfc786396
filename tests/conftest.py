"""Shared set-up: property tests without a deadline, as a first call may compile, and an order for several processes."""

from __future__ import annotations

import gc
import os
import shutil
import sys
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

# Linear algebra in one thread, for the parts of the library that tests call by themselves and for what tests start: the
# threads of two workers would wait for each other by spinning (simulate.one_thread). Said before any of it is loaded.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# Bytecode is kept whatever the environment says: each of the processes that tests start would compile the package anew.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

sys.path.insert(0, str(Path(__file__).parent))

settings.register_profile("workbench", deadline=None, max_examples=60, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("workbench")

# Two workers begin with half of the tests each: the first with what estimates and detects, the second, in the middle of
# the order, with what simulates, analyzes and tunes. Each compiles its own; by the time that the second's servers and
# scenarios estimate, and the first's scenarios tune, what they need is compiled, and not once more beside the other.
# Scenarios, each of which takes long, come early: what is left in the end is short, and neither waits for the other.
FIRST = ("estimate", "scenarios", "detect", "fleet", "record", "report")
SECOND = ("symbolic", "simulate", "analyze", "tune", "ui", "scenario")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the folders in order, the second from the middle on, among what is not named; in a folder as they were."""
    first, second, others = [], [], []
    for item in items:
        folder = item.path.parent.name
        (first if folder in FIRST else second if folder in SECOND else others).append(item)
    for part, names in ((first, FIRST), (second, SECOND)):
        part.sort(key=lambda item: names.index(item.path.parent.name))
    before = max(len(items) // 2 - len(first), 0)
    items[:] = first + others[:before] + second + others[before:]


@pytest.fixture(scope="session", autouse=True)
def _no_word_on_compiling() -> Iterator[None]:
    """Which test compiles a kernel first is chance, and what it says on standard error then is no test's."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("workbench.cli.command.tell_compiling", lambda: None)
        yield


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Return a browser of Debian's, driven by Playwright: its headless shell, which takes a fifth less, or Chromium.

    Skipped where there is neither, unless WORKBENCH_REQUIRE_BROWSER=1 says that there must be one.
    """
    required = os.environ.get("WORKBENCH_REQUIRE_BROWSER") == "1"
    names = ("chromium-headless-shell", "chromium", "chromium-browser")
    path = next((found for name in names if (found := shutil.which(name))), None)
    if path is None and not required:
        pytest.skip("no chromium is installed")
    assert path is not None, "WORKBENCH_REQUIRE_BROWSER=1, and no chromium is installed"
    if not required:
        pytest.importorskip("playwright")
    from playwright import sync_api

    with sync_api.sync_playwright() as playwright:
        running = playwright.chromium.launch(executable_path=path, args=["--no-sandbox", "--disable-gpu"])
        yield running
        running.close()


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make a report's figures and draw none, which takes most of its time: for what is told and kept around them."""
    from matplotlib.figure import Figure

    from workbench.report import page
    from workbench.report.style import svg_text

    empty = svg_text(Figure())
    monkeypatch.setattr(page, "svg_text", lambda *_: empty)


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Collect no garbage while the modules are imported nor, later, among what they hold, and seldom: little is any."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.set_threshold(20_000, 10, 10)
        gc.enable()
