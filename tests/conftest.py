"""Shared set-up: property tests without a deadline, as a first call may compile, and an order for several processes."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

sys.path.insert(0, str(Path(__file__).parent))

settings.register_profile("workbench", deadline=None, max_examples=60, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("workbench")

# Two workers begin with half of the tests each: the first with what has most to compile, the second, within `symbolic`,
# with what needs little of that; by the time that its servers and their workers estimate and tune, what they
# need is compiled, and not once more beside the first. What is not named is left to even out the end.
FIRST = ("estimate", "detect", "analyze", "tune", "simulate", "fleet", "scenarios", "model", "kpi")
SECOND = ("symbolic", "record", "ui", "scenario", "report")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the folders in order, what is not named in the end; within a folder as they were."""
    places = {name: place for place, name in enumerate(FIRST + SECOND)}
    items.sort(key=lambda item: places.get(item.path.parent.name, len(places)))
