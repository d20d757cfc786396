"""What the scenario's schema is built of: closed mappings, quantities with their units, and choices among variants."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    PlainValidator,
    ValidationInfo,
    ValidatorFunctionWrapHandler,
    WithJsonSchema,
    WrapValidator,
    model_validator,
)
from pydantic_core import CoreSchema, core_schema

from workbench.errors import InvalidValue
from workbench.scenario import units

__all__ = [
    "Band",
    "BandValue",
    "Closed",
    "FileName",
    "FilterRatio",
    "GainValue",
    "IntegralRange",
    "IntegralTime",
    "Name",
    "Noise",
    "NonNegative",
    "Number",
    "OneOrMany",
    "OnlyName",
    "Percent",
    "PositiveTime",
    "Seed",
    "Size",
    "Time",
    "TrueOr",
    "Words",
    "by_key",
    "by_presence",
    "text_form",
]


def text_form(pattern: str, **also: Any) -> dict[str, Any]:
    """Return the JSON Schema of a text of this pattern, or of what `also` says."""
    return {"anyOf": [{"type": "string", "pattern": pattern}, *([also] if also else [])]}


Number = Annotated[float, Field(allow_inf_nan=False)]
NonNegative = Annotated[float, Field(allow_inf_nan=False, ge=0)]
Percent = Annotated[float, BeforeValidator(units.percent), WithJsonSchema(text_form(units.PERCENT_FORM, type="number"))]
Size = Annotated[
    units.Quantity, PlainValidator(units.size), WithJsonSchema(text_form(units.PERCENT_FORM, type="number"))
]
Band = Annotated[
    float,
    BeforeValidator(units.percent),
    Field(ge=0, le=100),
    WithJsonSchema(text_form(units.PERCENT_FORM, type="number", minimum=0, maximum=100)),
]
Time = Annotated[float, BeforeValidator(units.time), Field(ge=0), WithJsonSchema(text_form(units.TIME_FORM, const=0))]
PositiveTime = Annotated[float, BeforeValidator(units.time), Field(gt=0), WithJsonSchema(text_form(units.TIME_FORM))]
IntegralTime = Annotated[
    float, BeforeValidator(units.integral_time), Field(gt=0), WithJsonSchema(text_form(units.INTEGRAL_FORM))
]


def _integral_range(written: object, handler: ValidatorFunctionWrapHandler) -> list[float]:
    times: list[float] = handler(written)
    return units.integral_range(written, times) if isinstance(written, list) else times


IntegralRange = Annotated[list[IntegralTime], WrapValidator(_integral_range)]
GainValue = Annotated[
    units.Quantity, PlainValidator(units.gain), WithJsonSchema(text_form(units.GAIN_FORM, type="number", minimum=0))
]
BandValue = Annotated[
    units.Quantity,
    PlainValidator(units.proportional_band),
    WithJsonSchema(text_form(units.PERCENT_FORM, type="number", exclusiveMinimum=0)),
]
FilterRatio = Annotated[
    float,
    BeforeValidator(units.filter_ratio),
    Field(gt=0),
    WithJsonSchema(text_form(units.FILTER_FORM, type="number", exclusiveMinimum=0)),
]
Seed = Annotated[int, Field(ge=0)]
Name = Annotated[str, Field(min_length=1, max_length=80, pattern=r"\S")]
Words = Annotated[str, Field(max_length=4000)]
FileName = Annotated[str, Field(min_length=1, max_length=400)]


class OneOrMany:
    """Annotation of a list that may be written as its only entry."""

    @staticmethod
    def _listed(value: object) -> object:
        return value if isinstance(value, list) else [value]

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_before_validator_function(self._listed, handler(source))

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        listed = handler(schema)
        return {"anyOf": [listed["items"], listed]}


class OnlyName:
    """Annotation of a mapping that may be written as its `name` alone, where the rest has defaults."""

    def __init__(self, *names: str) -> None:
        self.names = names

    def _named(self, value: object) -> object:
        return {"name": value} if isinstance(value, str) and value in self.names else value

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_before_validator_function(self._named, handler(source))

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        return {"anyOf": [{"enum": list(self.names), "type": "string"}, handler(schema)]}


class TrueOr:
    """Annotation of a mapping that may be written as true (the mapping without entries) or false (none)."""

    def __init__(self, what: str) -> None:
        self.what = what

    def _mapped(self, value: object) -> object:
        if isinstance(value, bool):
            return {} if value else None
        if value is not None and not isinstance(value, dict):
            raise InvalidValue("", value, f"must be true, false, or a mapping ({self.what} written out)")
        return value

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_before_validator_function(self._mapped, handler(source))

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        return {"anyOf": [{"type": "boolean"}, handler(schema)]}


def _pick(tag: Callable[[dict[str, Any]], object], variants: tuple[str, ...], key: str) -> Discriminator:
    """Return the choice among variants; names in <> so that they are never taken for a key of the file."""

    def choose(data: object) -> str | None:
        name = tag(data) if isinstance(data, dict) else None
        return f"<{name}>" if name in variants else None

    return Discriminator(
        choose,
        custom_error_type="variant",
        # Read by the loader; a context would not do, as annotations have to be hashable.
        custom_error_message=f"{key}|{'|'.join(variants)}",
    )


def by_key(key: str, *variants: str) -> Discriminator:
    """Return the choice by the value of one key."""
    return _pick(lambda data: data.get(key), variants, key)


def by_presence(*variants: str) -> Discriminator:
    """Return the choice by the first of these keys that is there."""
    return _pick(lambda data: next((name for name in variants if name in data), None), variants, "")


class Closed(BaseModel):
    """Base: no unknown keys, no conversion of types, frozen."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

    @model_validator(mode="before")
    @classmethod
    def _remember(cls, data: object, info: ValidationInfo) -> object:
        # The loader names the allowed keys beside an unknown one: it finds them here, by the mapping's identity.
        if isinstance(info.context, dict) and isinstance(data, dict):
            info.context[id(data)] = tuple(field.alias or name for name, field in cls.model_fields.items())
        return data


class Noise(Closed):
    """White Gaussian measurement noise."""

    sd: Annotated[NonNegative, Field(description="standard deviation, EU")]
    seed: Seed = 0
