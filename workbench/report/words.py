"""Numbers, units and short phrases as the report prints them: significant digits, "102 s", "8.0 h", "−92 %"."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

from workbench.model.compensator import (
    Compensator,
    ConstantReinforcement,
    Dither,
    IntegralDeadband,
    Knocker,
    TwoMove,
)
from workbench.model.controller import PID
from workbench.model.karnopp import Karnopp
from workbench.model.loop import Loop
from workbench.model.numbers import ROUNDING, counted, duration, figure, given, interval, quantity, setting
from workbench.model.plant import FOPDT, Plant
from workbench.model.rule import Amigo, DetunedIntegral, Lambda, Rule, Simc, ZieglerNichols
from workbench.model.valve import Choudhury, Deadband, Directional, He, Ideal, Kano, Positional, Stenman, Valve

__all__ = [
    "ROUNDING",
    "capital",
    "change",
    "compensator_words",
    "controller_words",
    "counted",
    "decimals_of",
    "difference",
    "duration",
    "error_and_wear",
    "figure",
    "given",
    "interval",
    "join",
    "label",
    "legible",
    "lower_first",
    "nearby",
    "parameter",
    "parameter_words",
    "plant_words",
    "published",
    "quantity",
    "rule_words",
    "sentences",
    "setting",
    "slug",
    "valve_words",
]

_CONTROL = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f\ud800-\udfff\ufffe\uffff]")


def change(new: float, old: float) -> str:
    """Return how `new` differs from `old`: "−92 %", "+48 %", "6.0 times", "unchanged", "from 0 to 3.1"."""
    if math.isnan(new) or math.isnan(old):
        return "not known"
    if new == old:
        return "unchanged"
    if old == 0.0 or math.isinf(old) or math.isinf(new) or new * old < 0.0:
        return f"from {given(old)} to {given(new)}"
    ratio = new / old
    if 0.0 < ratio < 1e-6:
        return f"from {given(old)} to {given(new)}"  # one of them diverged
    if ratio >= 3.0:
        return f"{figure(ratio, 2)} times"
    percent = 100.0 * (ratio - 1.0)
    size = f"{abs(percent):.0f}" if abs(percent) >= 1.0 and not 99.0 < -percent < 100.0 else f"{abs(percent):.1f}"
    if float(size) == 0.0:
        return "unchanged"
    return f"{'−' if percent < 0 else '+'}{size} %"


def error_and_wear(error: tuple[float, float], travel: tuple[float, float]) -> str:
    """Return what a tuning makes of mean square error (EU^2) and valve travel (%), each now and before."""
    return (
        f"mean square error {figure(error[0])} EU² ({change(*error)}), valve travel {figure(travel[0])} % "
        f"({change(*travel)})"
    )


def decimals_of(values: Sequence[float]) -> int:
    """Return the decimals with which a column of published figures was printed: the most that any of them shows."""
    return max((_decimals(v) for v in values), default=0)


def _decimals(value: float) -> int:
    text = f"{value:.12g}"
    if "e" in text or "." not in text:
        return 0
    return len(text.split(".")[1])


def published(value: float, decimals: int) -> str:
    """Return a published figure as it was printed."""
    if not math.isfinite(value):
        return figure(value)
    return f"{value:,.{decimals}f}".replace("-", "−")


def difference(ours: float, theirs: float, decimals: int) -> str:
    """Return in words how our figure differs from a published one printed with `decimals` decimals.

    "to the digit" where ours rounds to the printed digits and these are two or more, or it differs by less than 2 %;
    "rounds to the published figure" where one printed digit proves less than that; else per cent, or a factor where it
    is more than 2.
    """
    if math.isnan(ours):
        return "not known here"
    if math.isinf(ours) or math.isinf(theirs):
        return "to the digit" if ours == theirs else f"{figure(ours)} here"
    printed = f"{theirs:.{decimals}f}"
    if f"{ours:.{decimals}f}" == printed:
        close = ours == theirs or abs(ours - theirs) < 0.02 * abs(theirs)
        significant = len(re.sub(r"\D", "", printed).lstrip("0"))
        return "to the digit" if close or significant >= 2 else "rounds to the published figure"
    if theirs == 0.0 or ours * theirs <= 0.0:
        return f"{figure(ours - theirs, 2)} off"
    ratio = ours / theirs
    if ratio > 2.0:
        return f"higher by a factor of {figure(ratio, 2)}"
    if ratio < 0.5:
        return f"lower by a factor of {figure(1.0 / ratio, 2)}"
    percent = abs(100.0 * (ratio - 1.0))
    return f"{percent:.0f} % {'higher' if ratio > 1.0 else 'lower'}" if percent >= 1.0 else f"{percent:.1g} % off"


def sentences(parts: Sequence[str]) -> str:
    """Return texts as sentences one after the other: each begins with a capital and ends with a full stop."""
    told = [p.strip() for p in parts if p.strip()]
    return " ".join(p[0].upper() + p[1:] + ("" if p.endswith((".", "!", "?")) else ".") for p in told)


def join(parts: Sequence[str]) -> str:
    """Return "a", "a and b", "a, b and c"."""
    if len(parts) < 2:
        return "".join(parts)
    return ", ".join(parts[:-1]) + " and " + parts[-1]


def controller_words(controller: PID, digits: int | None = None, out: str = "%") -> str:
    """Return "Kc 2.351 %/EU, Ti 9.500 s" (and Td and compensator where there are), in the controller's own form.

    out: the unit of what it puts out.
    """
    gain = {"parallel": (f"{out}/(EU s)", f"{out} s/EU")}.get(controller.form)
    parts = [f"Kc {setting(controller.Kc, digits)} {out}/EU"]
    if gain is None:
        integral = "no integral action" if math.isinf(controller.Ti) else f"Ti {setting(controller.Ti, digits)} s"
        derivative = f"Td {setting(controller.Td, digits)} s"
    else:
        integral = (
            f"1/Ti {figure(0.0 if math.isinf(controller.Ti) else 1.0 / controller.Ti, max(5, digits or 0))} {gain[0]}"
        )
        derivative = f"Td {setting(controller.Td, digits)} {gain[1]}"
    parts.append(integral)
    if controller.Td > 0.0:
        parts.append(derivative)
    if controller.compensator is not None:
        parts.append(compensator_words(controller.compensator))
    return ", ".join(parts)


def parameter(value: float, digits: int | None, *, converted: bool) -> str:
    """Return a controller's parameter; converted: what a site's digits make of it, which has no last digit itself."""
    return setting(float(f"{value:.6g}"), min(digits or 0, 6) or None) if converted else setting(value, digits)


def compensator_words(what: Compensator | None) -> str:
    """Return what a controller does about stiction besides its law, in words; "none" for nothing."""
    match what:
        case None:
            return "none"
        case IntegralDeadband():
            within = f"within ±{given(what.band)} EU"
            stops = math.isinf(what.ratio)
            return f"integral dead band {within}" if stops else f"Ti {given(what.ratio)} times as long {within}"
        case Knocker():
            a, width, period = given(what.amplitude), given(what.width), given(what.period)
            return f"knocker, {a} % for {width} s every {period} s"
        case ConstantReinforcement():
            return f"constant reinforcement, {given(what.amplitude)} %"
        case TwoMove():
            at, to = setting(what.at), given(what.steady_output)
            ends = "" if math.isinf(what.release) else f", until the error exceeds {given(what.release)} EU"
            return f"two moves at {at} s, {given(what.amplitude)} % beyond and back to OP {to} %{ends}"
        case Dither():
            return f"{what.shape} dither, {given(what.amplitude)} % every {given(what.period)} s"


def nearby(margin: float) -> str:
    """Return where the worst case of a tuning is sought, in words; `margin` is relative, as in `Tuned.margin`."""
    if margin == 0.0:
        return "within half the last digit of each setting"
    return f"within the larger of ±{given(100.0 * margin)} % and half the last digit of each setting"


def rule_words(rule: Rule) -> str:
    """Return a rule with its options in words, and its source."""
    if isinstance(rule, Simc):
        at = "equal to the dead time" if rule.tau_c is None else f"of {given(rule.tau_c)} s"
        text = f"SIMC with a closed-loop time constant {at}"
    elif isinstance(rule, Lambda):
        unit = "s" if rule.unit == "s" else "time constants"
        text = f"lambda tuning with lambda = {given(rule.value)} {unit}"
    elif isinstance(rule, Amigo):
        text = f"AMIGO, {rule.controller}"
    elif isinstance(rule, ZieglerNichols):
        method = {"step": "step response", "ultimate": "ultimate gain"}[rule.method]
        text = f"Ziegler and Nichols' {method}, {rule.controller}"
    elif isinstance(rule, DetunedIntegral):
        text = f"the integral time made {given(rule.factor)} times as long"
    else:
        text = (
            f"no crossing of the loci: Ti {given(rule.integral_ratio)} times time constant plus dead time, Kc "
            f"{given(rule.gain_margin)} times below the gain at which they meet"
        )
    return f"{text} ({rule.source})"


def valve_words(valve: Valve) -> str:
    """Return the valve's law and parameters in words."""
    if isinstance(valve, Ideal):
        return "ideal valve, no friction"
    if isinstance(valve, Stenman):
        return f"Stenman's one-parameter stiction, d = {given(valve.d)} %"
    if isinstance(valve, Choudhury):
        return f"Choudhury's two-parameter stiction, S = {given(valve.S)} %, J = {given(valve.J)} %"
    if isinstance(valve, Deadband):
        return f"dead band (backlash) of {given(valve.b)} %"
    if isinstance(valve, Kano):
        return f"Kano's two-parameter stiction, S = {given(valve.S)} %, J = {given(valve.J)} %"
    if isinstance(valve, He):
        return f"He's stiction by static and dynamic friction, f_s = {given(valve.fs)} %, f_d = {given(valve.fd)} %"
    if isinstance(valve, Directional):
        return f"stiction that differs by direction: up {valve_words(valve.up)}; down {valve_words(valve.down)}"
    if isinstance(valve, Positional):
        places = zip(valve.positions, valve.valves, strict=True)
        text = "; ".join(f"at {given(at)} % {valve_words(one)}" for at, one in places)
        return f"stiction that varies along the travel, linear between places: {text}"
    if isinstance(valve, Karnopp):
        return (
            f"a stem of {given(valve.mass)} kg on a spring of {given(valve.spring)} N/m over {given(valve.travel)} m, "
            f"Coulomb friction {given(valve.coulomb)} N, static {given(valve.static)} N, viscous "
            f"{given(valve.viscous)} N s/m, Stribeck velocity {given(valve.stribeck)} m/s (by forces alone S = "
            f"{figure(valve.stick_band)} %, J = {figure(valve.slip_jump)} %)"
        )
    return type(valve).__name__


