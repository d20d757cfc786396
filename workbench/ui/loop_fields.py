"""The entries of a loop: plant, valve, controller. Each function gives them under a path of its own in a scenario."""

from __future__ import annotations

from dataclasses import replace

from workbench.model.controller import FORMS, STRUCTURES
from workbench.ui.entry import SECONDS, Field

__all__ = [
    "COMPENSATORS",
    "OWN_WEIGHT",
    "VALVES",
    "controller_fields",
    "element_fields",
    "of_output",
    "plant_fields",
    "valve_fields",
]

OWN_WEIGHT = "own setpoint weight"  # a structure without a name of its own
# What a valve or compensator of each type has, by its names in a scenario.
VALVES: dict[str, tuple[str, ...]] = {
    "ideal": (),
    "stenman": ("d",),
    "he": ("fs", "fd"),
    "choudhury": ("S", "J"),
    "kano": ("S", "J"),
    "deadband": ("b",),
    "directional": ("up.S", "up.J", "down.S", "down.J"),
    "positional": ("places",),
    "karnopp": ("mass", "spring", "travel", "coulomb", "static", "viscous", "stribeck", "substep"),
}
COMPENSATORS: dict[str, tuple[str, ...]] = {
    "integral_deadband": ("band", "ratio"),
    "knocker": ("amplitude", "width", "period"),
    "constant_reinforcement": ("amplitude",),
    "two_move": ("amplitude", "at", "steady_output", "release"),
    "dither": ("amplitude", "period", "shape"),
}


def plant_fields(
    path: str, gain: str = "EU/%", moved: str = "%", given: tuple[str, str, str] = ("1", "5", "1")
) -> tuple[Field, ...]:
    """Return a plant's entries. gain, moved: units of its gain and of what it is moved by; given: K, tau, theta."""
    K, tau, theta = given
    return (
        Field(
            f"{path}.type",
            "Kind",
            "fopdt",
            choices=(("fopdt", "first order plus dead time"), ("integrating", "integrating plus dead time")),
        ),
        Field(
            f"{path}.gain",
            "Gain K",
            K,
            (gain,),
            otherwise=(f"{path}.type", "integrating", f"EU/({moved} s)"),
            slider="log",
        ),
        Field(f"{path}.time_constant", "Time constant", tau, SECONDS, slider="log", when=(f"{path}.type", ("fopdt",))),
        Field(f"{path}.dead_time", "Dead time", theta, SECONDS, slider="linear", reach=5.0),
    )


def valve_fields(path: str, d: str = "2") -> tuple[Field, ...]:
    """Return a valve's entries, those of every law; d: % of the first one's."""

    def band(name: str, label: str, default: str, *types: str, hint: str = "") -> Field:
        return Field(f"{path}.{name}", label, default, ("%",), slider="log", when=(f"{path}.type", types), hint=hint)

    def of_stem(name: str, label: str, default: str, unit: str, hint: str = "") -> Field:
        when = (f"{path}.type", ("karnopp",))
        return Field(f"{path}.{name}", label, default, (unit,), slider="log", when=when, hint=hint)

    return (
        Field(
            f"{path}.type",
            "Law",
            "stenman",
            choices=(
                ("ideal", "ideal, no friction"),
                ("stenman", "Stenman (d)"),
                ("he", "He (fs, fd)"),
                ("choudhury", "Choudhury (S, J)"),
                ("kano", "Kano (S, J)"),
                ("deadband", "dead band (b)"),
                ("directional", "Choudhury, unlike directions"),
                ("positional", "stiction along the travel"),
                ("karnopp", "Karnopp, a stem with mass"),
            ),
        ),
        band("d", "Stiction d", d, "stenman"),
        band("fs", "Static friction fs", "1.5", "he"),
        band("fd", "Dynamic friction fd", "0.5", "he", hint="at most fs"),
        band("S", "Stick band S", "2", "choudhury", "kano"),
        band("J", "Slip jump J", "1", "choudhury", "kano"),
        band("b", "Full band b", "2", "deadband"),
        band("up.S", "Upward S", "2", "directional"),
        band("up.J", "Upward J", "1", "directional"),
        band("down.S", "Downward S", "3", "directional"),
        band("down.J", "Downward J", "1", "directional"),
        Field(
            f"{path}.places",
            "Places",
            "-20 3\n0 2\n20 4",
            when=(f"{path}.type", ("positional",)),
            rows=5,
            hint="a line each: stem position, d; or position, S, J; all %",
        ),
        # Kayihan and Doyle's set (`model.karnopp`).
        of_stem("mass", "Mass", "1.36", "kg"),
        of_stem("spring", "Spring", "52500", "N/m"),
        of_stem("travel", "Travel", "0.0847", "m"),
        of_stem("coulomb", "Coulomb friction", "1423", "N", hint="in motion"),
        of_stem("static", "Static friction", "1708", "N", hint="at least Coulomb's"),
        of_stem("viscous", "Viscous friction", "612", "N s/m"),
        of_stem("stribeck", "Stribeck velocity", "0.000254", "m/s"),
        Field(
            f"{path}.substep",
            "Longest step",
            "1",
            ("ms", "s"),
            when=(f"{path}.type", ("karnopp",)),
            hint="of its integration",
        ),
    )


