"""How fast back-calculation may be: the law itself, run beyond what a loop accepts."""

from __future__ import annotations

import numpy as np
import pytest
from loops import paper_loop

import workbench as wb
from workbench.simulate import kernel
from workbench.simulate.coefficients import coefficients, rest

LIMITED = {"output_limits": (-0.001, 0.001), "anti_windup": "back_calculation"}


def late_swing(share: float) -> float:
    """OP's swing late in a run against a limit, as a share of its range, with Ts/Tt set in the law's own row."""
    row = coefficients(paper_loop(0.5, 20.0, **LIMITED))[0]
    row[kernel.TS_TT] = share
    n = 4000
    state, past = rest(row)
    u, x, v = np.empty(n), np.empty(n), np.empty(n)
    r = np.full(n + 1, 20.0)
    kernel.run_loop(
        row, r, np.zeros(n + 1), np.zeros(n + 1), state, past, np.empty(n + 1), u, x, v, np.empty(n, np.int8)
    )
    return float(np.ptp(u[-500:])) / 0.002


def test_the_limit_is_half_a_sample_time_by_the_law_itself() -> None:
    assert late_swing(1.0) == 0.0
    assert late_swing(1.99) == 0.0
    for share in (2.0, 2.1):
        assert late_swing(share) == 1.0, "OP is thrown from limit to limit for good"


def test_a_loop_refuses_what_the_law_cannot_hold() -> None:
    with pytest.raises(wb.InvalidValue, match=r"PID\.tracking_time: 0\.5 s given; .*half the sample time \(1 s\)"):
        paper_loop(0.5, 20.0, **LIMITED, tracking_time=0.5)
    with pytest.raises(wb.InvalidValue, match=r"PID\.tracking_time: 0\.4 s \(that of Ti\) given"):
        paper_loop(0.5, 0.4, **LIMITED)
    for kept in (
        paper_loop(0.5, 20.0, **LIMITED, tracking_time=0.51),
        paper_loop(0.5, 20.0, anti_windup="back_calculation", tracking_time=0.1),
        paper_loop(0.5, 0.4, output_limits=(-1.0, 1.0)),
    ):
        assert np.isfinite(wb.simulate(kept, wb.Experiment(50.0, wb.Step(1.0))).op).all()
