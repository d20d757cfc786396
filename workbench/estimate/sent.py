"""Whether OP's steps are the historian's or the controller's own: which of the two explains more of PV.

A historian rounds what it keeps; a controller with a coarse output rounds what it sends, and then the valve got just
what is recorded. The record's law of PV and SP is the same, only what the stem makes of PV tells them apart.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

from workbench.estimate.fits.data import Centred, centre
from workbench.estimate.fits.fit import Fit, disturbance, predict
from workbench.estimate.search.profile import Profile
from workbench.estimate.search.stems import path_of, silent
from workbench.estimate.search.two_parameter import band_stem, look
from workbench.model.record import FloatArray, Record
from workbench.record.rounding import step_of

__all__ = ["left_by_line", "left_by_stem", "likelier_op"]

CLEAR = 10.0  # of N log V: "very strong" evidence (R. Kass, A. Raftery, J. Am. Stat. Assoc. 90 (1995) 773-795)
MATTERS = 0.05  # of the slips that may be a sample off: fewer are not worth a second search


Model = TypeVar("Model")


def likelier_op(
    record: Record,
    data: Centred,
    searched: Callable[[Centred, Callable[[float], None]], Model],
    left: Callable[[Centred, Model], tuple[float, bool]],
    tell: Callable[[float], None] = silent,
) -> tuple[Centred, Model]:
    """Return the record with OP within its steps, as `centre` has it, or as it was sent; and its model, `searched`.

    left: the mean square that a model leaves of PV, EU^2, and whether that is noise alone. tell: called with the share
    done, which `searched` tells of one record. As it was sent only where that is clearly likelier. What is not known of
    OP is nothing then, if the model leaves noise alone; else the steps may be the historian's after all.
    """
    if data.unsure < MATTERS:
        return data, searched(data, tell)
    sent = centre(record, "integrating" if data.integrating else "fopdt", sent=True)
    found = searched(data, lambda share: tell(0.5 * share))
    other = searched(sent, lambda share: tell(0.5 + 0.5 * share))
    (least, _), (as_sent, noise) = left(data, found), left(sent, other)
    if not data.samples * math.log(max(as_sent, 1e-300) / max(least, 1e-300)) < -CLEAR:
        return data, found
    return (sent if noise else replace(sent, doubt=step_of(record.op) / math.sqrt(12.0))), other


def left_by_line(data: Centred, linear: Fit) -> tuple[float, bool]:
    """Return the mean square that a linear fit leaves of PV, EU^2, and whether that is noise alone."""
    return _left(data, linear, data.u, 0)


def left_by_stem(data: Centred, found: Profile | None, delays: float) -> tuple[float, bool]:
    """Return the least mean square that a stem leaves of PV, EU^2, and whether that is noise alone.

    delays: the longest dead time looked at, samples.
    """
    stems: list[tuple[Fit, FloatArray, int]] = []
    if found is not None:
        best = found.best
        stems.append((best.fit, path_of(data.u, best.d_low, best.first)[0], best.first))
    if bands := look(data, delays):
        b = bands[0]
        stems.append((b.fit, band_stem(data.u, b.S, b.J, b.first, b.sense)[0], max(b.first, 0)))
    if not stems:
        return data.variance, False
    return _left(data, *min(stems, key=lambda one: one[0].sse))


def _left(data: Centred, fit: Fit, x: FloatArray, first: int) -> tuple[float, bool]:
    left = data.y - predict(data, x, first, fit)[0]
    return max(fit.sse / data.samples, data.floor), disturbance(left, data.floor).size == 1