def element_fields(path: str) -> tuple[Field, ...]:
    """Return the entries of what few loops have about the valve: `path` is the loop's."""
    curved = (f"{path}.characteristic.type", ("equal_percentage",))
    return (
        Field(
            f"{path}.characteristic.type",
            "Characteristic",
            "linear",
            choices=(("linear", "flow in proportion"), ("equal_percentage", "equal percentage")),
            more=True,
        ),
        Field(
            f"{path}.characteristic.rangeability",
            "Rangeability",
            "50",
            slider="log",
            when=curved,
            hint="needs output limits within the travel",
            more=True,
        ),
        Field(
            f"{path}.characteristic.opening",
            "Opening at rest",
            "50",
            ("%",),
            slider="linear",
            reach=100.0,
            when=curved,
            more=True,
        ),
        Field(
            f"{path}.fail_open",
            "Fail-open",
            "false",
            flag=True,
            hint="OP closes the valve; the action turns",
            more=True,
        ),
    )


def controller_fields(path: str, *, of_cascade: str = "", given: tuple[str, str] = ("0.5", "20")) -> tuple[Field, ...]:
    """Return a controller's entries. of_cascade: "primary" or "secondary", "" for a single loop's; given: Kc and Ti."""
    limited = (f"{path}.limited", ("true",))
    own = (f"{path}.structure", (OWN_WEIGHT,))
    out = "unit" if of_cascade == "primary" else "%"
    gains = (f"{out}/EU",) if of_cascade else ("%/EU", "%/%", "PB %")
    fields = (
        Field(f"{path}.Kc", "Gain Kc", given[0], gains, slider="log"),
        Field(f"{path}.Ti", "Integral time Ti", given[1], (*SECONDS, "repeats/min"), slider="log", hint="or none"),
        Field(f"{path}.Td", "Derivative time Td", "0", SECONDS, slider="linear", reach=10.0),
        Field(f"{path}.form", "Form", "ideal", choices=tuple((form, form) for form in FORMS)),
        Field(
            f"{path}.structure",
            "Structure",
            "PID on error",
            choices=tuple((name, name) for name in (*STRUCTURES, OWN_WEIGHT)),
        ),
        Field(f"{path}.derivative_on", "Derivative on", "pv", choices=(("error", "error"), ("pv", "PV")), when=own),
        Field(f"{path}.setpoint_weight", "Setpoint weight", "0.5", when=own, hint="0 to 1"),
        Field(f"{path}.derivative_filter", "Derivative filter n", "10", hint="Tf = Td/n, or none"),
        Field(
            f"{path}.action",
            "Action",
            "reverse",
            choices=(("reverse", "reverse (plant gain > 0)"), ("direct", "direct (plant gain < 0)")),
        ),
        Field(f"{path}.limited", "Output limits", "false", flag=True),
        Field(f"{path}.output_limits.low", "Lowest OP", "-50", (out,), when=limited, hint="from rest"),
        Field(f"{path}.output_limits.high", "Highest OP", "50", (out,), when=limited, hint="from rest"),
        Field(
            f"{path}.anti_windup",
            "Anti-windup",
            "clamp",
            choices=(("clamp", "clamp"), ("back_calculation", "back-calculation")),
            when=limited,
        ),
        Field(
            f"{path}.tracking_time",
            "Tracking time",
            "",
            SECONDS,
            when=limited,
            hint="of back-calculation; empty: Ti",
        ),
        Field(
            f"{path}.output_resolution",
            "Output resolution",
            "0",
            (out,),
            slider="linear",
            reach=1.0,
            hint="OP in whole multiples of it",
            more=True,
        ),
        *_compensator(f"{path}.compensator", out),
    )
    return of_output(fields)


def of_output(fields: tuple[Field, ...]) -> tuple[Field, ...]:
    """Return fields among which those in a primary's own unit are in EU of the secondary where its scale is 1."""
    return tuple(
        replace(field, otherwise=("cascade.scale", "1", field.units[0].replace("unit", "EU")))
        if field.units and field.units[0].startswith("unit")
        else field
        for field in fields
    )


def _compensator(path: str, out: str) -> tuple[Field, ...]:
    kind = f"{path}.type"

    def field(name: str, label: str, default: str, units: tuple[str, ...] = (), **also: object) -> Field:
        when = (kind, tuple(one for one, names in COMPENSATORS.items() if name in names))
        return Field(f"{path}.{name}", label, default, units, when=when, more=True, **also)  # type: ignore[arg-type]

    return (
        Field(
            kind,
            "Compensator",
            "none",
            choices=(
                ("none", "none"),
                ("integral_deadband", "integral dead band"),
                ("knocker", "knocker"),
                ("constant_reinforcement", "constant reinforcement"),
                ("two_move", "two moves"),
                ("dither", "dither"),
            ),
            hint="of stiction, besides tuning",
            more=True,
        ),
        field("band", "Band of the error", "1", ("EU",), slider="log"),
        field("ratio", "Ti within the band", "none", hint="so many times as long; none: stopped"),
        field("amplitude", "Amplitude", "2", (out,), slider="log"),
        field("width", "Pulse width", "1", SECONDS),
        field("period", "Period", "6", SECONDS, slider="linear", reach=20.0),
        field("shape", "Shape", "sine", choices=(("sine", "sine"), ("square", "square"))),
        field("at", "At", "300", SECONDS),
        field("steady_output", "Steady output", "4", (out,), slider="linear", reach=10.0, signed=True),
        field("release", "Release at an error of", "", ("EU",), hint="empty: never"),
    )
