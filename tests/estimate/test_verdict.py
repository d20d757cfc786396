"""The one verdict of fitted models and of detection, where they differ."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import workbench as wb
from workbench.estimate.verdict import Evidence, agree
from workbench.model.detection import StemEvidence


@pytest.fixture(scope="module")
def healthy() -> wb.Detection:
    """Detection of a loop whose valve is ideal, which acquits it."""
    loop = wb.Loop(wb.FOPDT(2.0, 8.0, 2.0), wb.Ideal(), wb.PID(Kc=0.6, Ti=10.0), 1.0)
    load = wb.Series(np.random.default_rng(0).normal(0.0, 0.5, 1000).tolist())
    moves = [wb.Step(2.0), wb.Step(-3.0, 500.0)]
    run = wb.simulate(loop, wb.Experiment(1000.0, setpoint=moves, load=load, noise=wb.Noise(0.05, 1)))
    found = wb.detect(wb.Record(run.pv, run.op, 1.0, sp=run.sp))
    assert found.verdict == "no_stiction"
    return found


def evidence(d: float, left: float) -> Evidence:
    """What a model with a stem of band d, %, that leaves a share of the linear model's residual has to say."""
    return Evidence(
        samples=1000,
        variance=1.0,
        floor=1e-6,
        linear=0.4,
        stem=0.4 * left,
        slips=20,
        d=d,
        gain=1.0,
        op_range=10.0,
        nothing=1.0,
        wide=0.4,
        two_parameter=0.4,
        bands=(d, d),
        linear_delay=0.01,
        tau=0.01,
        d_range=(d, d),
        islands=(),
        exact=True,
        at_limit=False,
        method="profile",
        iterations=0,
    )


@pytest.mark.parametrize(("share", "verdict"), [(1.1, "no_stiction"), (0.5, "undecided")])
def test_a_stem_that_detection_has_excluded_does_not_stand_against_it(
    healthy: wb.Detection, share: float, verdict: str
) -> None:
    assert healthy.test is not None
    d = share * healthy.test.wide_from
    assert agree(evidence(d, 0.8), "stiction", ("why",), healthy)[0] == verdict
    # Not where the test excludes nothing.
    open_test = replace(healthy, test=replace(healthy.test, wide=0.0))
    assert agree(evidence(d, 0.8), "stiction", ("why",), open_test)[0] == "undecided"


def test_a_stem_that_leaves_hardly_anything_prevails(healthy: wb.Detection) -> None:
    assert healthy.test is not None
    for d in (0.5 * healthy.test.wide_from, 2.0 * healthy.test.wide_from):
        assert agree(evidence(d, 0.05), "stiction", ("why",), healthy)[0] == "stiction"
        # A dozen moves of a stem are as many steps of a load that drifts: these prevail over nothing.
        few = replace(evidence(d, 0.05), slips=12)
        assert agree(few, "stiction", ("why",), healthy)[0] == "undecided"
        assert agree(few, "stiction", ("why",), replace(healthy, verdict="undecided"))[0] == "stiction"


def test_no_slip_at_all_acquits_no_valve(healthy: wb.Detection) -> None:
    assert agree(replace(evidence(math.nan, 1.0), slips=0), "undecided", ("why",), healthy)[0] == "undecided"


def test_a_valve_that_explains_most_is_not_acquitted_for_few_slips(healthy: wb.Detection) -> None:
    few = replace(evidence(0.5, 0.05), slips=2)
    assert agree(few, "undecided", ("why",), healthy)[0] == "undecided"
    # By a dead band as by a staircase; not where the linear model leaves nothing that matters, or either explains it.
    assert agree(replace(few, stem=0.4, two_parameter=0.1), "undecided", ("why",), healthy)[0] == "undecided"
    assert agree(replace(few, stem=0.3), "undecided", ("why",), healthy)[0] == "no_stiction"
    assert agree(replace(few, linear=0.04, stem=0.002), "undecided", ("why",), healthy)[0] == "no_stiction"
    # All but nothing of that little is not chance either, as long as the record resolves it.
    for little in (replace(few, linear=0.04, stem=0.0007), replace(few, linear=0.04, stem=0.04, two_parameter=0.0)):
        assert agree(little, "undecided", ("why",), healthy)[0] == "undecided"
        assert agree(replace(little, floor=0.001), "undecided", ("why",), healthy)[0] == "no_stiction"


def test_the_model_alone_does_not_accuse_where_a_wave_of_steady_period_is_clearly_likelier(
    healthy: wb.Detection,
) -> None:
    assert healthy.test is not None
    for waved, verdict in ((-31.0, "undecided"), (-29.0, "stiction")):
        open_one = replace(healthy, verdict="undecided", test=replace(healthy.test, predicting=50.0, waved=waved))
        assert agree(evidence(4.0, 0.05), "stiction", ("why",), open_one)[0] == verdict
    # Where no wave was asked for, it is as far ahead as the stem itself.
    unasked = replace(healthy, verdict="undecided", test=replace(healthy.test, predicting=-60.0, waved=-60.0))
    assert agree(evidence(4.0, 0.05), "stiction", ("why",), unasked)[0] == "stiction"