def parameter_words(valve: Valve, plant: Plant, residual_variance: float) -> str:
    """Return a fitted model's parameters and its residual variance on one line."""
    band = {Stenman: "d", Deadband: "dead band"}.get(type(valve), "S")
    parts = [] if isinstance(valve, Ideal) else [f"{band} {figure(valve.stick_band)} %"]
    if isinstance(valve, Choudhury):
        parts.append(f"J {figure(valve.J)} %")
    parts.append(f"gain {figure(plant.gain)} {'EU/%' if isinstance(plant, FOPDT) else 'EU/(% s)'}")
    if isinstance(plant, FOPDT):
        parts.append(f"time constant {figure(plant.time_constant)} s")
    parts.append(f"dead time {figure(plant.dead_time)} s")
    return f"{', '.join(parts)}: residual variance {figure(residual_variance)} EU²"


def plant_words(plant: Plant) -> str:
    """Return the plant's kind and parameters in words."""
    if isinstance(plant, FOPDT):
        return (
            f"first order plus dead time: gain {given(plant.gain)} EU/%, time constant "
            f"{given(plant.time_constant)} s, dead time {given(plant.dead_time)} s"
        )
    return f"integrating: gain {given(plant.gain)} EU/(% s), dead time {given(plant.dead_time)} s"


