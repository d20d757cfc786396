"""What is drawn of a valve's signature on given axes: the ramp's loop, and the small steps."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from workbench.model.analyses import Signature
from workbench.report.draw import phase, remark
from workbench.report.style import OP, SP, VALVE
from workbench.report.words import given

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["signature_ramp", "signature_steps"]

# Share of the height left free above the curves, for the remark.
HEADROOM = 0.12


def signature_ramp(ax: Axes, found: Signature) -> None:
    """Draw the stem against the slow ramp, with the line of a valve without friction, and the dead band read there."""
    ends = [float(found.ramp_op.min()), float(found.ramp_op.max())]
    ax.plot(ends, ends, label="no friction", **{**SP, "linewidth": 0.7})
    x, y = phase(found.ramp_op, found.ramp_stem)
    ax.plot(x, y, label="stem", **VALVE)
    remark(ax, _read("dead band", found.dead_band_down, found.dead_band_up, found.step))
    ax.set_xlabel("OP, slow ramp (%)")
    ax.set_ylabel("valve (%)")
    ax.margins(y=HEADROOM)
    ax.legend(loc="lower right")


def signature_steps(ax: Axes, found: Signature) -> None:
    """Draw the small steps and the stem's answer sample by sample, with the resolution read there."""
    samples = np.arange(found.steps_op.size, dtype=np.float64)
    ax.plot(samples, found.steps_stem, label="stem", drawstyle="steps-post", **VALVE)
    ax.plot(samples, found.steps_op, label="OP", drawstyle="steps-post", **OP)
    remark(ax, _read("resolution", found.resolution_down, found.resolution_up, found.step))
    ax.set_xlabel("sample")
    ax.set_ylabel("OP in small steps, valve (%)")
    ax.margins(x=0.01, y=HEADROOM)
    ax.legend(loc="lower center")


def _read(name: str, down: float, up: float, step: float) -> str:
    values = f"{given(up, 3)} %" if abs(up - down) <= step else f"{given(up, 3)} % up, {given(down, 3)} % down"
    return f"{name} {values}, in steps of {given(step, 3)} %"
