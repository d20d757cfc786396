"""What is said of a tuning that only a sticking valve holds, and of the room that a repaired one leaves."""

from __future__ import annotations

import workbench as wb
from workbench.analyze.standing import standing
from workbench.model.results import Intervals
from workbench.report.standing import room_words, standing_doubt

LOOP = wb.Loop(wb.FOPDT(0.64, 5.9, 2.3), wb.Choudhury(2.2, 0.9), wb.PID(2.8, 9.5), 1.0)
RANGES = Intervals(gain=(0.5, 0.8), time_constant=(4.7, 7.4), dead_time=(1.9, 2.4))


def test_a_repaired_valve_allows_more_only_where_the_loop_is_far_from_what_was_allowed() -> None:
    calm = standing(LOOP.with_controller(wb.PID(0.3, 9.5)), RANGES)
    assert calm is not None
    assert calm.worst is not None
    reached = max(calm.own.max_sensitivity, calm.worst.max_sensitivity)
    assert room_words(calm, 2.0) == (
        f"A repaired valve allows more: with an ideal valve the maximum sensitivity is {reached:.1f} at most within "
        "the plant's 95 % range, and 2.0 was allowed."
    )
    assert room_words(calm, 1.05 * reached) == ""
    tight = standing(LOOP, RANGES)
    assert room_words(tight, 2.0) == ""
    assert room_words(calm, None) == ""  # nothing was asked of the tuning
    assert room_words(standing(LOOP.with_controller(wb.PID(0.3, 9.5))), 2.0) == ""  # nor is the plant's range known
    assert room_words(None, 2.0) == ""


def test_a_place_in_the_ranges_names_what_the_plant_has() -> None:
    level = wb.Loop(wb.Integrating(0.002, 4.0), wb.Stenman(1.2), wb.PID(60.0, 300.0), 2.0)
    said = standing_doubt(standing(level, Intervals(gain=(0.0005, 0.02), dead_time=(3.0, 9.0))))
    assert said.startswith("with gain 0.0200 EU/(% s)")
    assert "time constant" not in said
    assert "–" not in said
    lag = standing_doubt(standing(LOOP, Intervals(gain=(0.5, 0.8), time_constant=(0.5, 9.0), dead_time=(1.9, 2.4))))
    assert "time constant 0.500 s" in lag
