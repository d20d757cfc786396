"""What the command prints and writes for an estimate or a tuning: lines for people, strict JSON for programs."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table
from rich.text import Text

from workbench.model.results import Complementarity, Estimate, NoiseModel, Repeats, SolveStatus, Tuned
from workbench.model.site import SiteCase
from workbench.model.study import NamedEstimate, Study
from workbench.model.valve import Ideal, Stenman
from workbench.report.content import controller_content, plant_content, valve_content, weights_content
from workbench.report.estimates import load_words
from workbench.report.figures import estimate_figure, svg_file
from workbench.report.files import write_files
from workbench.report.known import gain_doubt, strays, unpinned
from workbench.report.results import results_content, strict_json
from workbench.report.settings import beside_words, case_content, form_content, typed_words
from workbench.report.shared import objective_words
from workbench.report.style import svg_text
from workbench.report.words import controller_words, counted, figure, given, interval, nearby, plant_words, valve_words
from workbench.scenario.retune import Retuned, run_words
from workbench.score import Scored

__all__ = ["estimate_json", "estimate_lines", "exit_code", "score_parts", "tuned_json", "tuned_lines", "write_estimate"]

HINT = "a hint only"
VERDICTS = {"stiction": "the valve sticks", "no_stiction": "no stiction found", "undecided": "undecided"}


def estimate_lines(found: Estimate) -> list[str]:
    """Return model, stiction with its interval, verdict and reasons, one line each."""
    record = found.record
    first, *kept = record.summary()
    lines = [f"Record     {first}", *(f"           {note}" for note in kept)]
    lines.append(f"Model      {plant_words(found.plant)}")
    # An undecided record gives no number to rely on, whatever the fit's own interval says.
    sure = _sure(found)
    for name, unit in (("gain", ""), ("time_constant", "s"), ("dead_time", "s")):
        pair = getattr(found.intervals, name)
        if pair is not None:
            lines.append(f"           {name.replace('_', ' ')}: {interval(pair, unit)} ({sure})")
    lines.append(f"Valve      {valve_words(found.valve)}")
    lines += [f"           {line}" for line in _stiction_ranges(found)]
    if found.repeats is not None:
        first, *others = _repeats_lines(found.repeats)
        lines += [f"Parts      {first}", *(f"           {line}" for line in others)]
    stem = found.valve_position
    met = f"PV is met within {figure(found.noise_sd, 3)} EU (standard deviation)"
    if strays(found):
        met = "a prediction from it alone wanders away from PV with the load, and says nothing of the valve"
    reach = f"{figure(float(stem.min()))} to {figure(float(stem.max()))} %"
    lines.append(f"Stem       {counted(found.slips, 'move')}, {reach}; {met}")
    # Its sizes are PV's answers over the gain.
    doubt = " (sizes are a hint only, as the gain is)" if sure == HINT or gain_doubt(found) else ""
    for i, load in enumerate(load_words(found)):
        lines.append(f"{'' if i else 'Load':<10} {load}, nobody recorded it{doubt}")
    if found.noise_model is not None:
        lines.append(f"Noise      {_noise_words(found.noise_model)}")
    if found.complementarity is not None:
        lines.append(f"Program    {_program_words(found.complementarity)}")
    lines.append(f"Linear fit {plant_words(found.linear.plant)}; it ignores the stiction")
    if len(found.candidates) > 1:
        span = min(m.bic for m in found.candidates)
        for i, model in enumerate(found.candidates):
            what = f"{valve_words(model.valve)}: residual variance {figure(model.residual_variance, 3)} EU²"
            criteria = f"AIC {model.aic:.1f}, BIC {model.bic:.1f} (+{model.bic - span:.1f})"
            lines.append(f"{'Models' if i == 0 else '':<10} {what}, {criteria}")
    lines.append(f"Verdict    {VERDICTS.get(found.verdict, found.verdict)}")
    lines += [f"           {reason}" for reason in found.reasons]
    return lines


def _repeats_lines(found: Repeats) -> list[str]:
    """Return what parts of the record say by themselves, each way and over time."""
    lines = [
        f"{given(part.start, 6)} to {given(part.end, 6)} s by itself, with the same process: "
        f"{figure(part.band, 3)} % (95 %: {interval(part.interval, '%', 3)}; {counted(part.slips, 'stem move')})"
        for part in found.parts
    ]
    for what, value, pair, unit in (
        ("upward less downward", found.difference, found.difference_interval, "%"),
        ("drift", found.drift, found.drift_interval, "%/h"),
    ):
        if value is not None:
            lines.append(f"{what}: {figure(value, 2)} {unit} (95 %: {interval(pair, unit, 2)})")
    return lines


def _noise_words(noise: NoiseModel) -> str:
    """Return the disturbance that the joint refinement found."""
    what = "white" if not noise.ar else f"autoregressive, coefficients {', '.join(figure(a, 3) for a in noise.ar)}"
    text = f"{what}; one sample ahead PV is foretold within {figure(noise.innovation_sd, 3)} EU (standard deviation)"
    if noise.drift_interval is not None:
        text += f"; PV drifts by {figure(noise.drift, 3)} EU/s (95 %: {interval(noise.drift_interval, 'EU/s')})"
    return text


def _program_words(program: Complementarity) -> str:
    """Return how the complementarity program ended, and where."""
    return (
        f"{program.status.value} after {program.iterations:,} iterations, worst violation "
        f"{figure(program.residual, 2)}, worst product {figure(program.complementarity, 2)}; d = "
        f"{figure(program.d)} % and {plant_words(program.plant)}"
    )


def _stiction_ranges(found: Estimate) -> list[str]:
    if isinstance(found.valve, Ideal):
        return []
    lines = []
    names = ("d",) if isinstance(found.valve, Stenman) else ("S", "J")
    for name in names:
        pair = getattr(found.intervals, name)
        lines.append(f"{name}: {interval(pair, '%')} ({_sure(found)})" if pair is not None else f"{name}: no interval")
    if found.identifiable:
        return lines
    if found.verdict != "stiction":
        lines.append("the record does not pin the stiction (see the verdict): take these figures as a hint")
    else:
        lines.append(unpinned(found))
    return lines


def _sure(found: Estimate) -> str:
    return HINT if found.verdict == "undecided" else "95 %"


def estimate_json(found: Estimate) -> str:
    """Return the estimate as strict JSON, with the estimated stem as `valve_position` (shape (N,))."""
    study = Study("estimate", "", "", "", None, None, (NamedEstimate(found.record.source, found),), ())
    content = dict(results_content(study)["estimate"])
    for name in ("truth", "reference", "note"):
        content.pop(name, None)
    content["candidates"] = [
        {
            "valve": valve_words(m.valve),
            "plant": plant_words(m.plant),
            "residual_variance": m.residual_variance,
            "aic": m.aic,
            "bic": m.bic,
            "slips": m.slips,
        }
        for m in found.candidates
    ]
    content["valve_position"] = [float(f"{x:.6g}") for x in found.valve_position.tolist()]
    return strict_json(content)


def write_estimate(found: Estimate, folder: Path) -> list[Path]:
    """Write the figure and the signals (time, SP, PV, prediction, OP, valve_position) and return their paths.

    All are written whole, or none. Raises `OutputError`.
    """
    record = found.record
    columns: list[tuple[str, Any]] = [("time", record.time), ("PV", record.pv), ("prediction", found.prediction)]
    columns += [("OP", record.op), ("valve_position", found.valve_position)]
    if record.sp is not None:
        columns.insert(1, ("SP", record.sp))
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([name for name, _ in columns])
    for row in np.column_stack([values for _, values in columns]).tolist():
        writer.writerow([f"{value:.10g}" for value in row])
    files = {
        "estimate.svg": svg_file(svg_text(estimate_figure(found))),
        "estimate.csv": text.getvalue(),
        "estimate.json": estimate_json(found),
    }
    write_files(files, folder)
    return [folder / name for name in files]


def tuned_lines(result: Retuned) -> list[str]:
    """Return the settings to type in and how they were found, one line each."""
    tuned, site, typed = result.tuned, result.site, result.typed
    best, worst = tuned.spread
    own, pid = controller_words(tuned.controller, tuned.digits), tuned.controller
    lines = [f"{result.name}: {own}"]
    if site is not None and typed is not None:
        if typed.settings is None:
            lines[0] += f", which has no equivalent in the site's {site.form} form ({typed.refused})"
        else:
            lines = [f"{result.name}: {typed_words(site, typed.settings, tuned.digits)}"]
            lines.append(f"  found     {own} ({pid.form} form){_as_typed_in(tuned, typed)}")
            pid = typed.settings.controller
    structure = pid.structure or f"setpoint weight {pid.setpoint_weight:g}"
    lines.append(f"  model     {plant_words(tuned.loop.plant)}; {valve_words(tuned.loop.valve)}")
    lines.append(f"  form      {pid.form}, {structure}, {pid.action} action")
    lines.append(f"  weights   J = {objective_words(tuned.weights)}")
    lines.append(
        f"  J         {figure(tuned.objective, 5)} (start {figure(tuned.start_objective, 5)}; at most "
        f"{figure(tuned.worst, 5)} {nearby(tuned.margin)})"
    )
    lines.append(f"  run       {run_words(tuned)}, against the start")
    lines.append(
        f"  search    {tuned.status.value}; {counted(len(tuned.restarts), 'restart')}, J {figure(best, 5)} to "
        f"{figure(worst, 5)}, seed {tuned.seed}"
    )
    lines += [f"  assumed   {words}" for words in result.assumed]
    if tuned.message:
        lines.append(f"  note      {tuned.message}")
    return lines


def _as_typed_in(tuned: Tuned, typed: SiteCase) -> str:
    """Say what the site's digits make of J, "" where they leave it, or where J is one over an ensemble."""
    if tuned.ensemble is not None or typed.objective is None or typed.beside is None:
        return ""
    text = "" if typed.objective == tuned.objective else f"; with the site's digits J is {figure(typed.objective, 5)}"
    return text + (f".{beside_words(typed.beside, None, 'J')}" if typed.knife_edge else "")


