"""A cycle that depends on the start is told as a range, and only what holds for every start is a claim."""

from __future__ import annotations

from loops import paper_loop, paper_step

import workbench as wb
from workbench.model.numbers import figure
from workbench.report.judge import late_figure, late_words, over_starts


def test_a_slow_loops_cycles_are_told_as_a_range_and_one_that_all_starts_share_as_a_figure():
    slow = wb.limit_cycle(paper_loop(0.5, 200.0), paper_step())
    low, high = over_starts(slow, "mean_square_error")
    assert low < 0.1 < 0.5 < high
    assert late_words(slow, "mean_square_error") == f"{figure(low, 3)} to {figure(high, 3)}"
    assert low <= late_figure(slow, "mean_square_error") <= high
    shared = wb.limit_cycle(paper_loop(2.01, 301.0), paper_step())
    ends = over_starts(shared, "travel_per_hour")
    assert ends[0] < ends[1], "the starts differ a little, and one figure is told"
    assert late_figure(shared, "travel_per_hour") == shared.travel_per_hour
    assert late_words(shared, "travel_per_hour") == figure(shared.travel_per_hour, 3)
