"""Plain data as the YAML of a scenario: short mappings on one line, texts quoted wherever they could be read otherwise.

What is typed is written as it stands where it reads as a number, a quantity or a name; anything else is quoted, so that
nothing typed can become a key, an alias or a comment.
"""

from __future__ import annotations

import json
import re

__all__ = ["Tree", "scalar", "words", "yaml_of"]

Tree = str | dict[str, "Tree"] | list["Tree"]

WIDTH = 110
_NUMBER = re.compile(r"[-+]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][-+]?[0-9]+)?(?: ?[A-Za-z%][A-Za-z%/]*)?")
_WORDS = re.compile(r"[A-Za-z][A-Za-z0-9_.()/+%-]*(?: [A-Za-z0-9_.()/+%-]+)*")
_CONSTANTS = {"null", "true", "false", "yes", "no", "on", "off", "y", "n"}


def scalar(text: str) -> str:
    """Return a typed value as a YAML scalar: plain where it reads as a number, a quantity or a word, else quoted."""
    if _NUMBER.fullmatch(text) or _WORDS.fullmatch(text):
        return text
    return _quoted(text)


def words(text: str) -> str:
    """Return a text as a YAML scalar that is read as text, whatever it holds."""
    if _WORDS.fullmatch(text) and text.casefold() not in _CONSTANTS:
        return text
    return _quoted(text)


def _quoted(text: str) -> str:
    # JSON's escapes are YAML's, and keep every character that YAML does not allow as it stands.
    return json.dumps(text, ensure_ascii=not text.isprintable())


def yaml_of(tree: dict[str, Tree]) -> str:
    """Return a tree whose leaves are YAML scalars (by `scalar` or `words`) as a document."""
    return "".join(_entry(key, value, 0) for key, value in tree.items())


def _entry(key: str, value: Tree, depth: int) -> str:
    pad = "  " * depth
    line = f"{pad}{key}: {_flow(value)}\n"
    if isinstance(value, str) or len(line) <= WIDTH or not value:
        return line
    if isinstance(value, list):
        return f"{pad}{key}:\n" + "".join(_item(one, depth + 1) for one in value)
    return f"{pad}{key}:\n" + "".join(_entry(name, one, depth + 1) for name, one in value.items())


def _item(value: Tree, depth: int) -> str:
    pad = "  " * depth
    line = f"{pad}- {_flow(value)}\n"
    if not isinstance(value, dict) or len(line) <= WIDTH:
        return line
    body = "".join(_entry(name, one, depth + 1) for name, one in value.items())
    return f"{pad}- {body[len(pad) + 2 :]}"


def _flow(value: Tree) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key}: {_flow(one)}" for key, one in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(_flow(one) for one in value) + "]"
    return value
