"""Whether stiction repeats: parts, directions and drift of simulated valves whose truth is known."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

import workbench as wb
from workbench.cli.output import estimate_lines
from workbench.estimate.fits.data import centre
from workbench.estimate.fits.fit import Fit, predict
from workbench.estimate.kernels.path import band_path, each_way_path, spans_of, stem_path
from workbench.estimate.kernels.repeat import HELD, scan_held
from workbench.estimate.repeat import repeats_of, words_of
from workbench.model.results import Estimate, Part, Repeats
from workbench.model.study import NamedEstimate, Study
from workbench.report.results import results_content, strict

PLANT = wb.FOPDT(2.0, 6.0, 1.6)


@cache
def record_of(
    up: float = 2.0,
    down: float = 2.0,
    *,
    gap: float = math.nan,
    drift: float = 0.0,
    samples: int = 1200,
    seed: int = 1,
    sd: float = 0.05,
    Ti: float = 15.0,
) -> wb.Record:
    """A loop in closed loop whose stem sticks as wide as `up` and `down`, times 1 + drift (share of the record - 1/2).

    gap nan: it slips to OP (Stenman); else its two directions are gap apart (S up and down, J = S - gap).
    """
    noise = np.random.default_rng(seed).normal(0.0, sd, samples)
    pole, m, f = math.exp(-1.0 / PLANT.time_constant), math.floor(PLANT.dead_time), PLANT.dead_time % 1.0
    part = pole ** (1.0 - f)
    integral = y = x = led = last = 0.0
    sense, moving = 1, False
    v: list[float] = [0.0] * (m + 2)
    pv, op = [], []
    for k in range(samples):
        setpoint = 5.0 * (k >= 30) - 8.0 * (k >= samples // 2)
        wide = 1.0 + drift * (k / samples - 0.5)
        e = setpoint - y - noise[k]
        integral += 0.5 / Ti * e
        u = 0.5 * e + integral
        if math.isnan(gap):
            if u - x > up * wide or x - u > down * wide:
                x = u
        else:
            if moving and (u - last) * sense > 0.0:
                led = u
            else:
                on = (u - led) * sense
                turns = -on > wide * (down if sense > 0 else up)
                moving = turns or on > wide * (up if sense > 0 else down) - gap
                sense = -sense if turns else sense
                led = u if moving else led
            x = led - sense * gap / 2.0
        last = u
        v.append(x)
        pv.append(y + noise[k] + 50.0)
        op.append(u + 40.0)
        y = pole * y + PLANT.gain * ((1.0 - part) * v[-1 - m] + (part - pole) * v[-2 - m])
    return wb.Record(np.array(pv), np.array(op), 1.0)


def parts_of(found: Estimate) -> tuple[Part, ...]:
    assert found.repeats is not None
    return found.repeats.parts


@pytest.mark.parametrize("method", ["profile", "joint"])
def test_a_constant_stiction_repeats_in_every_part(method: str) -> None:
    record = record_of()
    found = wb.estimate(record, plant="fopdt", method=method)
    parts = parts_of(found)
    assert len(parts) >= 3
    # The setpoint's first step comes early in the first part, whose own range is wide.
    assert all(p.band == pytest.approx(2.0, rel=0.02) for p in parts[1:])
    assert all(p.interval[0] <= p.band <= p.interval[1] for p in parts)
    assert all(p.interval[0] <= 2.0 + 0.02 and p.interval[1] >= 2.0 - 0.02 for p in parts)
    assert all(p.slips >= 5 for p in parts)
    assert parts[0].start >= 0.0
    assert parts[-1].end <= 1200.0
    assert all(a.end <= b.start for a, b in itertools.pairwise(parts))
    repeats = found.repeats
    assert repeats is not None
    assert repeats.drift_interval is not None
    assert repeats.difference_interval is not None
    assert repeats.drift_interval[0] <= 0.0 <= repeats.drift_interval[1]
    assert repeats.difference_interval[0] <= 0.0 <= repeats.difference_interval[1]
    assert words_of(repeats) == ()
    lines = "\n".join(estimate_lines(found))
    assert "by itself, with the same process" in lines
    assert "upward less downward: " in lines
    assert "%/h (95 %" in lines
    content = results_content(Study("s", "", "", "", None, None, (NamedEstimate("loop", found),), ()))["estimate"]
    told = strict(content)["repeats"]  # type: ignore[index,call-overload]
    assert len(told["parts"]) == len(parts)
    assert told["parts"][0]["band"] == pytest.approx(parts[0].band)


def at_the_true_plant(record: wb.Record, valve: wb.Stenman | wb.Choudhury) -> Repeats:
    """What the parts say where the plant is not in doubt."""
    found = replace(
        wb.estimate(record, plant="fopdt", method="two_step"), plant=PLANT, valve=valve, verdict="stiction", slips=60
    )
    repeats = repeats_of(centre(record, "fopdt"), found)
    assert repeats is not None
    return repeats


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_drift_of_the_stiction_is_seen(sign: float) -> None:
    repeats = at_the_true_plant(record_of(drift=0.35 * sign, samples=1500), wb.Stenman(2.0))
    truth = sign * 0.35 * 2.0 / (1500.0 / 3600.0)
    assert repeats.drift == pytest.approx(truth, rel=0.3)
    assert repeats.drift_interval is not None
    assert repeats.drift_interval[0] <= truth <= repeats.drift_interval[1]
    assert f"the stiction {'grows' if sign > 0.0 else 'falls'} over the record" in words_of(repeats)[0]


@pytest.mark.parametrize(("up", "down", "gap"), [(3.4, 2.6, math.nan), (2.6, 3.4, 1.8)])
def test_a_stem_that_sticks_one_way_more_is_seen(up: float, down: float, gap: float) -> None:
    valve = wb.Stenman(3.0) if math.isnan(gap) else wb.Choudhury(3.0, 1.2)
    repeats = at_the_true_plant(record_of(up, down, gap=gap, samples=3000, Ti=10.0, sd=0.03), valve)
    assert repeats.difference == pytest.approx(up - down, rel=0.2)
    assert repeats.difference_interval is not None
    assert repeats.difference_interval[0] <= up - down <= repeats.difference_interval[1]
    words = "more upward than downward" if up > down else "more downward than upward"
    assert any(words in reason for reason in words_of(repeats))


def test_what_matters_is_among_the_reasons() -> None:
    found = wb.estimate(record_of(drift=0.6, samples=800), valve="stenman", plant="fopdt")
    assert found.verdict == "stiction"
    assert found.repeats is not None
    assert words_of(found.repeats)
    assert found.reasons[-len(words_of(found.repeats)) :] == words_of(found.repeats)


def test_parts_that_disagree_leave_the_stick_band_open() -> None:
    # From 2.4 to 3.6 % over the record, the slip jump from 0.4 to 1.6 %: no one stem is the whole record's.
    how = {"valve": "choudhury", "plant": "fopdt"}
    found = wb.estimate(record_of(3.0, 3.0, gap=2.0, drift=0.4, samples=1400, Ti=10.0), **how)
    assert not found.identifiable
    assert any("the stick band S is not identified" in reason for reason in found.reasons)
    low, high = found.intervals.S or (math.nan, math.nan)
    assert low < 2.4 < 2.9 < high
    alike = wb.estimate(record_of(3.0, 3.0, gap=2.0, samples=1400, Ti=10.0), **how)
    low, high = alike.intervals.S or (math.nan, math.nan)
    assert 2.98 < low <= 3.0 <= high < 3.02


def test_a_dead_band_shows_no_difference_between_its_ways() -> None:
    found = wb.estimate(record_of(3.0, 3.0, gap=3.0, samples=1200, Ti=8.0), valve="deadband", plant="fopdt")
    assert isinstance(found.valve, wb.Deadband)
    assert all(math.isnan(p.up) and math.isnan(p.down) for p in parts_of(found))
    assert found.repeats is not None
    assert found.repeats.difference is None
    assert "upward less downward" not in "\n".join(estimate_lines(found))


def test_without_stiction_or_with_few_slips_nothing_is_said() -> None:
    loop = wb.Loop(PLANT, wb.Ideal(), wb.PID(Kc=0.5, Ti=20.0), 1.0)
    run = wb.simulate(loop, wb.Experiment(400.0, setpoint=wb.Step(4.0, at=20.0), noise=wb.Noise(0.05, 1)))
    record = wb.Record(run.pv, run.op, 1.0)
    assert wb.estimate(record, plant="fopdt").repeats is None
    assert wb.estimate(record, plant="fopdt", valve="linear", method="joint").repeats is None
    short = record_of(samples=100)
    found = wb.estimate(short, plant="fopdt", valve="stenman")
    assert found.slips < 16
    assert found.repeats is None or len(found.repeats.parts) == 2


def test_the_parts_of_a_long_record_are_its_active_stretches() -> None:
    found = wb.estimate(record_of(samples=9000), plant="fopdt", valve="stenman")
    parts = parts_of(found)
    assert len(parts) == 6
    assert all(p.end - p.start <= 1500.0 for p in parts)
    assert all(p.band == pytest.approx(2.0, rel=0.02) for p in parts)


def test_an_integrating_plant_is_held_too() -> None:
    loop = wb.Loop(wb.Integrating(0.05, 2.0), wb.Stenman(2.0), wb.PID(Kc=0.8, Ti=60.0), 2.0)
    steps = [wb.Step(4.0, 50.0), wb.Step(-6.0, 1500.0)]
    run = wb.simulate(loop, wb.Experiment(3000.0, setpoint=steps, noise=wb.Noise(0.03, 2)))
    found = wb.estimate(wb.Record(run.pv, run.op, 2.0), plant="integrating", valve="stenman")
    parts = parts_of(found)
    assert all(p.band == pytest.approx(2.0, rel=0.05) for p in parts)
    again = repeats_of(centre(found.record, "integrating"), found)
    assert again is not None
    assert again.parts == parts


def part(band: float, low: float, high: float, start: float = 0.0) -> Part:
    return Part(start, start + 1800.0, band, (low, high), band, band, 9)


@pytest.mark.parametrize(
    ("repeats", "words"),
    [
        (Repeats((part(2.0, 1.9, 2.1), part(3.0, 2.9, 3.1)), 0.28, None, None, None, None), "does not repeat"),
        (Repeats((part(2.0, 1.0, 4.0), part(3.0, 1.5, 4.0)), 0.28, None, None, None, None), ""),
        (Repeats((part(2.0, 1.9, 2.05), part(2.1, 2.08, 2.2)), 0.03, None, None, None, None), ""),
        (Repeats((part(2.0, 1.9, 2.1),) * 2, 0.0, None, None, -0.5, (-0.7, -0.3)), "more downward than upward"),
        (Repeats((part(2.0, 1.9, 2.1),) * 2, 0.0, None, None, -0.5, (-1.1, 0.1)), ""),
        (Repeats((part(2.0, 1.9, 2.1),) * 2, 0.0, None, None, -0.1, (-0.11, -0.09)), ""),
        (Repeats((part(2.0, 1.9, 2.1),) * 3, 0.0, 0.8, (0.2, 1.4), None, None), "grows over the record"),
        (Repeats((part(2.0, 1.9, 2.1),) * 3, 0.0, -0.8, (-1.4, -0.2), None, None), "falls over the record"),
        (Repeats((part(2.0, 1.9, 2.1),) * 3, 0.0, 0.8, (-0.2, 1.8), None, None), ""),
    ],
)
def test_only_what_matters_is_said(repeats: Repeats, words: str) -> None:
    said = words_of(repeats)
    assert len(said) == (1 if words else 0)
    assert all(words in sentence for sentence in said)


def walk(seed: int, n: int) -> np.ndarray:
    return np.cumsum(np.random.default_rng(seed).normal(0.0, 1.0, n))


@given(
    seed=st.integers(0, 999),
    n=st.integers(5, 80),
    S=st.floats(0.5, 5.0),
    share=st.floats(0.0, 1.3),
    first=st.integers(0, 4),
    sense=st.sampled_from([1.0, -1.0]),
)
def test_a_stem_alike_both_ways_is_the_known_one(
    seed: int, n: int, S: float, share: float, first: int, sense: float
) -> None:
    op = walk(seed, n)
    ours, theirs = np.empty(n), np.empty(n)
    slips = each_way_path(op, math.nan, S, S, first, sense, ours, np.empty(4))
    assert slips == stem_path(op, S, first, theirs)
    np.testing.assert_array_equal(ours, theirs)
    J = share * S
    gap = S - J
    slips = each_way_path(op, gap, J, J, first, sense, ours, np.empty(4))
    # gap + J may differ from S by one rounding.
    assert slips == band_path(op, spans_of(op), gap + J, J, first, sense, theirs, np.empty(4))
    np.testing.assert_allclose(ours, theirs, atol=1e-12)


@given(
    seed=st.integers(0, 999),
    integrating=st.booleans(),
    # Hundredths: where a dead time is all but whole, x0 shows in one sample too little to be told.
    theta=st.integers(0, 400).map(lambda hundredths: hundredths / 100.0),
    tau=st.floats(0.5, 20.0),
    gain=st.sampled_from([0.7, -2.0]),
    up=st.floats(0.5, 3.0),
    down=st.floats(0.5, 3.0),
)
def test_held_costs_are_least_squares_and_the_kernel_is_its_plain_self(
    seed: int, integrating: bool, theta: float, tau: float, gain: float, up: float, down: float
) -> None:
    n = 60
    record = wb.Record(walk(seed, n), walk(seed + 1000, n), 1.0)
    data = centre(record, "integrating" if integrating else "fopdt")
    starts, bands = np.array([[0.0, 1.0]]), np.array([[math.nan, up, down], [0.5 * up, 0.2 * up, 0.3 * up]])
    costs, found = np.empty(2), np.empty((2, HELD))
    arguments = (data.y, data.u, starts, bands, 0.02, gain, integrating, tau, theta)
    scan_held(*arguments, costs, found)
    plain, beside = np.empty(2), np.empty((2, HELD))
    scan_held.py_func(*arguments, plain, beside)
    np.testing.assert_array_equal(costs, plain)
    np.testing.assert_array_equal(found, beside)
    for band, cost, row in zip(bands, costs, found, strict=True):
        x = np.empty(n)
        each_way_path(data.u, *band, 0, 1.0, x, np.empty(4))
        fit = Fit(math.nan, tau, theta, gain, row[3], row[4], row[5])
        prediction, columns = predict(data, x, 0, fit)
        rest = columns[[0, 2, 3]].T
        terms, *_ = np.linalg.lstsq(rest, data.y - gain * columns[1], rcond=None)
        least = float(((data.y - gain * columns[1] - rest @ terms) ** 2).sum())
        assert cost == pytest.approx(least, rel=1e-6, abs=1e-6 * float(data.y @ data.y))
        assert float(((data.y - prediction) ** 2).sum()) == pytest.approx(
            cost, rel=1e-4, abs=1e-6 * float(data.y @ data.y)
        )


@given(
    seed=st.integers(0, 999),
    gap=st.one_of(st.just(math.nan), st.floats(-1.0, 2.0)),
    up=st.floats(0.5, 3.0),
    down=st.floats(0.5, 3.0),
    at=st.tuples(st.floats(0.01, 0.99), st.floats(0.01, 0.99)),
)
def test_within_its_box_a_stem_goes_the_same_way(
    seed: int, gap: float, up: float, down: float, at: tuple[float, float]
) -> None:
    assume(not gap + min(up, down) < 0.0)
    op, box = walk(seed, 70), np.empty(4)
    ours, theirs = np.empty(70), np.empty(70)
    slips = each_way_path(op, gap, up, down, 0, 1.0, ours, box)
    ends = np.clip(box, 0.0, 10.0)
    assert box[0] <= up < box[1]
    assert box[2] <= down < box[3]
    other = [low + share * (high - low) for low, high, share in zip(ends[::2], ends[1::2], at, strict=True)]
    assert each_way_path(op, gap, *other, 0, 1.0, theirs, np.empty(4)) == slips
    np.testing.assert_array_equal(ours, theirs)
    # Beyond it, it slips elsewhere.
    if math.isfinite(box[1]):
        each_way_path(op, gap, float(box[1]) * (1.0 + 1e-9) + 1e-12, down, 0, 1.0, theirs, np.empty(4))
        assert not np.array_equal(ours, theirs)
