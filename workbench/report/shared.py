"""What the report says that all cases share: plant, valve, controller, sampling, experiment and objective."""

from __future__ import annotations

import math
from collections.abc import Callable

from workbench.model.cascade import CascadeExperiment
from workbench.model.controller import PID
from workbench.model.study import Study
from workbench.model.titles import kpi_title
from workbench.model.tuning import Objective
from workbench.report.words import compensator_words, given, loop_words, plant_words, setting, valve_words

__all__ = ["CONTROLLER_ROWS", "experiment_words", "loop_lines", "objective_words"]


def _filter(pid: PID) -> str:
    if pid.Td == 0.0:
        return "–"
    return "none" if math.isinf(pid.derivative_filter) else f"Td/{given(pid.derivative_filter)}"


def _limits(pid: PID) -> str:
    limits = pid.output_limits
    return "none" if limits is None else f"{_signed(limits[0])} to {_signed(limits[1])} %"


def _signed(value: float) -> str:
    return "none" if math.isinf(value) else given(value)


def _tracking(pid: PID) -> str:
    if pid.output_limits is None or pid.anti_windup != "back_calculation":
        return "–"
    return "Ti" if pid.tracking_time is None else f"{setting(pid.tracking_time)} s"


# What a controller is beside its settings: title, and its text for one controller.
CONTROLLER_ROWS: tuple[tuple[str, Callable[[PID], str]], ...] = (
    ("Form", lambda p: p.form),
    ("Structure", lambda p: p.structure or f"D on {p.derivative_on}, weight {given(p.setpoint_weight)}"),
    ("Derivative filter", _filter),
    ("Action", lambda p: p.action),
    ("Output limits", _limits),
    ("Anti-windup", lambda p: "–" if p.output_limits is None else p.anti_windup.replace("_", "-")),
    ("Tracking time", _tracking),
    ("Output resolution", lambda p: f"{given(p.output_resolution)} %" if p.output_resolution > 0.0 else "–"),
    ("Compensator", lambda p: compensator_words(p.compensator)),
)


# Not worth a word where all cases share it.
UNSAID = (("Output limits", {"none"}), ("Compensator", {"none"}))


def loop_lines(study: Study) -> list[tuple[str, str]]:
    """Return what all cases share, as (what, text): plant, valve, controller, sampling, experiment, objective."""
    lines: list[tuple[str, str]] = []
    if study.cases:
        loop = study.cases[0].loop
        lines += [("Plant", plant_words(loop.plant)), ("Valve", valve_words(loop.valve))]
        lines += loop_words(loop)
        shared = []
        for text, describe in CONTROLLER_ROWS:
            every = {describe(c.loop.controller) for c in study.cases}
            if text == "Derivative filter":  # of no concern where a case has no derivative action
                every -= {"–"}
            if len(every) == 1 and every != {"–"} and (text, every) not in UNSAID:
                shared.append(f"{text.lower()} {every.pop()}")
        lines.append(("Controller", ", ".join(shared) or "differs from case to case (see the table)"))
        lines.append(("Sample time", f"{given(loop.sample_time)} s"))
        if loop.pv_range is not None:
            lines.append(("PV range", f"{given(loop.pv_range[0])} to {given(loop.pv_range[1])} EU"))
    if study.experiment is not None:
        lines.append(("Experiment", experiment_words(study)))
    if study.objective is not None:
        lines.append(("Objective J", objective_words(study.objective)))
    return lines


def experiment_words(study: Study) -> str:
    """Return the experiment in words."""
    experiment = study.experiment
    assert experiment is not None  # noqa: S101
    parts = [f"{setting(experiment.duration)} s"]
    own = experiment.primary_load_parts if isinstance(experiment, CascadeExperiment) else ()
    for name, unit, profile in (
        ("setpoint", "EU", experiment.setpoint_parts),
        ("load", "%", experiment.load_parts),
        ("primary's load", "EU of the secondary", own),
    ):
        for part in profile:
            kind = type(part).__name__.lower()
            if kind == "step":
                parts.append(f"{name} step of {given(part.size)} {unit} at {setting(part.at)} s")  # type: ignore[union-attr]
            elif kind == "ramp":
                parts.append(
                    f"{name} ramp of {given(part.size)} {unit} from {setting(part.start)} s to {setting(part.end)} s"  # type: ignore[union-attr]
                )
            else:
                parts.append(f"{name} as a given series")
    noise = experiment.noise
    if noise is not None and noise.sd > 0.0:
        parts.append(f"measurement noise of standard deviation {given(noise.sd)} EU (seed {noise.seed})")
    else:
        parts.append("no noise")
    inner = experiment.secondary_noise if isinstance(experiment, CascadeExperiment) else None
    if inner is not None and inner.sd > 0.0:
        parts.append(f"on the secondary's {given(inner.sd)} EU (seed {inner.seed})")
    if experiment.stem_offset != 0.0:
        parts.append(f"stem offset {given(experiment.stem_offset)} %")
    return ", ".join(parts)


def objective_words(weights: Objective) -> str:
    """Return the weighted sum of eq. (2), and of figures of the run, in words, without the terms of weight 0."""
    terms = []
    for weight, text in (
        (weights.w1, "Σ (SP − PV)²"),
        (weights.w2, "Σ OP²"),
        (weights.w4, "Σ (OP move)²"),
        (weights.w3, "(SP − PV)² at the end"),
    ):
        if weight > 0.0:
            terms.append(f"{given(weight)} {text}")
    words = [" + ".join(terms) + ", sums over samples"] if terms else []
    for name, weight in dict(weights.kpis).items():
        title, unit = kpi_title(name)
        words.append(f"{given(weight)} × {title}{f' ({unit})' if unit else ''}")
    return " + ".join(words)
