"""A controller that runs faster than the record: what slips at unrecorded peaks of OP is not excluded by that."""

from __future__ import annotations

import numpy as np
import pytest

import workbench as wb

LENGTH = 900.0  # s
MOVES = [wb.Step(12.0), wb.Step(-16.0, at=150.0), wb.Step(10.0, at=300.0), wb.Step(-14.0, at=800.0)]
WORDS = "runs faster than the record"


def recorded(valve: wb.Stenman | wb.Ideal, every: int, seed: int, moves: list[wb.Step]) -> wb.Record:
    """A noisy loop under setpoint moves, recorded each second, whose controller runs so many times in one."""
    loop = wb.Loop(wb.FOPDT(1.0, 6.0, 2.0), valve, wb.PID(1.0, 6.0), 1.0 / every)
    run = wb.simulate(loop, wb.Experiment(LENGTH, moves, noise=wb.Noise(0.3, seed)))
    pv, op, sp = (signal[::every] for signal in (run.pv, run.op, run.sp))
    return wb.Record(pv + 50.0, np.round(op + 40.0, 2), 1.0, sp=sp + 50.0)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_band_that_large_moves_hide_is_not_excluded_where_op_peaks_between_samples(seed: int) -> None:
    found = wb.detect(recorded(wb.Stenman(2.0), 10, seed, MOVES))
    assert found.verdict == "undecided"
    assert WORDS in found.reasons[0]
    assert "a record at the controller's scan would tell" in found.reasons[0]
    # That is so: recorded so, the same loop is found.
    assert wb.detect(recorded(wb.Stenman(2.0), 1, seed, MOVES)).verdict == "stiction"


@pytest.mark.parametrize("every", [1, 10])
@pytest.mark.parametrize("seed", [1, 3])
def test_a_healthy_valve_is_acquitted_all_the_same(every: int, seed: int) -> None:
    # No stem, however narrow, comes near OP itself.
    found = wb.detect(recorded(wb.Ideal(), every, seed, MOVES))
    assert found.verdict == "no_stiction"
    assert found.test is not None
    assert found.test.predicting < -30.0


def test_without_larger_moves_nothing_is_hidden() -> None:
    found = wb.detect(recorded(wb.Ideal(), 10, 1, [wb.Step(0.01)]))
    assert not any(WORDS in reason for reason in found.reasons)
