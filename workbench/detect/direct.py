"""Direct evidence: where a positioner records the stem, how its moves compare with OP's."""

from __future__ import annotations

import math

import numpy as np

from workbench.detect.laws import laws_of
from workbench.model.detection import StemEvidence
from workbench.model.record import FloatArray

__all__ = ["stem_evidence"]


def _left(position: FloatArray, drive: FloatArray) -> float:
    """Share of the position's variance that a straight line through the drive leaves."""
    centred = drive - drive.mean()
    power = float(centred @ centred)
    if power <= 0.0:
        return 1.0
    moved = position - position.mean()
    return max(1.0 - float(moved @ centred) ** 2 / power / float(moved @ moved), 0.0)


def stem_evidence(op: FloatArray, position: FloatArray) -> StemEvidence | None:
    """Return what the recorded stem (% of travel, shape (N,)) says about its valve; None where OP never moves.

    follows: share of the position's variance that OP itself, a straight line through it, leaves; sticks: likewise the
    best sticking stem driven by OP, of the given band and jump (%), from the grid of the stem test.
    """
    width = float(np.ptp(op))
    if not width > 0.0:
        return None
    if not np.ptp(position) > 0.0:
        return StemEvidence(band=width, jump=0.0, follows=1.0, sticks=1.0)
    best, band, jump = math.inf, 0.0, 0.0
    for law in (law for laws in laws_of(width) for law in laws.each()):
        left = _left(position, law.path(op))
        if left < best:
            best, band, jump = left, law.band, law.valve.slip_jump
    return StemEvidence(band=band, jump=jump, follows=_left(position, op), sticks=best)
