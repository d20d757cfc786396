"""The tuning rules of a scenario: `rule: simc`, or a mapping with the rule's name and options."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, PlainValidator, Tag, WithJsonSchema

from workbench.model.rule import Amigo, DetunedIntegral, Lambda, NoCrossing, Rule, Simc, ZieglerNichols
from workbench.scenario import units
from workbench.scenario.entries import Closed, Name, Number, OnlyName, PositiveTime, by_key, text_form

__all__ = ["DetunedIntegralRule", "RuleEntry", "rule_of"]

LambdaTime = Annotated[units.Quantity, PlainValidator(units.lambda_time), WithJsonSchema(text_form(units.LAMBDA_FORM))]
AboveOne = Annotated[Number, Field(gt=1)]


class SimcRule(Closed):
    """Skogestad's SIMC rule: PI."""

    name: Literal["simc"]
    tau_c: Annotated[PositiveTime | None, Field(description="closed-loop time constant (default: the dead time)")] = (
        None
    )


class LambdaRule(Closed):
    """Lambda tuning: PI."""

    name: Literal["lambda"]
    wanted: Annotated[
        LambdaTime, Field(alias="lambda", description='closed-loop time constant, such as "15 s" or "3 tau"')
    ] = units.Quantity(3.0, "tau")


class AmigoRule(Closed):
    """AMIGO."""

    name: Literal["amigo"]
    controller: Literal["PI", "PID"] = "PI"


class ZieglerNicholsRule(Closed):
    """Ziegler and Nichols: from the step response, or from the ultimate gain."""

    name: Literal["ziegler_nichols"]
    method: Literal["step", "ultimate"] = "step"
    controller: Literal["PI", "PID"] = "PI"


class DetunedIntegralRule(Closed):
    """Another case with a longer integral time."""

    name: Literal["detuned_integral"]
    base: Annotated[Name, Field(description="the case, above this one, whose integral action is detuned")]
    factor: Annotated[AboveOne, Field(description="on its Ti")] = 10.0


class NoCrossingRule(Closed):
    """The PI controller for which the describing function predicts no cycle."""

    name: Literal["no_crossing"]
    integral_ratio: Annotated[AboveOne, Field(description="Ti over time constant plus dead time")] = 2.0
    gain_margin: Annotated[AboveOne, Field(description="gain at which the loci first meet, over Kc")] = 2.0


NAMES = ("simc", "lambda", "amigo", "ziegler_nichols", "detuned_integral", "no_crossing")
RuleEntry = Annotated[
    Annotated[
        Annotated[SimcRule, Tag("<simc>")]
        | Annotated[LambdaRule, Tag("<lambda>")]
        | Annotated[AmigoRule, Tag("<amigo>")]
        | Annotated[ZieglerNicholsRule, Tag("<ziegler_nichols>")]
        | Annotated[DetunedIntegralRule, Tag("<detuned_integral>")]
        | Annotated[NoCrossingRule, Tag("<no_crossing>")],
        by_key("name", *NAMES),
    ],
    OnlyName(*NAMES),
]


def rule_of(entry: Closed) -> Rule:
    """Return the model's rule of an entry. Raises `InvalidValue`."""
    if isinstance(entry, LambdaRule):
        return Lambda(entry.wanted.value, entry.wanted.unit)
    if isinstance(entry, AmigoRule):
        return Amigo(entry.controller)
    if isinstance(entry, ZieglerNicholsRule):
        return ZieglerNichols(entry.method, entry.controller)
    if isinstance(entry, DetunedIntegralRule):
        return DetunedIntegral(entry.factor)
    if isinstance(entry, NoCrossingRule):
        return NoCrossing(entry.integral_ratio, entry.gain_margin)
    return Simc(entry.tau_c if isinstance(entry, SimcRule) else None)
