"""Whether OP's steps are the historian's or the controller's own: which of the two explains more of PV.

A historian rounds what it keeps; a controller with a coarse output rounds what it sends, and then the valve got just
what is recorded. The record's law of PV and SP is the same, only what the stem makes of PV tells them apart.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple, TypeVar

from workbench.estimate.fits.data import Centred, centre
from workbench.estimate.fits.fit import Fit, autoregression, predict
from workbench.estimate.search.profile import Profile
from workbench.estimate.search.stems import silent
from workbench.estimate.search.two_parameter import look
from workbench.model.record import FloatArray, Record
from workbench.record.rounding import step_of

__all__ = ["left_by_line", "left_by_stem", "likelier_op"]

CLEAR = 10.0  # of N log V: "very strong" evidence (R. Kass, A. Raftery, J. Am. Stat. Assoc. 90 (1995) 773-795)
MATTERS = 0.05  # of the slips that may be a sample off: fewer are not worth a second search


Model = TypeVar("Model")


class Left(NamedTuple):
    """What a model leaves of PV, in N log V: as if it were noise, and the BIC of it as coloured; noise: whether it is.

    A load step or a slow load, of which the models know nothing yet, is most of what they leave. Beside that a stem
    that slips at other times may make up for some of it, and leave less than the right one does, by one measure or by
    the other, but seldom by both.
    """

    white: float
    coloured: float
    noise: bool


def likelier_op(
    record: Record,
    data: Centred,
    searched: Callable[[Centred, Callable[[float], None]], Model],
    left: Callable[[Centred, Model], Left],
    tell: Callable[[float], None] = silent,
) -> tuple[Centred, Model]:
    """Return the record with OP within its steps, as `centre` has it, or as it was sent; and its model, `searched`.

    left: what a model leaves of PV. tell: called with the share done, which `searched` tells of one record. As it was
    sent only where that is clearly likelier. What is not known of OP is nothing then, if the model leaves noise alone;
    else the steps may be the historian's after all.
    """
    if data.unsure < MATTERS:
        return data, searched(data, tell)
    sent = centre(record, "integrating" if data.integrating else "fopdt", sent=True)
    found = searched(data, lambda share: tell(0.5 * share))
    other = searched(sent, lambda share: tell(0.5 + 0.5 * share))
    within, as_sent = left(data, found), left(sent, other)
    if not max(as_sent.white - within.white, as_sent.coloured - within.coloured) < -CLEAR:
        return data, found
    return (sent if as_sent.noise else replace(sent, doubt=step_of(record.op) / math.sqrt(12.0))), other


def left_by_line(data: Centred, linear: Fit) -> Left:
    """Return what a linear fit leaves of PV."""
    return _left(data, linear, data.u, 0)


def left_by_stem(data: Centred, found: Profile | None, delays: float) -> Left:
    """Return what the best stem leaves of PV.

    delays: the longest dead time looked at, samples.
    """
    stems: list[tuple[Fit, FloatArray, int]] = []
    if found is not None:
        best = found.best
        stems.append((best.fit, best.stem(data.u), best.first))
    if bands := look(data, delays):
        b = bands[0]
        stems.append((b.fit, b.stem(data.u), b.begin))
    if not stems:
        power = data.samples * math.log(max(data.variance, data.floor))
        return Left(power, power, noise=False)
    return _left(data, *min(stems, key=lambda one: one[0].sse))


def _left(data: Centred, fit: Fit, x: FloatArray, first: int) -> Left:
    a, bic = autoregression(data.y - predict(data, x, first, fit)[0], data.floor)
    return Left(data.samples * math.log(max(fit.sse / data.samples, data.floor, 1e-300)), bic, a.size == 1)
