"""Colours that survive colour blindness and print, with line styles that tell the same; for any library that draws.

The palette is Okabe and Ito's ("Color Universal Design", 2008) without its yellow, which fades on white paper.
"""

from __future__ import annotations

from typing import Any

__all__ = [
    "BLACK",
    "CASES",
    "GROWS",
    "LINEAR",
    "OP",
    "PREDICTION",
    "PV",
    "SHADES",
    "SP",
    "VALVE",
    "VERMILION",
    "Style",
    "case_style",
]

Style = dict[str, Any]

BLACK, ORANGE, SKY, GREEN = "#000000", "#E69F00", "#56B4E9", "#009E73"
BLUE, VERMILION, PURPLE, GREY = "#0072B2", "#D55E00", "#CC79A7", "#767676"

PV: Style = {"color": BLUE, "linestyle": "-", "linewidth": 1.3}
SP: Style = {"color": BLACK, "linestyle": (0, (5, 2)), "linewidth": 0.9}
OP: Style = {"color": VERMILION, "linestyle": (0, (4, 1.5)), "linewidth": 1.0}
VALVE: Style = {"color": GREEN, "linestyle": "-", "linewidth": 1.4}
PREDICTION: Style = {"color": VERMILION, "linestyle": (0, (4, 1.5)), "linewidth": 1.2}
LINEAR: Style = {"color": PURPLE, "linestyle": (0, (4, 1.2, 1, 1.2)), "linewidth": 1.3}

CASES: tuple[Style, ...] = (
    {"color": BLACK, "linestyle": "-"},
    {"color": ORANGE, "linestyle": (0, (6, 2))},
    {"color": SKY, "linestyle": "-"},
    {"color": VERMILION, "linestyle": (0, (2, 1.2))},
    {"color": PURPLE, "linestyle": (0, (6, 1.5, 1.5, 1.5))},
    {"color": BLUE, "linestyle": "-"},
    {"color": GREEN, "linestyle": (0, (4, 1.2))},
    {"color": GREY, "linestyle": (0, (1, 1))},
)

# The lines of the next eight cases, which take up the colours: of each colour another line than before, and of black
# none that is taken for SP.
AGAIN: tuple[Any, ...] = (
    (0, (6, 1.5, 1.5, 1.5)),
    "-",
    (0, (4, 1.2)),
    "-",
    (0, (1, 1)),
    (0, (6, 2)),
    "-",
    (0, (4, 1.2)),
)

# Eight steps of viridis (S. van der Walt, N. Smith, matplotlib 1.5): even in lightness, so that print without colour
# keeps their order, and told apart by the colour-blind. The lightest is the least.
SHADES = ("#fde725", "#a0da39", "#4ac16d", "#1fa187", "#277f8e", "#365c8d", "#46327e", "#440154")
GROWS = "#d9d9d9"  # of a map: where the loop would be unstable with an ideal valve too


def case_style(index: int) -> Style:
    """Return colour and line style of the case in that place; after eight the colours, after 16 both begin again."""
    style = CASES[index % len(CASES)]
    return {**style, "linestyle": AGAIN[index % len(CASES)]} if index // len(CASES) % 2 else style
