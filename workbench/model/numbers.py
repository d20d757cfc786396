"""How numbers are written for people: "0.4571", "1,220", "102 s"; one law for reports, notebooks and pages."""

from __future__ import annotations

import math
import re

__all__ = ["ROUNDING", "counted", "duration", "figure", "given", "interval", "quantity", "setting"]

ROUNDING = 1e-12


def figure(value: float, digits: int = 4) -> str:
    """Return a number at `digits` significant digits: "0.4571", "12.18", "1,220", "−3.1", "1.2e−7"; "–" for nan.

    Whole digits before the decimal point are never rounded away below a million. What is smaller than 1e-12 is rounding
    error in this project's units, and shown as 0.
    """
    if math.isnan(value):
        return "–"
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    if abs(value) < ROUNDING:
        return "0"
    size = abs(value)
    magnitude = math.floor(math.log10(float(f"{size:.{digits - 1}e}")))
    if magnitude < -4 or magnitude >= 6:
        mantissa, exponent = f"{size:.{digits - 1}e}".split("e")
        text = f"{mantissa}e{int(exponent)}".replace("-", "−")
    else:
        text = f"{size:,.{max(0, digits - 1 - magnitude)}f}"
    return f"−{text}" if value < 0 else text


def given(value: float, digits: int = 4) -> str:
    """Return a given (not measured) number at up to `digits` significant digits, without trailing zeros: "1", "0.5"."""
    mantissa, e, exponent = figure(value, digits).partition("e")
    return (mantissa.rstrip("0").rstrip(".") if "." in mantissa else mantissa) + e + exponent


def counted(many: int, one: str, several: str = "") -> str:
    """Return a number with what it counts: "1 loop", "1,220 loops"; several: of more, `one` with an s by default."""
    return f"{many:,} {one if many == 1 else several or f'{one}s'}"


def quantity(value: float, unit: str, digits: int = 4) -> str:
    """Return a number with its unit, "12.18 %", and nothing but "–" for nan."""
    return figure(value, digits) if math.isnan(value) else f"{figure(value, digits)} {unit}".rstrip()


def setting(value: float, digits: int | None = None) -> str:
    """Return a controller parameter with every digit that it has (at least `digits` of them), to be typed in.

    A converted parameter, such as 100/150, has no last digit: more than ten are cut to six, unless `digits` asks for
    them.
    """
    if math.isinf(value):
        return "none"
    text = f"{value:.12g}"
    if len(re.sub(r"\D", "", text.partition("e")[0]).strip("0")) > max(10, digits or 0):
        text = f"{value:.6g}"
    if digits is not None and value != 0.0 and "e" not in text:
        full = f"{value:#.{digits}g}".rstrip(".")
        if "e" not in full and float(full) == float(text) and len(full) > len(text):
            return full
    return text


def duration(seconds: float) -> str:
    """Return a time in the unit that reads best: "13.7 s", "102 s", "34 min", "8.0 h", "4.2 days"; "–" for nan."""
    if math.isnan(seconds):
        return "–"
    if math.isinf(seconds):
        return "never"
    if seconds < 600.0:
        return f"{figure(seconds, 3)} s"
    if seconds < 7200.0:
        return f"{seconds / 60.0:.0f} min"
    if seconds < 72.0 * 3600.0:
        return f"{seconds / 3600.0:.1f} h"
    return f"{seconds / 86400.0:.1f} days"


def interval(pair: tuple[float, float] | None, unit: str, digits: int = 4) -> str:
    """Return "1.99 to 2.01 %", with more digits (up to seven) where its ends would look the same; None: "not given".

    An open end is infinite: "12 s or more", "3 EU/% or less", and "open at both ends".
    """
    if pair is None:
        return "not given"
    low, high = pair
    if math.isinf(low) and math.isinf(high):
        return "open at both ends"
    if math.isinf(low) or math.isinf(high):
        end, way = (high, "less") if math.isinf(low) else (low, "more")
        return f"{f'{figure(end, digits)} {unit}'.rstrip()} or {way}"
    while digits < 7 and low != high and figure(low, digits) == figure(high, digits):
        digits += 1
    return f"{figure(low, digits)} to {figure(high, digits)} {unit}".rstrip()
