"""Whether the figures of a run are chance: whether those of the same controller but for its last digits are others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from workbench.model.experiment import Experiment
from workbench.model.loop import Loop
from workbench.model.results import Kpis
from workbench.simulate.run import simulate

__all__ = ["by_chance"]

HAIRS = (-1e-12, -1e-13, 1e-13, 1e-12)  # of Kc: what a calculation in another order changes, or another machine
APART = 0.05  # of a figure, from which on another one is no longer the same


def by_chance(loop: Loop, experiment: Experiment, kpis: Kpis) -> tuple[Kpis, ...]:
    """Return the figures of runs whose Kc is a hair larger or smaller, none where they are those of the run, `kpis`.

    Where OP comes to rest at the very edge of the stick band, rounding decides whether the stem slips, and noise and
    feedback carry that on: the run is then one of many that the same loop may make.
    """
    pid = loop.controller
    others = []
    with np.errstate(over="ignore", invalid="ignore"):
        for hair in HAIRS:
            near = loop.with_controller(replace(pid, Kc=pid.Kc * (1.0 + hair)))
            others.append(simulate(near, experiment).kpis)
    return tuple(others) if any(_apart(one, kpis) for one in others) else ()


def _apart(one: Kpis, other: Kpis) -> bool:
    pairs = ((getattr(one, name), getattr(other, name)) for name in ("mean_square_error", "valve_travel"))
    return any(abs(a - b) > APART * abs(b) for a, b in pairs if np.isfinite(a) and np.isfinite(b))
