"""Numbers, units and phrases as the report prints them."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workbench.model.controller import PID
from workbench.report import words

finite = st.floats(allow_nan=False, allow_infinity=False, min_value=-1e12, max_value=1e12)


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    [
        (12.1834, 4, "12.18"),
        (0.45678, 4, "0.4568"),
        (1220.2, 4, "1,220"),
        (123456.7, 3, "123,457"),
        (9.99996, 4, "10.00"),
        (-0.17, 2, "−0.17"),
        (1.234e-7, 3, "1.23e−7"),
        (0.0, 4, "0"),
        (-3e-15, 4, "0"),
        (math.nan, 4, "–"),
        (math.inf, 4, "∞"),
    ],
)
def test_figures(value: float, digits: int, text: str) -> None:
    assert words.figure(value, digits) == text


@settings(deadline=None, max_examples=200)
@given(finite, st.integers(2, 7))
def test_a_figure_is_the_number_to_its_digits(value: float, digits: int) -> None:
    back = float(words.figure(value, digits).replace(",", "").replace("−", "-"))
    assert back == pytest.approx(value, rel=0.51 * 10.0 ** (1 - digits), abs=1e-12)


def test_given_numbers_have_no_trailing_zeros() -> None:
    assert [words.given(v) for v in (1.0, 0.5, 20.0, 1000.0, 12.345678)] == ["1", "0.5", "20", "1,000", "12.35"]


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (13.66, "13.7 s"),
        (102.4, "102 s"),
        (1800.0, "30 min"),
        (28887.0, "8.0 h"),
        (4e5, "4.6 days"),
        (math.inf, "never"),
    ],
)
def test_durations(seconds: float, text: str) -> None:
    assert words.duration(seconds) == text


@pytest.mark.parametrize(
    ("new", "old", "text"),
    [
        (0.0366, 0.4582, "−92 %"),
        (1.48, 1.0, "+48 %"),
        (6.0, 1.0, "6.0 times"),
        (1.0, 1.0, "unchanged"),
        (3.0, 0.0, "from 0 to 3"),
        (0.0004, 1.0, "−100.0 %"),
        (0.0, 1.0, "−100 %"),
        (12.0, 1e149, "from 1e149 to 12"),
        (12.0, math.inf, "from ∞ to 12"),
        (math.nan, 1.0, "not known"),
    ],
)
def test_changes(new: float, old: float, text: str) -> None:
    assert words.change(new, old) == text


@pytest.mark.parametrize(
    ("ours", "theirs", "decimals", "text"),
    [
        (12.1834, 12.18, 2, "to the digit"),
        (0.9849, 1.0, 2, "2 % lower"),
        (0.4582, 0.69, 2, "34 % lower"),
        (75.4, 449.29, 2, "lower by a factor of 6.0"),
        (237.2, 108.45, 2, "higher by a factor of 2.2"),
        (2.003, 1.99, 2, "0.7 % off"),
        (math.nan, 1.0, 0, "not known here"),
        (-1.0, 1.0, 1, "−2.0 off"),
    ],
)
def test_differences_from_published_figures(ours: float, theirs: float, decimals: int, text: str) -> None:
    assert words.difference(ours, theirs, decimals) == text


def test_a_column_is_taken_as_printed_with_its_most_decimals() -> None:
    # 1.00 reaches us as 1.0; without its column, 0.98 would count as equal to the digit.
    decimals = words.decimals_of([0.69, 1.0, 0.43])
    assert decimals == 2
    assert words.published(1.0, decimals) == "1.00"
    assert words.difference(0.98, 1.0, decimals) != "to the digit"


def test_settings_keep_every_digit() -> None:
    assert words.setting(2.351) == "2.351"
    assert words.setting(9.5, 4) == "9.500"
    assert words.setting(2.35168213, 4) == "2.35168213"
    assert words.setting(math.inf) == "none"


def test_controllers_in_their_own_form() -> None:
    assert words.controller_words(PID(2.351, 9.5), 4) == "Kc 2.351 %/EU, Ti 9.500 s"
    assert words.controller_words(PID(0.5, math.inf, 6.0)) == "Kc 0.5 %/EU, no integral action, Td 6 s"
    assert words.controller_words(PID(0.5, 40.0, form="parallel")) == "Kc 0.5 %/EU, 1/Ti 0.025000 %/(EU s)"


def test_intervals_take_digits_until_their_ends_differ() -> None:
    assert words.interval((1.99, 2.01), "%", 3) == "1.99 to 2.01 %"
    assert words.interval((1.9991, 2.0012), "%", 3) == "1.999 to 2.001 %"
    assert words.interval(None, "%") == "not given"


def test_one_of_a_thing_is_singular_and_nothing_has_no_unit() -> None:
    assert [words.counted(n, "loop") for n in (0, 1, 1220)] == ["0 loops", "1 loop", "1,220 loops"]
    assert words.counted(1, "group oscillates", "groups oscillate") == "1 group oscillates"
    assert words.quantity(12.18, "%") == "12.18 %"
    assert words.quantity(3.0, "") == "3.000"
    assert words.quantity(math.nan, "%") == "–"


def test_open_intervals_have_no_end() -> None:
    assert words.interval((12.0, math.inf), "s", 3) == "12.0 s or more"
    assert words.interval((-math.inf, -0.5), "EU/%", 3) == "−0.500 EU/% or less"
    # As read back from a file, where an open end is "none" whichever it is.
    assert words.interval((math.inf, 0.5), "", 3) == "0.500 or less"
    assert words.interval((-math.inf, math.inf), "EU/%") == "open at both ends"


def test_sentences_are_finished() -> None:
    assert words.sentences(["one thing", " Another. ", ""]) == "One thing. Another."


def test_names_for_figures() -> None:
    assert words.label("a\nb\x00") == "a b�"
    assert not words.label("_hidden").startswith("_")
    assert len(words.label("x" * 500)) == 60


@settings(deadline=None, max_examples=100)
@given(st.lists(st.text(max_size=60), max_size=8))
def test_file_names_are_plain_and_distinct(names: list[str]) -> None:
    taken: set[str] = set()
    slugs = [words.slug(n, taken) for n in names]
    assert len(set(slugs)) == len(slugs)
    assert all(s and set(s) <= set("abcdefghijklmnopqrstuvwxyz0123456789_") for s in slugs)
