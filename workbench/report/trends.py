"""What results.json holds so that runs can be laid over each other later: the experiment, and each case's signals.

Signals are thinned to what a figure shows; figures are never computed from them.
"""

from __future__ import annotations

import hashlib
from typing import Any

import numpy as np

from workbench.model.cascade import CascadeExperiment
from workbench.model.experiment import Experiment, Profile, Ramp, Step
from workbench.model.record import FloatArray
from workbench.model.results import Run
from workbench.model.study import Study
from workbench.report.shared import experiment_words
from workbench.report.thinned import seen, thin

__all__ = ["experiment_content", "read_signal", "trends_content"]

COLUMNS = 150  # of a figure that lays runs over each other
GAP = "-"  # a value that is not finite, or beyond what is drawn


def experiment_content(study: Study) -> dict[str, Any] | None:
    """Return a study's experiment, in words and in full; of a series its samples and what tells it from others."""
    experiment = study.experiment
    if experiment is None:
        return None
    content: dict[str, Any] = {"words": experiment_words(study), "duration": experiment.duration}
    content |= {name: [_part(part) for part in parts] for name, parts in _profiles(experiment).items()}
    content["noise"] = _noise(experiment.noise)
    content["stem_offset"] = experiment.stem_offset
    if isinstance(experiment, CascadeExperiment):
        content["secondary_noise"] = _noise(experiment.secondary_noise)
    return content


def _profiles(experiment: Experiment) -> dict[str, tuple[Profile, ...]]:
    found = {"setpoint": experiment.setpoint_parts, "load": experiment.load_parts}
    if isinstance(experiment, CascadeExperiment):
        found["primary_load"] = experiment.primary_load_parts
    return found


def _part(part: Profile) -> dict[str, Any]:
    if isinstance(part, Step):
        return {"type": "step", "size": part.size, "at": part.at}
    if isinstance(part, Ramp):
        return {"type": "ramp", "size": part.size, "start": part.start, "end": part.end}
    digest = hashlib.sha256(repr((part.values, part.times)).encode()).hexdigest()[:16]
    return {"type": "series", "samples": len(part.values), "sha256": digest}


def _noise(noise: Any) -> dict[str, Any] | None:
    return None if noise is None else {"sd": noise.sd, "seed": noise.seed}


def trends_content(study: Study) -> list[dict[str, Any]]:
    """Return SP, PV and OP of every case; of a cascade those of both of its loops."""
    found = [_trend(case.name, "", case.run) for case in study.cases]
    for case in study.cascade:
        found += [_trend(case.name, part, getattr(case.run, part)) for part in ("primary", "secondary")]
    return found


def _trend(name: str, part: str, run: Run) -> dict[str, Any]:
    step = float(run.time[1] - run.time[0]) if run.time.size > 1 else run.loop.sample_time
    signals = {"sp": _held(run.sp), "pv": _signal(run.pv), "op": _signal(run.op)}
    return {"case": name, **({"loop": part} if part else {}), "sample_time": step, **signals}


def _held(signal: FloatArray) -> dict[str, str]:
    """Return a signal that mostly stands still by its changes alone, where that is shorter."""
    changes = np.flatnonzero(np.diff(signal) != 0.0) + 1
    if changes.size > COLUMNS:
        return _signal(signal)
    at = np.unique(np.concatenate(([0], changes, [signal.size - 1])))
    return _text(at.astype(np.float64), signal[at])


def _signal(signal: FloatArray) -> dict[str, str]:
    return _text(*thin(np.arange(signal.size, dtype=np.float64), seen(signal), COLUMNS))


def _text(at: FloatArray, values: FloatArray) -> dict[str, str]:
    """Return samples and their values as two texts of numbers; "0..999" stands for all samples from 0 to 999."""
    whole = at.size > 1 and bool((np.diff(at) == 1.0).all())
    places = f"{at[0]:.0f}..{at[-1]:.0f}" if whole else " ".join(f"{k:.0f}" for k in at)
    return {"at": places, "value": " ".join(f"{v:.4g}" if np.isfinite(v) else GAP for v in values.tolist())}


def read_signal(content: dict[str, str], sample_time: float) -> tuple[FloatArray, FloatArray]:
    """Return (time, s; values), each of shape (M,), of a signal's texts. Raises ValueError for anything else."""
    first, dots, last = content["at"].partition("..")
    at = np.arange(int(first), int(last) + 1) if dots else np.array([int(k) for k in content["at"].split()])
    values = np.array([float("nan") if v == GAP else float(v) for v in content["value"].split()], dtype=np.float64)
    if at.shape != values.shape or not at.size or (np.diff(at) <= 0).any():
        msg = f"{at.size} samples and {values.size} values"
        raise ValueError(msg)
    return np.asarray(at * sample_time, dtype=np.float64), values
