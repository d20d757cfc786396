"""The entries of a tuning to be found: of a loop, and of a cascade in turn."""

from __future__ import annotations

from workbench.ui.entry import SECONDS, Field, Group
from workbench.ui.loop_fields import of_output

__all__ = ["TUNE_GROUPS"]

_TUNE = Group(
    "tune",
    "Search",
    (
        Field("tune.kind", "Controller", "PI", choices=(("PI", "PI (Td = 0)"), ("PID", "PID"))),
        Field("tune.bounds.Kc.low", "Kc from", "0", ("%/EU",)),
        Field("tune.bounds.Kc.high", "Kc to", "10", ("%/EU",)),
        Field("tune.bounds.Ti.low", "Ti from", "5", SECONDS),
        Field("tune.bounds.Ti.high", "Ti to", "600", SECONDS),
        Field("tune.bounds.Td.low", "Td from", "0", SECONDS, when=("tune.kind", ("PID",))),
        Field("tune.bounds.Td.high", "Td to", "60", SECONDS, when=("tune.kind", ("PID",))),
        Field(
            "tune.robust",
            "Robust",
            "false",
            flag=True,
            hint="over random steps, loads, noise and plants 20 % off",
        ),
        Field("tune.constraints.max_sensitivity", "Largest Ms", "", hint="empty: none (robust: 2)"),
        Field("tune.constraints.valve_travel", "Largest valve travel", "", ("%",), hint="empty: none"),
        Field("tune.digits", "Digits to type in", "4", whole=True),
        Field("tune.restarts", "Searches", "4", whole=True),
        Field("tune.seed", "Seed", "0", whole=True),
    ),
)


def _part(path: str, gain: str, given: tuple[str, str], when: tuple[str, tuple[str, ...]] | None) -> tuple[Field, ...]:
    """Return kind and bounds of one of a cascade's controllers; given: the highest Kc and Ti."""
    derived = (f"{path}.kind", ("PID",))
    kinds = (("PI", "PI (Td = 0)"), ("PID", "PID"))
    fields = (
        Field(f"{path}.kind", "Controller", "PI", choices=kinds, when=when),
        Field(f"{path}.bounds.Kc.low", "Kc from", "0.01", (gain,), when=when),
        Field(f"{path}.bounds.Kc.high", "Kc to", given[0], (gain,), when=when),
        Field(f"{path}.bounds.Ti.low", "Ti from", "1", SECONDS, when=when),
        Field(f"{path}.bounds.Ti.high", "Ti to", given[1], SECONDS, when=when),
        Field(f"{path}.bounds.Td.low", "Td from", "0", SECONDS, when=derived),
        Field(f"{path}.bounds.Td.high", "Td to", "10", SECONDS, when=derived),
    )
    return of_output(fields)


_BOTH = ("tune_cascade.tuned", ("both",))
_ALONE = "tune_cascade.secondary.experiment"
_SECONDARY = Group(
    "tune_secondary",
    "The secondary",
    (
        Field(
            "tune_cascade.tuned",
            "Tuned are",
            "both",
            choices=(("both", "the secondary, then the primary"), ("primary", "the primary alone")),
        ),
        *_part("tune_cascade.secondary", "%/EU", ("5", "100"), _BOTH),
        Field(f"{_ALONE}.duration", "Its experiment", "600", SECONDS, when=_BOTH, hint="duration"),
        Field(f"{_ALONE}.setpoint.step", "Setpoint step", "1", ("EU",), when=_BOTH, hint="of the secondary"),
        Field(f"{_ALONE}.setpoint.at", "at", "0", SECONDS, when=_BOTH),
        Field(f"{_ALONE}.load.step", "Load step", "-2", ("%",), when=_BOTH),
        Field(f"{_ALONE}.load.at", "at", "300", SECONDS, when=_BOTH),
        Field(f"{_ALONE}.noise.sd", "Noise", "0.02", ("EU",), when=_BOTH, hint="standard deviation"),
        Field(f"{_ALONE}.noise.seed", "Noise seed", "2", whole=True, when=_BOTH),
    ),
)
_PRIMARY = Group("tune_primary", "The primary over it", _part("tune_cascade.primary", "unit/EU", ("10", "600"), None))

TUNE_GROUPS = (_TUNE, _SECONDARY, _PRIMARY)
