"""Files are written whole, and all or none."""

from __future__ import annotations

from pathlib import Path

import pytest

from workbench.errors import OutputError
from workbench.report.files import write_files


def test_nothing_is_renamed_before_everything_is_written(tmp_path: Path) -> None:
    folder = tmp_path / "new" / "sub"
    write_files({"a.txt": "ä\n", "b.txt": "1"}, folder)
    assert (folder / "a.txt").read_bytes() == "ä\n".encode()
    (folder / "c.txt").mkdir()
    with pytest.raises(OutputError, match=r"c\.txt: is a folder where a file is to be written; move it away"):
        write_files({"a.txt": "2", "c.txt": "2"}, folder)
    with pytest.raises(UnicodeEncodeError):
        write_files({"a.txt": "3", "b.txt": "\ud800"}, folder)
    assert sorted(p.name for p in folder.iterdir()) == ["a.txt", "b.txt", "c.txt"]
    assert (folder / "a.txt").read_text(encoding="utf-8") == "ä\n"


def test_a_folder_that_cannot_be_made_is_one_message(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(OutputError, match=r"cannot be written \(a part of this path is a file, not a folder\)"):
        write_files({"a.txt": "1"}, tmp_path / "file" / "sub")


def test_a_folder_made_in_vain_is_removed(tmp_path: Path) -> None:
    with pytest.raises(UnicodeEncodeError):
        write_files({"a.txt": "\ud800"}, tmp_path / "new")
    assert list(tmp_path.iterdir()) == []
