"""Describing function and exact verdict side by side, in one sentence."""

from __future__ import annotations

from workbench.analyze.relaxation import relaxation_condition
from workbench.model.results import DescribingFunction, LimitCycle

__all__ = ["COMPARISONS", "agreement", "comparison"]

COMPARISONS = (
    "agrees",
    "misses a relaxation cycle",
    "misses a cycle",
    "predicts a cycle that does not exist",
    "no verdict",
)


def comparison(df: DescribingFunction, cycle: LimitCycle) -> str:
    """Return the class of a describing function's verdict beside the exact one, one of `COMPARISONS`.

    A loop that cycles from some starts only counts as one that cycles; crossings that are all unstable predict none.
    """
    if cycle.outcome == "undecided":
        return "no verdict"
    predicted, cycles = df.prediction == "cycle", cycle.outcome in ("cycles", "depends")
    if predicted == cycles:
        return "agrees"
    if predicted:
        return "predicts a cycle that does not exist"
    return "misses a relaxation cycle" if relaxation_condition(df.loop) else "misses a cycle"


def agreement(df: DescribingFunction, cycle: LimitCycle) -> str:
    """Return what the describing function and the exact simulation say together: whether they agree, and by how much.

    Errors are those of the describing function against the exact cycle, in per cent; the PV swing is peak to peak.
    Where the loop would be unstable with an ideal valve too, a second sentence says that the valve is not alone to
    blame for the cycle.
    """
    text = _compared(df, cycle)
    if cycle.outcome in ("cycles", "depends") and not df.linear_stable:
        text += " The loop would be unstable with an ideal valve too, so the cycle is not the valve's alone."
    return text


def _compared(df: DescribingFunction, cycle: LimitCycle) -> str:
    unstable = "The loci cross only where a cycle would not last"
    told = {
        "cycle": f"The describing function predicts a cycle with a period of {_time(df.period)}",
        "no cycle": "The describing function predicts no cycle",
    }.get(df.prediction, unstable)
    kind = comparison(df, cycle)
    if kind == "no verdict":
        if cycle.grows:
            return f"{told}; by exact simulation PV grows without bound."
        return f"{told}; the exact simulation gives no verdict to compare with."
    if cycle.outcome == "settles":
        return _settled(df, cycle, told)
    start = " from some starts" if cycle.outcome == "depends" else ""
    if kind == "agrees":
        period = _off(df.period / cycle.period - 1.0)
        swing = _off(2.0 * df.pv_amplitude / cycle.pv_peak_to_peak - 1.0)
        return (
            f"Both say that the loop cycles{start}; the describing function's period is {period}, its PV swing {swing}."
        )
    if df.prediction != "no cycle":
        return (
            f"{unstable}, so the describing function gives no period; by exact simulation the loop cycles{start}, with "
            f"a period of {_time(cycle.period)}."
        )
    if kind == "misses a relaxation cycle":
        cause = "a relaxation cycle, its blind spot wherever Kc K J/S < 1 and Ti > tau + theta, as here"
        return f"{told}, but the loop cycles{start}: {cause}."
    return f"{told}, but by exact simulation the loop cycles{start}, with a period of {_time(cycle.period)}."


def _settled(df: DescribingFunction, cycle: LimitCycle, told: str) -> str:
    """The sentence for a loop that settles from the start that decides; `told`: what the describing function says."""
    cycling = sum(start.outcome == "cycles" for start in cycle.starts)
    if cycling:
        contrast = "and" if df.prediction == "no cycle" else "but"
        return (
            f"{told}, {contrast} from this start the loop settles; "
            f"from {cycling} of {len(cycle.starts) - 1} others it cycles."
        )
    if df.prediction == "cycle":
        return f"{told} that does not exist: the loop settles."
    if df.prediction != "no cycle":
        return f"{told}: swings smaller than that should die out, and by exact simulation the loop settles."
    return "Both say that the loop does not cycle."


def _time(seconds: float) -> str:
    """A time in the unit that reads best."""
    for limit, unit, name, form in (
        (600.0, 1.0, "s", ".3g"),
        (7200.0, 60.0, "min", ".0f"),
        (259200.0, 3600.0, "h", ".1f"),
    ):
        if seconds < limit:
            return f"{seconds / unit:{form}} {name}"
    return f"{seconds / 86400.0:.1f} days"


def _off(error: float) -> str:
    if abs(error) < 0.005:
        return "right to 0.5 %"
    return f"{abs(100.0 * error):.0f} % too {'large' if error > 0 else 'small'}"
