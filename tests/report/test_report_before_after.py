"""Before and after, as the paper's Tables III and IV: figures, changes, and the published ones beside them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from workbench.model.study import CaseResult, Study
from workbench.report.before_after import before_after_table
from workbench.report.tables import difference_table

Make = Callable[..., Any]
TABLE_III = (
    {"pv_sd": 336.0, "controller_travel": 250.0, "settling_time": 14400.0, "oscillation_index": 0.84},
    {"pv_sd": 90.0, "controller_travel": 86.0, "settling_time": 135.0, "oscillation_index": 0.4},
)


def measured(case: CaseResult, **kpis: float) -> CaseResult:
    return replace(case, run=replace(case.run, kpis=replace(case.run.kpis, **kpis)))


def two(study: Study) -> Study:
    before = measured(study.cases[0], pv_sd=2.0, controller_travel=50.0, settling_time=800.0, oscillation_index=0.8)
    after = measured(study.cases[1], pv_sd=0.5, controller_travel=20.0, settling_time=90.0, oscillation_index=0.4)
    cases = [replace(case, reference=theirs) for case, theirs in zip((before, after), TABLE_III, strict=True)]
    still = [replace(case, limit_cycle=None) for case in cases]
    return replace(study, cases=(*still, study.cases[2]), estimates=())


def test_the_papers_layout_with_its_changes(study: Study) -> None:
    table = before_after_table(two(study))
    assert table is not None
    assert table.heads == ("Case 1", "Case 2", "change", "Optimised PI", "change")
    rows = {row.label: [(cell.text, cell.small) for cell in row.cells[:3]] for row in table.rows}
    assert rows["Standard deviation of PV"] == [
        ("2.000", "publ. 336"),
        ("0.5000", "publ. 90"),
        ("−75 %", "publ. −73 %"),
    ]
    assert rows["Controller travel"][2] == ("−60 %", "publ. −66 %"), "its own figures make −66, not the printed −67"
    assert rows["Settling time"] == [
        ("13 min", "publ. 4.0 h"),
        ("90.0 s", "publ. 135 s"),
        ("−89 %", "publ. −99.1 %"),
    ]
    assert rows["Oscillation index"][2] == ("−50 %", "publ. −52 %")
    assert table.rows[0].cells[4].small == "", "nothing was published of that case"


def test_a_loop_that_never_settles_has_no_change(study: Study) -> None:
    told = two(study)
    never = measured(told.cases[0], settling_time=float("inf"))
    table = before_after_table(replace(told, cases=(never, told.cases[1])))
    assert table is not None
    assert [cell.text for cell in table.rows[3].cells] == ["not in the run", "90.0 s", "–"]
    against = difference_table(replace(told, cases=(never, told.cases[1])))
    assert against is not None
    texts = [(cell.text, cell.small) for row in against.rows for cell in row.cells]
    assert ("not in the run here", "not in the run here, 4.0 h published") in texts
    assert ("33 % lower", "90.0 s here, 135 s published") in texts


def test_a_settling_time_that_is_none_to_go_by_has_no_change(study: Study) -> None:
    told = two(study)
    cycling = replace(told.cases[1], limit_cycle=study.cases[1].limit_cycle)
    table = before_after_table(replace(told, cases=(told.cases[0], cycling)))
    assert table is not None
    assert table.rows[3].cells[1].small.startswith("not for good: it cycles")
    assert table.rows[3].cells[2].text == "–"
    inside = measured(told.cases[1], settling_time=0.0)
    table = before_after_table(replace(told, cases=(told.cases[0], inside)))
    assert table is not None
    assert [cell.text for cell in table.rows[3].cells[1:]] == ["never outside", "–"]


def test_other_published_figures_do_not_ask_for_it(study: Study) -> None:
    assert before_after_table(study) is None
    told = two(study)
    alone = replace(told, cases=(told.cases[0], replace(told.cases[1], reference={})))
    assert before_after_table(alone) is None
