"""Whether OP's steps are the historian's or the controller's own: which of the two explains more of PV.

A historian rounds what it keeps; a controller with a coarse output rounds what it sends, and then the valve got just
what is recorded. The record's law of PV and SP is the same, only what the stem makes of PV tells them apart.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from workbench.estimate.data import Centred, centre
from workbench.estimate.fit import Fit, disturbance, predict
from workbench.estimate.profile import Profile
from workbench.estimate.resolution import step_of
from workbench.estimate.stems import path_of
from workbench.estimate.two_parameter import band_stem, look
from workbench.model.record import FloatArray, Record

__all__ = ["likelier_op"]

CLEAR = 10.0  # of N log V: "very strong" evidence (R. Kass, A. Raftery, J. Am. Stat. Assoc. 90 (1995) 773-795)
MATTERS = 0.05  # of the slips that may be a sample off: fewer are not worth a second search


def likelier_op(
    record: Record, data: Centred, delays: float, searched: Callable[[Centred], Profile | None]
) -> tuple[Centred, Profile | None]:
    """Return the record with OP within its steps, as `centre` has it, or as it was sent; and its profile, `searched`.

    delays: the longest dead time looked at, samples. As it was sent only where that is clearly likelier. What is not
    known of OP is nothing then, if the stem leaves noise alone; else the steps may be the historian's after all.
    """
    found = searched(data)
    if data.unsure < MATTERS:
        return data, found
    sent = centre(record, "integrating" if data.integrating else "fopdt", sent=True)
    other = searched(sent)
    (least, _), (as_sent, noise) = (_left(one, stem, delays) for one, stem in ((data, found), (sent, other)))
    if not data.samples * math.log(max(as_sent, 1e-300) / max(least, 1e-300)) < -CLEAR:
        return data, found
    return (sent if noise else replace(sent, doubt=step_of(record.op) / math.sqrt(12.0))), other


def _left(data: Centred, found: Profile | None, delays: float) -> tuple[float, bool]:
    """The least mean square that a stem leaves of PV, EU^2, and whether that is noise alone."""
    stems: list[tuple[Fit, FloatArray, int]] = []
    if found is not None:
        best = found.best
        stems.append((best.fit, path_of(data.u, best.d_low, best.first)[0], best.first))
    if bands := look(data, delays):
        b = bands[0]
        stems.append((b.fit, band_stem(data.u, b.S, b.J, b.first, b.sense)[0], max(b.first, 0)))
    if not stems:
        return data.variance, False
    fit, x, first = min(stems, key=lambda one: one[0].sse)
    left = data.y - predict(data, x, first, fit)[0]
    return max(fit.sse / data.samples, data.floor), disturbance(left, data.floor).size == 1
