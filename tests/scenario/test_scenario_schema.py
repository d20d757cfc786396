"""The committed JSON Schema is the one that the code makes, and names what the model names."""

from __future__ import annotations

import json
from dataclasses import fields
from importlib.resources import files
from typing import get_args

from workbench.model.controller import FORMS, PID, STRUCTURES
from workbench.model.results import Intervals, Kpis
from workbench.scenario import schema
from workbench.scenario.estimate_entries import EstimateReference


def test_the_committed_schema_is_current() -> None:
    committed = files("workbench.scenario").joinpath("schema.json").read_text(encoding="utf-8")
    assert committed == schema.json_schema(), "write workbench.scenario.schema.json_schema() to schema.json"


def test_the_schema_is_closed_everywhere() -> None:
    content = json.loads(schema.json_schema())
    assert content["additionalProperties"] is False
    objects = [d for d in content["$defs"].values() if d.get("type") == "object"]
    assert objects
    assert all(d["additionalProperties"] is False for d in objects)


def test_names_are_the_models() -> None:
    assert set(get_args(schema.KpiName)) == {f.name for f in fields(Kpis)} | {"objective"}
    assert set(EstimateReference.model_fields) == {f.name for f in fields(Intervals)}
    keys = set(schema.ControllerKeys.model_fields) - {"structure"}
    assert keys | {"Kc", "Ti", "Td"} == {f.name for f in fields(PID)}
    given = schema.ControllerKeys.model_json_schema()["properties"]
    assert set(given["structure"]["anyOf"][0]["enum"]) == set(STRUCTURES)
    assert set(given["form"]["anyOf"][0]["enum"]) == set(FORMS)
