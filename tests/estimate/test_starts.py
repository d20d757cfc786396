"""Where a two-parameter stem may first slip, and what a record does not tell of it."""

from __future__ import annotations

import numpy as np
import pytest

import workbench as wb
from workbench.estimate.fits.data import centre
from workbench.estimate.fits.fit import LEAST_TAU, Limits
from workbench.estimate.kernels.bands import scan_starts
from workbench.estimate.search.models import bands_of
from workbench.estimate.search.sought import sought
from workbench.estimate.search.two_parameter import AT_ONCE, STARTS, best_start, look


def holds(pair: tuple[float, float] | None, value: float) -> bool:
    return pair is not None and pair[0] <= value <= pair[1]


@pytest.mark.parametrize("first", [38, 47, 90, 131, 160])
def test_the_best_of_many_first_slips_is_met(first: int) -> None:
    # OP ramps: each of its 180 samples may be the first slip's, more than are tried at first.
    op = np.concatenate([np.linspace(0.0, 20.0, 181)[1:], 20.0 - np.linspace(0.0, 20.0, 181)[1:]])
    S, J, tau, theta = 21.0, 3.0, 5.0, 4.0
    stem = np.where(np.arange(op.size) < first, -9.0, op - 9.0)
    stem[180:] = stem[179]
    pv, lag = np.zeros(op.size), stem[0]
    for k in range(op.size):
        pv[k] = lag
        lag += (1.0 - np.exp(-1.0 / tau)) * (stem[max(k - int(theta), 0)] - lag)
    data = centre(wb.Record(pv, op, 1.0), "fopdt")
    firsts, ranged, senses = data.starts
    assert firsts.size > 2 * STARTS
    able = ranged <= S + J
    starts = np.vstack([AT_ONCE, np.column_stack([firsts[able][1:], senses[able][1:]])])
    costs = np.empty(len(starts))
    scan_starts(data.target, data.u, S, J, starts, data.sign, False, tau, theta, data.a, data.skip, costs)
    least, at, sense = best_start(data, (S, J), (tau, theta))
    assert (at, sense) == (first, 1.0) == tuple(starts[np.argmin(costs)])
    assert least == costs.min()


def late(loop: wb.Loop, setpoint: list[wb.Step], sd: float, seed: int, quantum: float = 0.0) -> wb.Record:
    """1,000 samples from within the cycle."""
    run = wb.simulate(loop, wb.Experiment(2000.0, setpoint=setpoint, noise=wb.Noise(sd, seed)))
    pv = run.pv[1000:] if quantum == 0.0 else np.round(run.pv[1000:] / quantum) * quantum
    return wb.Record(pv, run.op[1000:], 1.0, sp=run.sp[1000:])


def test_a_first_slip_off_by_one_sample_is_put_right() -> None:
    # Sixteen slips on ramps alike: from a start that is off by one, stems that slip three samples later look better.
    valve, sd = wb.Choudhury(1.0768220700648368, 0.5774493464850187), 0.01379149477044848
    controller = wb.PID(Kc=0.19910479276714266, Ti=3.194365491415788)
    loop = wb.Loop(wb.FOPDT(0.8640586989972787, 3.1134077220783247, 9.591350688588323), valve, controller, 1.0)
    found = wb.estimate(late(loop, [wb.Step(1.4474691485208497)], sd, 1670737351, sd / 4.0), plant="fopdt")
    assert isinstance(found.valve, wb.Choudhury)
    assert found.valve.stick_band == pytest.approx(valve.S, rel=0.01)
    assert found.plant.dead_time == pytest.approx(9.59, abs=0.2)


def test_a_dead_band_that_op_never_turns_within_is_as_wide_as_one_likes() -> None:
    # After a setpoint move the loop comes to rest without turning back by more than any of these bands.
    loop = wb.Loop(wb.FOPDT(1.83, 12.7146, 7.89182), wb.Deadband(1.16864), wb.PID(Kc=0.375291, Ti=23.9953), 1.0)
    record = late(loop, [wb.Step(2.23888), wb.Step(-3.35833, at=1478.0)], 0.0671656, 13)
    # A search over stems with any jump that ends without one has found a dead band.
    data = centre(record, "fopdt")
    bands = bands_of(data, look(data, 30.0), sought(data, 30.0, None, False), Limits((LEAST_TAU, 1000.0), (0.0, 30.0)))
    assert bands["choudhury"].best.J == 0.0
    assert bands["deadband"].best.fit.sse <= bands["choudhury"].best.fit.sse
    assert {b.J for b in bands["deadband"].met} == {bands["deadband"].only} == {0.0}
    found = wb.estimate(record, plant="fopdt")
    assert isinstance(found.valve, wb.Deadband)
    assert not found.identifiable
    assert holds(found.intervals.S, 1.16864)
    assert found.intervals.S[1] > 1.4 * 1.16864
    assert holds(found.intervals.gain, 1.83)


def test_a_stem_that_leaves_nothing_is_not_told_in_the_measure_of_one_that_did() -> None:
    # In the colour of what a stem off by some samples leaves, one-parameter stems leave less than the record resolves.
    valve = wb.Choudhury(0.503853899293597, 0.21456942954043465)
    plant = wb.Integrating(0.010938618670586714, 8.274889361019756)
    loop = wb.Loop(plant, valve, wb.PID(Kc=3.933462810472872, Ti=92.9656393024369), 1.0)
    moves = [wb.Step(0.036538123541393235), wb.Step(-0.05480718531208985, at=1330.0)]
    found = wb.estimate(late(loop, moves, 0.0, 0), plant="integrating")
    assert isinstance(found.valve, wb.Choudhury)
    assert found.load_swing is None
    assert found.valve.stick_band == pytest.approx(valve.S, rel=0.01)
    assert found.plant.gain == pytest.approx(plant.gain, rel=0.001)
