"""Text cut by blocks: the same cells and lines as one by one, or none at all."""

from __future__ import annotations

import csv
import io
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import workbench as wb
from workbench.errors import RecordError
from workbench.record import csv_file
from workbench.record.blocks import Block

cells = st.text(st.sampled_from('a1. "\r\n;,\x0b\x85\u20ac\u2028'), max_size=3) | st.sampled_from(
    ["12.5", " 3", "Ω", ""]
)
ends = st.sampled_from(["\n", "\n", "\r\n", "\r", "\n\n", ""])


@given(st.lists(st.tuples(st.lists(cells, min_size=3, max_size=3), ends)), st.sampled_from(",; "))
def test_a_block_has_the_cells_of_csv_or_none(rows: list[tuple[list[str], str]], mark: str) -> None:
    text = "".join(mark.join(row) + end for row, end in rows)
    block = Block(text, 7)
    assert block.numbers.tolist() == [7 + k for k in range(len(list(io.StringIO(text, newline=""))))]
    cut = block.columns(mark, 3, [0, 2])
    if cut is not None:
        reader = csv.reader(io.StringIO(text, newline=""), delimiter=mark, skipinitialspace=True)
        listed = list(reader)
        assert [[row[0], row[2]] for row in listed] == [list(row) for row in zip(*cut, strict=True)]
        assert all(len(row) == 3 for row in listed)
        assert len(listed) == block.numbers.size


@given(st.lists(st.tuples(st.text(st.sampled_from('ab1", \u20ac\x0b'), max_size=6), ends), max_size=12))
def test_lines_in_which_a_word_is_are_those_of_a_search_line_by_line(rows: list[tuple[str, str]]) -> None:
    text = "".join(line + end for line, end in rows)
    pattern = re.compile("ab|b1")
    lines = list(io.StringIO(text, newline=""))
    block = Block(text, 1)
    part = block.having(pattern)
    own = [(k, line) for k, line in enumerate(lines, 1) if pattern.search(line)]
    if part is not block:
        assert list(zip(part.numbers.tolist(), part.lines(), strict=True)) == own
    else:
        assert any('"' in line or "\r" in line for line in lines)


def test_even_lines_are_cut() -> None:
    """What the tests above hold is no more than "none": here cells there must be."""
    for end in ("\n", "\r\n"):
        for text in ("1,2,3", "1, 2,x\u20ac", ",,", "1 2,Ω,"):
            whole = end.join([text] * 3)
            for block in (whole, whole + end):
                row = [cell.lstrip(" ") for cell in text.split(",")]
                assert Block(block, 1).columns(",", 3, [0, 1, 2]) == [[cell] * 3 for cell in row]
    assert Block('"1"," 2",3\n"",,"x"\n', 1).columns(",", 3, [0, 1, 2]) == [["1", ""], [" 2", ""], ["3", "x"]]
    for text in ("1,2,3\n1,2\n1,2,3,4\n", "1,2,3\n\n", '1,"2,3\n', '1, "2",3\n', '1,"2""",3\n', "1,2,3\r1,2,3\n"):
        assert Block(text, 1).columns(",", 3, [0]) is None


@pytest.mark.parametrize("block", [100, 1 << 18])
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_a_file_is_read_by_blocks_as_row_by_row(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, block: int, end: str
) -> None:
    rng = np.random.default_rng(5)
    rows = [f"{k},{50 + rng.normal():.3f},{40 + rng.normal():.2f},x" for k in range(500)]
    odd = {
        100: '100,"50.5",40,a remark',
        150: '150,50,40,"over\ntwo lines"',
        200: "200,50.1",
        250: "",
        300: "300,50,1,40,x",
        350: "350, 50.2, Bad Input ,\u20ac",
        400: '400,="50.3",40,',
        450: "450,50,40,x,",
    }
    text = end.join(["t,PV,OP,note", *(odd.get(k, row) for k, row in enumerate(rows))])
    (tmp_path / "x.csv").write_text(text, encoding="utf-8", newline="")
    monkeypatch.setattr(csv_file, "_BLOCK", block)
    by_blocks = wb.read_record(tmp_path / "x.csv")
    monkeypatch.setattr(Block, "columns", lambda *_: None)
    by_rows = wb.read_record(tmp_path / "x.csv")
    assert np.array_equal(by_blocks.pv, by_rows.pv)
    assert np.array_equal(by_blocks.time, by_rows.time)
    assert by_blocks.notes == by_rows.notes
    assert by_blocks.counts == by_rows.counts
    assert any("line 303" in note for note in by_rows.notes)


def test_an_open_quote_is_refused_with_its_line_after_many_blocks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(csv_file, "_BLOCK", 200)
    rows = [f"{k},{k % 7},{k % 5},{chr(34) if k == 900 else ''}x" for k in range(1000)]
    (tmp_path / "x.csv").write_text("\n".join(["t,PV,OP,note", *rows]))
    with pytest.raises(RecordError, match=r"line 902, column 'note': a quote .* up to line 1001; close it"):
        wb.read_record(tmp_path / "x.csv")
