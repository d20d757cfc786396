"""Records that hold next to nothing of a valve: neither detection nor the estimate acquits it."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

import workbench as wb

SAMPLES = 300


def sticky(samples: int = SAMPLES) -> wb.Record:
    """A loop whose valve sticks, from its setpoint move on."""
    loop = wb.Loop(wb.FOPDT(1.0, 5.0, 1.0), wb.Stenman(2.0), wb.PID(Kc=0.5, Ti=20.0), 1.0)
    run = wb.simulate(
        loop, wb.Experiment(float(samples), setpoint=wb.Step(4.0, at=5.0), noise=wb.Noise(sd=0.05, seed=3))
    )
    return wb.Record(run.pv + 50.0, run.op + 40.0, 1.0, sp=run.sp + 50.0)


def with_op(moves: np.ndarray) -> wb.Record:
    """The same PV and SP beside an OP of 40 % that moves once."""
    record = sticky()
    return wb.Record(record.pv, 40.0 + moves, 1.0, sp=record.sp)


def beginning() -> wb.Record:
    """Thirty samples of that loop, in which the stem slips once or twice, without the setpoint."""
    record = sticky()
    return wb.Record(record.pv[:30], record.op[:30], 1.0)


AT = np.arange(SAMPLES)
RECORDS = {
    "one blip": lambda: with_op((AT == 150) * 1.0),
    "one step": lambda: with_op((AT >= 150) * 1.0),
    "thirty samples": beginning,
}


@pytest.mark.parametrize("which", RECORDS)
@pytest.mark.parametrize(
    "ask", [wb.detect, partial(wb.estimate, plant="fopdt", valve="stenman")], ids=["detect", "estimate"]
)
def test_next_to_nothing_does_not_acquit_a_valve(which: str, ask: object) -> None:
    found = ask(RECORDS[which]())
    assert found.verdict != "no_stiction"
    assert found.reasons


def test_the_whole_record_of_that_loop_is_found() -> None:
    assert wb.detect(sticky(600)).verdict == "stiction"
