"""The valve signature: what is read from the runs is what each law's parameters say."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from loops import numbers, valves

import workbench as wb


def reads(found, dead_bands, resolutions):
    """Whether the four figures lie at most a step below these (down, up), rounding aside."""
    measured = (found.dead_band_down, found.dead_band_up, found.resolution_down, found.resolution_up)
    gaps = np.array([*dead_bands, *resolutions]) - measured
    return bool((gaps >= -1e-9).all() and (gaps <= found.step * (1.0 + 1e-9)).all())


@given(valve=valves)
def test_dead_band_is_s_and_resolution_is_j(valve):
    found = wb.signature(valve)
    if isinstance(valve, wb.Directional):
        up, down = valve.up, valve.down
        # The stem's distance behind the input one way, and the lead that it needs the other way.
        bands = [(a.S - a.J + b.S + b.J) / 2.0 for a, b in ((up, down), (down, up))]
        assert reads(found, bands, (down.J, up.J))
    else:
        assert reads(found, (valve.stick_band,) * 2, (valve.slip_jump,) * 2)
    assert found.dead_band == max(found.dead_band_down, found.dead_band_up)
    assert found.resolution == max(found.resolution_down, found.resolution_up)


@given(S=numbers(0.5, 5.0), share=numbers(0.0, 1.0), step=st.sampled_from([0.02, 0.005]))
def test_finer_steps_read_finer(S, share, step):
    found = wb.signature(wb.Choudhury(S, share * S), step=step)
    assert found.step == step
    assert reads(found, (S, S), (share * S,) * 2)
    assert np.abs(np.diff(found.ramp_op)).max() == pytest.approx(step)
    assert np.abs(np.diff(found.steps_op)).max() == pytest.approx(step)


def test_the_runs_are_the_valves_own():
    found = wb.signature(wb.Kano(3.0, 1.0))
    # Kano's first slip upward needs J; the ramp then goes up, down and up again.
    first = int(np.flatnonzero(np.diff(found.ramp_stem))[0]) + 1
    assert found.ramp_op[first - 1] <= 1.0 + 1e-9
    assert found.ramp_op[first] > 1.0 - 1e-9
    assert np.flatnonzero(np.diff(np.sign(np.diff(found.ramp_op)))).size == 2
    assert (found.ramp_op.min(), found.ramp_op.max()) == pytest.approx((-12.0, 12.0))
    # In small steps the stem rests in between, and moves by jumps of J.
    jumps = np.abs(np.diff(found.steps_stem))[-5000:]
    assert jumps[jumps > 0.1].size >= 4
    assert jumps[jumps > 0.0] == pytest.approx(np.full(np.count_nonzero(jumps), 1.0), abs=1.01 * found.step)


@pytest.mark.parametrize("valve", [wb.Ideal(), wb.Stenman(0.0), wb.He(0.0, 0.0)])
def test_a_valve_without_friction_swallows_nothing(valve):
    found = wb.signature(valve)
    np.testing.assert_array_equal(found.ramp_stem, found.ramp_op)
    assert (found.dead_band, found.resolution) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"valve": 2.0}, "signature.valve"),
        ({"valve": wb.Stenman(1.0), "step": 0.0}, "signature.step"),
        ({"valve": wb.Stenman(1.0), "step": 0.3}, "1e-05 and 0.2 %"),
        ({"valve": wb.Stenman(1.0), "step": 1e-6}, "1e-05 and 0.2 %"),
    ],
)
def test_bad_input_is_refused(arguments, words):
    with pytest.raises(wb.InvalidValue, match=words):
        wb.signature(**arguments)