def tuned_json(results: Sequence[Retuned]) -> str:
    """Return tunings as strict JSON: a list of controller, objective, status, search, and what the site types in."""
    content = []
    for result in results:
        tuned = result.tuned
        best, worst = tuned.spread
        content.append(
            {
                "name": result.name,
                "controller": controller_content(tuned.controller),
                "objective": tuned.objective,
                "status": tuned.status.name.lower(),
                "message": tuned.message,
                "start_objective": tuned.start_objective,
                "worst": tuned.worst,
                "margin": tuned.margin,
                "digits": tuned.digits,
                "seed": tuned.seed,
                "spread": {"best": best, "worst": worst},
                "assumed": list(result.assumed),
                "model": {"plant": plant_content(tuned.loop.plant), "valve": valve_content(tuned.loop.valve)},
                "weights": weights_content(tuned.weights),
                "site": _site_content(result),
            }
        )
    return strict_json({"tunings": content})


def _site_content(result: Retuned) -> dict[str, object] | None:
    """Return what is typed in at the site, as results.json has it; None where the scenario does not say how."""
    if result.site is None or result.typed is None:
        return None
    return form_content(result.site) | case_content(result.typed)


def score_parts(scored: Sequence[Scored], content: Mapping[str, Any]) -> list[Table | Text]:
    """Return what a score shows: the table of records, those that could not be used, confusion and accuracy."""
    table = Table(box=None, pad_edge=False)
    for title in ("file", "tag", "label", "verdict", ""):
        table.add_column(title, overflow="fold")
    for title in ("S, %", "J, %", "K", "tau, s", "theta, s", "time, s"):
        table.add_column(title, justify="right")
    for one in scored:
        right = "right" if one.verdict == one.label else "open" if one.verdict == "undecided" else "wrong"
        values = (one.S, one.J, one.gain, one.time_constant, one.dead_time)
        shown = [figure(value) if math.isfinite(value) else "" for value in values]
        table.add_row(Text(one.file), Text(one.tag), one.label, one.verdict, right, *shown, f"{one.seconds:.2f}")
    parts: list[Table | Text] = [table]
    parts += [Text(f"Not used: {one.error}") for one in scored if one.error]
    for label, verdicts in content["confusion"].items():
        counts = ", ".join(f"{verdict} {many}" for verdict, many in verdicts.items())
        parts.append(Text(f"label {label}: {counts}"))
    parts.append(
        Text(
            f"accuracy {content['accuracy']:.1%} of {counted(content['records'], 'record', 'records')}, "
            f"{content['accuracy_by_tag']:.1%} of {counted(content['tags'], 'tag', 'tags')} (undecided counts as wrong)"
        )
    )
    return parts


def exit_code(status: SolveStatus) -> int:
    """Return 0 for a success, 130 where the user interrupted, 1 otherwise."""
    if status is SolveStatus.INTERRUPTED:
        return 130
    return 0 if status.success else 1
