"""Lines of stems walked side by side: each row as the plain law has it, and every sequence of slips met."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from workbench.estimate.kernels import abreast
from workbench.estimate.kernels.output_error import FIT, drive_of, oe_cost
from workbench.estimate.kernels.path import band_path, spans_of
from workbench.estimate.search.two_parameter import band_stem

WHITE = np.ones(1)
outputs = arrays(np.float64, st.integers(3, 60), elements=st.integers(-40, 40).map(lambda i: i / 8.0))


def moves(op: np.ndarray, S: float, J: float) -> tuple[int, ...]:
    return tuple(np.flatnonzero(np.diff(band_stem(op, S, J, 0, 1.0)[0])).tolist())


@settings(deadline=None, max_examples=20)
@given(op=outputs, S=st.floats(0.3, 4.0), J=st.floats(0.0, 4.0), along=st.sampled_from([0, 1]))
def test_a_walk_meets_every_sequence_of_slips_between_its_ends(op: np.ndarray, S: float, J: float, along: int) -> None:
    begin, end = (S, J)[along], (S, J)[along] + 2.0
    y = np.cumsum(op)
    # With no dead time and a sample more, every slip shows.
    op, y = np.append(op, op[-1]), np.append(y, y[-1])
    lines = np.array([[S, J, along, end, 0.0, 10.0, 0.0, 1.0, 3.0, 0.0]])
    rows = abreast.walk_bands(y, op, lines, 0.0, False, WHITE, 0, 4000)
    assert (np.diff(rows[:, along]) > 0.0).all()
    met = {moves(op, *row[:2]) for row in rows}
    tried = [(at, J) if along == 0 else (S, at) for at in np.linspace(begin, end - 1e-9, 60)]
    for width, jump in tried:
        # Where a distance of OP's is S to the last digit, rounding decides whether the stem slips.
        if moves(op, width, jump) not in met:
            assert moves(op, width * (1.0 - 1e-12), jump) != moves(op, width * (1.0 + 1e-12), jump)


def plain_cost(
    y: np.ndarray, op: np.ndarray, row: np.ndarray, line: np.ndarray, integrating: bool, a: np.ndarray, skip: int
) -> tuple[float, int]:
    """The cost of a row's stem taken alone, and its slips that PV can answer to."""
    first, sense, tau, theta = int(line[6]), line[7], line[8], line[9]
    x, drive, out = np.empty(op.size), np.empty(op.size), np.empty(FIT)
    band_path(op, spans_of(op), row[0], row[1], first, sense, x, np.empty(4))
    drive_of(x, max(first, 0), a, drive)
    cost = oe_cost(y, drive, max(first, 0), -math.inf, math.inf, 0.0, integrating, tau, theta, a, skip, out)
    until = op.size - math.floor(theta)
    return cost, band_stem(op[:until], row[0], row[1], first, sense)[1] if first < until else 1


@pytest.mark.parametrize("integrating", [False, True])
@pytest.mark.parametrize(("order", "skip"), [(0, 0), (0, 3), (3, 3), (3, 8)])
def test_rows_are_those_of_the_stems_taken_alone(integrating: bool, order: int, skip: int) -> None:
    rng = np.random.default_rng([order, skip, integrating])
    a = np.array([1.0, -0.8, 0.1, 0.05])[: order + 1]
    for many in (1, 30):
        n = int(rng.integers(60, 300))
        y, op = np.cumsum(rng.normal(0.0, 1.0, n)), np.cumsum(rng.normal(0.0, 1.0, n)).round(1)
        y, op = y - y.mean(), op - op.mean()
        high, low = np.maximum.accumulate(op), np.minimum.accumulate(op)
        firsts = [-1, 0, *(np.flatnonzero((op[1:] > high[:-1]) | (op[1:] < low[:-1])) + 1).tolist()]
        span, lines = float(np.ptp(op)), []
        for _ in range(many):
            S, along = rng.uniform(0.05, 0.8) * span, int(rng.integers(0, 2))
            J = rng.uniform(0.0, 1.2) * S * (rng.random() < 0.8)
            end = (S, J)[along] + rng.uniform(-0.02, 0.25) * span
            theta = rng.uniform(0.0, 8.0) if rng.random() < 0.5 else float(rng.integers(0, 6))
            start = (float(rng.choice(firsts)), float(rng.choice([-1.0, 1.0])))
            lines.append([S, J, along, end, 0.004 * span, 0.03 * span, *start, rng.uniform(0.3, 40.0), theta])
        table = np.array(lines)
        rows = abreast.walk_bands(y, op, table, 0.0, integrating, a, skip, 40000)
        going = [
            i
            for i, line in enumerate(table)
            if line[3] > line[int(line[2])] and band_stem(op, line[0], line[1], int(line[6]), line[7])[1] > 0
        ]
        assert sorted(set(rows[:, 4].astype(int).tolist())) == going
        for row in rows:
            cost, slips = plain_cost(y, op, row, table[int(row[4])], integrating, a, skip)
            assert row[2] == pytest.approx(cost, rel=1e-6, abs=1e-9 * float(y @ y))
            assert row[3] == slips


def test_rows_end_where_there_is_room_for_no_more() -> None:
    rng = np.random.default_rng(1)
    y, op = np.cumsum(rng.normal(0.0, 1.0, 100)), np.cumsum(rng.normal(0.0, 1.0, 100))
    lines = np.array([[0.5, 0.2, 0, 5.0, 1e-4, 1e-3, 0.0, 1.0, 3.0, 1.0]])
    assert len(abreast.walk_bands(y, op, lines, 0.0, False, WHITE, 0, 50)) == 50
