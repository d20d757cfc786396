"""Files written whole: beside their place first, then renamed, so that an interrupted run leaves the last good ones."""

from __future__ import annotations

import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from workbench.errors import OutputError

__all__ = ["write_files"]


def write_files(files: Mapping[str, str], folder: Path) -> None:
    """Write texts (UTF-8) under their names into `folder`, which is made where it is missing; none unless all.

    Nothing is renamed before everything is written. Raises `OutputError` where the folder cannot be written.
    """
    spares: list[tuple[Path, Path]] = []
    made = not folder.exists()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name in files:
            # Found out before the first file is renamed, else half of the result would be new.
            if (folder / name).is_dir():
                raise OutputError(f"{folder / name}: is a folder where a file is to be written; move it away")
        for name, text in files.items():
            target = folder / name
            spare = folder / f".{name}.{os.getpid()}.tmp"
            spares.append((spare, target))
            with spare.open("w", encoding="utf-8", newline="\n") as out:
                out.write(text)
        for spare, target in spares:
            spare.replace(target)
    except OSError as error:
        if isinstance(error, OutputError):
            raise
        reason = error.strerror or str(error)
        if isinstance(error, FileExistsError | NotADirectoryError):
            reason = "a part of this path is a file, not a folder"
        raise OutputError(f"{folder}: cannot be written ({reason})") from error
    finally:
        for spare, _ in spares:
            # What was renamed is gone; what is left belongs to a run that failed.
            with suppress(OSError):
                spare.unlink(missing_ok=True)
        if made and folder.is_dir() and not any(folder.iterdir()):
            folder.rmdir()
