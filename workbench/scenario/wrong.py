"""What a schema refuses, in our words: what was given, and what is allowed. One law for scenarios and manifests."""

from __future__ import annotations

from typing import Any

from workbench.errors import InvalidValue
from workbench.scenario.document import Node, nearest
from workbench.scenario.units import comma_rule, is_quantity

__all__ = ["given_words", "literals", "refusal"]

_KINDS = {
    "float_type": "must be a number",
    "float_parsing": "must be a number",
    "finite_number": "must be a finite number",
    "int_type": "must be a whole number",
    "int_from_float": "must be a whole number",
    "bool_type": "must be true or false (yes, no, on and off are text in YAML 1.2)",
    "string_type": "must be text (numbers and true/false need quotes to be text)",
    "list_type": "must be a list: [one, other], or a line with - for each",
    "dict_type": "must be a mapping",
    "model_type": "must be a mapping",
    "string_pattern_mismatch": "must not be blank",
}


def refusal(node: Node, error: Any) -> str:
    """Return one of pydantic's errors at a node in words: "9 given; must be <= 5".

    What needs the whole document to be told (a missing or unknown key) is not for here.
    """
    kind, context, given = str(error["type"]), error.get("ctx") or {}, given_words(node)
    if kind == "literal_error":
        words = literals(str(context.get("expected", "")))
        return f"{given} given{nearest(error['input'], words)}; must be one of {', '.join(words)}"
    if kind == "value_error":
        cause = context.get("error")
        return f"{given} given; {cause.allowed}" if isinstance(cause, InvalidValue) else str(cause)
    more = ""
    if _KINDS.get(kind) == "must be a number":
        more = ", without a unit" if is_quantity(error["input"]) else comma_rule(str(error["input"]))
    return f"{given} given; {_rule(kind, context, str(error['msg']))}{more}"


def given_words(node: Node) -> str:
    """Return what was given, as the file writes it."""
    if node.entries is not None:
        return "a mapping"
    if node.items is not None:
        return f"a list of {len(node.items)}"
    if node.value is None and node.text == "":
        return "nothing"
    text = node.text if node.text.isprintable() else ascii(node.text)[1:-1]
    shown = text if len(text) <= 60 else text[:57] + "..."
    return repr(shown) if not shown.strip() else shown


def _rule(kind: str, context: dict[str, Any], message: str) -> str:
    if kind in _KINDS:
        return _KINDS[kind]
    bounds = {
        "greater_than": ("gt", "must be above {}"),
        "greater_than_equal": ("ge", "must be >= {}"),
        "less_than_equal": ("le", "must be <= {}"),
        "string_too_short": ("min_length", "must not be empty"),
        "string_too_long": ("max_length", "must have at most {} characters"),
    }
    if kind in bounds:
        name, words = bounds[kind]
        return words.format(_plain_number(context.get(name)))
    if kind in ("too_short", "too_long"):
        low, high = context.get("min_length"), context.get("max_length")
        return f"must hold at least {low}" if kind == "too_short" else f"must hold at most {high}"
    return message[:1].lower() + message[1:]


def _plain_number(value: object) -> str:
    return f"{value:g}" if isinstance(value, int | float) else str(value)


def literals(expected: str) -> tuple[str, ...]:
    """Return the choices that pydantic lists as `'a', 'b' or 'c'`."""
    return tuple(expected.replace("' or '", "', '").strip("'").split("', '"))
