"""Stiction Workbench: estimate, simulate, analyze and tune control loops whose valve sticks.

`import workbench as wb` gives the public names below; each is loaded when it is first used.
"""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING

__version__ = "0.1.0"

_HOME = {
    "WorkbenchError": "errors",
    "InvalidValue": "errors",
    "OutputError": "errors",
    "RecordError": "errors",
    "ScenarioError": "errors",
    "SolveError": "errors",
    "FOPDT": "model.plant",
    "Integrating": "model.plant",
    "Ideal": "model.valve",
    "Stenman": "model.valve",
    "He": "model.valve",
    "Choudhury": "model.valve",
    "Kano": "model.valve",
    "Deadband": "model.valve",
    "Directional": "model.valve",
    "Positional": "model.valve",
    "Karnopp": "model.karnopp",
    "PID": "model.controller",
    "EqualPercentage": "model.characteristic",
    "IntegralDeadband": "model.compensator",
    "Knocker": "model.compensator",
    "ConstantReinforcement": "model.compensator",
    "TwoMove": "model.compensator",
    "Dither": "model.compensator",
    "Loop": "model.loop",
    "Cascade": "model.cascade",
    "CascadeExperiment": "model.cascade",
    "Step": "model.experiment",
    "Ramp": "model.experiment",
    "Series": "model.experiment",
    "Noise": "model.experiment",
    "Experiment": "model.experiment",
    "Record": "model.record",
    "Objective": "model.tuning",
    "Bounds": "model.tuning",
    "Simc": "model.rule",
    "Lambda": "model.rule",
    "Amigo": "model.rule",
    "ZieglerNichols": "model.rule",
    "DetunedIntegral": "model.rule",
    "NoCrossing": "model.rule",
    "Ensemble": "model.ensemble",
    "Constraints": "model.ensemble",
    "SolveStatus": "model.results",
    "Detection": "model.detection",
    "simulate": "simulate.run",
    "simulate_batch": "simulate.run",
    "evaluate": "simulate.run",
    "signature": "simulate.signature",
    "read_record": "record.reader",
    "detect": "detect.detect",
    "estimate": "estimate.estimate",
    "describing_function": "analyze.describing_function",
    "limit_cycle": "analyze.limit_cycle",
    "cycle_map": "analyze.cycle_map",
    "cascade_cycle": "analyze.cascade",
    "tune_cascade": "tune.cascade",
    "margins": "analyze.margins",
    "assess": "tune.ensemble",
    "tune": "tune.tune",
    "apply_rule": "tune.rules",
    "value_of_repair": "tune.repair",
    "pareto_front": "tune.front",
    "load_scenario": "scenario.loader",
    "run_scenario": "scenario.runner",
    "plot": "report.plot",
}

__all__ = [
    "FOPDT",
    "PID",
    "Amigo",
    "Bounds",
    "Cascade",
    "CascadeExperiment",
    "Choudhury",
    "ConstantReinforcement",
    "Constraints",
    "Deadband",
    "Detection",
    "DetunedIntegral",
    "Directional",
    "Dither",
    "Ensemble",
    "EqualPercentage",
    "Experiment",
    "He",
    "Ideal",
    "IntegralDeadband",
    "Integrating",
    "InvalidValue",
    "Kano",
    "Karnopp",
    "Knocker",
    "Lambda",
    "Loop",
    "NoCrossing",
    "Noise",
    "Objective",
    "OutputError",
    "Positional",
    "Ramp",
    "Record",
    "RecordError",
    "ScenarioError",
    "Series",
    "Simc",
    "SolveError",
    "SolveStatus",
    "Stenman",
    "Step",
    "TwoMove",
    "WorkbenchError",
    "ZieglerNichols",
    "__version__",
    "apply_rule",
    "assess",
    "cascade_cycle",
    "cycle_map",
    "describing_function",
    "detect",
    "estimate",
    "evaluate",
    "limit_cycle",
    "load_scenario",
    "margins",
    "pareto_front",
    "plot",
    "read_record",
    "run_scenario",
    "signature",
    "simulate",
    "simulate_batch",
    "tune",
    "tune_cascade",
    "value_of_repair",
]


def __getattr__(name: str) -> object:
    if name not in _HOME:
        msg = f"module 'workbench' has no attribute {name!r}"
        raise AttributeError(msg)
    value = getattr(import_module(f"workbench.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)


class _Package(ModuleType):
    """Keeps `wb.simulate`, `wb.detect`, `wb.estimate` and `wb.tune` the public functions.

    The import system would bind the folders of the same names here, whenever the first module of one is imported.
    """

    def __setattr__(self, name: str, value: object) -> None:
        if name in _HOME and isinstance(value, ModuleType):
            return
        super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package

if TYPE_CHECKING:
    from workbench.analyze.cascade import cascade_cycle
    from workbench.analyze.cycle_map import cycle_map
    from workbench.analyze.describing_function import describing_function
    from workbench.analyze.limit_cycle import limit_cycle
    from workbench.analyze.margins import margins
    from workbench.detect.detect import detect
    from workbench.errors import InvalidValue, OutputError, RecordError, ScenarioError, SolveError, WorkbenchError
    from workbench.estimate.estimate import estimate
    from workbench.model.cascade import Cascade, CascadeExperiment
    from workbench.model.characteristic import EqualPercentage
    from workbench.model.compensator import ConstantReinforcement, Dither, IntegralDeadband, Knocker, TwoMove
    from workbench.model.controller import PID
    from workbench.model.detection import Detection
    from workbench.model.ensemble import Constraints, Ensemble
    from workbench.model.experiment import Experiment, Noise, Ramp, Series, Step
    from workbench.model.karnopp import Karnopp
    from workbench.model.loop import Loop
    from workbench.model.plant import FOPDT, Integrating
    from workbench.model.record import Record
    from workbench.model.results import SolveStatus
    from workbench.model.rule import Amigo, DetunedIntegral, Lambda, NoCrossing, Simc, ZieglerNichols
    from workbench.model.tuning import Bounds, Objective
    from workbench.model.valve import Choudhury, Deadband, Directional, He, Ideal, Kano, Positional, Stenman
    from workbench.record.reader import read_record
    from workbench.report.plot import plot
    from workbench.scenario.loader import load_scenario
    from workbench.scenario.runner import run_scenario
    from workbench.simulate.run import evaluate, simulate, simulate_batch
    from workbench.simulate.signature import signature
    from workbench.tune.cascade import tune_cascade
    from workbench.tune.ensemble import assess
    from workbench.tune.front import pareto_front
    from workbench.tune.repair import value_of_repair
    from workbench.tune.rules import apply_rule
    from workbench.tune.tune import tune