def loop_words(loop: Loop) -> list[tuple[str, str]]:
    """Return what few loops have, as (what, text)."""
    lines = []
    if loop.fail_open:
        lines.append(("Action of the valve", "fail-open: a rising OP closes it; loads are in % of opening"))
    if loop.scan > 1:
        lines.append(("Controller scan", f"every {given(loop.scan * loop.sample_time)} s ({loop.scan} samples)"))
    if loop.characteristic is not None:
        R, opening = loop.characteristic.rangeability, loop.characteristic.opening
        text = f"equal percentage, rangeability {given(R)}, {given(opening)} % open at the operating point, where the"
        lines.append(("Characteristic", f"{text} plant's gain holds"))
    return lines


def legible(text: str) -> str:
    """Return text with every control character that neither HTML nor XML allows made visible as "�"."""
    return _CONTROL.sub("�", text)


def label(text: str, longest: int = 60) -> str:
    """Return a name fit for a figure: on one line, without control characters, cut to `longest` characters.

    A leading underscore is shielded, since matplotlib leaves such names out of its legends.
    """
    clean = " ".join(legible(text).split())
    if len(clean) > longest:
        clean = clean[: longest - 1] + "…"
    return "\u200b" + clean if clean.startswith("_") else clean


def slug(text: str, taken: set[str] | None = None) -> str:
    """Return a file name part of letters, digits and underscores, not yet in `taken` (to which it is added)."""
    base = re.sub(r"[^a-z0-9]+", "_", text.lower()).strip("_")[:40] or "case"
    name, count = base, 2
    while taken is not None and name in taken:
        name, count = f"{base}_{count}", count + 1
    if taken is not None:
        taken.add(name)
    return name


def capital(sentence: str) -> str:
    """Return a sentence with its first letter a capital."""
    return sentence[:1].upper() + sentence[1:]


def lower_first(sentence: str) -> str:
    """Return a sentence to stand after a colon: its first word in lower case, unless it is a name or symbol."""
    first = sentence.split(" ", 1)[0]
    return sentence[:1].lower() + sentence[1:] if first in ("The", "Both", "It", "Neither", "A", "No") else sentence
