"""Reports print to clean A4 pages, from a real browser (conftest.py)."""

from __future__ import annotations

import re
import zlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from workbench.model.study import Study
from workbench.report.compare import comparison
from workbench.report.compare_page import comparison_page
from workbench.report.compared import read_all
from workbench.report.page import write_report

A4 = (595.0, 842.0)  # points
MILLIMETRE = 96.0 / 25.4  # CSS pixels
BODY = (182.0, 267.0)  # mm of A4 within the page's margins
SHIPPED = Path(__file__).parents[2] / "reports"

pytestmark = pytest.mark.slow
Make = Callable[..., Any]


def opened(browser: Any, path: Path) -> Any:
    page = browser.new_page(viewport={"width": round(BODY[0] * MILLIMETRE), "height": round(BODY[1] * MILLIMETRE)})
    page.goto(path.as_uri())
    return page


def content_streams(pdf: bytes) -> list[bytes]:
    """Return what each page of a PDF by Chromium draws, in order."""
    objects = {int(m[1]): m.start() for m in re.finditer(rb"\n(\d+) 0 obj\n", pdf)}
    streams = []
    for page in re.finditer(rb"/Type /Page\n.*?/Contents (\d+) 0 R", pdf, re.DOTALL):
        begin = pdf.index(b"stream\n", objects[int(page[1])]) + len(b"stream\n")
        streams.append(zlib.decompress(pdf[begin : pdf.index(b"\nendstream", begin)]))
    return streams


def clean(pdf: bytes) -> int:
    """Return the number of pages, after looking at each: A4, and more than a line of letters on it."""
    boxes = re.findall(rb"/MediaBox \[0 0 ([\d.]+) ([\d.]+)\]", pdf)
    streams = content_streams(pdf)
    assert len(streams) == len(boxes) > 0
    for width, height in boxes:
        assert (float(width), float(height)) == pytest.approx(A4, abs=1.0)
    for number, stream in enumerate(streams, 1):
        shown = len(re.findall(rb"\bT[jJ]\b", stream))
        assert shown > 100, f"page {number} of {len(streams)} holds its number and next to nothing else"
    return len(streams)


def printed(page: Any) -> bytes:
    pdf: bytes = page.pdf(prefer_css_page_size=True, print_background=False)
    return pdf


def test_a_report_prints_to_clean_pages(written: Path, browser: Any) -> None:
    page = opened(browser, written / "report.html")
    assert 5 <= clean(printed(page)) <= 12
    page.close()


def test_a_longer_report_takes_more_pages_and_none_is_empty(
    study: Study, case: Make, browser: Any, tmp_path: Path
) -> None:
    told = replace(study, estimates=(), scenario_text="title: A study made for tests\n" * 12)
    many = [replace(case(f"Case {i}", 0.5 + 0.05 * i, 20.0), note="A note. " * 20) for i in range(4)]
    write_report(replace(told, cases=tuple(many)), tmp_path)
    page = opened(browser, tmp_path / "report.html")
    longer = clean(printed(page))
    page.close()
    write_report(replace(told, cases=tuple(many[:1])), tmp_path)
    page = opened(browser, tmp_path / "report.html")
    assert clean(printed(page)) < longer
    page.close()


@pytest.mark.parametrize("name", ["robust_retune", "loop_2_reflux"])
def test_shipped_reports_print_with_nothing_cut(name: str, browser: Any) -> None:
    page = opened(browser, SHIPPED / name / "report.html")
    clean(printed(page))
    page.emulate_media(media="print")
    # What must not be cut fits on a page, and nothing hangs out at the side.
    sizes = page.eval_on_selector_all(
        "figure, .pair, .scroll:not(.long), tr, pre",
        "all => all.map(e => [e.tagName, e.scrollWidth, e.tagName === 'PRE' ? 0 : e.getBoundingClientRect().height])",
    )
    assert len(sizes) > 10
    for tag, width, height in sizes:
        assert width <= BODY[0] * MILLIMETRE + 1.0, (tag, width)
        assert height <= BODY[1] * MILLIMETRE, (tag, height)
    assert page.evaluate("getComputedStyle(document.querySelector('.summary')).backgroundColor") == "rgba(0, 0, 0, 0)"
    headings = page.eval_on_selector_all("h2, h3", "all => all.map(e => getComputedStyle(e).breakAfter)")
    assert set(headings) == {"avoid"}
    page.close()


def test_a_comparison_of_many_cases_stays_on_the_screen_and_on_the_paper(browser: Any, tmp_path: Path) -> None:
    results, notes = read_all([SHIPPED / "which_tunings_cycle", SHIPPED / "table_2"])
    found = comparison(results, notes=notes)
    assert len(found.lines) == 13
    (tmp_path / "compare.html").write_text(comparison_page(found), encoding="utf-8")
    page = opened(browser, tmp_path / "compare.html")
    clean(printed(page))
    wide = "all => all.map(e => e.scrollWidth - e.clientWidth)"
    page.emulate_media(media="print")
    assert max(page.eval_on_selector_all(".scroll", wide)) <= 1
    page.emulate_media(media="screen")
    page.set_viewport_size({"width": 1300, "height": 900})
    assert max(page.eval_on_selector_all(".scroll", wide)) <= 1
    page.close()
