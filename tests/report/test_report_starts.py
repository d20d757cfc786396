"""A cycle that depends on the start is told as a range, and only what holds for every start is a claim."""

from __future__ import annotations

from loops import paper_loop, paper_step

import workbench as wb
from workbench.report.judge import over_starts, span_words


def test_a_slow_loops_cycles_are_told_as_a_range_and_one_that_all_starts_share_as_a_figure():
    slow = wb.limit_cycle(paper_loop(0.5, 200.0), paper_step())
    low, high = over_starts(slow, "mean_square_error")
    assert low < 0.1 < 0.5 < high
    assert " to " in span_words((low, high))
    shared = over_starts(wb.limit_cycle(paper_loop(2.01, 301.0), paper_step()), "mean_square_error")
    assert " to " not in span_words(shared)
