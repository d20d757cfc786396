"""Describing function and exact verdict side by side, in one sentence."""

from __future__ import annotations

import math

from workbench.analyze.relaxation import relaxation_condition
from workbench.model.results import DescribingFunction, LimitCycle

__all__ = ["agreement"]


def agreement(df: DescribingFunction, cycle: LimitCycle) -> str:
    """Return one plain sentence: whether the describing function and the exact simulation agree, and by how much.

    Errors are those of the describing function against the exact cycle, in per cent; the PV swing is peak to peak.
    """
    predicted = math.isfinite(df.period)
    said = f"a cycle with a period of {df.period:.3g} s" if predicted else "no cycle"
    if cycle.outcome == "undecided":
        return f"The describing function predicts {said}; the exact simulation gives no verdict to compare with."
    cycling = sum(start.outcome == "cycles" for start in cycle.starts)
    if cycle.outcome == "settles":
        others = f" from this start (from {cycling} of {len(cycle.starts) - 1} others it cycles)" if cycling else ""
        if predicted:
            return f"The describing function predicts {said} that does not exist: the loop settles{others}."
        return f"Both say that the loop does not cycle{others}."
    start = " from some starts" if cycle.outcome == "depends" else ""
    if predicted:
        period = _off(df.period / cycle.period - 1.0)
        swing = _off(2.0 * df.pv_amplitude / cycle.pv_peak_to_peak - 1.0)
        return (
            f"Both say that the loop cycles{start}; the describing function's period is {period}, its PV swing {swing}."
        )
    cause = "it misses this cycle"
    if relaxation_condition(df.loop):
        cause = "a relaxation cycle, its blind spot wherever Kc K J/S < 1 and Ti > tau + theta, as here"
    return f"The describing function predicts no cycle, but the loop cycles{start}: {cause}."


def _off(error: float) -> str:
    if abs(error) < 0.005:
        return "right to 0.5 %"
    return f"{abs(100.0 * error):.0f} % too {'large' if error > 0 else 'small'}"