def test_the_model_alone_does_not_accuse_where_every_stem_foretells_worse_and_it_leaves_colour(
    healthy: wb.Detection,
) -> None:
    assert healthy.test is not None

    def verdict(predicting: float, colour: float, left: float = 0.4) -> tuple[str, tuple[str, ...]]:
        one = evidence(4.0, left)
        test = replace(healthy.test, predicting=predicting, waved=predicting, left=one.stem / colour)
        return agree(one, "stiction", ("why",), replace(healthy, verdict="undecided", test=test))

    final, reasons = verdict(-300.0, 5.0)
    assert final == "undecided"
    assert any("5 times what a prediction by one sample does" in reason for reason in reasons)
    # Not by chance, nor where the model leaves noise alone, or hardly anything.
    assert verdict(-29.0, 5.0)[0] == "stiction"
    assert verdict(-300.0, 1.9)[0] == "stiction"
    assert verdict(-300.0, 5.0, left=0.05)[0] == "stiction"


@pytest.mark.slow
def test_a_square_load_does_not_accuse_a_healthy_valve() -> None:
    # It was said to stick, and by how much: the dead band's turns come near to the wave's.
    wave = np.sign(np.sin(2.0 * np.pi * 5.0 * np.arange(1799) / 530.0 + 0.3))
    loop = wb.Loop(wb.FOPDT(0.603, 16.37, 2.17), wb.Ideal(), wb.PID(Kc=1.38, Ti=16.37), 5.0)
    sizes, times = (1.07, -2.38, 3.55, 2.73, -3.29), (1920.0, 3585.0, 7425.0, 7930.0, 8215.0)
    moves = [wb.Step(size, at=at) for size, at in zip(sizes, times, strict=True)]
    run = wb.simulate(loop, wb.Experiment(8995.0, moves, wb.Series((1.45 * wave).tolist()), wb.Noise(0.054, 1)))
    found = wb.estimate(wb.Record(run.pv + 50.0, np.round(run.op + 45.0, 2), 5.0, sp=run.sp + 50.0))
    assert found.verdict == "undecided"
    assert any("every stem foretells PV worse than OP itself" in reason for reason in found.reasons)
    assert not found.identifiable


def test_a_cycle_that_a_dead_band_explains_to_the_last_digit_is_not_the_linear_loops_own() -> None:
    # Of PV's 1 % that the linear loop leaves the band leaves a thousandth, in nine slips and no noise.
    loop = wb.Loop(wb.Integrating(0.0277, 0.306), wb.Deadband(0.759), wb.PID(Kc=4.0, Ti=36.1), 1.0)
    run = wb.simulate(loop, wb.Experiment(2000.0, setpoint=[wb.Step(0.129)]))
    record = wb.Record(run.pv[1000:] + 50.0, run.op[1000:] + 40.0, 1.0, sp=run.sp[1000:] + 50.0)
    assert wb.detect(record).verdict == "no_stiction"
    found = wb.estimate(record, plant="integrating")
    assert found.verdict == "undecided"
    assert isinstance(found.valve, wb.Deadband)
    assert found.valve.b == pytest.approx(0.759, rel=0.005)
    assert found.plant.gain == pytest.approx(0.0277, rel=0.005)


def test_a_recorded_stem_that_follows_op_is_doubted_where_pv_shows_one_that_sticks(healthy: wb.Detection) -> None:
    followed = replace(healthy, stem=StemEvidence(band=2.0, jump=0.0, follows=0.001, sticks=0.001))
    # Short of certainty the recorded stem stands; against certainty it may be no stem's.
    assert agree(evidence(4.0, 0.2), "stiction", ("why",), followed)[0] == "no_stiction"
    verdict, reasons = agree(evidence(4.0, 0.05), "stiction", ("why",), followed)
    assert verdict == "undecided"
    assert any("what the positioner was asked for" in reason for reason in reasons)


def test_an_op_that_is_recorded_as_the_stem_is_no_verdict_against_pv() -> None:
    loop = wb.Loop(wb.FOPDT(1.5, 10.0, 3.0), wb.Stenman(3.0), wb.PID(Kc=0.6, Ti=12.0), 1.0)
    run = wb.simulate(loop, wb.Experiment(1000.0, [wb.Step(4.0, 50.0)], noise=wb.Noise(0.05, 1)))
    record = wb.Record(run.pv + 50.0, run.op + 40.0, 1.0, sp=run.sp + 50.0)
    assert wb.estimate(record).verdict == "stiction"
    asked = wb.estimate(replace(record, valve_position=record.op))
    assert asked.verdict == "undecided"
    assert not asked.identifiable
    measured = wb.estimate(replace(record, valve_position=run.valve + 40.0))
    assert measured.verdict == "stiction"
