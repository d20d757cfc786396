"""Controller settings in the units of control systems: gain or proportional band; seconds, minutes, repeats a minute.

Inside, Kc is in %/EU and times are in seconds. "%/%" and the proportional band refer PV to its range.
"""

from __future__ import annotations

import math

from workbench.errors import InvalidValue
from workbench.model.checks import choice, number, ordered_pair

__all__ = ["GAIN_UNITS", "INTEGRAL_UNITS", "gain_from", "gain_to", "integral_time_from", "integral_time_to"]

GAIN_UNITS = ("%/EU", "%/%", "PB %")
INTEGRAL_UNITS = ("s", "min", "repeats/min", "repeats/s")


def _span(pv_range: tuple[float, float] | None, unit: str) -> float:
    if pv_range is None:
        raise InvalidValue("pv_range", "none", f"a PV range (low, high) is needed for a gain in {unit}")
    low, high = ordered_pair(pv_range, "pv_range")
    return high - low


def gain_from(value: float, unit: str, pv_range: tuple[float, float] | None = None) -> float:
    """Return Kc in %/EU from a gain in %/EU or %/% (of the PV range), or from a proportional band in % (100 / (%/%)).

    Raises `InvalidValue` for an unknown unit, a value that is negative (a band: not above 0), or a missing PV range.
    """
    choice(unit, "gain unit", GAIN_UNITS)
    if unit == "%/EU":
        return number(value, "Kc", least=0.0, unit="%/EU")
    span = _span(pv_range, unit)
    if unit == "%/%":
        return number(value, "Kc", least=0.0, unit="%/%") * 100.0 / span
    return 100.0 / number(value, "proportional band", above=0.0, unit="%") * 100.0 / span


def gain_to(Kc: float, unit: str, pv_range: tuple[float, float] | None = None) -> float:
    """Return a gain Kc (%/EU, >= 0) in `unit`, as `gain_from` reads it; the band of a gain of 0 is `math.inf`.

    Raises `InvalidValue` as `gain_from` does.
    """
    choice(unit, "gain unit", GAIN_UNITS)
    number(Kc, "Kc", least=0.0, unit="%/EU")
    if unit == "%/EU":
        return Kc
    per_range = Kc * _span(pv_range, unit) / 100.0
    if unit == "%/%":
        return per_range
    return 100.0 / per_range if per_range > 0.0 else math.inf


def integral_time_from(value: float, unit: str) -> float:
    """Return Ti in s from s, min, repeats/min or repeats/s (0 repeats: no integral action, `math.inf`)."""
    choice(unit, "integral unit", INTEGRAL_UNITS)
    if unit.startswith("repeats"):
        rate = number(value, f"{unit} of the integral action", least=0.0)
        return (60.0 if unit == "repeats/min" else 1.0) / rate if rate > 0.0 else math.inf
    return number(value, "Ti", above=0.0, infinite=True, unit=unit) * (60.0 if unit == "min" else 1.0)


def integral_time_to(Ti: float, unit: str) -> float:
    """Return Ti (s, > 0, `math.inf` for no integral action) in `unit`, as `integral_time_from` reads it."""
    choice(unit, "integral unit", INTEGRAL_UNITS)
    number(Ti, "Ti", above=0.0, infinite=True, unit="s")
    if unit.startswith("repeats"):
        return (60.0 if unit == "repeats/min" else 1.0) / Ti
    return Ti / (60.0 if unit == "min" else 1.0)
